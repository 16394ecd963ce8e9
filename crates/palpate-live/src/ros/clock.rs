//! The time in messages: of the system clock, or of a simulation.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::message::{Clock, Stamp};

/// The clock of stamps.
#[derive(Debug, Clone, Default)]
pub(super) struct RosClock {
    /// Bits of the last time on `/clock`, s; 0 before the first. `None` for the system clock.
    sim_time: Option<Arc<AtomicU64>>,
}

impl RosClock {
    /// The system clock, or that of `/clock`.
    pub(super) fn new(is_simulated: bool) -> Self {
        Self { sim_time: is_simulated.then(Arc::default) }
    }

    /// Whether it follows `/clock`.
    pub(super) fn is_simulated(&self) -> bool {
        self.sim_time.is_some()
    }

    /// Takes the time of a message on `/clock`.
    pub(super) fn set(&self, Clock { clock }: Clock) {
        let now_s = clock.seconds().unwrap_or(0.0);
        self.sim_time.iter().for_each(|bits| bits.store(now_s.to_bits(), Ordering::Relaxed));
    }

    /// The present time, s.
    pub(super) fn now_s(&self) -> f64 {
        match &self.sim_time {
            Some(bits) => f64::from_bits(bits.load(Ordering::Relaxed)),
            None => {
                SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |now| now.as_secs_f64())
            }
        }
    }

    /// The present time as a stamp.
    pub(super) fn stamp(&self) -> Stamp {
        match &self.sim_time {
            Some(_) => Stamp::at(self.now_s()),
            None => Stamp::now(),
        }
    }
}
