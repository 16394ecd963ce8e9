//! What can be wrong with a picture, its camera, or the two together.

use std::io;
use std::path::{Path, PathBuf};

use super::dropped::Dropped;
use crate::input;

/// What can be wrong with a picture, its camera, or the two together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RgbdError {
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// No image or array, or one of a kind that is not read.
    #[error("`{path}` {reason}")]
    File { path: PathBuf, reason: String },
    /// A camera that is no camera.
    #[error("`{path}`: {reason}")]
    Camera { path: PathBuf, reason: String },
    /// A pose that does not only turn and move.
    #[error("{place}: {reason}; wanted {WANTED_POSE}")]
    Pose { place: String, reason: String },
    /// Images and camera that are not of one size.
    #[error(
        "{what} is {found_width} x {found_height} pixels, the depth image {width} x {height}; \
         wanted depth aligned to the colour image, and the intrinsics of that size"
    )]
    Size { what: &'static str, found_width: u32, found_height: u32, width: u32, height: u32 },
    /// A unit of depth that puts everything far away or on the lens.
    #[error(
        "the median depth is {median_m} m, {beyond} than such cameras see: is the unit right? \
         Integers were taken as {unit_m} m each, floats as metres; 0.001 is right for most depth \
         images, 0.0001 or 0.00025 for some"
    )]
    DepthUnit { beyond: &'static str, median_m: f64, unit_m: f64 },
    /// Nothing to see.
    #[error("no pixel is left: {dropped}; {remedy}")]
    Nothing { dropped: Dropped, remedy: &'static str },
}

/// What [`super::read_pose`] and [`super::pose_from_text`] take.
const WANTED_POSE: &str =
    "camera_to_world as a rigid 4x4 matrix, row by row, or as x y z qx qy qz qw";

/// Reads a whole file.
pub(super) fn bytes_of(path: &Path) -> Result<Vec<u8>, RgbdError> {
    input::read(path, u64::MAX).map_err(|source| RgbdError::Io { path: path.to_owned(), source })
}
