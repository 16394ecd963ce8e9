//! Which samples of a touch are learnt from: only as many as carry new information.
//!
//! What the model leaves unexplained is many times the sensors' noise, and alike in samples that follow closely on each
//! other: fifty samples in 50 ms say hardly more than one of them. Each counts as a measurement of its own, though,
//! so that the same touch, logged fifty times as often, would outweigh the prior by fifty times as much, fill the memory
//! and cost fifty times the work. So samples closer together than `LEAST_S` are predicted, and not learnt from. Where samples
//! have no times, the mean displacement from sample to sample replaces them.

use std::f64::consts::TAU;

use crate::tracker::Sample;

/// The least time between samples that are learnt from, s: somewhat less than the period of the logs that the shipped
/// settings were chosen on, 20 Hz. Of those all are learnt from, of 1 kHz one in 45.
const LEAST_S: f64 = 0.045;

/// The same without times: least displacement of the fastest joint, rad (m). In those logs it is 2 to 9 mrad a sample.
const LEAST_RAD: f64 = 2e-3;
/// A smaller step from sample to sample is the noise of an arm at rest.
const MOVING_RAD: f64 = 1e-5;

/// Takes samples of one touch that are far enough apart.
#[derive(Debug, Clone, Default)]
pub struct Downsampling {
    /// When the last one was, s.
    pub(crate) last_s: Option<f64>,
    /// Samples since the last one that was learnt from, itself included; 0 before the first.
    since: u32,
    /// Joint positions of the sample before, n_joints.
    previous_q: Vec<f64>,
    /// Sum and number of the fastest joint's displacements from sample to sample, rad, while it moves.
    steps: (f64, u32),
}

impl Downsampling {
    /// Whether this sample is learnt from; the first after a clock went back is.
    pub fn takes(&mut self, sample: &Sample) -> bool {
        self.follow(&sample.q);
        let is_close = match (sample.time_s, self.last_s) {
            (Some(now), Some(last)) => (0.0..LEAST_S).contains(&(now - last)),
            (Some(_), None) => false,
            (None, _) => self.since > 0 && f64::from(self.since) * self.mean_step() < LEAST_RAD,
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
    fn what_is_learnt_hardly_depends_on_the_rate() {
        // The worst are just above 22 Hz, where every other sample is left out.
        for rate_hz in [20, 25, 30, 40, 100, 125, 200, 500, 1000] {
            let times = (0..rate_hz).map(|sample| f64::from(sample) / f64::from(rate_hz));
            let learnt = taken(times.map(|time_s| (Some(time_s), 0.0)));
            let learnt = learnt.iter().filter(|takes| **takes).count();
            assert!((13..=23).contains(&learnt), "{learnt} at {rate_hz} Hz");
        }
    }

    #[test]
    fn without_times_the_way_of_the_joints_gives_the_rate() {
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
