//! Ripple of a joint's gears: torque that repeats a number of times in each turn of the joint, caused by the teeth of a
//! strain wave gear (Taghirad and Bélanger 1998). It excites vibrations of the whole arm, at some frequencies more than
//! at others, so it appears in the torques of other joints as well, and its amplitude and phase depend on its frequency
//! `f`:
//!
//! ```text
//! a(f) cos(n q) + c(f) sin(n q),    f = n q̇ / 2π
//! ```
//!
//! `a` and `c` are linear between knots every [`STEP_HZ`], with separate values for both directions; at rest there is
//! no ripple.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Distance between knots, Hz.
const STEP_HZ: f64 = 10.0;
/// Number of knots of one direction; above the last, coefficients are constant.
const KNOTS: usize = 6;

/// Number of coefficients of one order, for one joint in whose torque it appears.
pub const RIPPLE_COEFFICIENTS: usize = 4 * KNOTS;

/// Ripple of one order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ripple {
    /// Number of repetitions in a turn of the joint: n.
    pub order: f64,
    /// For each joint of the robot `a₁ c₁ a₂ c₂ …` of the knots forwards, then backwards, N·m; empty for a joint
    /// without this ripple.
    pub coefficients: Vec<Vec<f64>>,
}

impl Ripple {
    /// The two knots on both sides of a speed of the joint, by number, and their weights.
    pub fn knots(order: f64, speed: f64) -> [(usize, f64); 2] {
        let place = ((order * speed / TAU).abs() / STEP_HZ).min(KNOTS as f64);
        let below = (place as usize).min(KNOTS - 1);
        let part = place - below as f64;
        let first = if speed < 0.0 { KNOTS } else { 0 };
        // Below the first knot is rest.
        let weight = if below == 0 { 0.0 } else { 1.0 - part };
        [(first + below.saturating_sub(1), weight), (first + below, part)]
    }

    /// Numbers and factors of the coefficients that are used at a position and a speed of the joint.
    pub fn factors(order: f64, q: f64, speed: f64) -> [(usize, f64); 4] {
        let (sin, cos) = (order * q).sin_cos();
        let [(lower, below), (upper, part)] = Self::knots(order, speed);
        [
            (2 * lower, below * cos),
            (2 * lower + 1, below * sin),
            (2 * upper, part * cos),
            (2 * upper + 1, part * sin),
        ]
    }

    /// Adds the motor torques of this ripple, n_joints, N·m, at a position and a speed of the joint with these gears.
    pub fn add_to(&self, torques: &mut [f64], q: f64, speed: f64) {
        let factors = Self::factors(self.order, q, speed);
        for (torque, own) in torques.iter_mut().zip(&self.coefficients) {
            if !own.is_empty() {
                *torque += factors.iter().map(|(k, factor)| own[*k] * factor).sum::<f64>();
            }
        }
    }

    /// Checks it for an arm of `joints` joints; the error is a sentence.
    pub(super) fn check(&self, joints: usize) -> Result<(), String> {
        let lists = self.coefficients.len();
        if lists != joints {
            return Err(format!(
                "ripple.coefficients has {lists} lists; wanted {joints}, one for each joint"
            ));
        }
        let mut lengths = self.coefficients.iter().map(Vec::len);
        if let Some(found) = lengths.find(|own| ![0, RIPPLE_COEFFICIENTS].contains(own)) {
            return Err(format!(
                "a list of ripple.coefficients has {found} numbers; wanted {RIPPLE_COEFFICIENTS}, or none"
            ));
        }
        match self.coefficients.iter().flatten().chain([&self.order]).find(|own| !own.is_finite()) {
            Some(number) => Err(format!("ripple has {number}; wanted finite numbers")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ripple_is_continuous_in_speed_and_none_at_rest() {
        let ripple = Ripple {
            order: 240.0,
            coefficients: vec![
                Vec::new(),
                (0..RIPPLE_COEFFICIENTS).map(|k| 1.0 + k as f64).collect(),
            ],
        };
        let at = |speed: f64| {
            let mut torques = [0.0; 2];
            ripple.add_to(&mut torques, 0.3, speed);
            torques
        };
        assert_eq!(at(0.0), [0.0, 0.0]);
        let step = 1e-7;
        for k in -2_000..2_000 {
            let speed = 0.001 * f64::from(k);
            let [none, torque] = at(speed);
            assert_eq!(none, 0.0);
            // No slope is steeper than that from one knot to the next, of 47 N·m at most.
            let steepest = 2.0 * 47.0 * 240.0 / (TAU * STEP_HZ);
            assert!((at(speed + step)[1] - torque).abs() <= steepest * step, "{speed}");
        }
        // At a knot, only its own coefficients are used.
        let speed = 2.0 * STEP_HZ * TAU / 240.0;
        let (sin, cos) = 72.0_f64.sin_cos();
        assert!((at(speed)[1] - (3.0 * cos + 4.0 * sin)).abs() < 1e-9);
        assert!((at(-speed)[1] - (15.0 * cos + 16.0 * sin)).abs() < 1e-9);
        assert_eq!(at(1e3), at(1e4));
    }
}
