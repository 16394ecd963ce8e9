//! Robots from files: a built-in one by its name, or a URDF with its meshes.
//!
//! | file    | says                                             |
//! |---------|--------------------------------------------------|
//! | `find`  | where the file is that a URDF calls `package://` |
//! | `mesh`  | triangles of STL, OBJ and, by `dae`, COLLADA     |
//! | `xml`   | documents of bounded depth                       |
//! | `inertia` | a URDF with other masses                       |
//! | `cache` | baked links kept between runs                    |
//!
//! What the numbers of a URDF mean and how a shape is baked is the core's business.

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

/// Where baked links are kept between runs.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum CachePlace {
    /// `PALPATE_CACHE_DIR` if it is set, else the user's cache folder.
    #[default]
    User,
    /// This folder.
    At(PathBuf),
    /// Nowhere.
    Off,
}

impl CachePlace {
    /// The folder, if there is to be one.
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

/// How to load a robot.
#[derive(Debug, Clone, Default)]
pub struct ArmOptions {
    /// Folders that hold packages, or are one, for `package://`; searched first.
    pub package_path: Vec<PathBuf>,
    /// Where baked links are kept.
    pub cache: CachePlace,
    /// How to bake.
    pub bake: BakeConfig,
}

/// A robot ready to touch, and how it came about.
#[derive(Debug, Clone)]
pub struct LoadedArm {
    /// The robot and its surfaces.
    pub arm: Arm,
    /// The URDF, `None` for a built-in robot.
    pub urdf: Option<PathBuf>,
    /// One for each link that has shapes.
    pub links: Vec<LoadedLink>,
    /// What went wrong without harm.
    pub warnings: Vec<String>,
}

/// How the surface of a link came about.
#[derive(Debug, Clone)]
pub struct LoadedLink {
    /// Name of the link.
    pub name: String,
    /// Whether it came from the cache.
    pub cached: bool,
    /// Its mesh files.
    pub meshes: Vec<PathBuf>,
    /// What baking found out, then or now.
    pub report: BakeReport,
}

/// What can be wrong with the files of a robot.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RobotFileError {
    /// Neither a name nor a file.
    #[error("there is no robot `{name}`: neither a URDF of that path nor a built-in one ({known})")]
    Unknown { name: String, known: String },
    /// The system refused to read, or the file is no such file.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// A URDF that still has to be made.
    #[error("`{path}` is a xacro, not a URDF; expand it first: `xacro {path} > robot.urdf`")]
    Xacro { path: PathBuf },
    /// A URDF that is wrong.
    #[error("`{path}`: {source}")]
    Urdf { path: PathBuf, source: RobotError },
    /// A mesh that is nowhere.
    #[error("link `{link}` wants the mesh `{written}`, which is not there; looked for {looked}")]
    NoMesh { link: String, written: String, looked: String },
    /// A mesh that is broken.
    #[error("link `{link}`: the mesh `{path}` {reason}")]
    Mesh { link: String, path: PathBuf, reason: String },
    /// Shapes that cannot be baked.
    #[error("`{name}`: {source}")]
    Arm { name: String, source: ArmError },
}

/// Loads a robot by the name of a built-in one or the path of a URDF, and bakes its links.
///
/// # Errors
///
/// [`RobotFileError`]; a cache that cannot be read or written is none, but a warning at most.
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

/// Turns links into surfaces.
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
            // One is enough, the others fail alike; without meshes, baking is quick anyway.
            self.warnings.push(warning);
        }
        let loaded = LoadedLink { name: link.name.clone(), cached: false, meshes, report };
        Ok(Some((grid, loaded)))
    }

    /// The mesh files of a link by their names in the URDF.
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
                    [] => "no place: copy it to a file beside the URDF".to_owned(),
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
