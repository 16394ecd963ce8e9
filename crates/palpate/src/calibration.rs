//! Prediction bands: intervals around predicted torques that contain the measured ones in a given share of cases.
//!
//! The half-width of joint j's band at a level, such as 0.9, is
//!
//! ```text
//! q(level) · (a_j + b |τ̂_j| + c s_j)        s: √ diag(H P Hᵀ), the springs' own standard deviation
//! ```
//!
//! with a, b, c and q found on touches that were held out (`palpate_learn::calibrate`). Frames of a touch are not
//! independent, so n touches give no level above n / (n + 1): with the chance that is left, a new touch is worse than all
//! of them.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

/// What the widths of bands are computed from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Constant term a, n_joints, N·m.
    pub floor_n_m: Vec<f64>,
    /// Factor b of the predicted torque.
    pub by_torque: f64,
    /// Factor c of the springs' standard deviation.
    pub by_std: f64,
    /// Standard deviation of the stiffness of cells that were never touched, N/m.
    pub untouched_std_n_per_m: f64,
    /// Touches that were held out.
    pub touches: u32,
    /// q at some levels, in rising order.
    pub quantiles: Vec<BandQuantiles>,
    /// Of each held-out touch that touched anything, root mean squares of its errors: over a + b |τ̂| + c s, and over those
    /// of the measured torques and a. A touch that fits far worse contradicts the field.
    #[serde(default)]
    pub misfits: Vec<[f64; 2]>,
}

/// The factors q of a level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BandQuantiles {
    /// The share of torques that the band is to contain, 0 to 1.
    pub level: f64,
    /// For the torque of a joint in a frame.
    pub frame: f64,
    /// For the largest torque of a joint in a touch, with the width where the largest is predicted.
    pub peak: f64,
}

impl Calibration {
    /// The highest level that has a band; 0 if none has.
    pub fn highest_level(&self) -> f64 {
        self.quantiles.last().map_or(0.0, |last| last.level)
    }

    /// The level of tables and pictures: 0.9, or the highest if that is lower.
    pub fn default_level(&self) -> f64 {
        self.highest_level().min(0.9)
    }

    /// The factors of a level, interpolated; `None` below the lowest and above the highest.
    pub fn at(&self, level: f64) -> Option<BandQuantiles> {
        self.quantiles.first().filter(|first| level >= first.level - 1e-9)?;
        let after = self.quantiles.iter().position(|known| known.level >= level - 1e-9)?;
        let (from, to) = (self.quantiles[after.saturating_sub(1)], self.quantiles[after]);
        let part = if to.level > from.level {
            (level - from.level) / (to.level - from.level)
        } else {
            1.0
        };
        let part = part.clamp(0.0, 1.0);
        let mix = |of: fn(&BandQuantiles) -> f64| of(&from) + part * (of(&to) - of(&from));
        Some(BandQuantiles { level, frame: mix(|own| own.frame), peak: mix(|own| own.peak) })
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

    /// Checks that it is one of a robot with so many joints, and all its numbers are finite and not negative.
    ///
    /// # Errors
    ///
    /// What is wrong, as a sentence.
    pub fn check(&self, n_joints: usize) -> Result<(), String> {
        let found = self.floor_n_m.len();
        if found != n_joints {
            return Err(format!("the bands are of {found} joints; wanted {n_joints}"));
        }
        let scales = [self.by_torque, self.by_std, self.untouched_std_n_per_m].into_iter();
        let factors = self.quantiles.iter().flat_map(|own| [own.frame, own.peak]);
        let numbers = self
            .floor_n_m
            .iter()
            .copied()
            .chain(scales)
            .chain(factors)
            .chain(self.misfits.iter().copied().flatten());
        if let Some(number) = numbers.into_iter().find(|own| !(own.is_finite() && *own >= 0.0)) {
            return Err(format!("the bands hold {number}; wanted a number of at least 0"));
        }
        let levels: Vec<f64> = self.quantiles.iter().map(|own| own.level).collect();
        let rise = levels.windows(2).all(|pair| pair[0] < pair[1]);
        if !rise || levels.iter().any(|level| !(*level > 0.0 && *level < 1.0)) {
            return Err("the levels of the bands do not rise between 0 and 1".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_those_that_are_known_and_end_with_the_last() {
        let of = |level: f64, q: f64| BandQuantiles { level, frame: q, peak: 3.0 * q };
        let calibration = Calibration {
            floor_n_m: vec![0.1, 0.2],
            by_torque: 0.5,
            by_std: 2.0,
            untouched_std_n_per_m: 10.0,
            touches: 9,
            quantiles: vec![of(0.5, 1.0), of(0.9, 3.0)],
            misfits: vec![[0.5, 0.3], [0.7, 0.2]],
        };
        assert!(calibration.check(2).is_ok() && calibration.check(3).is_err());
        assert_eq!(calibration.at(0.95), None);
        assert_eq!(calibration.highest_level(), 0.9);
        let middle = calibration.at(0.7).unwrap();
        assert!((middle.frame - 2.0).abs() < 1e-12 && (middle.peak - 6.0).abs() < 1e-12);
        assert_eq!(calibration.at(0.5).unwrap().frame, 1.0);
        assert_eq!(calibration.at(0.2), None);
        let scale = calibration.scale(&[-2.0, 0.0], &[0.0, 0.3]);
        assert!((scale - DVector::from_vec(vec![1.1, 0.8])).amax() < 1e-12);
    }
}
