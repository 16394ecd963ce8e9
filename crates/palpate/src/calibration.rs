//! Bands around predicted torques that hold the measured ones so often: found on touches that were held out.
//!
//! The half-width of joint j's band at a level, such as 0.9, is
//!
//! ```text
//! q(level) · (a_j + b |τ̂_j| + c s_j)        s: √ diag(H P Hᵀ), the springs' own standard deviation
//! ```
//!
//! with a, b and c that make the bands of held-out touches narrowest, and q such that they hold that share of the
//! frames of a touch (`palpate_learn::calibrate`). Frames of a touch are not independent, so a calibration on n touches
//! says nothing of levels above n / (n + 1): with that chance a new touch is worse than all of them.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

/// How wide bands are, and at which levels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// a: n_joints, N·m.
    pub floor_n_m: Vec<f64>,
    /// b.
    pub by_torque: f64,
    /// c.
    pub by_std: f64,
    /// Standard deviation of the stiffness of cells that were never touched, N/m.
    pub untouched_std_n_per_m: f64,
    /// Touches that were held out, one after the other.
    pub touches: u32,
    /// q at some levels, in rising order.
    pub quantiles: Vec<BandQuantiles>,
}

/// q at a level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BandQuantiles {
    /// The share of torques that bands are to hold, 0 to 1.
    pub level: f64,
    /// Of the torque of a joint in a frame.
    pub frame: f64,
    /// Of the norm of the error of all joints in a frame.
    pub norm: f64,
    /// Of the largest torque of a joint in a touch, where the largest is predicted.
    pub peak: f64,
}

impl Calibration {
    /// The highest level that there is a band for.
    pub fn highest_level(&self) -> f64 {
        self.quantiles.last().map_or(0.0, |last| last.level)
    }

    /// q at a level, between those that are known; `None` above the highest.
    pub fn at(&self, level: f64) -> Option<BandQuantiles> {
        let after = self.quantiles.iter().position(|known| known.level >= level - 1e-9)?;
        let (from, to) = (self.quantiles[after.saturating_sub(1)], self.quantiles[after]);
        let part = if to.level > from.level {
            (level - from.level) / (to.level - from.level)
        } else {
            1.0
        };
        let part = part.clamp(0.0, 1.0);
        let mix = |of: fn(&BandQuantiles) -> f64| of(&from) + part * (of(&to) - of(&from));
        Some(BandQuantiles {
            level,
            frame: mix(|own| own.frame),
            norm: mix(|own| own.norm),
            peak: mix(|own| own.peak),
        })
    }

    /// `a + b |τ̂| + c s`: n_joints, N·m, of a predicted torque and its springs' standard deviation, n_joints, N·m.
    ///
    /// # Panics
    ///
    /// If these are of another number of joints.
    pub fn scale(&self, torque: &[f64], torque_std: &[f64]) -> DVector<f64> {
        assert_eq!(torque.len(), self.floor_n_m.len(), "a torque for each joint");
        let joints = self.floor_n_m.iter().zip(torque).zip(torque_std);
        let scale = joints.map(|((floor, torque), std)| {
            floor + self.by_torque * torque.abs() + self.by_std * std
        });
        DVector::from_iterator(torque.len(), scale)
    }

    /// Whether its numbers can be, for so many joints.
    pub fn is_sound(&self, n_joints: usize) -> bool {
        let is_size = |number: &f64| number.is_finite() && *number >= 0.0;
        let scales = self.floor_n_m.iter().chain([
            &self.by_torque,
            &self.by_std,
            &self.untouched_std_n_per_m,
        ]);
        let quantiles = self.quantiles.iter().flat_map(|own| [own.frame, own.norm, own.peak]);
        let levels = || self.quantiles.iter().map(|own| own.level);
        self.floor_n_m.len() == n_joints
            && scales.copied().chain(quantiles).all(|number| is_size(&number))
            && levels().all(|level| level > 0.0 && level < 1.0)
            && levels().zip(levels().skip(1)).all(|(a, b)| a < b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_those_that_are_known_and_end_with_the_last() {
        let of =
            |level: f64, q: f64| BandQuantiles { level, frame: q, norm: 2.0 * q, peak: 3.0 * q };
        let calibration = Calibration {
            floor_n_m: vec![0.1, 0.2],
            by_torque: 0.5,
            by_std: 2.0,
            untouched_std_n_per_m: 10.0,
            touches: 9,
            quantiles: vec![of(0.5, 1.0), of(0.9, 3.0)],
        };
        assert!(calibration.is_sound(2) && !calibration.is_sound(3));
        assert_eq!(calibration.at(0.95), None);
        assert_eq!(calibration.highest_level(), 0.9);
        let middle = calibration.at(0.7).unwrap();
        assert!((middle.frame - 2.0).abs() < 1e-12 && (middle.peak - 6.0).abs() < 1e-12);
        assert_eq!(calibration.at(0.2).unwrap().frame, 1.0);
        let scale = calibration.scale(&[-2.0, 0.0], &[0.0, 0.3]);
        assert!((scale - DVector::from_vec(vec![1.1, 0.8])).amax() < 1e-12);
    }
}
