//! Friction of a joint.
//!
//! Coulomb friction with hysteresis where the joint reverses: its state z is a *stop operator*, which moves with the
//! joint and is limited to −1 to 1, so that friction goes from one direction to the other over twice the presliding
//! distance, and stays constant while the joint stands still (Dahl's model with an exponent of 0). Added to that are
//! friction that falls with speed from breakaway on (Stribeck), a viscous part, and a part that is the same in both
//! directions:
//!
//! ```text
//! F = z (coulomb + breakaway · exp(−|q̇| / stribeck)) + asymmetry · |z| + viscous · q̇
//! ```
//!
//! At the start of a log the state is unknown: its lower and upper bounds are followed, which meet when the joint has
//! moved far enough.

use serde::{Deserialize, Serialize};

/// Friction of a joint; the units are those of a revolute joint (else N and m for N·m and rad).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointFriction {
    /// Coulomb friction, mean of both directions, N·m.
    pub coulomb: f64,
    /// Half of the difference between the directions, N·m.
    pub asymmetry: f64,
    /// How much larger friction is at the slowest speeds, N·m.
    pub breakaway: f64,
    /// Speed at which the breakaway part has fallen to 1/e, rad/s.
    pub stribeck: f64,
    /// Viscous friction, N·m·s/rad.
    pub viscous: f64,
    /// How far the joint moves after a reversal until half of the change of its friction is over, rad; with 0, friction
    /// changes at once.
    pub presliding: f64,
}

impl Default for JointFriction {
    fn default() -> Self {
        Self {
            coulomb: 0.0,
            asymmetry: 0.0,
            breakaway: 0.0,
            stribeck: 0.03,
            viscous: 0.0,
            presliding: 0.0,
        }
    }
}

/// The state of the friction of a joint: bounds of the stop operator.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionState {
    low: f64,
    high: f64,
}

impl Default for FrictionState {
    fn default() -> Self {
        Self { low: -1.0, high: 1.0 }
    }
}

impl FrictionState {
    /// Follows the joint over a part (0 to 1) of the motion from the second to the third of four positions at
    /// consecutive samples, rad. Where the joint reverses, it does so between the samples, on the parabola through the
    /// first three.
    ///
    /// The fourth distinguishes a reversal from a stop: a joint that stops, or a position that is logged twice, is no
    /// reversal.
    pub fn follow(&mut self, [before, from, to, after]: [f64; 4], part: f64, presliding: f64) {
        let (came, way) = (from - before, to - from);
        if came * way >= 0.0 && came * (after - to) >= 0.0 {
            return self.advance(part * way, presliding);
        }
        let bend = way - came;
        let at = |part: f64| part * way + 0.5 * part * (part - 1.0) * bend;
        let turn = 0.5 - way / bend;
        let turn = if turn.is_finite() { turn.clamp(0.0, part) } else { part };
        self.advance(at(turn), presliding);
        self.advance(at(part) - at(turn), presliding);
    }

    /// Follows the joint over a displacement, rad.
    pub fn advance(&mut self, way: f64, presliding: f64) {
        let step = if presliding > 0.0 { way / presliding } else { way.signum() * 2.0 };
        if way != 0.0 {
            self.low = (self.low + step).clamp(-1.0, 1.0);
            self.high = (self.high + step).clamp(-1.0, 1.0);
        }
    }

    /// Middle between the bounds of the state, −1 to 1.
    pub fn middle(self) -> f64 {
        f64::midpoint(self.low, self.high)
    }

    /// Half of the distance between the bounds, 0 to 1: the uncertainty of the state.
    pub fn unknown(self) -> f64 {
        0.5 * (self.high - self.low)
    }
}

impl JointFriction {
    /// Factors of the four coefficients `coulomb, asymmetry, breakaway, viscous`.
    pub fn factors(z: f64, speed: f64, stribeck: f64) -> [f64; 4] {
        [z, z.abs(), z * (-speed.abs() / stribeck).exp(), speed]
    }

    /// Torque that the motor needs against friction, N·m, at a state z and a speed, rad/s.
    pub fn torque(&self, z: f64, speed: f64) -> f64 {
        let own = [self.coulomb, self.asymmetry, self.breakaway, self.viscous];
        own.iter()
            .zip(Self::factors(z, speed, self.stribeck))
            .map(|(own, factor)| own * factor)
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_of_the_state_hold_every_start_and_meet() {
        let ways = [0.3, -0.1, -0.4, 0.2, -0.9, 0.05, -2.5, 0.3];
        let mut bounds = FrictionState::default();
        let mut starts: Vec<f64> = (-10..=10).map(|z| f64::from(z) / 10.0).collect();
        for way in ways {
            bounds.advance(way, 1.0);
            for z in &mut starts {
                *z = (*z + way).clamp(-1.0, 1.0);
                assert!((bounds.low..=bounds.high).contains(z));
            }
        }
        assert_eq!((bounds.unknown(), bounds.middle()), (0.0, starts[0]));
    }

    #[test]
    fn a_joint_turns_between_two_samples() {
        // The parabola from 1 to 1 reverses halfway; with a presliding distance of 0, friction at its end is
        // that of the way back.
        for (part, wanted) in [(0.4, 1.0), (1.0, -1.0)] {
            let mut state = FrictionState::default();
            state.follow([0.0, 1.0, 1.0, 0.0], part, 0.0);
            assert_eq!(state.middle(), wanted);
        }
        // A motion in one direction is followed from sample to sample.
        let mut state = FrictionState { low: -1.0, high: -1.0 };
        state.follow([0.0, 0.5, 1.0, 1.5], 1.0, 0.5);
        assert_eq!(state.middle(), 0.0);
    }

    #[test]
    fn a_joint_that_stops_or_is_logged_twice_keeps_its_friction() {
        for presliding in [0.0, 1e-4] {
            for after in [[1.0, 1.0], [1.0, 2.0], [2.0, 2.0]] {
                let mut state = FrictionState { low: 1.0, high: 1.0 };
                state.follow([0.0, 1.0, after[0], after[1]], 1.0, presliding);
                assert_eq!((state.low, state.high), (1.0, 1.0), "{after:?}");
            }
        }
    }

    #[test]
    fn a_joint_that_turns_round_crosses_over_twice_the_presliding_distance() {
        let mut state = FrictionState::default();
        state.advance(1.0, 0.01);
        state.advance(-0.01, 0.01);
        assert_eq!(state.middle(), 0.0);
        state.advance(0.0, 0.01);
        assert_eq!(state.middle(), 0.0, "it stays while the joint stands still");
        let friction = JointFriction { coulomb: 2.0, viscous: 3.0, ..JointFriction::default() };
        assert_eq!(friction.torque(-1.0, -0.1), -2.3);
    }
}
