//! What a depth camera saw, made into a cloud in the world frame.
//!
//! | file           | is                                                                    |
//! |----------------|-----------------------------------------------------------------------|
//! | `camera`       | where a pixel looks: intrinsics, distortion, pose                     |
//! | `distortion`   | the lens model of OpenCV and ROS, and its inverse                     |
//! | `camera_file`  | cameras as JSON or YAML, by palpate, Open3D and ROS                   |
//! | `pose`         | where the camera stands: 4x4 or seven numbers, as text, JSON or npy   |
//! | `images`       | colours and depths in memory                                          |
//! | `image_files`  | the same from PNG and JPEG, and from PNG, TIFF and npy                |
//! | `flying`       | which depths hang between an object and what is behind it             |
//! | `dropped`      | how many pixels were left out, and why                                |
//! | `back_project` | all of it together                                                    |
//!
//! Camera axes are OpenCV's: x to the right, y down, z forward. Depth is along z, not along the
//! ray. The centre of the first pixel is at (0, 0).

mod back_project;
mod camera;
mod camera_file;
mod distortion;
mod dropped;
mod error;
mod flying;
mod image_files;
mod images;
mod pose;

pub use back_project::{BackProjection, BackProjectionConfig, back_project};
pub use camera::{Camera, Intrinsics};
pub use camera_file::{CameraFile, read_camera};
pub use distortion::Distortion;
pub use dropped::Dropped;
pub use error::RgbdError;
pub use flying::FlyingPixels;
pub use image_files::{read_colour, read_depth};
pub use images::{ColourImage, DepthImage};
pub use pose::{pose_from_text, read_pose};

#[cfg(test)]
mod tests;
