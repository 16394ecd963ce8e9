//! Whether the joints of a recording are loaded no more than where the last touch began, whatever its torques count as.
//!
//! An arm that goes from one place to the next sweeps points of the box on its way, which a simulator of contacts then
//! finds touched though nothing is there. Its torques know better: in the air they are those of the last pause, but for
//! gravity. Whether they hold gravity, and in which sign, nobody has said here; so all three readings are followed, and the
//! one counts in which the torques vary least: a wrong one adds gravity to them, or leaves it in.

use std::collections::VecDeque;

use palpate::{Robot, Sample};

use crate::inspect::farthest;

/// Samples of a standstill whose mean is taken, at least and at most.
const MEAN_OF: [usize; 2] = [10, 100];
/// As much of the largest load counts as none.
const FREE: f64 = 0.2;
/// How gravity enters the readings: not at all, as what the joints feel, as what the motors exert.
const READINGS: [f64; 3] = [0.0, -1.0, 1.0];

/// Torques by joint, N·m, in each reading.
type Torques = [Vec<f64>; READINGS.len()];

/// Loads since the last pause.
#[derive(Default)]
pub(super) struct Load {
    /// Samples in which the arm stands still, with their positions.
    still: VecDeque<(Vec<f64>, Torques)>,
    /// Where the last touch began, and the largest difference from it since then, N·m.
    start: Option<Torques>,
    largest: [f64; READINGS.len()],
    /// The largest of all touches before.
    before: [f64; READINGS.len()],
}

impl Load {
    /// Begins a touch: what the arm bears now counts as nothing.
    pub(super) fn begin(&mut self) {
        self.start = self.mean();
        for (before, largest) in self.before.iter_mut().zip(std::mem::take(&mut self.largest)) {
            *before = before.max(largest);
        }
    }

    /// Forgets all samples: those to come are of another recording.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Takes the next sample; whether the arm stands still and bears as little as where the last touch began, if that can
    /// be said.
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
        // On a way through the air nothing is large, so what other touches had counts for half.
        let usual = self.largest[least].max(0.5 * self.before[least]);
        // Without torques, as in a planned motion, nothing can be said.
        usual > 0.0 && now[least] <= FREE * usual
    }

    /// Of the standstill, if it is long enough.
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

/// By how much torques differ from those at a start, N·m, in each reading.
fn loads(now: &Torques, start: &Torques) -> [f64; READINGS.len()] {
    std::array::from_fn(|reading| farthest(&now[reading], &start[reading]))
}
