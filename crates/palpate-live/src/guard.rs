//! `--guard`: a flag to stop, raised by the first torque beyond a limit.
//!
//! Measured and predicted external torque count alike, joint by joint. The flag stays up until it
//! is taken back by a new tare: a robot that stopped where it presses must not start again because
//! it no longer moves.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

/// What passed the limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trip {
    /// Number of the joint, from 0.
    pub joint: usize,
    /// Its torque, N·m.
    pub torque_n_m: f64,
    /// Whether that was predicted, or else measured.
    pub predicted: bool,
}

/// Watches the external torque.
#[derive(Debug, Clone)]
pub struct Guard {
    limit_n_m: f64,
    trip: Option<Trip>,
}

impl Guard {
    /// A guard of a limit, N·m (N for a prismatic joint).
    pub fn new(limit_n_m: f64) -> Self {
        Self { limit_n_m, trip: None }
    }

    /// Looks at torques of a step, n_joints, N·m; `Some` if this is the first to pass the limit.
    pub fn watch(&mut self, measured: &DVector<f64>, predicted: &DVector<f64>) -> Option<&Trip> {
        if self.trip.is_some() {
            return None;
        }
        let passed = |torques: &DVector<f64>, predicted: bool| {
            let joint = torques.iamax();
            let torque_n_m = torques[joint];
            (torque_n_m.abs() > self.limit_n_m).then_some(Trip { joint, torque_n_m, predicted })
        };
        self.trip = passed(measured, false).or_else(|| passed(predicted, true));
        self.trip.as_ref()
    }

    /// Whether the flag is up.
    pub fn is_up(&self) -> bool {
        self.trip.is_some()
    }

    /// Takes the flag back.
    pub fn reset(&mut self) {
        self.trip = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dvector;

    #[test]
    fn the_first_torque_beyond_the_limit_raises_the_flag_and_no_other() {
        let mut guard = Guard::new(5.0);
        let calm = dvector![1.0, -5.0];
        assert_eq!(guard.watch(&calm, &calm), None);
        let trip = Trip { joint: 1, torque_n_m: -5.1, predicted: false };
        assert_eq!(guard.watch(&dvector![0.0, -5.1], &dvector![9.0, 0.0]), Some(&trip));
        assert_eq!(guard.watch(&dvector![0.0, -7.0], &calm), None);
        assert!(guard.is_up());
        guard.reset();
        let trip = Trip { joint: 0, torque_n_m: 6.0, predicted: true };
        assert_eq!(guard.watch(&calm, &dvector![6.0, 0.0]), Some(&trip));
    }
}
