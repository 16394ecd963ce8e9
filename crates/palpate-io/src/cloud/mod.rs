//! Coloured point clouds of an object, as PLY or PCD.
//!
//! | file            | content                                                           |
//! |-----------------|-------------------------------------------------------------------|
//! | `points`        | a cloud in memory                                                 |
//! | `ply`, `pcd`    | the headers of the two formats, which name the numbers of a row   |
//! | `table`         | reading of rows, as text or binary, for both formats              |
//! | `rows`          | conversion of rows to points and colours                          |
//! | `lzf`           | decompression of PCD's `binary_compressed`                        |
//! | `write`         | writing of points, colours and any further columns                |
//! | `truth`         | true values of every point of a simulation, for evaluation        |
//!
//! No library is used for reading. The two formats are so similar that one decoder can read both;
//! `ply-rs-bw` needs a parser generator and returns each number by name, and `pcd-rs` allocates the
//! size in the header. Here, sizes in a header are checked against the length of the file before
//! memory is allocated.

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
pub use points::{Cloud, CloudFile};
pub use truth::{PointTruth, read_point_truth};
pub use write::{Column, write_pcd, write_ply};

/// Reads a cloud: PLY (text or binary of either byte order) or PCD 0.7 (text, binary, compressed).
///
/// The file's first bytes decide the format, not its name. Colours may be bytes, 16-bit
/// integers or floats named `red green blue`, `r g b` or `diffuse_red …`, or PCL's packed `rgb`;
/// everything else is skipped, also faces and normals. A cloud without colours is accepted.
///
/// # Errors
///
/// [`CloudError`]. No content makes it panic, or allocate memory for data that is not in the file.
pub fn read(path: &Path) -> Result<CloudFile, CloudError> {
    let bytes = input::read(path, u64::MAX)
        .map_err(|source| CloudError::Io { path: path.to_owned(), source })?;
    decode(&bytes, path)
}

/// Reads a cloud from bytes; `path` is for error messages.
fn decode(bytes: &[u8], path: &Path) -> Result<CloudFile, CloudError> {
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
