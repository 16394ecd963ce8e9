//! Selects the samples of a touch that are learnt from, so that the logging rate has little influence.
//!
//! The residual of the model is many times the noise of the sensors, and nearly equal in consecutive samples: fifty
//! samples within 50 ms carry hardly more information than one of them. The estimator, however, takes samples as
//! independent. The same touch, logged at fifty times the rate, would count fifty times as much against the prior, fill
//! the memory and take fifty times the computation. So samples within `MIN_S` of the last learnt one are not learnt
//! from: they are predicted only, or passed over. Samples without times are selected by the mean displacement from sample to sample instead.

use std::f64::consts::TAU;

use crate::tracker::Sample;

/// Least time between learnt samples, s: a little below the period of the logs (20 Hz) for which the default settings
/// were chosen. Of these logs all samples are learnt, of logs at 1 kHz one in 45.
const MIN_S: f64 = 0.045;

/// Least displacement of the fastest joint between learnt samples without times, rad (m). In those logs it is 2 to 9
/// mrad per sample.
const MIN_RAD: f64 = 2e-3;
/// Displacement from sample to sample, rad (m), below which the arm counts as at rest.
const MOVING_RAD: f64 = 1e-5;

/// Selects samples of one touch that are far enough apart.
#[derive(Debug, Clone, Default)]
pub struct Downsampling {
    /// Time of the last learnt sample, s.
    pub(crate) last_s: Option<f64>,
    /// Number of samples since the last learnt one, including it; 0 before the first.
    since: u32,
    /// Joint positions of the previous sample, n_joints.
    previous_q: Vec<f64>,
    /// Sum and number of the displacements of the fastest joint from sample to sample, rad, while it moves.
    steps: (f64, u32),
}

impl Downsampling {
    /// Whether to learn from this sample. The first sample after the clock went back is always learnt.
    pub fn takes(&mut self, sample: &Sample) -> bool {
        self.follow(&sample.q);
        let is_close = match (sample.time_s, self.last_s) {
            (Some(now), Some(last)) => (0.0..MIN_S).contains(&(now - last)),
            (Some(_), None) => false,
            (None, _) => self.since > 0 && f64::from(self.since) * self.mean_step() < MIN_RAD,
        };
        if is_close {
            self.since += 1;
        } else {
            self.since = 1;
            self.last_s = sample.time_s.or(self.last_s);
        }
        !is_close
    }

    fn follow(&mut self, q: &[f64]) {
        let turned = |(now, before): (&f64, &f64)| {
            let way = (now - before).rem_euclid(TAU);
            way.min(TAU - way)
        };
        let step = q.iter().zip(&self.previous_q).map(turned).fold(0.0, f64::max);
        if step > MOVING_RAD {
            self.steps = (self.steps.0 + step, self.steps.1 + 1);
        }
        self.previous_q.clear();
        self.previous_q.extend_from_slice(q);
    }

    /// Mean displacement of the fastest joint from sample to sample while it moves, rad; infinite before it has moved.
    fn mean_step(&self) -> f64 {
        let (sum, count) = self.steps;
        if count > 0 { sum / f64::from(count) } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(samples: impl IntoIterator<Item = (Option<f64>, f64)>) -> Vec<bool> {
        let mut downsampling = Downsampling::default();
        let sample = |(time_s, q)| Sample::new(time_s, vec![0.0, q], vec![0.0; 2]);
        samples.into_iter().map(|of| downsampling.takes(&sample(of))).collect()
    }

    #[test]
    fn the_number_of_learnt_samples_hardly_depends_on_the_rate() {
        // The worst are just above 22 Hz, where every other sample is left out.
        for rate_hz in [20, 25, 30, 40, 100, 125, 200, 500, 1000] {
            let times = (0..rate_hz).map(|sample| f64::from(sample) / f64::from(rate_hz));
            let learnt = taken(times.map(|time_s| (Some(time_s), 0.0)));
            let learnt = learnt.iter().filter(|takes| **takes).count();
            assert!((13..=23).contains(&learnt), "{learnt} at {rate_hz} Hz");
        }
    }

    #[test]
    fn without_times_the_displacement_of_the_joints_replaces_the_time() {
        // Half a second at rest, one in which a joint turns by 0.07 rad past the end of its range, then at rest again.
        let q = |time_s: f64| {
            let q = 6.25 + 0.07 * (time_s - 0.5).clamp(0.0, 1.0);
            if q > TAU { q - TAU } else { q }
        };
        for rate_hz in [20, 40, 100, 200, 500, 1000] {
            let times = (0..3 * rate_hz).map(|sample| f64::from(sample) / f64::from(rate_hz));
            let learnt = taken(times.map(|time_s| (None, q(time_s))));
            let [moving, held] = [1, 3].map(|half| {
                let from = (half * rate_hz / 2) as usize + 1;
                learnt[from..from + rate_hz as usize].iter().filter(|takes| **takes).count()
            });
            assert!((19..=36).contains(&moving), "{moving} moving at {rate_hz} Hz");
            assert!((19..=36).contains(&held), "{held} held at {rate_hz} Hz");
        }
    }

    #[test]
    fn a_fast_approach_does_not_hide_how_slow_the_contact_is() {
        // Half a second at 0.3 rad/s, then three at 0.05 rad/s.
        let q = |time_s: f64| 0.3 * time_s.min(0.5) + 0.05 * (time_s - 0.5).max(0.0);
        for rate_hz in [200, 1000] {
            let times = (0..7 * rate_hz / 2).map(|sample| f64::from(sample) / f64::from(rate_hz));
            let learnt = taken(times.map(|time_s| (None, q(time_s))));
            let contact = learnt[2 * rate_hz as usize..3 * rate_hz as usize].iter();
            let count = contact.filter(|takes| **takes).count();
            assert!((19..=60).contains(&count), "{count} at {rate_hz} Hz");
        }
    }

    #[test]
    fn samples_of_an_arm_at_rest_without_times_and_after_a_jump_back_are_learnt_from() {
        let at_rest = |times: [Option<f64>; 5]| taken(times.map(|time_s| (time_s, 0.0)));
        assert_eq!(
            at_rest([None, None, Some(1.0), None, Some(1.001)]),
            [true, true, true, true, false]
        );
        assert_eq!(
            at_rest([Some(5.0), Some(5.01), Some(0.0), Some(0.01), Some(0.05)]),
            [true, false, true, false, true]
        );
    }
}
