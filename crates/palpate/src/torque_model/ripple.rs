//! Ripple of a joint's gears: torque that comes back a number of times in each turn of the joint, as the teeth of a
//! strain wave gear make it (Taghirad and Bélanger 1998). It shakes the whole arm, which swings with some frequencies
//! more than with others, so other joints feel it as well, and its size and phase depend on its frequency `f`:
//!
//! ```text
//! a(f) cos(n q) + c(f) sin(n q),    f = n q̇ / 2π
//! ```
//!
//! `a` and `c` are linear between knots every [`STEP_HZ`], forwards and backwards; at rest there is no ripple.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Distance of the knots, Hz.
const STEP_HZ: f64 = 10.0;
/// Knots of one direction; above the last, nothing changes any more.
const KNOTS: usize = 6;

/// Coefficients of one order for one joint that feels it.
pub const RIPPLE_COEFFICIENTS: usize = 4 * KNOTS;

/// Ripple of one order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ripple {
    /// How often it comes back in a turn of the joint: n.
    pub order: f64,
    /// For each joint of the robot `a₁ c₁ a₂ c₂ …` of the knots forwards, then backwards, N·m; empty: it feels nothing.
    pub coefficients: Vec<Vec<f64>>,
}

impl Ripple {
    /// The two knots that count at a speed of the joint, by number, and their weights.
    pub fn knots(order: f64, speed: f64) -> [(usize, f64); 2] {
        let place = ((order * speed / TAU).abs() / STEP_HZ).min(KNOTS as f64);
        let below = (place as usize).min(KNOTS - 1);
        let part = place - below as f64;
        let first = if speed < 0.0 { KNOTS } else { 0 };
        // Below the first knot is rest.
        let weight = if below == 0 { 0.0 } else { 1.0 - part };
        [(first + below.saturating_sub(1), weight), (first + below, part)]
    }

    /// The coefficients that count at a position and a speed of the joint, by number, and what each is multiplied by.
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

    /// Adds the torques that the motors need, n_joints, N·m, at a position and a speed of the joint whose gears make it.
    pub fn add_to(&self, torques: &mut [f64], q: f64, speed: f64) {
        let factors = Self::factors(self.order, q, speed);
        for (torque, own) in torques.iter_mut().zip(&self.coefficients) {
            if !own.is_empty() {
                *torque += factors.iter().map(|(k, factor)| own[*k] * factor).sum::<f64>();
            }
        }
    }

    /// What of it cannot be in an arm of so many joints, as a sentence.
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
        // At a knot, its own coefficients hold alone.
        let speed = 2.0 * STEP_HZ * TAU / 240.0;
        let (sin, cos) = 72.0_f64.sin_cos();
        assert!((at(speed)[1] - (3.0 * cos + 4.0 * sin)).abs() < 1e-9);
        assert!((at(-speed)[1] - (15.0 * cos + 16.0 * sin)).abs() < 1e-9);
        assert_eq!(at(1e3), at(1e4));
    }
}
