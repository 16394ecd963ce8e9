//! Coloured clouds: what a camera saw of the object, as PLY or PCD.
//!
//! | file            | is                                                                |
//! |-----------------|-------------------------------------------------------------------|
//! | `ply`, `pcd`    | a header of text that names the numbers of a row, and their bytes |
//! | `rows`          | the same for both: which numbers are a point, which its colour    |
//! | `lzf`           | what PCD's `binary_compressed` unpacks                            |
//! | `write`         | the way out: points, colours, any more columns                    |
//! | `truth`         | what a simulation knows of every point, for checking              |
//!
//! Both formats are read by code of our own, not by a library. They are one thing in two dialects,
//! so that one decoder serves both; `ply-rs-bw` is sound but brings a parser generator and hands
//! over each number by name, and `pcd-rs` allocates what a header claims. Nothing here is
//! allocated before the file's own length has confirmed it.

mod lzf;
mod pcd;
mod ply;
mod rows;
mod truth;
mod write;

use crate::atomic::WriteError;
use nalgebra::Point3;
use std::io;
use std::path::{Path, PathBuf};

pub use truth::{PointTruth, read_point_truth};
pub use write::{Column, write_pcd, write_ply};

/// What can be wrong with a cloud.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum CloudError {
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// Neither of the two formats.
    #[error("`{path}` is no cloud: it begins with {found}; wanted a PLY or PCD file")]
    NotCloud { path: PathBuf, found: String },
    /// A header that says too little, or contradicts itself.
    #[error("`{path}` has a header that cannot be used, line {line}: {reason}")]
    Header { path: PathBuf, line: usize, reason: String },
    /// A cloud without coordinates.
    #[error(
        "`{path}` holds no points: wanted the numbers x, y and z of {of}, found {found}; export it \
         with positions"
    )]
    NoPositions { path: PathBuf, of: &'static str, found: String },
    /// Fewer bytes than promised.
    #[error(
        "`{path}` is truncated: it holds {held} of the {promised} {unit} that its header promises; \
         copy it again"
    )]
    Truncated { path: PathBuf, held: u64, promised: u64, unit: String },
    /// A number that cannot be what it is called.
    #[error("`{path}`: {place} is {found}; wanted {wanted}")]
    Value { path: PathBuf, place: String, found: String, wanted: &'static str },
    /// Nothing to see.
    #[error("`{path}` holds no finite point; {dropped} that are not finite were dropped")]
    Empty { path: PathBuf, dropped: usize },
    /// Compressed bytes that do not unpack to what was promised.
    #[error("`{path}` is damaged: {reason}; copy it again")]
    Damaged { path: PathBuf, reason: String },
}

/// Points in the world frame, each with a colour or none of them.
///
/// Every coordinate is finite.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cloud {
    points: Vec<Point3<f64>>,
    colours: Option<Vec<[u8; 3]>>,
}

impl Cloud {
    /// A cloud of points, m, and their colours (red, green, blue).
    ///
    /// # Panics
    ///
    /// If there are not as many colours as points, or a coordinate is not finite: whoever makes a
    /// cloud has checked that. [`read()`] drops such points and counts them.
    #[must_use]
    pub fn new(points: Vec<Point3<f64>>, colours: Option<Vec<[u8; 3]>>) -> Self {
        assert!(colours.as_ref().is_none_or(|c| c.len() == points.len()), "one colour a point");
        let is_finite = |point: &Point3<f64>| point.iter().all(|number| number.is_finite());
        assert!(points.iter().all(is_finite), "every coordinate is finite");
        Self { points, colours }
    }

    /// The points, m, world frame.
    #[must_use]
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Red, green and blue of each point, if the cloud has colours.
    #[must_use]
    pub fn colours(&self) -> Option<&[[u8; 3]]> {
        self.colours.as_deref()
    }

    /// How many points there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// A cloud as it came from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The finite points, in the order of the file.
    pub cloud: Cloud,
    /// Rows of the file, counted from 0, that hold no finite point: organised clouds keep such
    /// rows for pixels without depth. The other rows are the cloud.
    pub dropped: Vec<usize>,
}

/// Reads a cloud: PLY (text or binary of either byte order) or PCD 0.7 (text, binary, compressed).
///
/// The format is told by the file's first bytes, not by its name. Colours may be bytes, 16-bit
/// integers or floats named `red green blue`, `r g b` or `diffuse_red …`, or PCL's packed `rgb`;
/// all else is skipped, faces and normals among it. A cloud without colours is not refused here.
///
/// # Errors
///
/// [`CloudError`]; whatever the bytes are, no panic, and no more memory than they fill.
pub fn read(path: &Path) -> Result<Reading, CloudError> {
    let bytes =
        std::fs::read(path).map_err(|source| CloudError::Io { path: path.to_owned(), source })?;
    decode(&bytes, path)
}

/// Reads a cloud from bytes; `path` is for errors only.
fn decode(bytes: &[u8], path: &Path) -> Result<Reading, CloudError> {
    let first_line = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
    if first_line.trim_ascii() == b"ply" {
        return ply::decode(bytes, path);
    }
    if first_line.starts_with(b"# .PCD") || first_line.starts_with(b"VERSION") {
        return pcd::decode(bytes, path);
    }
    let start = &first_line[..first_line.len().min(24)];
    let found = match start {
        [] => "nothing".to_owned(),
        _ => format!("`{}`", start.escape_ascii()),
    };
    Err(CloudError::NotCloud { path: path.to_owned(), found })
}

#[cfg(test)]
mod tests;
