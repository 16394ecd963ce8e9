//! Baked links kept between runs; a file is used only if its hash is right.
//!
//! A file is named by the hash of everything that made it: shapes, bytes of the mesh files, how to
//! bake, and the versions of the code that does. So a change of any gives another name, and what is
//! stale is never looked up. Within, a hash of name and content shows what is broken, cut
//! off or renamed; it is then baked again. Whoever may write could seal another link, so that only a
//! folder of one's own is used. Writing is atomic, so that several processes may share the folder.
//! Nothing is ever removed: the folder may be deleted at any time.

use super::mesh::MESH_VERSION;
use crate::atomic::{self, WriteError};
use crate::input;
use blake3::{Hash, Hasher};
use palpate::BakeConfig;
use palpate::unstable::{BAKE_VERSION, BakeReport, Collision, DistanceGrid, Shape};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Changes whenever the layout of the file or of the key does.
const CACHE_VERSION: u32 = 2;
/// A file larger than this is none of ours.
const MAX_BYTES: u64 = 1 << 29;

/// A folder of baked links, or none.
#[derive(Debug, Clone)]
pub(super) struct Cache {
    pub(super) folder: Option<PathBuf>,
}

impl Cache {
    /// The cache in a folder, if others cannot write to it; else the second is why not.
    pub(super) fn open(folder: Option<PathBuf>) -> (Self, Option<String>) {
        match folder {
            Some(folder) if input::is_ones_own(&folder).is_ok_and(|own| !own) => {
                let why = format!(
                    "the cache folder `{}` is not used: it belongs to another user, or others may \
                     write to it; choose another one (--cache-dir), or take their right away \
                     (chmod go-w)",
                    folder.display()
                );
                (Self { folder: None }, Some(why))
            }
            folder => (Self { folder }, None),
        }
    }

    fn path(&self, key: &Hash) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}.link", key.to_hex())))
    }

    /// The link of that key, if it is there and whole.
    pub(super) fn get(&self, key: &Hash) -> Option<(DistanceGrid, BakeReport)> {
        let path = self.path(key)?;
        let bytes = input::read(&path, MAX_BYTES).ok()?;
        if !input::is_ones_own(path.parent()?).ok()? {
            return None; // it was made meanwhile
        }
        let (content, seal) = bytes.split_last_chunk::<32>()?;
        if blake3::Hash::from_bytes(*seal) != sealed(key, content) {
            return None;
        }
        // The report is a line of JSON, the grid what follows it.
        let mut parts = content.splitn(2, |&byte| byte == b'\n');
        let report = serde_json::from_slice(parts.next()?).ok()?;
        Some((DistanceGrid::from_bytes(parts.next()?).ok()?, report))
    }

    /// Keeps a link. It is not an error if that fails: the reason is for a warning.
    pub(super) fn put(
        &self,
        key: &Hash,
        grid: &DistanceGrid,
        report: &BakeReport,
    ) -> Result<(), String> {
        let Some(path) = self.path(key) else { return Ok(()) };
        let mut content = serde_json::to_vec(report).expect("a report is plain data");
        content.push(b'\n');
        content.extend(grid.to_bytes());
        let seal = sealed(key, &content);
        let written = make_parent(&path).and_then(|()| {
            atomic::write(&path, |out| {
                out.write_all(&content)?;
                out.write_all(seal.as_bytes())
            })
        });
        written.map_err(|error| format!("the baked link could not be kept for next time: {error}"))
    }
}

fn make_parent(path: &Path) -> Result<(), WriteError> {
    let folder = path.parent().unwrap_or(path);
    let mut builder = std::fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.recursive(true).create(folder).map_err(|source| WriteError::Io {
        path: folder.to_owned(),
        remedy: "choose another cache folder",
        source,
    })
}

fn sealed(key: &Hash, content: &[u8]) -> Hash {
    Hasher::new().update(key.as_bytes()).update(content).finalize()
}

/// The key of a link: `mesh_bytes` gives the hash of a mesh file as the URDF spells it.
pub(super) fn key(
    shapes: &[Collision],
    config: &BakeConfig,
    mesh_bytes: impl Fn(&str) -> Hash,
) -> Hash {
    let mut hasher = Hasher::new();
    let mut shapes = shapes.to_vec();
    for part in &mut shapes {
        if let Shape::Mesh { filename, .. } = &mut part.shape {
            hasher.update(mesh_bytes(filename).as_bytes());
            // Of its name only the ending matters, which says how to read it.
            let ending = Path::new(filename).extension().unwrap_or_default();
            *filename = ending.to_string_lossy().to_ascii_lowercase();
        }
    }
    // As `Debug` writes them: all that there is to a shape, and every number to the last bit.
    let inputs = format!("{CACHE_VERSION} {BAKE_VERSION} {MESH_VERSION} {config:?} {shapes:?}");
    hasher.update(inputs.as_bytes()).finalize()
}
