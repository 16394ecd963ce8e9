//! One layer of settings over another: what the upper has not, the lower gives.

use super::sections::{LatticeSettings, Section, Settings, TouchSettings};

impl Settings {
    /// These settings, and those of `lower` wherever these say nothing.
    pub fn over(self, lower: Self) -> Self {
        Self {
            robot: self.robot.or(lower.robot),
            log: self.log.or(lower.log),
            touch: self.touch.over(lower.touch),
            lattice: self.lattice.over(lower.lattice),
            contact: self.contact.or(lower.contact),
            estimator: self.estimator.or(lower.estimator),
        }
    }
}

impl TouchSettings {
    /// Frames given above turn off a `no_tare` below, and a `no_tare` above the frames below; that
    /// there is a tare after all says nothing of its frames.
    fn over(self, mut lower: Self) -> Self {
        if self.tare_frames.is_some() {
            lower.no_tare = None;
        }
        if self.no_tare == Some(true) {
            lower.tare_frames = None;
        }
        self.or(lower)
    }
}

impl LatticeSettings {
    /// A box given above replaces an origin and shape below, and the other way round.
    fn over(self, mut lower: Self) -> Self {
        if self.by_shape() {
            (lower.box_low_m, lower.box_high_m) = (None, None);
        }
        if self.by_box() {
            (lower.origin_m, lower.shape) = (None, None);
        }
        self.or(lower)
    }
}
