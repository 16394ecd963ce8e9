//! One layer of settings over another: the upper one wins, the lower one fills the gaps.

use super::sections::{LatticeSettings, Section, Settings, TouchSettings};

impl Settings {
    /// These settings; those that are not given are taken from `lower`.
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
    /// `tare_frames` overrides `no_tare` of the lower layer, and `no_tare = true` overrides its
    /// `tare_frames`; `no_tare = false` keeps them.
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
    /// A box replaces origin and shape of the lower layer, and the other way round.
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
