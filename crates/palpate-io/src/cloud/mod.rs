//! Coloured clouds: what a camera saw of the object, as PLY or PCD.
//!
//! | file            | is                                                                |
//! |-----------------|-------------------------------------------------------------------|
//! | `points`        | a cloud in memory                                                 |
//! | `ply`, `pcd`    | a header of text that names the numbers of a row                  |
//! | `table`         | the rows of both, in text or bytes                                |
//! | `rows`          | which numbers of a row are a point, and which its colour          |
//! | `lzf`           | what PCD's `binary_compressed` unpacks                            |
//! | `write`         | the way out: points, colours, any more columns                    |
//! | `truth`         | what a simulation knows of every point, for checking              |
//!
//! Both formats are read by code of our own, not by a library. They are one thing in two dialects,
//! so that one decoder serves both; `ply-rs-bw` is sound but brings a parser generator and hands
//! over each number by name, and `pcd-rs` allocates what a header claims. Nothing here is
//! allocated before the file's own length has confirmed it.

mod error;
mod lzf;
mod pcd;
mod ply;
mod points;
mod rows;
mod table;
mod truth;
mod write;

use crate::input;
use std::path::Path;

pub use error::CloudError;
pub use points::{Cloud, Reading};
pub use truth::{PointTruth, read_point_truth};
pub use write::{Column, write_pcd, write_ply};

/// Reads a cloud: PLY (text or binary of either byte order) or PCD 0.7 (text, binary, compressed).
///
/// The file's first bytes decide the format, not its name. Colours may be bytes, 16-bit
/// integers or floats named `red green blue`, `r g b` or `diffuse_red …`, or PCL's packed `rgb`;
/// all else is skipped, faces and normals among it. A cloud without colours is not refused here.
///
/// # Errors
///
/// [`CloudError`]; whatever the bytes are, no panic, and no more memory than they fill.
pub fn read(path: &Path) -> Result<Reading, CloudError> {
    let bytes = input::read(path, u64::MAX)
        .map_err(|source| CloudError::Io { path: path.to_owned(), source })?;
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
