//! Loads robots: a built-in one by its name, or a URDF with its meshes.
//!
//! | file      | content                                          |
//! |-----------|--------------------------------------------------|
//! | `find`    | search for mesh files, such as `package://` URLs |
//! | `mesh`    | triangles of STL, OBJ and, with `dae`, COLLADA   |
//! | `xml`     | XML parsing with limited depth                   |
//! | `inertia` | writing masses and inertias into a URDF          |
//! | `cache`   | cache of baked links between runs                |
//!
//! The crate `palpate` interprets the URDF and bakes the shapes.

mod cache;
mod dae;
mod find;
mod inertia;
mod mesh;
mod xml;

use crate::input;
use blake3::Hash;
use cache::Cache;
use find::Search;
pub use inertia::with_inertia;
use palpate::unstable::{BakeReport, DistanceGrid, Link, Shape, bake, solid};
use palpate::{Arm, ArmError, BakeConfig, Robot, RobotError};
use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};

/// Folder in which baked links are kept between runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum CachePlace {
    /// `PALPATE_CACHE_DIR` if it is set, else the user's cache folder.
    #[default]
    User,
    /// The given folder.
    At(PathBuf),
    /// No cache.
    Off,
}

impl CachePlace {
    /// The folder; `None` without a cache.
    #[must_use]
    pub fn folder(&self) -> Option<PathBuf> {
        match self {
            Self::At(folder) => Some(folder.clone()),
            Self::Off => None,
            Self::User => match std::env::var_os("PALPATE_CACHE_DIR").filter(|dir| !dir.is_empty())
            {
                Some(folder) => Some(folder.into()),
                None => directories::ProjectDirs::from("", "", "palpate")
                    .map(|dirs| dirs.cache_dir().join("links")),
            },
        }
    }
}

/// Options for loading a robot.
#[derive(Debug, Clone, Default)]
pub struct ArmOptions {
    /// Folders of packages (the package or its parent folder) for `package://`; searched first.
    pub package_path: Vec<PathBuf>,
    /// Cache of baked links.
    pub cache: CachePlace,
    /// Settings for baking the links.
    pub bake: BakeConfig,
}

/// A robot with its surfaces, and how it was loaded.
#[derive(Debug, Clone)]
pub struct LoadedArm {
    /// The robot and its surfaces.
    pub arm: Arm,
    /// The URDF, `None` for a built-in robot.
    pub urdf: Option<PathBuf>,
    /// Links that have collision shapes.
    pub links: Vec<LoadedLink>,
    /// Problems that did not stop the loading.
    pub warnings: Vec<String>,
}

/// How the surface of a link was loaded.
#[derive(Debug, Clone)]
pub struct LoadedLink {
    /// Name of the link.
    pub name: String,
    /// Whether the surface was read from the cache.
    pub cached: bool,
    /// Mesh files of the link.
    pub meshes: Vec<PathBuf>,
    /// Report of the baking, also for a cached link.
    pub report: BakeReport,
}

/// What can be wrong with the files of a robot.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RobotFileError {
    /// Neither the name of a built-in robot nor an existing file.
    #[error("there is no robot `{name}`: neither a URDF of that path nor a built-in one ({known})")]
    Unknown { name: String, known: String },
    /// The operating system reported an error, or the path is not a regular file.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// A xacro that must be expanded to a URDF first.
    #[error("`{path}` is a xacro, not a URDF; expand it first: `xacro {path} > robot.urdf`")]
    Xacro { path: PathBuf },
    /// An invalid URDF.
    #[error("`{path}`: {source}")]
    Urdf { path: PathBuf, source: RobotError },
    /// A mesh file that was not found.
    #[error("link `{link}` needs the mesh `{written}`, which was not found; looked for {looked}")]
    NoMesh { link: String, written: String, looked: String },
    /// A broken mesh file.
    #[error("link `{link}`: the mesh `{path}` {reason}")]
    Mesh { link: String, path: PathBuf, reason: String },
    /// Shapes that cannot be baked.
    #[error("`{name}`: {source}")]
    Arm { name: String, source: ArmError },
}

/// Loads a built-in robot by its name, or a URDF by its path, and bakes its links.
///
/// # Errors
///
/// [`RobotFileError`]. A cache that cannot be read or written is not an error, but at most a
/// warning.
pub fn load_arm(name_or_path: &str, options: &ArmOptions) -> Result<LoadedArm, RobotFileError> {
    let path = Path::new(name_or_path);
    let (robot, urdf) = match Robot::built_in(name_or_path) {
        Some(robot) => (robot, None),
        None => (read_urdf(path)?, Some(path.to_owned())),
    };
    let folder = urdf.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
    let folder = std::path::absolute(folder.join(".")).unwrap_or_else(|_| folder.to_owned());
    let (cache, unused) = Cache::open(options.cache.folder());
    let mut baker = Baker {
        search: Search::new(&folder, &options.package_path),
        cache,
        config: options.bake,
        warnings: unused.into_iter().collect(),
    };
    let (mut surfaces, mut links) = (Vec::new(), Vec::new());
    for link in robot.links() {
        let baked = baker.link(link, name_or_path)?;
        let (grid, loaded) = baked.unzip();
        surfaces.push(grid);
        links.extend(loaded);
    }
    let arm = Arm::new(robot, surfaces)
        .map_err(|source| RobotFileError::Arm { name: name_or_path.to_owned(), source })?;
    Ok(LoadedArm { arm, urdf, links, warnings: baker.warnings })
}

fn read_urdf(path: &Path) -> Result<Robot, RobotFileError> {
    if !path.exists() {
        let known = Robot::built_in_names().collect::<Vec<_>>().join(", ");
        return Err(RobotFileError::Unknown { name: path.display().to_string(), known });
    }
    let text = String::from_utf8_lossy(&read_file(path)?).into_owned();
    let is_xacro = path.extension().is_some_and(|ending| ending == "xacro");
    if is_xacro || text.contains("<xacro:") {
        return Err(RobotFileError::Xacro { path: path.to_owned() });
    }
    Robot::from_urdf(text.trim_start_matches('\u{feff}'))
        .map_err(|source| RobotFileError::Urdf { path: path.to_owned(), source })
}

/// Reads a whole file.
fn read_file(path: &Path) -> Result<Vec<u8>, RobotFileError> {
    input::read(path, u64::MAX)
        .map_err(|source| RobotFileError::Io { path: path.to_owned(), source })
}

/// Bakes links to surfaces, using the cache.
struct Baker {
    search: Search,
    cache: Cache,
    config: BakeConfig,
    warnings: Vec<String>,
}

/// The bytes of a mesh file.
struct MeshFile {
    path: PathBuf,
    bytes: Vec<u8>,
    hash: Hash,
}

impl Baker {
    /// The surface of a link from the cache, or baked; `None` if it has no shapes.
    fn link(
        &mut self,
        link: &Link,
        robot: &str,
    ) -> Result<Option<(DistanceGrid, LoadedLink)>, RobotFileError> {
        if link.collision.is_empty() {
            return Ok(None);
        }
        let files = self.mesh_files(link)?;
        let hash_of = |written: &str| files[written].hash;
        let key = cache::key(&link.collision, &self.config, hash_of);
        let mut meshes: Vec<PathBuf> = files.values().map(|file| file.path.clone()).collect();
        meshes.sort();
        if let Some((grid, report)) = self.cache.get(&key) {
            let loaded = LoadedLink { name: link.name.clone(), cached: true, meshes, report };
            return Ok(Some((grid, loaded)));
        }
        let load = |written: &str| {
            let file = &files[written];
            mesh::read(&file.bytes, &file.path).map_err(Into::into)
        };
        let failed = |source| RobotFileError::Arm { name: robot.to_owned(), source };
        let broken_mesh = |error| match error {
            ArmError::Mesh { link, filename, reason } => {
                let path = files[&filename].path.clone();
                RobotFileError::Mesh { link, path, reason: reason.to_string() }
            }
            other => failed(other),
        };
        let Some(solid) = solid(link, load).map_err(broken_mesh)? else { return Ok(None) };
        let (grid, report) = bake(&solid, &self.config)
            .map_err(|reason| failed(ArmError::Shape { link: link.name.clone(), reason }))?;
        if let Err(warning) = self.cache.put(&key, &grid, &report)
            && self.warnings.is_empty()
            && !meshes.is_empty()
        {
            // One warning is enough: the others would be equal. Without meshes, baking is fast
            // anyway.
            self.warnings.push(warning);
        }
        let loaded = LoadedLink { name: link.name.clone(), cached: false, meshes, report };
        Ok(Some((grid, loaded)))
    }

    /// The mesh files of a link, by their names in the URDF.
    fn mesh_files(&self, link: &Link) -> Result<HashMap<String, MeshFile>, RobotFileError> {
        let mut files = HashMap::new();
        for part in &link.collision {
            let Shape::Mesh { filename: written, .. } = &part.shape else { continue };
            if files.contains_key(written) {
                continue;
            }
            let path = self.search.find(written).map_err(|looked| {
                let looked: Vec<String> =
                    looked.iter().take(6).map(|path| format!("`{}`", path.display())).collect();
                let looked = match looked.as_slice() {
                    [] => "no file: copy it to a file beside the URDF, and name that in the URDF"
                        .to_owned(),
                    places => places.join(", "),
                };
                let (link, written) = (link.name.clone(), written.clone());
                RobotFileError::NoMesh { link, written, looked }
            })?;
            let bytes = read_file(&path)?;
            let hash = blake3::hash(&bytes);
            files.insert(written.clone(), MeshFile { path, bytes, hash });
        }
        Ok(files)
    }
}
