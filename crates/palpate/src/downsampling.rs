//! Which samples of a touch are learnt from: no more than tell anything new.
//!
//! What the model leaves unexplained is many times the sensors' noise, and alike in samples that follow closely on each
//! other: fifty samples in 50 ms say hardly more than one of them. Each counts as a measurement of its own, though,
//! so that the same touch, logged fifty times as often, would outweigh the prior by fifty times as much, fill the memory
//! and cost fifty times the work. So samples closer together than `LEAST_S` are predicted, and not learnt from.

/// The least time between samples that are learnt from, s: somewhat less than the period of the logs that the shipped
/// settings were chosen on, 20 Hz. Of those all are learnt from, of 1 kHz one in 45.
const LEAST_S: f64 = 0.045;

/// Takes samples of one touch that are far enough apart.
#[derive(Debug, Clone, Default)]
pub struct Downsampling {
    /// When the last one was, s.
    pub(crate) last_s: Option<f64>,
}

impl Downsampling {
    /// Whether a sample at this time, s, is learnt from; one without a time is, and so is the first after a clock went
    /// back.
    pub fn takes(&mut self, time_s: Option<f64>) -> bool {
        let Some(now) = time_s else { return true };
        let is_close = |last: f64| (0.0..LEAST_S).contains(&(now - last));
        let takes = !self.last_s.is_some_and(is_close);
        if takes {
            self.last_s = Some(now);
        }
        takes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(times: impl IntoIterator<Item = Option<f64>>) -> Vec<bool> {
        let mut downsampling = Downsampling::default();
        times.into_iter().map(|time| downsampling.takes(time)).collect()
    }

    #[test]
    fn what_is_learnt_hardly_depends_on_the_rate() {
        // The worst are just above 22 Hz, where every other sample is left out.
        for rate_hz in [20, 25, 30, 40, 100, 125, 200, 500, 1000] {
            let times = (0..rate_hz).map(|sample| Some(f64::from(sample) / f64::from(rate_hz)));
            let learnt = taken(times).iter().filter(|takes| **takes).count();
            assert!((13..=23).contains(&learnt), "{learnt} at {rate_hz} Hz");
        }
    }

    #[test]
    fn samples_without_times_and_after_a_jump_back_are_learnt_from() {
        assert_eq!(
            taken([None, None, Some(1.0), None, Some(1.001)]),
            [true, true, true, true, false]
        );
        assert_eq!(
            taken([Some(5.0), Some(5.01), Some(0.0), Some(0.01)]),
            [true, false, true, false]
        );
    }
}
