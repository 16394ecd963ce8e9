//! Compact numbers for the JSON of the pages: integers in a small unit, which take half the bytes
//! of decimal fractions, and numbers of four significant digits where the range is wide.

use nalgebra::{Isometry3, Point3};

/// The integer that stands for 1, or for 1 m.
pub(super) const PER_ONE: f64 = 1e4;

/// The number rounded to four significant digits.
pub(super) fn four_digits(number: f64) -> f64 {
    format!("{number:.3e}").parse().expect("a number is written as one")
}

/// A point, in tenths of a millimetre.
pub(super) fn tenths(point: &Point3<f64>) -> [i64; 3] {
    [0, 1, 2].map(|axis| (point[axis] * PER_ONE).round() as i64)
}

/// A pose as position in tenths of a millimetre, then the quaternion i, j, k, w times [`PER_ONE`].
pub(super) fn seven(pose: &Isometry3<f64>) -> [i64; 7] {
    let [x, y, z] = tenths(&pose.translation.vector.into());
    let turn = pose.rotation.coords.map(|part| (part * PER_ONE).round() as i64);
    [x, y, z, turn.x, turn.y, turn.z, turn.w]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits_and_little_text() {
        let all: Vec<f64> = (0..2_000).map(|n| four_digits(123.0 / 1.007_f64.powi(n))).collect();
        for (n, packed) in all.iter().enumerate() {
            let k = 123.0 / 1.007_f64.powi(n as i32);
            assert!((packed / k - 1.0).abs() < 6e-4, "{packed} for {k}");
        }
        assert!(serde_json::to_string(&all).unwrap().len() < 9 * all.len());
    }

    #[test]
    fn a_pose_keeps_its_turn() {
        let pose = Isometry3::new([0.1, -0.2, 0.3].into(), [0.4, -0.5, 0.6].into());
        let seven = seven(&pose);
        assert_eq!(seven[..3], [1_000, -2_000, 3_000]);
        let squares: f64 = seven[3..].iter().map(|&part| (part as f64 / PER_ONE).powi(2)).sum();
        assert!((squares - 1.0).abs() < 4e-4);
    }
}
