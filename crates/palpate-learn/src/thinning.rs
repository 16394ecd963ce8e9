//! Bounds the time of choosing settings from a long log: of its touches, fewer samples are simulated.
//!
//! The simulator cuts the motion between two samples into sub-steps. So a touch of which only every n-th sample is
//! simulated takes nearly the same path in fewer steps: the arm often moves by 1 to 3 mm between samples, and a sub-step
//! may be 6 mm. If that is not enough, the ends of touches are left out. Contacts depend on the motion since the start
//! of the touch, so the start is never left out.

use std::sync::Arc;

use nalgebra::{DVector, Isometry3};
use palpate::unstable::{Downsampling, Tracker};
use palpate::{Arm, MapperConfig, Sample, SettingError, Tare};
use rayon::prelude::*;

/// Which of the samples that are learnt ([`Downsampling`]) are simulated, after the tare.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Thinning {
    /// Every n-th sample is simulated; this is n, at least 1.
    pub(crate) every: usize,
    /// The part of each touch, from its first sample on, that is simulated, above 0 and up to 1.
    pub(crate) part: f64,
}

/// Largest [`Thinning::every`]: 0.4 s at 20 Hz.
const MOST: usize = 8;

/// A thinning is not increased if this gains less than a tenth of a touch: a fast arm needs as many steps with fewer
/// samples.
const NEARLY: f64 = 0.9;

impl Default for Thinning {
    /// All samples.
    fn default() -> Self {
        Self { every: 1, part: 1.0 }
    }
}

impl Thinning {
    /// Whether the sample is simulated that is the `learnt`-th (from 0) of those learnt after the tare, and the
    /// `index`-th of the `samples` of its touch.
    pub(crate) fn takes(self, learnt: usize, place: (usize, usize)) -> bool {
        learnt.is_multiple_of(self.every) && self.reaches(place)
    }

    /// Whether the `index`-th of the `samples` of a touch is in the part that is simulated.
    pub(crate) fn reaches(self, (index, samples): (usize, usize)) -> bool {
        index as f64 <= self.part * samples as f64
    }
}

/// How far the arm moves in some touches.
pub(crate) struct Ways {
    /// For each touch, the ways from each learnt sample to the next, m.
    ways_m: Vec<Vec<f64>>,
    substep_m: f64,
}

impl Ways {
    /// Of touches, given by their samples.
    pub(crate) fn of(arm: &Arm, config: &MapperConfig, touches: &[&[Sample]]) -> Self {
        let ways_m = touches.par_iter().map(|samples| ways_m(arm, samples)).collect();
        Self { ways_m, substep_m: config.contact.substep_cells * config.lattice.spacing_m() }
    }

    /// About the number of steps of the simulator.
    pub(crate) fn steps(&self, Thinning { every, part }: Thinning) -> f64 {
        let of_way = |way_m: &[f64]| (way_m.iter().sum::<f64>() / self.substep_m).ceil().max(1.0);
        let ways = self.ways_m.iter().flat_map(|ways_m| ways_m.chunks(every));
        part * ways.map(of_way).sum::<f64>()
    }

    /// A thinning of samples that are thinned already, with which there are at most `steps` steps: the least one with
    /// which the simulated part of each touch is at least [`NEARLY`] the largest possible.
    pub(crate) fn thinned_to(&self, steps: f64, from: Thinning) -> Thinning {
        let thinned = |every| {
            let needed = self.steps(Thinning { every, ..from });
            Thinning { every, part: from.part * (steps / needed).min(1.0) }
        };
        let multiples = (from.every..=MOST.max(from.every)).step_by(from.every).map(thinned);
        let multiples: Vec<Thinning> = multiples.collect();
        let most = multiples.iter().map(|thinning| thinning.part).fold(0.0, f64::max);
        let found = multiples.into_iter().find(|thinning| thinning.part >= NEARLY * most);
        found.unwrap_or(from)
    }
}

/// How far the arm moves from each learnt sample of a touch to the next, m; 0 for samples of another robot.
fn ways_m(arm: &Arm, samples: &[Sample]) -> Vec<f64> {
    let mut downsampling = Downsampling::default();
    let learnt = samples.iter().filter(|sample| downsampling.takes(sample));
    let poses: Vec<Option<Vec<Isometry3<f64>>>> =
        learnt.map(|sample| Some(arm.robot.forward(&sample.q).ok()?.world_from_link)).collect();
    let way_m = |pair: &[Option<Vec<Isometry3<f64>>>]| match pair {
        [Some(from), Some(to)] => arm.travel_m(from, to),
        _ => 0.0,
    };
    poses.windows(2).map(way_m).collect()
}

/// For each touch, given by its samples, the largest change of the torque since its first sample, or without a tare the
/// largest torque, as the norm over the joints, N·m. Contacts are not simulated, so this takes little time.
///
/// # Errors
///
/// If a setting is out of its range.
pub fn largest_changes(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[&[Sample]],
) -> Result<Vec<f64>, SettingError> {
    let (contact, touch) = (&config.contact, config.touch.clone());
    let tracker = Tracker::new(Arc::clone(arm), config.lattice.clone(), contact, touch)?;
    let largest = |samples: &&[Sample]| {
        // Samples that cannot be used are refused where they are simulated.
        let mut torques = samples.iter().filter_map(|sample| Some(tracker.check(sample).ok()?.1));
        let first = torques.next().filter(|_| config.touch.tare != Tare::None);
        let change = |torque: DVector<f64>| match &first {
            Some(first) => (torque - first).norm(),
            None => torque.norm(),
        };
        torques.map(change).fold(0.0, f64::max)
    };
    Ok(touches.par_iter().map(largest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_arm_is_thinned_and_of_a_fast_one_the_ends_are_left_out() {
        // 1 to 3 mm, or three times the sub-step, from sample to sample.
        let ways = |way_m: fn(usize) -> f64| {
            let ways_m = [1_000, 400].map(|samples| (0..samples).map(way_m).collect()).to_vec();
            Ways { ways_m, substep_m: 0.006 }
        };
        let (slow, fast) = (ways(|at| 0.001 * (1 + at % 3) as f64), ways(|_| 0.0179));
        assert_eq!([&slow, &fast].map(|ways| ways.steps(Thinning::default())), [1_400.0, 4_200.0]);
        for from in [Thinning::default(), Thinning { every: 3, part: 0.9 }] {
            assert_eq!(fast.thinned_to(2_100.0, from).every, from.every);
            let mut before = from;
            for steps in [1_500.0, 700.0, 600.0, 520.0, 300.0, 20.0] {
                let found = slow.thinned_to(steps, from);
                assert!(slow.steps(found) <= steps + 1e-9, "{found:?}");
                assert!(found.every.is_multiple_of(from.every) && found.every >= before.every);
                assert!(found.part <= before.part + 0.1 && found.part > 0.0, "{found:?}");
                before = found;
            }
            assert!(before.every >= 3 && before.part < 0.1, "{before:?}");
        }
        assert_eq!(slow.thinned_to(1_400.0, Thinning::default()), Thinning::default());
        assert_eq!(slow.thinned_to(750.0, Thinning::default()).every, 2);
    }
}
