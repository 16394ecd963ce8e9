//! The time in messages: the system's, or that of a simulation.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::message::{Clock, Stamp};

/// The clock that stamps are of.
#[derive(Debug, Clone, Default)]
pub(super) struct RosClock {
    /// Bits of the time, s, that was last told on `/clock`, 0 before; `None` for the system's clock.
    told: Option<Arc<AtomicU64>>,
}

impl RosClock {
    /// The system's clock, or that of `/clock`.
    pub(super) fn new(is_simulated: bool) -> Self {
        Self { told: is_simulated.then(Arc::default) }
    }

    /// Whether it is that of `/clock`.
    pub(super) fn is_simulated(&self) -> bool {
        self.told.is_some()
    }

    /// Takes what was told.
    pub(super) fn tell(&self, Clock { clock }: Clock) {
        let told_s = clock.seconds().unwrap_or(0.0);
        self.told.iter().for_each(|told| told.store(told_s.to_bits(), Ordering::Relaxed));
    }

    /// The time, s.
    pub(super) fn now_s(&self) -> f64 {
        match &self.told {
            Some(told) => f64::from_bits(told.load(Ordering::Relaxed)),
            None => {
                SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |now| now.as_secs_f64())
            }
        }
    }

    /// The same as a stamp.
    pub(super) fn stamp(&self) -> Stamp {
        match &self.told {
            Some(_) => Stamp::at(self.now_s()),
            None => Stamp::now(),
        }
    }
}
