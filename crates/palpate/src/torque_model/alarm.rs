//! Contact detection: the largest external torque of any joint, over its standard deviation, exceeds a threshold that
//! contact-free motion exceeds a given number of times an hour (false alarms).
//!
//! The threshold follows from the largest such ratio in each second of contact-free motion. Above the level that a
//! tenth of the seconds exceed, excesses are taken as exponential (the tail of most distributions, Pickands 1975 with a
//! shape of 0). Few seconds determine their mean badly, so two standard deviations are added to the estimated mean. It
//! may also be small by chance, so it is at least the estimate together with a prior, which counts as further seconds.

use serde::{Deserialize, Serialize};

use super::ExternalTorque;

/// Share of the seconds that exceed the level.
const TAIL: f64 = 0.1;
/// Least number of seconds of contact-free motion to estimate a tail.
const MIN_SECONDS: usize = 5;

/// Mean excess of the prior, relative to the level. It was chosen on a hundred simulated arms whose motions differed
/// from those of their identification, so that the threshold for one false alarm per hour is exceeded less often than
/// that.
const PRIOR_EXCESS: f64 = 0.12;
/// Weight of the prior, as a number of seconds in the tail.
const PRIOR_SECONDS: f64 = 10.0;

/// The tail of the statistic on contact-free motion, second by second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FalseAlarmModel {
    /// Level that a tenth of the seconds exceed, in standard deviations.
    pub level: f64,
    /// Mean excess over the level, in standard deviations: the larger of the estimates without and with the prior, each
    /// increased by two of its standard deviations.
    pub excess: f64,
    /// Number of seconds of motion.
    pub seconds: f64,
}

impl FalseAlarmModel {
    /// From touches without contact, each a list of time, s, and statistic; `None` if they last less than five seconds.
    pub fn of(touches: &[Vec<(f64, f64)>]) -> Option<Self> {
        let mut largest: Vec<f64> = Vec::new();
        for touch in touches {
            // Second by second, as far as there are samples; the last one may not be whole.
            let mut seconds: Vec<(f64, f64)> = Vec::new();
            for (time, statistic) in touch {
                let second = (time - touch[0].0).floor();
                match seconds.last_mut() {
                    Some((last, own)) if *last == second => *own = own.max(*statistic),
                    _ => seconds.push((second, *statistic)),
                }
            }
            seconds.pop();
            largest.extend(seconds.iter().map(|(_, statistic)| statistic));
        }
        if largest.len() < MIN_SECONDS {
            return None;
        }
        largest.sort_by(f64::total_cmp);
        let tail = ((largest.len() as f64 * TAIL).ceil() as usize).max(2);
        let (below, above) = largest.split_at(largest.len() - tail);
        let level = below.last().copied().unwrap_or(0.0);
        let sum = above.iter().map(|value| value - level).sum::<f64>();
        let n = tail as f64;
        let with_prior = high_mean(sum + PRIOR_SECONDS * PRIOR_EXCESS * level, n + PRIOR_SECONDS);
        let excess = high_mean(sum, n).max(with_prior).max(1e-6);
        Some(Self { level, excess, seconds: largest.len() as f64 })
    }

    /// Whether its numbers are finite and not negative.
    pub(super) fn is_sound(&self) -> bool {
        [self.level, self.excess, self.seconds].iter().all(|own| *own >= 0.0 && own.is_finite())
    }

    /// The threshold that contact-free motion exceeds this many times an hour, in standard deviations.
    pub fn threshold(&self, false_alarms_per_hour: f64) -> f64 {
        // A second exceeds the level with probability TAIL, and a threshold above it with
        // TAIL · exp(−(threshold − level) / excess).
        self.level + self.excess * (TAIL * 3600.0 / false_alarms_per_hour).ln().max(0.0)
    }
}

/// The mean of `n` exponential values plus two of its standard deviations, each mean/√n.
fn high_mean(sum: f64, n: f64) -> f64 {
    sum / n * (1.0 + 2.0 / n.sqrt())
}

impl ExternalTorque {
    /// The largest ratio of |torque| to its standard deviation over all joints.
    pub fn statistic(&self) -> f64 {
        let joints = self.torque.iter().zip(&self.std);
        joints.map(|(torque, std)| (torque / std).abs()).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_noise_passes_the_threshold_as_often_as_is_asked() {
        // Quantiles of an exponential distribution of mean 2, one a second, shuffled by a step that is coprime.
        let n = 100_000;
        let quantile = |k: usize| -2.0 * (1.0 - (k as f64 + 0.5) / n as f64).ln();
        let touch: Vec<(f64, f64)> = (0..=n).map(|k| (k as f64, quantile(k * 7_919 % n))).collect();
        let alarm = FalseAlarmModel::of(&[touch]).unwrap();
        for per_hour in [1.0, 10.0, 100.0] {
            let threshold = alarm.threshold(per_hour);
            let passed = (0..n).filter(|k| quantile(*k) > threshold).count() as f64;
            let wanted = per_hour * n as f64 / 3600.0;
            assert!((passed / wanted - 1.0).abs() < 0.1, "{passed} of {wanted}");
        }
    }

    #[test]
    fn a_short_tail_that_is_small_by_chance_has_little_weight() {
        // The largest of each second is hardly above the level.
        let flat = |seconds: u32| {
            let rows = (0..=seconds).map(|k| (f64::from(k), 3.5 + 0.001 * f64::from(k % 10)));
            FalseAlarmModel::of(&[rows.collect()]).unwrap()
        };
        assert!((5.5..7.0).contains(&flat(57).threshold(1.0)), "{:?}", flat(57));
        assert!((3.5..4.0).contains(&flat(36_000).threshold(1.0)), "{:?}", flat(36_000));
        // What is larger than the prior stays.
        let steep = (0..=60).map(|k| (f64::from(k), 3.0 + f64::from(k % 10)));
        let steep = FalseAlarmModel::of(&[steep.collect()]).unwrap();
        assert!((steep.excess - 1.0 * (1.0 + 2.0 / 6_f64.sqrt())).abs() < 1e-12, "{steep:?}");
    }

    #[test]
    fn short_motions_give_no_tail() {
        assert_eq!(FalseAlarmModel::of(&[vec![(0.0, 1.0), (3.0, 2.0)]]), None);
        // A gap is no time in which nothing was touched.
        assert_eq!(FalseAlarmModel::of(&[vec![(0.0, 1.0), (1e9, 2.0), (1e9 + 0.5, 2.0)]]), None);
    }
}
