//! Converts images of a depth camera to a point cloud in the world frame.
//!
//! | file           | content                                                               |
//! |----------------|-----------------------------------------------------------------------|
//! | `camera`       | camera model: intrinsics, distortion, pose                            |
//! | `distortion`   | the lens model of OpenCV and ROS, and its inverse                     |
//! | `camera_file`  | cameras as JSON or YAML, by palpate, Open3D and ROS                   |
//! | `pose`         | pose of the camera: 4x4 or seven numbers, as text, JSON or npy        |
//! | `images`       | colours and depths in memory                                          |
//! | `image_files`  | reading colours from PNG and JPEG, depths from PNG, TIFF and npy      |
//! | `flying`       | detection of flying pixels at the edges of objects                    |
//! | `dropped`      | numbers of pixels that were left out, by reason                       |
//! | `back_project` | from images and camera to the cloud                                   |
//!
//! Axes of the camera are those of OpenCV: x to the right, y down, z forward. Depth is along z, not
//! along the ray. The centre of the first pixel is at (0, 0).

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
pub use dropped::DroppedPixels;
pub use error::RgbdError;
pub use flying::FlyingPixels;
pub use image_files::{read_colour, read_depth};
pub use images::{ColourImage, DepthImage};
pub use pose::{pose_from_text, read_pose};

#[cfg(test)]
mod tests;
