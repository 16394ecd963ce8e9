//! Ripple of a joint's gears: torque that comes back a number of times in each turn of the joint, as the teeth of a
//! strain wave gear make it (Taghirad and Bélanger 1998). Its size changes with speed, since it shakes the structure:
//!
//! ```text
//! Σ_p |q̇|ᵖ [ (a_p + b_p sgn q̇) cos(n q) + (c_p + d_p sgn q̇) sin(n q) ]        p = 0, 1, 2
//! ```

use serde::{Deserialize, Serialize};

/// Coefficients of one order.
pub const RIPPLE_COEFFICIENTS: usize = 12;

/// Ripple of one order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ripple {
    /// How often it comes back in a turn of the joint: n.
    pub order: f64,
    /// `a₀ c₀ b₀ d₀ a₁ c₁ …`, N·m and s/rad.
    pub coefficients: Vec<f64>,
}

impl Ripple {
    /// What the coefficients are multiplied by at a position and a speed.
    pub fn factors(order: f64, q: f64, speed: f64) -> [f64; RIPPLE_COEFFICIENTS] {
        let (sin, cos) = (order * q).sin_cos();
        let (size, way) = (speed.abs(), if speed == 0.0 { 0.0 } else { speed.signum() });
        let of = |power: f64| [power * cos, power * sin, way * power * cos, way * power * sin];
        let [zero, one, two] = [of(1.0), of(size), of(size * size)];
        std::array::from_fn(|k| [zero, one, two][k / 4][k % 4])
    }

    /// Torque that the motor needs, N·m.
    pub fn torque(&self, q: f64, speed: f64) -> f64 {
        let factors = Self::factors(self.order, q, speed);
        self.coefficients.iter().zip(factors).map(|(own, factor)| own * factor).sum()
    }
}
