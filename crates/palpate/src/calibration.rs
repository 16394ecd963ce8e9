//! Prediction bands: intervals around predicted torques that contain the measured ones in a given share of cases.
//!
//! The half-width of joint j's band at a level, such as 0.9, is
//!
//! ```text
//! q(level) · (a_j + b |τ̂_j| + c s_j + d_j n)^g      s, the spread: √ diag(H diag(σ² + ρ² K²) Hᵀ)
//!                                                   n: share of unknown cells among the touched points
//! ```
//!
//! s is the standard deviation of the torque if the errors of the springs are independent, each with variance
//! σ² + ρ² K². Where the torques of stiff springs cancel, |τ̂| is small but its error is not; s is large there.
//!
//! The numbers a, b, c and q are found on held-out touches (`palpate_learn::calibrate`). Frames of a touch are not
//! independent, so n touches give no level above n / (n + 1): with probability 1 / (n + 1), the errors of a new touch
//! exceed those of all n.
//!
//! The exponent g is ½: these bands are narrower than with g = 1 and contain the same share of all torques, but a
//! smaller share of the largest ones. So there is a second band for the largest torque of a touch (the *peak*), with
//! its own q and g = 1. A guard should use the second one.
//!
//! With too few touches to hold out, bands are those of other objects ([`Calibration::of_other_objects`]): a is
//! proportional to the residual on the learnt touches, which without held-out touches is the best measure of how well
//! springs describe this object, and d to the measured torque. s is not used, since these factors were found without it
//! and σ depends on the sampling rate. g is 1, so that an object twice as stiff has bands twice as wide.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::estimator::LARGEST;

/// Factors from which the widths of bands are computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Constant term a, n_joints, N·m.
    pub floor_n_m: Vec<f64>,
    /// Factor b of the predicted torque.
    pub by_torque: f64,
    /// Factor c of s.
    pub by_std: f64,
    /// ρ: error of a spring relative to its stiffness, which s contains beside the standard deviation.
    #[serde(default)]
    pub relative_std: f64,
    /// Factors d of the share of unknown points, n_joints, N·m; empty if that share is not used.
    #[serde(default)]
    pub by_unknown_n_m: Vec<f64>,
    /// Exponent g of the sum, for the torque of a joint in a frame, above 0 and at most 1.
    #[serde(default = "one")]
    pub exponent: f64,
    /// Standard deviation of the stiffness of cells that were never touched, N/m.
    pub untouched_std_n_per_m: f64,
    /// Number of held-out touches; for bands of other objects, number of learnt touches.
    pub touches: u32,
    /// Whether b, d and q were found on other objects.
    #[serde(default)]
    pub of_other_objects: bool,
    /// q at some levels, in ascending order of level.
    pub quantiles: Vec<BandQuantiles>,
    /// For each held-out touch with contact: the root mean square of error over [`Calibration::scale`], and the root of
    /// the sum of squared errors over that of squared measured torques and a. A touch with far larger values
    /// contradicts the field.
    #[serde(default)]
    pub misfits: Vec<[f64; 2]>,
}

/// The factors q at one level.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BandQuantiles {
    /// Share of torques that the band should contain, 0 to 1.
    pub level: f64,
    /// For the torque of a joint in a frame, (N·m)^(1 − g).
    pub frame: f64,
    /// For the largest torque of a joint in a touch: multiplies the sum, without exponent, in the frame with the
    /// largest predicted torque.
    pub peak: f64,
}

fn one() -> f64 {
    1.0
}

/// Factors on other objects, at level 0.9: a over the residual on the learnt touches, b, and d over the measured
/// torque. From nine simulated objects, with touches held out after learning 1, 2, 4, 8 and all others, under given and
/// chosen settings.
const OTHERS: [f64; 3] = [0.998, 1.48, 1.057];
/// Levels on other objects, each with q of frames and q of peaks.
const OTHERS_Q: [[f64; 3]; 7] = [
    [0.5, 0.2, 0.8],
    [0.6, 0.28, 1.09],
    [0.7, 0.4, 1.42],
    [0.8, 0.59, 1.77],
    [0.85, 0.75, 2.09],
    [0.9, 1.0, 2.44],
    [0.95, 1.56, 3.37],
];
/// After n learnt touches, q of peaks is multiplied by 1 + `FEW_TOUCHES` / n.
const FEW_TOUCHES: f64 = 0.6;

/// Residuals and torques of the learnt samples in contact: root mean squares, n_joints each, N·m.
#[derive(Debug, Clone, PartialEq)]
pub struct LearntTorques {
    /// Of the residual τ_ext − τ̂.
    pub error_n_m: Vec<f64>,
    /// Of the measured torque τ_ext.
    pub torque_n_m: Vec<f64>,
}

impl LearntTorques {
    /// From samples, each with its residual and its measured torque, n_joints each, N·m. `None` without samples.
    pub fn of(samples: impl IntoIterator<Item = [Vec<f64>; 2]>) -> Option<Self> {
        let (mut sums, mut count): (Option<[Vec<f64>; 2]>, f64) = (None, 0.0);
        for sample in samples {
            let squares = sample.map(|own| own.iter().map(|x| x * x).collect::<Vec<_>>());
            match &mut sums {
                None => sums = Some(squares),
                Some(sums) => (sums.iter_mut().flatten())
                    .zip(squares.iter().flatten())
                    .for_each(|(sum, square)| *sum += square),
            }
            count += 1.0;
        }
        let mean = |own: Vec<f64>| own.into_iter().map(|sum| (sum / count).sqrt()).collect();
        let [error_n_m, torque_n_m] = sums?.map(mean);
        Some(Self { error_n_m, torque_n_m })
    }
}

impl Calibration {
    /// Bands with the factors found on other objects, for a field that has learnt from `touches` touches.
    ///
    /// `untouched_std_n_per_m` is the standard deviation of the stiffness of cells that were never touched. `None` if
    /// `touches` is 0 or a number is out of range.
    pub fn of_other_objects(
        learnt: &LearntTorques,
        touches: u32,
        untouched_std_n_per_m: f64,
    ) -> Option<Self> {
        let [by_error, by_torque, by_measured] = OTHERS;
        let few = 1.0 + FEW_TOUCHES / f64::from(touches);
        let quantiles =
            OTHERS_Q.map(|[level, frame, peak]| BandQuantiles { level, frame, peak: few * peak });
        let bands = Self {
            floor_n_m: learnt.error_n_m.iter().map(|error| by_error * error + 1e-9).collect(),
            by_torque,
            by_std: 0.0,
            relative_std: 0.0,
            by_unknown_n_m: learnt.torque_n_m.iter().map(|torque| by_measured * torque).collect(),
            exponent: 1.0,
            untouched_std_n_per_m,
            touches,
            of_other_objects: true,
            quantiles: quantiles.into(),
            misfits: Vec::new(),
        };
        (touches > 0 && bands.check(learnt.error_n_m.len()).is_ok()).then_some(bands)
    }

    /// The highest level with a band; 0 if there is no band.
    pub fn highest_level(&self) -> f64 {
        self.quantiles.last().map_or(0.0, |last| last.level)
    }

    /// The level of tables and pictures: 0.9, or the highest if that is lower.
    pub fn default_level(&self) -> f64 {
        self.highest_level().min(0.9)
    }

    /// The factors at a level, interpolated; `None` below the lowest and above the highest known level.
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

    /// The variance of a spring in s, (N/m)²: `σ² + ρ² K²`.
    pub fn spring_variance(&self, stiffness_n_per_m: f64, std_n_per_m: f64) -> f64 {
        spring_variance(self.relative_std, stiffness_n_per_m, std_n_per_m.powi(2))
    }

    /// s, n_joints, N·m, from `torque_std` = `√ diag(H diag(σ²) Hᵀ)` and `torque_rss` = `√ diag(H diag(K²) Hᵀ)`,
    /// n_joints, N·m.
    pub fn spread(&self, torque_std: &DVector<f64>, torque_rss: &DVector<f64>) -> DVector<f64> {
        torque_std.zip_map(torque_rss, |std, rss| std.hypot(self.relative_std * rss))
    }

    /// Half-width of the band at a level, n_joints, N·m; `None` if there is no band at that level.
    ///
    /// `torque` is the predicted torque and `spread` is s, n_joints each, N·m; `contacts` has the number of touched
    /// points, and how many of them are known.
    ///
    /// # Panics
    ///
    /// If the number of joints differs.
    pub fn half_width(
        &self,
        level: f64,
        torque: &[f64],
        spread: &[f64],
        contacts: [usize; 2],
    ) -> Option<DVector<f64>> {
        let scale = self.scale(torque, spread, contacts);
        Some(self.at(level)?.frame * self.shape(&scale))
    }

    /// Half-width of the band for the largest torque of a touch, n_joints, N·m, in the frame with the largest predicted
    /// torque; arguments as for [`Calibration::half_width`], and never narrower than that.
    ///
    /// # Panics
    ///
    /// If the number of joints differs.
    pub fn peak_half_width(
        &self,
        level: f64,
        torque: &[f64],
        spread: &[f64],
        contacts: [usize; 2],
    ) -> Option<DVector<f64>> {
        let (q, scale) = (self.at(level)?, self.scale(torque, spread, contacts));
        Some((q.peak * &scale).sup(&(q.frame * self.shape(&scale))))
    }

    /// A [`scale`](Self::scale) to the power of g: times q, the half-width for the torque of a joint in a frame.
    pub fn shape(&self, scale: &DVector<f64>) -> DVector<f64> {
        scale.map(|scale| scale.powf(self.exponent))
    }

    /// `a + b |τ̂| + c s + d n`, n_joints, N·m; arguments as for [`Calibration::half_width`].
    ///
    /// # Panics
    ///
    /// If the number of joints differs.
    pub fn scale(
        &self,
        torque: &[f64],
        spread: &[f64],
        [contacts, known]: [usize; 2],
    ) -> DVector<f64> {
        assert_eq!(torque.len(), self.floor_n_m.len(), "a torque for each joint");
        let unknown = contacts.saturating_sub(known) as f64 / contacts.max(1) as f64;
        let by_unknown = self.by_unknown_n_m.iter().map(|by| by * unknown);
        let by_unknown = by_unknown.chain(std::iter::repeat(0.0));
        let joints = self.floor_n_m.iter().zip(torque).zip(spread).zip(by_unknown);
        let scale = joints.map(|(((floor, torque), spread), by_unknown)| {
            floor + self.by_torque * torque.abs() + self.by_std * spread + by_unknown
        });
        DVector::from_iterator(torque.len(), scale)
    }

    /// Checks that this is a calibration for `n_joints` joints, with all numbers in their ranges.
    ///
    /// # Errors
    ///
    /// A sentence that says what is wrong.
    pub fn check(&self, n_joints: usize) -> Result<(), String> {
        let found = self.floor_n_m.len();
        if found != n_joints {
            return Err(format!("the bands are of {found} joints; wanted {n_joints}"));
        }
        let unknown = self.by_unknown_n_m.len();
        if unknown != 0 && unknown != n_joints {
            return Err(format!(
                "the bands have {unknown} factors for unknown points; wanted {n_joints}"
            ));
        }
        let scales = [self.by_torque, self.by_std, self.relative_std, self.untouched_std_n_per_m]
            .into_iter();
        let factors = self.quantiles.iter().flat_map(|own| [own.frame, own.peak]);
        let numbers = self
            .floor_n_m
            .iter()
            .copied()
            .chain(scales)
            .chain(factors)
            .chain(self.by_unknown_n_m.iter().copied())
            .chain(self.misfits.iter().copied().flatten());
        if let Some(number) = numbers.into_iter().find(|own| !(own.is_finite() && *own >= 0.0)) {
            return Err(format!("the bands hold {number}; wanted a number of at least 0"));
        }
        // If the squares of these overflow, bands are too narrow.
        let squared = [self.relative_std, self.untouched_std_n_per_m];
        if let Some(number) = squared.into_iter().find(|own| *own > LARGEST) {
            return Err(format!("the bands hold {number}; wanted at most {LARGEST}"));
        }
        if !(self.exponent > 0.0 && self.exponent <= 1.0) {
            return Err(format!(
                "the exponent of the bands is {}; wanted above 0, up to 1",
                self.exponent
            ));
        }
        let levels: Vec<f64> = self.quantiles.iter().map(|own| own.level).collect();
        let rise = levels.windows(2).all(|pair| pair[0] < pair[1]) && !levels.is_empty();
        if !rise || levels.iter().any(|level| !(*level > 0.0 && *level < 1.0)) {
            return Err("the bands need levels that rise and lie between 0 and 1".to_owned());
        }
        Ok(())
    }
}

/// [`Calibration::spring_variance`] from ρ, K and the variance σ², (N/m)².
#[inline]
pub fn spring_variance(relative_std: f64, stiffness_n_per_m: f64, variance: f64) -> f64 {
    variance + (relative_std * stiffness_n_per_m).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_of_other_objects_follow_what_was_learnt() {
        let of = |error: f64, measured: f64, touches| {
            let learnt = LearntTorques { error_n_m: vec![error; 2], torque_n_m: vec![measured; 2] };
            Calibration::of_other_objects(&learnt, touches, 1.0)
        };
        let none = [0.0, 0.0];
        let scale = |own: &Calibration, contacts| own.scale(&none, &none, contacts)[0];
        let (narrow, wide, one) =
            (of(0.1, 2.0, 9).unwrap(), of(0.3, 2.0, 9).unwrap(), of(0.1, 2.0, 1).unwrap());
        assert!((scale(&wide, [4, 4]) / scale(&narrow, [4, 4]) - 3.0).abs() < 1e-7);
        // Half of the points are unknown, or all.
        let more = |known| scale(&narrow, [4, known]) - scale(&narrow, [4, 4]);
        assert!(
            (more(0) - OTHERS[2] * 2.0).abs() < 1e-12 && (more(2) * 2.0 - more(0)).abs() < 1e-12
        );
        let (nine, one) = (narrow.at(0.9).unwrap(), one.at(0.9).unwrap());
        assert!(one.frame == nine.frame && one.peak > nine.peak, "{one:?}, {nine:?}");
        assert!(of(0.1, 2.0, 0).is_none() && of(f64::NAN, 2.0, 3).is_none());
        let learnt = LearntTorques::of([[vec![3.0], vec![1.0]], [vec![-4.0], vec![7.0]]]).unwrap();
        assert_eq!((learnt.error_n_m[0], learnt.torque_n_m[0]), (12.5f64.sqrt(), 5.0));
        assert_eq!(LearntTorques::of([]), None);
    }

    #[test]
    fn quantiles_lie_between_those_that_are_known_and_end_with_the_last() {
        let of = |level: f64, q: f64| BandQuantiles { level, frame: q, peak: 3.0 * q };
        let calibration = Calibration {
            floor_n_m: vec![0.1, 0.2],
            by_torque: 0.5,
            by_std: 2.0,
            relative_std: 10.0,
            by_unknown_n_m: vec![],
            exponent: 0.5,
            untouched_std_n_per_m: 10.0,
            touches: 9,
            of_other_objects: false,
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
        let scale = calibration.scale(&[-2.0, 0.0], &[0.0, 0.3], [2, 1]);
        assert!((scale - DVector::from_vec(vec![1.1, 0.8])).amax() < 1e-12);
        // 3 √1.1 and 3 √0.8 in a frame; 9 · 1.1 and 9 · 0.8 for the largest torque.
        let widths = [Calibration::half_width, Calibration::peak_half_width]
            .map(|of| of(&calibration, 0.9, &[-2.0, 0.0], &[0.0, 0.3], [2, 1]).unwrap());
        assert!((widths[0][0] - 3.146_427).abs() < 1e-6 && (widths[0][1] - 2.683_282).abs() < 1e-6);
        assert!((widths[1][0] - 9.9).abs() < 1e-12 && (widths[1][1] - 7.2).abs() < 1e-12);
        assert_eq!(calibration.half_width(0.95, &[0.0; 2], &[0.0; 2], [0, 0]), None);
        // Where the sum is small, a frame's band is the wider one.
        let small = Calibration { floor_n_m: vec![1e-4; 2], ..calibration.clone() };
        let peak = small.peak_half_width(0.9, &[0.0; 2], &[0.0; 2], [0, 0]).unwrap();
        assert!((peak[0] - 0.03).abs() < 1e-12, "{peak}");
        assert_eq!(calibration.spring_variance(0.2, 1.5), 2.25 + 4.0);
        for relative_std in [f64::NAN, -1.0, 1e300] {
            assert!(Calibration { relative_std, ..calibration.clone() }.check(2).is_err());
        }
        let untouched_std_n_per_m = 1e300;
        assert!(Calibration { untouched_std_n_per_m, ..calibration.clone() }.check(2).is_err());
        for exponent in [0.0, 1.1, f64::NAN] {
            assert!(Calibration { exponent, ..calibration.clone() }.check(2).is_err());
        }
    }
}
