//! Baked links kept between runs; a file is used only if its hash is right.
//!
//! A file is named by the hash of everything that made it: shapes, bytes of the mesh files, how to
//! bake, and the versions of the code that does. So a change of any gives another name, and what is
//! stale is never looked up. Within, a hash of name and content tells what is broken, cut
//! off or renamed; it is then baked again. Writing is atomic, so that several processes may share
//! the folder. Nothing is ever removed: the folder may be deleted at any time.

use crate::atomic::{self, IfExists, WriteError};
use blake3::{Hash, Hasher};
use palpate::BakeConfig;
use palpate::unstable::{BAKE_VERSION, BakeReport, Collision, DistanceGrid, Shape};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Changes whenever the layout of the file or of the key does.
const CACHE_VERSION: u32 = 1;
/// A file larger than this is none of ours.
const MAX_BYTES: u64 = 1 << 29;
const REPORT_BYTES: usize = 6 * 8;

/// A folder of baked links, or none.
#[derive(Debug, Clone)]
pub(super) struct Cache {
    folder: Option<PathBuf>,
}

impl Cache {
    pub(super) fn new(folder: Option<PathBuf>) -> Self {
        Self { folder }
    }

    fn path(&self, key: &Hash) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}.link", key.to_hex())))
    }

    /// The link of that key, if it is there and whole.
    pub(super) fn get(&self, key: &Hash) -> Option<(DistanceGrid, BakeReport)> {
        let path = self.path(key)?;
        if path.metadata().ok()?.len() > MAX_BYTES {
            return None;
        }
        let bytes = std::fs::read(path).ok()?;
        let (content, seal) = bytes.split_last_chunk::<32>()?;
        if blake3::Hash::from_bytes(*seal) != sealed(key, content) {
            return None;
        }
        let (report, grid) = content.split_at_checked(REPORT_BYTES)?;
        Some((DistanceGrid::from_bytes(grid).ok()?, report_from(report)?))
    }

    /// Keeps a link. It is not an error if that fails: the reason is for a warning.
    pub(super) fn put(
        &self,
        key: &Hash,
        grid: &DistanceGrid,
        report: &BakeReport,
    ) -> Result<(), String> {
        let Some(path) = self.path(key) else { return Ok(()) };
        let mut content = report_bytes(report);
        content.extend(grid.to_bytes());
        let seal = sealed(key, &content);
        let written = make_parent(&path).and_then(|()| {
            atomic::write(&path, IfExists::Replace, |out| {
                out.write_all(&content)?;
                out.write_all(seal.as_bytes())
            })
        });
        written.map_err(|error| format!("the baked link could not be kept for next time: {error}"))
    }
}

fn make_parent(path: &Path) -> Result<(), WriteError> {
    let folder = path.parent().unwrap_or(path);
    std::fs::create_dir_all(folder).map_err(|source| WriteError::Io {
        path: folder.to_owned(),
        remedy: "choose another cache folder",
        source,
    })
}

fn sealed(key: &Hash, content: &[u8]) -> Hash {
    Hasher::new().update(key.as_bytes()).update(content).finalize()
}

fn report_bytes(report: &BakeReport) -> Vec<u8> {
    let counts = [report.triangles, report.degenerate, report.flipped];
    let shares = [report.inside_m3, report.leaked_fraction, report.sealed_fraction];
    let counts = counts.into_iter().flat_map(|count| (count as u64).to_le_bytes());
    counts.chain(shares.into_iter().flat_map(f64::to_le_bytes)).collect()
}

fn report_from(bytes: &[u8]) -> Option<BakeReport> {
    let [a, b, c, d, e, f] = *bytes.as_chunks::<8>().0.first_chunk::<6>()?;
    let count = |raw| usize::try_from(u64::from_le_bytes(raw)).ok();
    Some(BakeReport {
        triangles: count(a)?,
        degenerate: count(b)?,
        flipped: count(c)?,
        inside_m3: f64::from_le_bytes(d),
        leaked_fraction: f64::from_le_bytes(e),
        sealed_fraction: f64::from_le_bytes(f),
    })
}

/// The key of a link: `mesh_bytes` gives the content of a mesh file as the URDF spells it.
pub(super) fn key(
    shapes: &[Collision],
    config: &BakeConfig,
    mesh_version: u32,
    mut mesh_bytes: impl FnMut(&str) -> Hash,
) -> Hash {
    let mut hasher = Hasher::new();
    for version in [CACHE_VERSION, BAKE_VERSION, mesh_version] {
        hasher.update(&version.to_le_bytes());
    }
    let mut numbers = |tag: u8, numbers: &[f64]| {
        hasher.update(&[tag]);
        numbers.iter().for_each(|number| {
            hasher.update(&number.to_bits().to_le_bytes());
        });
    };
    numbers(0, &[config.spacing_m, config.margin_m]);
    for Collision { link_from_shape: pose, shape } in shapes {
        numbers(1, pose.translation.vector.as_slice());
        numbers(2, pose.rotation.coords.as_slice());
        match shape {
            Shape::Box { size_m } => numbers(3, size_m.as_slice()),
            Shape::Cylinder { radius_m, length_m } => numbers(4, &[*radius_m, *length_m]),
            Shape::Sphere { radius_m } => numbers(5, &[*radius_m]),
            Shape::Capsule { radius_m, length_m } => numbers(6, &[*radius_m, *length_m]),
            Shape::Mesh { filename, scale } => {
                numbers(7, scale.as_slice());
                // The ending says how to read the bytes.
                let ending = Path::new(filename).extension().unwrap_or_default();
                let ending = ending.to_string_lossy().to_ascii_lowercase();
                for byte in mesh_bytes(filename).as_bytes().iter().chain(ending.as_bytes()) {
                    numbers(*byte, &[]);
                }
            }
        }
    }
    hasher.finalize()
}
