//! Errors of images, of their camera, and of both together.

use std::io;
use std::path::{Path, PathBuf};

use super::dropped::DroppedPixels;
use crate::input;

/// What can be wrong with images, their camera, or both together.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RgbdError {
    /// The operating system reported an error.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// A file that is not an image or array, or of an unsupported kind.
    #[error("`{path}` {reason}")]
    File { path: PathBuf, reason: String },
    /// A file that is not a valid camera.
    #[error("`{path}`: {reason}")]
    Camera { path: PathBuf, reason: String },
    /// A pose that is not a rotation and a translation.
    #[error("{place}: {reason}; wanted {WANTED_POSE}")]
    Pose { place: String, reason: String },
    /// Images and camera of different sizes.
    #[error(
        "{what} is {found_width} x {found_height} pixels, the depth image {width} x {height}; \
         wanted depth aligned to the colour image, and the intrinsics of that size"
    )]
    Size { what: &'static str, found_width: u32, found_height: u32, width: u32, height: u32 },
    /// A median depth that is implausibly small or large, probably because of a wrong unit.
    #[error(
        "the median depth is {median_m} m, {beyond} than such cameras see: is the unit right? \
         Integers were taken as {unit_m} m each, floats as metres; 0.001 is right for most depth \
         images, 0.0001 or 0.00025 for some"
    )]
    DepthUnit { beyond: &'static str, median_m: f64, unit_m: f64 },
    /// No pixel became a point.
    #[error("no pixel is left: {dropped}; {remedy}")]
    Nothing { dropped: DroppedPixels, remedy: &'static str },
}

/// The formats of [`super::read_pose`] and [`super::pose_from_text`], for an error message.
const WANTED_POSE: &str =
    "camera_to_world as a rigid 4x4 matrix, row by row, or as x y z qx qy qz qw";

/// Reads a whole file.
pub(super) fn bytes_of(path: &Path) -> Result<Vec<u8>, RgbdError> {
    input::read(path, u64::MAX).map_err(|source| RgbdError::Io { path: path.to_owned(), source })
}
