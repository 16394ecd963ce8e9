//! The lens model that OpenCV calls rational and ROS `plumb_bob` or `rational_polynomial`.
//!
//! A point whose ideal projection on the plane at one metre is `(x, y)`, with `r² = x² + y²`, is
//! seen at `(x', y')`:
//!
//! ```text
//! x' = x·s + 2·p1·x·y + p2·(r² + 2x²)        s = 1 + k1·r² + k2·r⁴ + k3·r⁶
//! y' = y·s + p1·(r² + 2y²) + 2·p2·x·y            ─────────────────────────
//!                                                1 + k4·r² + k5·r⁴ + k6·r⁶
//! ```
//!
//! The inverse has no closed form; Newton's method finds it where the model is invertible.

use nalgebra::{Matrix2, Vector2};

/// Largest number of steps of Newton's method; near a solution, each doubles the number of correct
/// digits.
const MAX_STEPS: usize = 30;
/// Tolerance of the inverse, m on the plane at one metre: a millionth of a pixel or less.
const TOLERANCE: f64 = 1e-12;

/// Coefficients of a lens, in the order `k1 k2 p1 p2 k3 k4 k5 k6`; all zero means no distortion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortion([f64; 8]);

impl Distortion {
    /// A lens with 0, 4, 5 or 8 coefficients; the others are zero. `None` for any other number of
    /// coefficients, or if one is not finite.
    #[must_use]
    pub fn new(coefficients: &[f64]) -> Option<Self> {
        let known = matches!(coefficients.len(), 0 | 4 | 5 | 8);
        if !known || coefficients.iter().any(|k| !k.is_finite()) {
            return None;
        }
        let mut all = [0.0; 8];
        all[..coefficients.len()].copy_from_slice(coefficients);
        Some(Self(all))
    }

    /// Whether there is no distortion.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.0.iter().all(|&k| k == 0.0)
    }

    /// The distorted point of an ideal one, both on the plane at one metre.
    #[must_use]
    pub fn distort(&self, ideal: Vector2<f64>) -> Vector2<f64> {
        self.with_jacobian(ideal).0
    }

    /// The ideal point of a distorted one (`seen`), both on the plane at one metre. `None` where
    /// the model has no inverse, which happens in corners that the calibration did not cover.
    #[must_use]
    pub(crate) fn undistort(&self, seen: Vector2<f64>) -> Option<Vector2<f64>> {
        if self.is_none() {
            return Some(seen);
        }
        let mut ideal = seen;
        for _ in 0..MAX_STEPS {
            let (shown, jacobian) = self.with_jacobian(ideal);
            // Where the determinant is negative, the model folds over: a solution there is not
            // valid.
            if jacobian.determinant() <= 0.0 {
                return None;
            }
            let miss = shown - seen;
            if miss.norm() < TOLERANCE {
                return Some(ideal);
            }
            ideal -= jacobian.try_inverse()? * miss;
        }
        None
    }

    /// [`Self::distort`] and its derivative.
    fn with_jacobian(&self, ideal: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.0;
        let (x, y) = (ideal.x, ideal.y);
        let r2 = ideal.norm_squared();
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let scale = above / below;
        let above_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let below_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        // Derivative of the scale by r², and of r² by x and y: 2x and 2y.
        let slope = (above_slope - scale * below_slope) / below;
        let shift = Vector2::new(
            2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = 2.0 * (slope * x * y + p1 * x + p2 * y);
        let jacobian = Matrix2::new(
            scale + 2.0 * slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            cross,
            cross,
            scale + 2.0 * slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (ideal * scale + shift, jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Calibrations of webcams, and of the wide lens of an Azure Kinect.
    const LENSES: [&[f64]; 3] = [
        &[-0.28, 0.09, 0.0007, -0.0003],
        &[0.12, -0.25, 0.001, -0.0015, 0.1],
        &[0.52, -2.63, 0.0007, -0.0003, 1.51, 0.40, -2.46, 1.44],
    ];

    #[test]
    fn the_jacobian_is_the_derivative_of_distort() {
        for lens in LENSES {
            let lens = Distortion::new(lens).unwrap();
            for ideal in [Vector2::new(0.3, -0.2), Vector2::new(-0.05, 0.4)] {
                let (_, jacobian) = lens.with_jacobian(ideal);
                for axis in 0..2 {
                    let mut nudge = Vector2::zeros();
                    nudge[axis] = 1e-6;
                    let slope = (lens.distort(ideal + nudge) - lens.distort(ideal - nudge)) / 2e-6;
                    assert!((jacobian.column(axis) - slope).norm() < 1e-8);
                }
            }
        }
    }

    #[test]
    fn a_known_lens_puts_a_pixel_where_its_formula_says() {
        // By hand: r² = 0.05, s = 1 − 0.28·0.05 + 0.09·0.0025.
        let lens = Distortion::new(LENSES[0]).unwrap();
        let seen = lens.distort(Vector2::new(0.2, 0.1));
        let s = 1.0 - 0.28 * 0.05 + 0.09 * 0.0025;
        let x = 0.2 * s + 2.0 * 0.0007 * 0.02 - 0.0003 * (0.05 + 0.08);
        let y = 0.1 * s + 0.0007 * (0.05 + 0.02) - 2.0 * 0.0003 * 0.02;
        assert!((seen - Vector2::new(x, y)).norm() < 1e-15);
    }

    #[test]
    fn beyond_the_fold_of_a_lens_nothing_is_seen() {
        let lens = Distortion::new(&[-0.5, 0.0, 0.0, 0.0]).unwrap(); // r·(1 − r²/2) peaks at 0.544
        assert!(lens.undistort(Vector2::new(0.54, 0.0)).is_some());
        assert_eq!(lens.undistort(Vector2::new(0.56, 0.0)), None);
    }

    #[test]
    fn other_numbers_of_coefficients_are_no_lens() {
        assert!(Distortion::new(&[0.0; 14]).is_none() && Distortion::new(&[f64::NAN; 5]).is_none());
        assert!(Distortion::new(&[]).unwrap().is_none());
    }

    proptest! {
        #[test]
        fn undistort_is_the_inverse_of_distort(
            lens in 0usize..3, x in -0.5f64..0.5, y in -0.4f64..0.4,
        ) {
            let lens = Distortion::new(LENSES[lens]).unwrap();
            let ideal = Vector2::new(x, y);
            let found = lens.undistort(lens.distort(ideal)).unwrap();
            prop_assert!((found - ideal).norm() < 1e-9, "{found} for {ideal}");
        }

        #[test]
        fn no_lens_makes_it_panic_or_answer_wrongly(
            lens in prop::array::uniform8(-1e3f64..1e3), x in -2.0f64..2.0, y in -2.0f64..2.0,
        ) {
            let lens = Distortion::new(&lens).unwrap();
            let seen = Vector2::new(x, y);
            if let Some(ideal) = lens.undistort(seen) {
                prop_assert!((lens.distort(ideal) - seen).norm() < 1e-9);
            }
        }
    }
}
