//! Reads cameras from text: JSON of palpate's data and of Open3D, YAML of ROS.
//!
//! | format                    | matrix                        | pose                                      |
//! |---------------------------|-------------------------------|-------------------------------------------|
//! | palpate                   | `fx fy cx cy`, or `K` by rows | `camera_to_world` by rows                 |
//! | Open3D, intrinsic         | `intrinsic_matrix` by columns |                                           |
//! | Open3D, parameters        | the same in `intrinsic`       | `extrinsic` by columns: camera from world |
//! | ROS, `camera_calibration` | `camera_matrix.data` by rows  |                                           |
//! | ROS, message              | `k` or `K` by rows            |                                           |
//!
//! All of them are parsed to a tree, whose keys show the format. ROS's `K` and `D` describe the raw
//! image; for a rectified one (`image_rect`) the coefficients must be zero.
//!
//! YAML is parsed by `serde-saphyr`, which limits depth and size: `serde_yaml` is archived, and its
//! forks contain a translated C library.

use super::camera::{Camera, Intrinsics};
use super::distortion::Distortion;
use super::error::{RgbdError, bytes_of};
use super::pose::{numbers_in, pose_of};
use nalgebra::Isometry3;
use serde_json::Value;
use std::path::Path;

/// Largest length of a text, bytes; a longer one is refused.
const MAX_BYTES: usize = 1 << 20;

/// Content of a camera file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraFile {
    /// Size, focal lengths, centre and lens.
    pub intrinsics: Intrinsics,
    /// Pose of the camera, if the file contains it.
    pub world_from_camera: Option<Isometry3<f64>>,
}

impl CameraFile {
    /// The camera at `pose` or else at the pose in the file; `None` without either.
    #[must_use]
    pub fn at(&self, pose: Option<Isometry3<f64>>) -> Option<Camera> {
        let world_from_camera = pose.or(self.world_from_camera)?;
        Some(Camera { intrinsics: self.intrinsics, world_from_camera })
    }
}

/// Reads a camera from JSON or YAML, in any of the formats of palpate, Open3D and ROS.
///
/// # Errors
///
/// [`RgbdError::Io`], [`RgbdError::Camera`] or [`RgbdError::Pose`].
pub fn read_camera(path: &Path) -> Result<CameraFile, RgbdError> {
    decode_camera(&bytes_of(path)?, path)
}

/// Reads a camera from bytes; `path` is for error messages.
pub(super) fn decode_camera(bytes: &[u8], path: &Path) -> Result<CameraFile, RgbdError> {
    let wrong = |reason: String| RgbdError::Camera { path: path.to_owned(), reason };
    let tree = tree(bytes).map_err(wrong)?;
    let inner = tree.get("intrinsic").unwrap_or(&tree);
    let intrinsics = intrinsics(inner).map_err(wrong)?;
    let keys = ["camera_to_world", "extrinsic"];
    let said = keys.into_iter().find_map(|key| Some((key, tree.get(key)?)));
    let pose = said.map(|(key, value)| {
        let place = format!("`{}`, `{key}`", path.display());
        pose_at(key, value).map_err(|reason| RgbdError::Pose { place, reason })
    });
    Ok(CameraFile { intrinsics, world_from_camera: pose.transpose()? })
}

/// The pose `world_from_camera` from the value of the key `camera_to_world` or `extrinsic`.
fn pose_at(key: &str, value: &Value) -> Result<Isometry3<f64>, String> {
    let numbers = numbers_in(value)?;
    if key == "camera_to_world" {
        return pose_of(&numbers);
    }
    let by_rows = if numbers.len() == 16 { transposed::<4>(&numbers) } else { numbers };
    Ok(pose_of(&by_rows)?.inverse())
}

/// Parses a text to a tree; of several YAML documents, the first is used.
fn tree(bytes: &[u8]) -> Result<Value, String> {
    if bytes.len() > MAX_BYTES {
        return Err("is longer than 1 MiB, too long for a camera".to_owned());
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|_| "is not text; wanted a camera as JSON or YAML".to_owned())?;
    let text = text.trim_start_matches('\u{feff}');
    let tree: Value = if text.trim_start().starts_with('{') {
        serde_json::from_str(text).map_err(|error| format!("is not valid JSON: {error}"))?
    } else {
        let is_mark = |line: &&str| matches!(line.trim_end(), "---" | "...");
        let first: Vec<&str> =
            text.lines().skip_while(is_mark).take_while(|line| !is_mark(line)).collect();
        serde_saphyr::from_str(&first.join("\n")).map_err(|error| {
            let line = error.to_string();
            format!("is not valid YAML: {}", line.lines().next().unwrap_or_default())
        })?
    };
    match tree {
        Value::Object(_) => Ok(tree),
        _ => Err("holds no names and values; wanted a camera as JSON or YAML".to_owned()),
    }
}

/// Swaps rows and columns of an `N` x `N` matrix.
fn transposed<const N: usize>(numbers: &[f64]) -> Vec<f64> {
    (0..N * N).map(|place| numbers[place % N * N + place / N]).collect()
}

fn intrinsics(camera: &Value) -> Result<Intrinsics, String> {
    let ([fx, fy], [cx, cy]) = matrix(camera)?;
    let side = |names: [&str; 2]| {
        let value = names.iter().find_map(|name| camera.get(name));
        let value = value.ok_or_else(|| format!("has no `{}`, a number of pixels", names[0]))?;
        let side = value.as_u64().and_then(|side| u32::try_from(side).ok());
        side.ok_or_else(|| {
            format!("has the {} {}; wanted a whole number of pixels", names[0], shortened(value))
        })
    };
    let size = [side(["width", "image_width"])?, side(["height", "image_height"])?];
    Intrinsics::new(size, [fx, fy], [cx, cy], distortion(camera)?)
}

/// Focal lengths and centre, pixels, from any of the known keys.
fn matrix(camera: &Value) -> Result<([f64; 2], [f64; 2]), String> {
    let single = |name: &str| camera.get(name).and_then(Value::as_f64);
    if let (Some(fx), Some(fy), Some(cx), Some(cy)) =
        (single("fx"), single("fy"), single("cx"), single("cy"))
    {
        return Ok(([fx, fy], [cx, cy]));
    }
    let keys = ["intrinsic_matrix", "camera_matrix", "K", "k"];
    let Some(key) = keys.into_iter().find(|key| camera.get(key).is_some()) else {
        return Err("has neither `fx fy cx cy` nor `K`, `camera_matrix` or `intrinsic_matrix`; \
                    wanted the intrinsics of the camera"
            .to_owned());
    };
    let numbers = list(camera, key)?;
    if numbers.len() != 9 {
        return Err(format!("has {} numbers in `{key}`; wanted 3x3", numbers.len()));
    }
    let by_rows = if key == "intrinsic_matrix" { transposed::<3>(&numbers) } else { numbers };
    match by_rows[..] {
        [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0] => Ok(([fx, fy], [cx, cy])),
        _ => Err(format!(
            "has {by_rows:?} in `{key}`, row by row; wanted fx 0 cx, 0 fy cy, 0 0 1: skewed pixels \
             and transposed matrices are not read"
        )),
    }
}

/// The numbers in a list, or in the key `data` of a matrix.
fn list(camera: &Value, key: &str) -> Result<Vec<f64>, String> {
    let value = camera.get(key).map(|value| value.get("data").unwrap_or(value));
    let numbers = value.and_then(|value| numbers_in(value).ok());
    numbers.ok_or_else(|| format!("has something else than numbers in `{key}`"))
}

fn distortion(camera: &Value) -> Result<Distortion, String> {
    let said = camera.get("distortion_model").or_else(|| camera.get("distortion"));
    let model = said.and_then(Value::as_str).unwrap_or_default();
    let keys = ["distortion_coefficients", "D", "d", "distortion"];
    let is_list = |key: &&str| camera.get(key).is_some_and(|value| !value.is_string());
    let mut coefficients = match keys.into_iter().find(is_list) {
        Some(key) if !camera[key].is_null() => list(camera, key)?,
        _ => Vec::new(),
    };
    // OpenCV may write 14 coefficients; those after the eighth are zero except for prisms and tilted sensors.
    while coefficients.len() > 8 && coefficients.last() == Some(&0.0) {
        coefficients.pop();
    }
    let known = ["", "none", "plumb_bob", "rational_polynomial", "radtan"];
    let lens = Distortion::new(&coefficients).filter(|_| known.contains(&model));
    lens.ok_or_else(|| {
        format!(
            "has the distortion model `{model}` with {} coefficients; wanted plumb_bob with 4 or 5 \
             or rational_polynomial with 8: rectify the images, and write `none`",
            coefficients.len()
        )
    })
}

/// A value as text of at most 24 characters.
fn shortened(value: &Value) -> String {
    value.to_string().chars().take(24).collect()
}
