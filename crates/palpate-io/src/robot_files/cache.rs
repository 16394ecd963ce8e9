//! Cache of baked links between runs; a file is used only if its hash is right.
//!
//! The name of a file is the hash of everything that it depends on: shapes, bytes of the mesh files,
//! settings of the baking, and versions of the code. After any change the name differs, so outdated
//! files are never used. A second hash in the file, of name and content, detects files that are
//! broken, truncated or renamed; the link is then baked again. Anyone who may write to the folder
//! could forge this hash, so only a folder that other users cannot write to is used. Writing is
//! atomic, so several processes can share the folder. Nothing is ever removed: the folder may be
//! deleted at any time.

use super::mesh::MESH_VERSION;
use crate::atomic::{self, WriteError};
use crate::input;
use blake3::{Hash, Hasher};
use palpate::BakeConfig;
use palpate::unstable::{BAKE_VERSION, BakeReport, Collision, DistanceGrid, Shape};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Part of every cache key; to be increased whenever the layout of the file or of the key changes.
const CACHE_VERSION: u32 = 2;
/// Largest size of a cache file, bytes; a larger file is ignored.
const MAX_BYTES: u64 = 1 << 29;

/// A folder of baked links, or no cache.
#[derive(Debug, Clone)]
pub(super) struct Cache {
    pub(super) folder: Option<PathBuf>,
}

impl Cache {
    /// The cache in a folder. If other users can write to it, no cache, and a warning with the reason.
    pub(super) fn open(folder: Option<PathBuf>) -> (Self, Option<String>) {
        match folder {
            Some(folder) if input::is_private_to_user(&folder).is_ok_and(|own| !own) => {
                let why = format!(
                    "the cache folder `{}` is not used: it belongs to another user, or others may \
                     write to it; choose another one (--cache-dir), or remove their right to \
                     write (chmod go-w)",
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

    /// The link with this key, if its file exists and is intact.
    pub(super) fn get(&self, key: &Hash) -> Option<(DistanceGrid, BakeReport)> {
        let path = self.path(key)?;
        let bytes = input::read(&path, MAX_BYTES).ok()?;
        if !input::is_private_to_user(path.parent()?).ok()? {
            return None; // the folder was created by another user after `open`
        }
        let (content, seal) = bytes.split_last_chunk::<32>()?;
        if blake3::Hash::from_bytes(*seal) != sealed(key, content) {
            return None;
        }
        // The report is one line of JSON; the grid follows.
        let mut parts = content.splitn(2, |&byte| byte == b'\n');
        let report = serde_json::from_slice(parts.next()?).ok()?;
        Some((DistanceGrid::from_bytes(parts.next()?).ok()?, report))
    }

    /// Stores a link. The error is the text of a warning: the link can be used without the cache.
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
        written.map_err(|error| format!("the baked link could not be stored in the cache: {error}"))
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

/// The key of a link; `mesh_bytes` returns the hash of a mesh file by its name in the URDF.
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
            // Only the extension of its name matters, which gives the format.
            let ending = Path::new(filename).extension().unwrap_or_default();
            *filename = ending.to_string_lossy().to_ascii_lowercase();
        }
    }
    // `Debug` output contains all fields of a shape, and every number exactly.
    let inputs = format!("{CACHE_VERSION} {BAKE_VERSION} {MESH_VERSION} {config:?} {shapes:?}");
    hasher.update(inputs.as_bytes()).finalize()
}
