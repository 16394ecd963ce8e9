//! When replays are made: remembered frames are fused again, so that the estimator does not forget them
//! (Sec. II).
//!
//! A frame is drawn and fused in `Estimator::replay` (`map.rs`, `ekf.rs`); `memory.rs` stores the frames.
//! [`ReplayPolicy`] determines when, and on which thread, the replays of a frame are made; their number is a setting of
//! the estimator. [`Replays`] owns the estimator and applies the policy. On whichever thread they run, replays (other
//! than in spare time) are made after the correction of their frame and before any other access to the belief, so the
//! result is the same to the bit.

mod memory;

use std::ops::{Deref, DerefMut};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard};

pub(crate) use memory::ReplayMemory;
pub use memory::{MemoryLimits, RngState};

use crate::estimator::Estimator;

/// When the replays of a frame are made, and on which thread.
///
/// How many belong to a frame is [`crate::EstimatorConfig::replays`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ReplayPolicy {
    /// On a thread of rayon's pool as soon as the frame is learnt, while the caller goes on; if the pool has one
    /// thread, or none is free, on the thread that accesses the belief next.
    #[default]
    Background,
    /// When the caller has spare time and calls [`crate::Mapper::spare_time`]: at most the replays of the latest frame.
    /// Replays that are not made before the next frame is learnt are dropped.
    SpareTime,
    /// As [`ReplayPolicy::SpareTime`], but without a bound on the number of replays.
    SpareTimeUnbounded,
}

/// An estimator, and the policy of its replays.
pub(crate) struct Replays {
    pending: Arc<Mutex<Pending>>,
    policy: ReplayPolicy,
    /// Number of replays for each frame.
    per_frame: u32,
    /// Number of replays that may still be made for the latest frame in spare time.
    spare: u32,
    /// Whether the latest sample was learnt from.
    learnt: bool,
}

/// An estimator, and the number of replays to be made before any other access to it.
struct Pending {
    estimator: Box<dyn Estimator>,
    due: u32,
}

/// The estimator with all its due replays made.
pub(crate) struct UpToDate<'a>(MutexGuard<'a, Pending>);

/// Waits for the estimator and makes the replays that are due.
fn up_to_date(pending: &Mutex<Pending>) -> UpToDate<'_> {
    let mut pending = pending.lock().expect("a replay panics only by a bug, which ends the mapper");
    let due = std::mem::take(&mut pending.due);
    if due > 0 {
        pending.estimator.replay(due);
    }
    UpToDate(pending)
}

impl Replays {
    /// Takes over an estimator, with `per_frame` replays for each frame that it learns.
    pub(crate) fn new(estimator: Box<dyn Estimator>, per_frame: u32, policy: ReplayPolicy) -> Self {
        let pending = Arc::new(Mutex::new(Pending { estimator, due: 0 }));
        Self { pending, policy, per_frame, spare: 0, learnt: false }
    }

    /// Sets another policy; replays left for spare time are dropped.
    pub(crate) fn set_policy(&mut self, policy: ReplayPolicy) {
        drop(self.estimator());
        (self.policy, self.spare) = (policy, 0);
    }

    /// The estimator, with its due replays made.
    pub(crate) fn estimator(&self) -> UpToDate<'_> {
        up_to_date(&self.pending)
    }

    /// Notes that a new sample comes, from which nothing is learnt so far.
    pub(crate) fn begin_step(&mut self) {
        self.learnt = false;
    }

    /// Sets whether the latest sample was learnt from, when a mapper is resumed.
    pub(crate) fn set_learnt(&mut self, learnt: bool) {
        self.learnt = learnt;
    }

    /// Ends a touch. `map` draws once from memory even for 0 replays, `ekf` does not. Earlier versions made this extra
    /// draw if the last sample was not learnt from; it is kept, so that fields stay equal to the bit.
    pub(crate) fn end_touch(&mut self) {
        let learnt = std::mem::take(&mut self.learnt);
        let mut estimator = self.estimator();
        if !learnt || self.per_frame == 0 {
            estimator.replay(0);
        }
    }

    /// Starts the replays of the frame that was just learnt, or notes them for later, according to the policy.
    pub(crate) fn replay(&mut self) {
        self.learnt = true;
        match self.policy {
            ReplayPolicy::Background => self.estimator().0.due = self.per_frame,
            ReplayPolicy::SpareTime | ReplayPolicy::SpareTimeUnbounded => {
                self.spare = self.per_frame
            }
        }
        if self.policy == ReplayPolicy::Background && rayon::current_num_threads() > 1 {
            let pending = Arc::clone(&self.pending);
            // A panic poisons the lock, which ends the mapper; uncaught, it would end the process.
            let replay = move || drop(up_to_date(&pending));
            rayon::spawn(move || drop(catch_unwind(AssertUnwindSafe(replay))));
        }
    }

    /// Number of replays that may be made in spare time.
    pub(crate) fn spare(&self) -> u32 {
        match self.policy {
            ReplayPolicy::SpareTimeUnbounded => u32::MAX,
            _ => self.spare,
        }
    }

    /// Makes replays in spare time until `grant` returns 0, no more may be made, or nothing is remembered; returns how
    /// many were made. `grant` gets the number that may still be made and returns how many to make before it is called
    /// again.
    pub(crate) fn spare_time(&mut self, mut grant: impl FnMut(u32) -> u32) -> u32 {
        let mut made = 0_u32;
        loop {
            let granted = match self.spare() {
                0 => break,
                spare => grant(spare).min(spare),
            };
            let visited = if granted > 0 { self.estimator().replay(granted).frames } else { 0 };
            if visited == 0 {
                break;
            }
            self.spare = self.spare.saturating_sub(visited);
            made = made.saturating_add(visited);
        }
        made
    }
}

impl Deref for UpToDate<'_> {
    type Target = dyn Estimator;

    fn deref(&self) -> &Self::Target {
        &*self.0.estimator
    }
}

impl DerefMut for UpToDate<'_> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut *self.0.estimator
    }
}
