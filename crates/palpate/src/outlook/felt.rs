//! What is felt at a stop of a path, and what is said of the points between two stops.

use std::ops::AddAssign;

use nalgebra::DVector;

use super::PathPoint;

/// What the arm feels where it stops, of all points or of a share of them.
#[derive(Debug, Clone)]
pub(super) struct Felt {
    /// τ̂, n_joints, N·m.
    pub(super) torque: DVector<f64>,
    /// diag(H P Hᵀ), n_joints, (N·m)².
    pub(super) torque_variance: DVector<f64>,
    /// Points touched, and those of them that are known; where some stand for others, an estimate.
    pub(super) contacts: f64,
    pub(super) known: f64,
}

/// Points of another share: their torques add up, and so do the variances of independent springs.
impl AddAssign<&Felt> for Felt {
    fn add_assign(&mut self, other: &Felt) {
        self.torque += &other.torque;
        self.torque_variance += &other.torque_variance;
        self.contacts += other.contacts;
        self.known += other.known;
    }
}

impl Felt {
    /// What is said of the stop.
    pub(super) fn point(&self) -> PathPoint {
        PathPoint {
            torque: self.torque.clone(),
            torque_std: self.torque_variance.map(f64::sqrt),
            contacts: self.contacts.round() as usize,
            known: self.known.round() as usize,
        }
    }
}

impl PathPoint {
    /// A part (0 to 1) of the way from one to another.
    pub(super) fn between(from: &Self, to: &Self, part: f64) -> Self {
        let count = |from: usize, to: usize| {
            (from as f64 + part * (to as f64 - from as f64)).round() as usize
        };
        Self {
            torque: from.torque.lerp(&to.torque, part),
            torque_std: from.torque_std.lerp(&to.torque_std, part),
            contacts: count(from.contacts, to.contacts),
            known: count(from.known, to.known),
        }
    }
}
