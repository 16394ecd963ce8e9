//! Whether the joints carry no more load than at the start of the last touch, for torques of unknown convention.
//!
//! An arm that moves between two touches sweeps points of the lattice, and a simulation of contacts finds them touched
//! although nothing is there. The torques show it: without contact they equal those of the last pause, apart from
//! gravity. Their sign, and whether they contain gravity, are not known here. So three readings are followed, and the
//! one is used in which the torques vary least, because a wrong reading adds gravity or does not remove it.

use std::collections::VecDeque;

use palpate::{Robot, Sample};

use crate::inspect::farthest;

/// Fewest and most samples of a standstill whose mean torque is used.
const MEAN_OF: [usize; 2] = [10, 100];
/// Largest load of a free arm, as a share of the usual largest load.
const FREE: f64 = 0.2;
/// Factor of the gravity torque that each reading adds to the logged torque: torques without gravity, with gravity and
/// sign plus, with gravity and sign minus.
const READINGS: [f64; 3] = [0.0, -1.0, 1.0];

/// Torque of each joint, N·m, by reading.
type Torques = [Vec<f64>; READINGS.len()];

/// Loads since the start of the last touch.
#[derive(Default)]
pub(super) struct Load {
    /// Joint positions and torques of the latest samples in which the arm stands still.
    still: VecDeque<(Vec<f64>, Torques)>,
    /// Torques at the start of the last touch, and the largest difference from them since then, N·m.
    start: Option<Torques>,
    largest: [f64; READINGS.len()],
    /// Largest difference in all touches before, N·m.
    before: [f64; READINGS.len()],
}

impl Load {
    /// Begins a touch: loads are measured from the present torques.
    pub(super) fn begin(&mut self) {
        self.start = self.mean();
        for (before, largest) in self.before.iter_mut().zip(std::mem::take(&mut self.largest)) {
            *before = before.max(largest);
        }
    }

    /// Forgets all samples, before those of another recording.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Takes the next sample; true if the arm stands still with as little load as at the start of the last touch, false
    /// if not or if that cannot be decided.
    pub(super) fn is_free(&mut self, robot: &Robot, sample: &Sample, still_rad: f64) -> bool {
        let Ok(poses) = robot.forward(&sample.q) else { return false };
        let gravity = robot.gravity_torque(&poses);
        let read = |sign: f64| -> Vec<f64> {
            sample.tau.iter().zip(gravity.iter()).map(|(tau, own)| tau + sign * own).collect()
        };
        let torques = READINGS.map(read);
        if let Some(start) = &self.start {
            for (largest, load) in self.largest.iter_mut().zip(loads(&torques, start)) {
                *largest = largest.max(load);
            }
        }
        if self.still.front().is_some_and(|(q, _)| farthest(q, &sample.q) > still_rad) {
            self.still.clear();
        }
        if self.still.len() == MEAN_OF[1] {
            self.still.pop_front();
        }
        self.still.push_back((sample.q.clone(), torques));
        let Some(mean) = self.mean() else { return false };
        let start = self.start.get_or_insert_with(|| mean.clone());
        let now = loads(&mean, start);
        let ever = |own: usize| self.largest[own].max(self.before[own]);
        let Some(least) = (0..now.len()).min_by(|a, b| ever(*a).total_cmp(&ever(*b))) else {
            return false;
        };
        // In a motion without contact all loads are small, so the largest load of earlier touches counts half.
        let usual = self.largest[least].max(0.5 * self.before[least]);
        // Without torques, as in a planned motion, nothing can be decided.
        usual > 0.0 && now[least] <= FREE * usual
    }

    /// Mean torques of the standstill, if it is long enough.
    fn mean(&self) -> Option<Torques> {
        (self.still.len() >= MEAN_OF[0]).then(|| {
            std::array::from_fn(|reading| {
                let joints = self.still[0].1[reading].len();
                let sum =
                    |joint: usize| self.still.iter().map(|own| own.1[reading][joint]).sum::<f64>();
                (0..joints).map(|joint| sum(joint) / self.still.len() as f64).collect()
            })
        })
    }
}

/// Largest difference of a joint's torque from that at the start, N·m, by reading.
fn loads(now: &Torques, start: &Torques) -> [f64; READINGS.len()] {
    std::array::from_fn(|reading| farthest(&now[reading], &start[reading]))
}
