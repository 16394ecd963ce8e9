//! When something is touched: the largest external torque of any joint, over its standard deviation, passes a
//! threshold that contact-free motion passes so many times an hour.
//!
//! The largest of each second of contact-free motion gives the threshold: above the level that a tenth of the seconds
//! pass, excesses are taken as exponential (the tail of most distributions, Pickands 1975 with a shape of 0). Few seconds
//! determine their mean badly, so what counts is two standard deviations above it. It may also be small by chance, so
//! it counts as at least what it is together with a prior, as if more seconds had been seen.

use serde::{Deserialize, Serialize};

use super::ExternalTorque;

/// What share of seconds sets the level from which on excesses count.
const TAIL: f64 = 0.1;
/// Seconds of contact-free motion from which a tail can be estimated.
const LEAST_SECONDS: usize = 5;

/// Mean excess of the prior, as a part of the level. It was chosen on a hundred simulated arms that moved otherwise than when
/// they were identified, so that the threshold for one false alarm per hour is passed less often than that.
const PRIOR_EXCESS: f64 = 0.12;
/// Seconds in the tail that the prior counts for.
const PRIOR_SECONDS: f64 = 10.0;

/// The tail of the statistic on contact-free motion, second by second.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alarm {
    /// Level that a tenth of the seconds pass, standard deviations.
    pub level: f64,
    /// Mean excess over it, two of its standard deviations higher than it was found, or than it is with the prior.
    pub excess: f64,
    /// Seconds that were looked at.
    pub seconds: f64,
}

impl Alarm {
    /// Of the statistic in touches without contact, at times, s; `None` if they last less than five seconds.
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
        if largest.len() < LEAST_SECONDS {
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

    /// The threshold that contact-free motion passes so many times an hour, standard deviations.
    pub fn threshold(&self, false_alarms_per_hour: f64) -> f64 {
        // A second passes the level with a chance of TAIL, and a threshold with that times the exponential.
        self.level + self.excess * (TAIL * 3600.0 / false_alarms_per_hour).ln().max(0.0)
    }
}

/// Two standard deviations above the mean of `n` exponential values: it has one of 1/√n of it.
fn high_mean(sum: f64, n: f64) -> f64 {
    sum / n * (1.0 + 2.0 / n.sqrt())
}

impl ExternalTorque {
    /// The largest |torque| over its standard deviation, of all joints.
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
        let alarm = Alarm::of(&[touch]).unwrap();
        for per_hour in [1.0, 10.0, 100.0] {
            let threshold = alarm.threshold(per_hour);
            let passed = (0..n).filter(|k| quantile(*k) > threshold).count() as f64;
            let wanted = per_hour * n as f64 / 3600.0;
            assert!((passed / wanted - 1.0).abs() < 0.1, "{passed} of {wanted}");
        }
    }

    #[test]
    fn a_tail_that_is_small_by_chance_counts_for_little_until_it_is_long() {
        // The largest of each second is hardly above the level.
        let flat = |seconds: u32| {
            let rows = (0..=seconds).map(|k| (f64::from(k), 3.5 + 0.001 * f64::from(k % 10)));
            Alarm::of(&[rows.collect()]).unwrap()
        };
        assert!((5.5..7.0).contains(&flat(57).threshold(1.0)), "{:?}", flat(57));
        assert!((3.5..4.0).contains(&flat(36_000).threshold(1.0)), "{:?}", flat(36_000));
        // What is larger than the prior stays.
        let steep = (0..=60).map(|k| (f64::from(k), 3.0 + f64::from(k % 10)));
        let steep = Alarm::of(&[steep.collect()]).unwrap();
        assert!((steep.excess - 1.0 * (1.0 + 2.0 / 6_f64.sqrt())).abs() < 1e-12, "{steep:?}");
    }

    #[test]
    fn short_motions_give_no_tail() {
        assert_eq!(Alarm::of(&[vec![(0.0, 1.0), (3.0, 2.0)]]), None);
        // A gap is no time in which nothing was touched.
        assert_eq!(Alarm::of(&[vec![(0.0, 1.0), (1e9, 2.0), (1e9 + 0.5, 2.0)]]), None);
    }
}
