//! Reduces the time of choosing settings from a long log: of its touches, only every n-th sample is simulated.
//!
//! The simulator cuts the motion between two samples into sub-steps. So a touch of which only every n-th sample is
//! simulated takes nearly the same path in fewer steps: the arm often moves by 1 to 3 mm between samples, and a sub-step
//! may be 6 mm. No part of a touch is left out: contacts depend on the motion since its start, and the largest torques
//! often come at its end.

use nalgebra::Isometry3;
use palpate::unstable::Downsampling;
use palpate::{Arm, MapperConfig, Sample};
use rayon::prelude::*;

/// Of the samples that are learnt ([`Downsampling`]), one of this many is simulated at least: one in 0.4 s at 20 Hz.
const MOST: usize = 8;

/// A fast arm needs as many steps with fewer samples, so no more are left out if that saves less than a tenth.
const NEARLY: f64 = 0.9;

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

    /// About the number of steps of the simulator, if every n-th sample is simulated.
    pub(crate) fn steps(&self, n: usize) -> f64 {
        let of_way = |way_m: &[f64]| (way_m.iter().sum::<f64>() / self.substep_m).ceil().max(1.0);
        self.ways_m.iter().flat_map(|ways_m| ways_m.chunks(n)).map(of_way).sum()
    }

    /// The least multiple of `n` up to [`MOST`] with which there are at most `steps` steps, or nearly as few as possible.
    pub(crate) fn thinned_to(&self, steps: f64, n: usize) -> usize {
        let multiples = || (n..=MOST.max(n)).step_by(n);
        let fewest = multiples().map(|n| self.steps(n)).fold(f64::INFINITY, f64::min);
        let enough = steps.max(fewest / NEARLY);
        multiples().find(|&n| self.steps(n) <= enough).unwrap_or(n)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_arm_is_thinned_until_the_steps_suffice_and_a_fast_one_is_not() {
        // 1 to 3 mm, or three times the sub-step, from sample to sample.
        let ways = |way_m: fn(usize) -> f64| {
            let ways_m = [1_000, 400].map(|samples| (0..samples).map(way_m).collect()).to_vec();
            Ways { ways_m, substep_m: 0.006 }
        };
        let (slow, fast) = (ways(|at| 0.001 * (1 + at % 3) as f64), ways(|_| 0.0179));
        assert_eq!([&slow, &fast].map(|ways| ways.steps(1)), [1_400.0, 4_200.0]);
        for n in [1, 3] {
            assert_eq!(fast.thinned_to(20.0, n), n);
            let mut before = n;
            for steps in [1_500.0, 700.0, 600.0, 520.0, 20.0] {
                let found = slow.thinned_to(steps, n);
                assert!(found.is_multiple_of(n) && found >= before && found <= MOST, "{found}");
                assert!(slow.steps(found) <= steps || slow.steps(found) < 0.5 * slow.steps(1));
                before = found;
            }
            assert!(before >= 3, "{before}");
        }
        assert_eq!([1_400.0, 750.0].map(|steps| slow.thinned_to(steps, 1)), [1, 2]);
    }
}
