//! Whether external torques follow the arm's own motion: friction that no model has subtracted, and inertia.
//!
//! Friction opposes every motion of its joint. An object that was pushed pushes on while the arm retreats, so its
//! torques do not change sign with the motion. The external torque of each joint is therefore regressed on the
//! direction and the speed of this joint, with coefficients that oppose the motion in both directions, and each touch is
//! predicted from the others:
//!
//! ```text
//! τ̂ = −c · tanh(q̇ / 0.2 q̇_rms) − v · q̇ − (inertia, by the masses of the URDF)        c, v ≥ 0
//! ```
//!
//! Accelerations have no free coefficient: in a touch that is slowed down and reversed, they are proportional to the
//! displacement, as the torque of a spring is. The inertia is taken or left out, and the speed is from a short or a
//! long window, whichever explains more.

use nalgebra::DVector;
use palpate::Robot;
use palpate::unstable::{LocalPolynomial, Window};
use rayon::prelude::*;

use crate::evaluation::MeanStd;
use crate::tracked::MotionFrame;

/// Halves of the windows from which speeds are computed, s.
const WINDOWS_S: [f64; 2] = [0.1, 0.2];
/// Time between frames without times, s: about that of learnt frames ([`palpate::unstable::Downsampling`]).
const UNTIMED_S: f64 = 0.05;
/// Speed, as a multiple of a joint's root mean square, from which on its friction is nearly that of its direction.
const SLOW: f64 = 0.2;
/// Frames with less than this part of the mean square torque, measured and predicted, have no share of their own.
const WEAK: f64 = 0.04;
/// Least part of what friction explains at a joint that is in the direction with less of it.
const LEAST_OF_DIRECTION: f64 = 0.1;

/// Motion of a frame, and its external torque.
struct Frame {
    /// Speeds, n_joints, rad/s.
    speed: Vec<f64>,
    /// External torque of the arm's inertia by its URDF, n_joints, N·m; 0 without times.
    inertia: DVector<f64>,
    /// External torque, n_joints, N·m.
    tau: Vec<f64>,
}

/// Motions of touches, by window, touch and frame.
pub(crate) struct OwnMotion(Vec<Vec<Vec<Frame>>>);

/// How well the arm's own motion explains external torques.
pub(crate) struct Explained {
    /// Share of the squared torque of held-out touches that it explains, while the arm moves.
    pub(crate) share: f64,
    /// Mean over frames of their own shares, not below 0: in contrast to `share`, frames with large torques count no
    /// more than those in which friction is predicted and nothing is measured.
    pub(crate) share_of_frames: f64,
    /// Predicted and measured torques by touch and frame, n_joints, N·m.
    pub(crate) touches: Vec<[Vec<Vec<f64>>; 2]>,
}

impl OwnMotion {
    /// The motions of touches, at about so many frames as `most` in all.
    pub(crate) fn of(robot: &Robot, motions: &[Vec<MotionFrame>], most: usize) -> Self {
        let n = motions.iter().map(Vec::len).sum::<usize>().div_ceil(most).max(1);
        let touches = |half_s: f64| {
            motions.par_iter().map(|motion| frames(robot, motion, (half_s, n))).collect()
        };
        Self(WINDOWS_S.map(touches).into())
    }

    /// How well the motion explains the torques of these touches, each predicted from the others; `None` if nothing
    /// moves.
    pub(crate) fn explain(&self, touches: &[usize]) -> Option<Explained> {
        let ways = self.0.iter().flat_map(|window| [(window, 0.0), (window, 1.0)]);
        ways.filter_map(|(window, inertia)| {
            let touches: Vec<&[Frame]> = touches.iter().map(|&touch| &window[touch][..]).collect();
            explain(&touches, inertia)
        })
        .max_by(|a, b| a.share.total_cmp(&b.share))
    }
}

/// The motion at every n-th frame of a touch.
fn frames(robot: &Robot, motion: &[MotionFrame], (half_s, n): (f64, usize)) -> Vec<Frame> {
    let (mut times_s, positions): (Vec<f64>, Vec<Vec<f64>>) = (motion.iter())
        .map(|frame| (frame.time_s.unwrap_or(f64::NAN), frame.unwrapped.clone()))
        .unzip();
    let is_timed = times_s.iter().all(|time| time.is_finite())
        && times_s.windows(2).all(|pair| pair[0] < pair[1]);
    if !is_timed {
        times_s = (0..times_s.len()).map(|number| UNTIMED_S * number as f64).collect();
    }
    let frame = |(frame, time_s): (&MotionFrame, &f64)| {
        let motion =
            LocalPolynomial::new(&times_s, &positions, half_s, Window::Centred).at(*time_s);
        let tau = frame.tau.clone();
        let inertia = match robot.forward(&frame.q) {
            Ok(poses) if is_timed => {
                let needed = robot.inverse_dynamics(&poses, &motion.first, &motion.second);
                -needed - robot.gravity_torque(&poses)
            }
            _ => DVector::zeros(tau.len()),
        };
        Frame { speed: motion.first, inertia, tau }
    };
    motion.iter().zip(&times_s).step_by(n).map(frame).collect()
}

/// How well the motion explains the torques of touches, with this multiple of the inertia.
fn explain(touches: &[&[Frame]], inertia: f64) -> Option<Explained> {
    let all = || touches.iter().flat_map(|touch| touch.iter());
    let n_joints = all().next()?.tau.len();
    let square = |j: usize| all().map(|frame| frame.speed[j].powi(2)).sum::<f64>();
    let slow = |j: usize| SLOW * (square(j) / all().count() as f64).sqrt();
    let fit = Fit { slow: (0..n_joints).map(slow).collect(), inertia };
    let sums: Vec<Vec<[Sums; 2]>> = touches.iter().map(|touch| fit.sums(touch)).collect();
    let of_others = |number: usize, j: usize| {
        let others = sums.iter().enumerate().filter(|(other, _)| *other != number);
        let [up, down] = others
            .fold([Sums::default(); 2], |sum, (_, own)| [0, 1].map(|of| sum[of] + own[j][of]));
        coefficients(up, down)
    };
    let predicted = |(number, touch): (usize, &&[Frame])| {
        let own: Vec<[f64; 2]> = (0..n_joints).map(|j| of_others(number, j)).collect();
        let measured = touch.iter().map(|frame| frame.tau.clone()).collect();
        [touch.iter().map(|frame| fit.torque(frame, &own)).collect(), measured]
    };
    let predicted: Vec<[Vec<Vec<f64>>; 2]> = touches.iter().enumerate().map(predicted).collect();

    let pairs = predicted.iter().flat_map(|[predicted, measured]| predicted.iter().zip(measured));
    let moving = all().zip(pairs).filter(|(frame, _)| fit.moves(frame));
    let norm = |of: &mut dyn Iterator<Item = f64>| of.map(|tau| tau * tau).sum::<f64>();
    // Squared error, and squares of the measured and the predicted torque.
    let squares: Vec<[f64; 3]> = moving
        .map(|(_, (predicted, measured))| {
            let error = norm(&mut predicted.iter().zip(measured).map(|(p, m)| p - m));
            [error, norm(&mut measured.iter().copied()), norm(&mut predicted.iter().copied())]
        })
        .collect();
    let [error, measured] = [0, 1].map(|of| squares.iter().map(|own| own[of]).sum::<f64>());
    let weak = WEAK * measured / squares.len() as f64;
    let strong = squares.iter().map(|own| (own[0], own[1].max(own[2])));
    let of_frames = strong.filter(|(_, size)| *size > weak).map(|(error, size)| 1.0 - error / size);
    let share_of_frames = MeanStd::of(of_frames.map(|share| share.max(0.0)))?.mean;
    Some(Explained { share: 1.0 - error / measured, share_of_frames, touches: predicted })
}

/// A regression of torques on the motion.
struct Fit {
    /// Speed of each joint, rad/s, from which on its friction is nearly that of its direction.
    slow: Vec<f64>,
    /// Multiple of the inertia that is subtracted.
    inertia: f64,
}

impl Fit {
    /// The factors of a joint's friction: direction and speed, with the sign of a torque that opposes them.
    fn factors(&self, frame: &Frame, j: usize) -> [f64; 2] {
        let (speed, slow) = (frame.speed[j], self.slow[j]);
        [if slow > 0.0 { -(speed / slow).tanh() } else { 0.0 }, -speed]
    }

    /// Whether any joint is faster than slow.
    fn moves(&self, frame: &Frame) -> bool {
        frame.speed.iter().zip(&self.slow).any(|(speed, slow)| speed.abs() > *slow)
    }

    /// The sums of a touch, by joint: where the joint moves up, and where it moves down.
    fn sums(&self, touch: &[Frame]) -> Vec<[Sums; 2]> {
        let of = |j: usize| {
            let mut sums = [Sums::default(); 2];
            for frame in touch {
                let left = frame.tau[j] - self.inertia * frame.inertia[j];
                let sum = &mut sums[usize::from(frame.speed[j] < 0.0)];
                *sum = *sum + Sums::of(self.factors(frame, j), left);
            }
            sums
        };
        (0..self.slow.len()).map(of).collect()
    }

    /// The torque of the motion at a frame, given the coefficients of each joint, n_joints, N·m.
    fn torque(&self, frame: &Frame, own: &[[f64; 2]]) -> Vec<f64> {
        let of = |(j, own): (usize, &[f64; 2])| {
            let [direction, speed] = self.factors(frame, j);
            own[0] * direction + own[1] * speed + self.inertia * frame.inertia[j]
        };
        own.iter().enumerate().map(of).collect()
    }
}

/// The coefficients of a joint; 0 unless they explain torque in both directions. A joint that moved one way, into
/// something, does not show whether its torque is friction.
fn coefficients(up: Sums, down: Sums) -> [f64; 2] {
    let own = (up + down).solution();
    let [up, down] = [up, down].map(|sums| sums.explained(own));
    if up.min(down) < LEAST_OF_DIRECTION * (up + down) { [0.0; 2] } else { own }
}

/// Sums of a regression on two factors: XᵀX (first, mixed, second) and Xᵀy.
#[derive(Debug, Clone, Copy, Default)]
struct Sums([f64; 5]);

impl std::ops::Add for Sums {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|of| self.0[of] + other.0[of]))
    }
}

impl Sums {
    fn of([a, b]: [f64; 2], y: f64) -> Self {
        Self([a * a, a * b, b * b, a * y, b * y])
    }

    /// By how much coefficients reduce the sum of squares.
    fn explained(self, [a, b]: [f64; 2]) -> f64 {
        let Self([aa, ab, bb, ay, by]) = self;
        2.0 * (a * ay + b * by) - (a * a * aa + 2.0 * a * b * ab + b * b * bb)
    }

    /// The coefficients with the smallest squared error, none below 0.
    fn solution(self) -> [f64; 2] {
        let Self([aa, ab, bb, ay, by]) = self;
        let determinant = aa * bb - ab * ab;
        if determinant > 1e-9 * aa * bb {
            let both = [(ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant];
            if both.iter().all(|own| *own >= 0.0) {
                return both;
            }
        }
        let [a, b] = [(ay, aa), (by, bb)]
            .map(|(y, square)| if square > 0.0 { (y / square).max(0.0) } else { 0.0 });
        // By which of them alone the squared error falls more.
        if a * ay >= b * by { [a, 0.0] } else { [0.0, b] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_those_of_least_squares_and_never_below_zero() {
        let rows = [[1.0, 0.5], [-1.0, 2.0], [1.0, 3.0]];
        let of = |wanted: [f64; 2]| {
            let sum = |sums: Sums, row: &[f64; 2]| {
                sums + Sums::of(*row, row[0] * wanted[0] + row[1] * wanted[1])
            };
            rows.iter().fold(Sums::default(), sum).solution()
        };
        let exact = of([2.0, 0.3]);
        assert!((exact[0] - 2.0).abs() < 1e-9 && (exact[1] - 0.3).abs() < 1e-9);
        assert_eq!(of([-2.0, -0.3]), [0.0, 0.0]);
        let one = of([2.0, -0.3]);
        assert!(one[0] > 0.0 && one[1] == 0.0, "{one:?}");
    }
}
