//! Checks the samples during a session, as `palpate inspect` checks a log, and collects warnings.

use std::mem::take;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use palpate::{Mapper, Sample};
use palpate_io::log::AngleUnit;
use palpate_live::MappedSample;
use palpate_live::latest_queue::LatestQueue;
use palpate_live::session::SessionState;
use palpate_work::inspect::log::LogCheck;

use crate::output::Output;

/// Largest number of samples that wait to be checked.
const WAITING: usize = 4096;
/// Least time between two samples that are kept, s: 100 Hz is enough for the checks.
const EVERY_S: f64 = 0.01;
/// Largest number of samples kept of the pause before a touch.
const PAUSE: usize = 100;
/// Number of samples kept of touches: beyond it, all are dropped when the next touch begins.
const KEPT: usize = 20_000;
/// Time between two checks.
const LOOK: Duration = Duration::from_secs(10);
/// How long the thread waits for a sample before it checks whether the session has ended.
const PATIENCE: Duration = Duration::from_millis(100);

/// A thread that checks the mapped samples without delaying the session.
pub(super) struct Checker {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    mapped: Arc<LatestQueue<MappedSample>>,
    warnings: Mutex<Vec<String>>,
    ends: AtomicBool,
}

impl Checker {
    pub(super) fn start(mapper: &Mapper) -> Self {
        let config = mapper.config();
        let (place, set) = ((config.lattice.clone(), config.contact.clone()), &config.touch);
        // Joint states of ROS are in radians.
        let check = LogCheck::new(mapper.arm(), place, set, (AngleUnit::Rad, false));
        let mapped = Arc::new(LatestQueue::new(WAITING));
        let shared =
            Arc::new(Shared { mapped, warnings: Mutex::default(), ends: AtomicBool::new(false) });
        let (own, still_rad) = (Arc::clone(&shared), set.still_rad);
        let looking = Looking { check, still_rad, pause: Vec::new(), kept_s: None, fresh: false };
        let thread = thread::spawn(move || looking.run(&own));
        Self { shared, thread: Some(thread) }
    }

    /// The queue of mapped samples to be checked.
    pub(super) fn inbox(&self) -> Arc<LatestQueue<MappedSample>> {
        Arc::clone(&self.shared.mapped)
    }

    /// The warnings that were not reported yet.
    pub(super) fn warnings(&self) -> Vec<String> {
        take(&mut *self.shared.warnings.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Checks the last samples, and returns the warnings.
    pub(super) fn end(&mut self) -> Vec<String> {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.shared.mapped.wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // a panic was reported where it happened
        }
        self.warnings()
    }
}

struct Looking {
    check: LogCheck,
    still_rad: f64,
    /// The last samples outside of touches.
    pause: Vec<Sample>,
    /// Time of the sample that was kept last, s.
    kept_s: Option<f64>,
    /// Whether samples were kept since the last check.
    fresh: bool,
}

impl Looking {
    fn run(mut self, shared: &Shared) {
        let mut looked = Instant::now();
        loop {
            let mapped = shared.mapped.pop(PATIENCE);
            let ends = mapped.is_none() && shared.ends.load(Ordering::Relaxed);
            if let Some(mapped) = mapped {
                self.take(mapped);
            }
            if self.fresh && (ends || looked.elapsed() >= LOOK) {
                let lines = self.check.look_live(&Output { quiet: true });
                shared.warnings.lock().unwrap_or_else(PoisonError::into_inner).extend(lines);
                (looked, self.fresh) = (Instant::now(), false);
            }
            if ends {
                return;
            }
        }
    }

    fn take(&mut self, MappedSample { sample, contacts, state, begins, .. }: MappedSample) {
        let due = |kept_s: f64| sample.time_s.is_none_or(|now_s| (now_s - kept_s).abs() >= EVERY_S);
        if !begins && !self.kept_s.is_none_or(due) {
            return;
        }
        self.kept_s = sample.time_s;
        if begins {
            self.check.begin_live(&self.start(&sample), KEPT);
            self.pause.clear();
        }
        if state == SessionState::Waiting {
            self.pause.push(sample);
            if self.pause.len() > 2 * PAUSE {
                self.pause.drain(..PAUSE);
            }
        } else {
            self.check.add(&sample, contacts);
            self.fresh = true;
        }
    }

    /// The samples of the pause before `sample` in which the arm stands as in `sample`.
    fn start(&self, sample: &Sample) -> Vec<Sample> {
        let is_still = |before: &&Sample| {
            let joints = before.q.iter().zip(&sample.q);
            joints.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) <= self.still_rad
        };
        let mut start: Vec<Sample> =
            self.pause.iter().rev().take(PAUSE).take_while(is_still).cloned().collect();
        start.reverse();
        start
    }
}
