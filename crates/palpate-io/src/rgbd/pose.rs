//! Reads the pose of a camera, `camera_to_world`: a rotation and a translation.
//!
//! A calibrated matrix is rarely orthonormal to the last digit. If it is off by at most [`SLACK`],
//! the nearest rotation is used; otherwise it is an error.

use super::error::{RgbdError, bytes_of};
use crate::npy::Rows;
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::io::Cursor;
use std::path::Path;

/// Largest deviation of a matrix from a rotation, or of a quaternion's length from 1: one
/// millimetre at one metre.
const SLACK: f64 = 1e-3;

/// Reads a pose from a file: text, JSON (bare or under the key `camera_to_world`) or npy.
///
/// # Errors
///
/// [`RgbdError::Io`], [`RgbdError::File`] or [`RgbdError::Pose`].
pub fn read_pose(path: &Path) -> Result<Isometry3<f64>, RgbdError> {
    decode_pose(&bytes_of(path)?, path)
}

/// Reads a pose from bytes; `path` is for error messages.
pub(super) fn decode_pose(bytes: &[u8], path: &Path) -> Result<Isometry3<f64>, RgbdError> {
    let place = || format!("`{}`", path.display());
    let wrong = |reason: String| RgbdError::Pose { place: place(), reason };
    let numbers = if bytes.starts_with(b"\x93NUMPY") {
        let numbers = Rows::open(Cursor::new(bytes)).and_then(Rows::all);
        numbers
            .map_err(|error| RgbdError::File { path: path.to_owned(), reason: error.to_string() })?
    } else {
        numbers_of_file(bytes).map_err(wrong)?
    };
    pose_of(&numbers).map_err(wrong)
}

/// Reads a pose from a text: 16 numbers row by row, or `x y z qx qy qz qw`, separated by blanks,
/// commas, semicolons or brackets; `#` begins a comment.
///
/// # Errors
///
/// [`RgbdError::Pose`] if the numbers are not a rotation and a translation.
pub fn pose_from_text(text: &str) -> Result<Isometry3<f64>, RgbdError> {
    let pose = numbers_of_text(text).and_then(|numbers| pose_of(&numbers));
    pose.map_err(|reason| RgbdError::Pose { place: "the camera's pose".to_owned(), reason })
}

/// The numbers in a text or in JSON. Here and below, an error is the end of a message to the user.
fn numbers_of_file(bytes: &[u8]) -> Result<Vec<f64>, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "the file is not text")?;
    if !text.trim_start().starts_with('{') {
        return numbers_of_text(text);
    }
    let object: serde_json::Value =
        serde_json::from_str(text).map_err(|error| format!("it is not valid JSON: {error}"))?;
    numbers_in(object.get("camera_to_world").ok_or("it has no key `camera_to_world`")?)
}

fn numbers_of_text(text: &str) -> Result<Vec<f64>, String> {
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default());
    let is_between = |c: char| c.is_whitespace() || matches!(c, ',' | ';' | '[' | ']');
    let words = lines.flat_map(|line| line.split(is_between)).filter(|word| !word.is_empty());
    let number = |word: &str| {
        let shown: String = word.chars().take(24).collect();
        word.parse().map_err(|_| format!("`{shown}` is not a number"))
    };
    words.map(number).collect()
}

/// All numbers in nested lists, in order.
pub(super) fn numbers_in(value: &serde_json::Value) -> Result<Vec<f64>, String> {
    match value.as_array() {
        Some(list) => Ok(list.iter().map(numbers_in).collect::<Result<Vec<_>, _>>()?.concat()),
        None => match value.as_f64() {
            Some(number) => Ok(vec![number]),
            None => Err("it holds something else than numbers".to_owned()),
        },
    }
}

/// The pose from 16 numbers, row by row, or from 7 numbers, `x y z qx qy qz qw`.
pub(super) fn pose_of(numbers: &[f64]) -> Result<Isometry3<f64>, String> {
    if let Some(number) = numbers.iter().find(|number| !number.is_finite()) {
        return Err(format!("it holds {number}"));
    }
    match *numbers {
        [x, y, z, qx, qy, qz, qw] => {
            let turn = Quaternion::new(qw, qx, qy, qz);
            if (turn.norm() - 1.0).abs() > SLACK {
                return Err(format!("its quaternion has the length {}, not 1", turn.norm()));
            }
            let turn = UnitQuaternion::from_quaternion(turn);
            Ok(Isometry3::from_parts(Translation3::new(x, y, z), turn))
        }
        [xx, xy, xz, x, yx, yy, yz, y, zx, zy, zz, z, ref last @ ..] if last.len() == 4 => {
            if last.iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b): (&f64, f64)| (a - b).abs() > 1e-9)
            {
                return Err(format!(
                    "its last row is {last:?}, not 0 0 0 1: is it written column by column?"
                ));
            }
            let turn = Matrix3::new(xx, xy, xz, yx, yy, yz, zx, zy, zz);
            let turn = nearest_rotation(&turn)?;
            Ok(Isometry3::from_parts(Vector3::new(x, y, z).into(), turn))
        }
        _ => Err(format!("it holds {} numbers", numbers.len())),
    }
}

/// The rotation nearest to a matrix; an error if it deviates by more than [`SLACK`] or is a
/// reflection.
fn nearest_rotation(turn: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, String> {
    let off = (turn.transpose() * turn - Matrix3::identity()).amax();
    if off.is_nan() || off > SLACK {
        return Err(format!(
            "its upper left 3x3 is not a rotation: its columns deviate by {off:.3} from length 1 \
             and right angles"
        ));
    }
    if turn.determinant() < 0.0 {
        return Err("its upper left 3x3 is a reflection: one axis points the wrong way".to_owned());
    }
    let svd = turn.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err("its upper left 3x3 is not a rotation".to_owned());
    };
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t)))
}
