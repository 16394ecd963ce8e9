//! What a URDF does not know of an arm, from logs of it in free motion: payload, masses, friction, bias, delay, gains.
//!
//! The torque that motors need is linear in most of it ([`palpate::TorqueModel`]), so this is a linear regression with a
//! Gaussian prior around the URDF (Atkeson, An and Hollerbach 1986; Gautier and Khalil 1990), and its posterior gives
//! the standard deviations. How far masses, friction, biases and gains may lie from what is assumed, and how large the
//! noise of each joint is, follows from the data: the evidence is maximised over them (MacKay 1992). Delay and gains
//! enter by Gauss-Newton steps. Masses and inertias are kept physically possible by a barrier (Wensing, Kim and Slotine
//! 2018: the pseudo-inertia is positive definite). Presliding distance and window are searched over a few values.
//!
//! | file         | says                                                              |
//! |--------------|-------------------------------------------------------------------|
//! | `rows`       | samples as rows of the regression, summed up by joint and fold    |
//! | `prior`      | how far what is sought may lie from what is assumed               |
//! | `posterior`  | what the data say                                                 |
//! | `possible`   | inertias that are physically possible                             |
//! | `ripple`     | torque that comes back with the teeth of the gears                |
//! | `held_out`   | what is left over on motion that was not used                     |
//! | `result`     | values with standard deviations, in the units that people read    |

mod held_out;
mod possible;
mod posterior;
mod prior;
mod result;
mod ripple;
mod rows;

pub use held_out::HeldOut;
pub use result::{BodyEstimate, Identified, JointEstimate, PayloadEstimate, Value};

use palpate::unstable::LinkId;
use palpate::{ExternalTorqueConfig, Gravity, Robot, Sample};

use posterior::Posterior;
use prior::Start;
use rows::{Rows, Settings, Turning};

/// What to identify.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifyConfig {
    /// The link in whose frame the payload is told.
    pub payload_link: LinkId,
    /// The torques are the drives' currents: gains are not near 1, and are told by the masses of the URDF.
    pub currents: bool,
}

/// Why nothing could be identified.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum IdentifyError {
    /// Too few samples.
    #[error("{found} samples are too few; {wanted} are wanted")]
    TooShort { found: usize, wanted: usize },
    /// No joint moves.
    #[error(
        "no joint moves by more than {wanted} rad, so nothing can be told apart; move all of them, as `palpate excite` does"
    )]
    NoMotion { wanted: f64 },
    /// Torques that are all the same.
    #[error("the torques are {0} N·m throughout: there is nothing in them")]
    NoTorque(f64),
    /// Torques without gravity.
    #[error(
        "the torques hold no gravity: the robot has taken it off, with masses and friction of its own; identification \
         wants the measured torques (of a Franka `tau_J`, not `tau_ext_hat_filtered`)"
    )]
    GravityRemoved,
    /// A payload on a link that does not move.
    #[error("the payload's link is moved by no joint")]
    PayloadLink,
    /// A sample that does not fit the robot.
    #[error(transparent)]
    Sample(#[from] palpate::TrackerError),
    /// Numbers that cannot be solved for.
    #[error("the regression cannot be solved: are there numbers in the log that are far off?")]
    Unsolvable,
}

/// Samples below which nothing is tried.
const LEAST_SAMPLES: usize = 20;
/// A joint that moves less, rad or m, does not move.
pub const LEAST_MOTION: f64 = 0.02;
/// Half windows that speeds and accelerations are tried with, s.
const WINDOWS_S: [f64; 6] = [0.05, 0.1, 0.17, 0.25, 0.35, 0.5];
/// How friction turns round, to start the search with.
const TURNING: Turning = Turning { presliding: 1e-3, stribeck: 0.03 };
/// Steps of the search for delay and presliding distances.
const SEARCH_STEPS: usize = 8;
/// The longest delay that is looked for, s.
const MOST_DELAY_S: f64 = 0.3;

/// Identifies an arm from touches in free motion, joints in the robot's order.
///
/// # Errors
///
/// If the touches do not serve: too short, no motion, torques without gravity or all alike.
pub fn identify(
    robot: &Robot,
    touches: &[&[Sample]],
    torques: &ExternalTorqueConfig,
    config: &IdentifyConfig,
) -> Result<Identified, IdentifyError> {
    let moved = check(robot, touches, torques)?;
    let payload_body = robot.body_of(config.payload_link).ok_or(IdentifyError::PayloadLink)?;
    let start = Start::of(robot, payload_body, config.currents);
    let n = robot.n_joints();
    let of = |settings: &Settings| Rows::of(robot, touches, torques.torque_sign, settings);
    let solve =
        |rows: &Rows| Posterior::of(rows, &rows.all(), &start).ok_or(IdentifyError::Unsolvable);

    let mut settings = Settings { window_s: WINDOWS_S[0], delay_s: 0.0, turning: vec![TURNING; n] };
    // With the shortest windows a slow clock tells no speeds; with none of them, they are taken as at rest.
    let mut best = (false, f64::INFINITY);
    for window_s in WINDOWS_S {
        let tried = Settings { window_s, ..settings.clone() };
        let rows = of(&tried)?;
        if (rows.timed, best.0) == (false, true) || (!rows.timed && best.1 < f64::INFINITY) {
            continue;
        }
        let left_over = solve(&rows)?.left_over();
        if left_over < best.1 || (rows.timed && !best.0) {
            (best, settings) = ((rows.timed, left_over), tried);
        }
    }
    let mut rows = of(&settings)?;
    let mut posterior = solve(&rows)?;
    // Friction that turns late looks like a delay, so both are sought together; the delay by the secant method, for
    // what its column says of the step that is left falls short of it.
    let mut last: Option<(f64, f64)> = None;
    for _ in 0..SEARCH_STEPS {
        settings.turning = rows.best_turning(&posterior);
        let left = posterior.delay().0;
        if rows.timed {
            let step = match last {
                Some((before, left_before)) if (left - left_before).abs() > 1e-9 => {
                    let secant = -left * (settings.delay_s - before) / (left - left_before);
                    secant.clamp(-5.0 * left.abs(), 5.0 * left.abs())
                }
                _ => left,
            };
            last = Some((settings.delay_s, left));
            settings.delay_s = (settings.delay_s + step).clamp(-MOST_DELAY_S, MOST_DELAY_S);
        }
        rows = of(&settings)?;
        posterior = solve(&rows)?;
    }

    let held_out = held_out::of(robot, touches, torques, (&rows, &settings), &start)?;
    Ok(result::of(robot, config, (&rows, &settings), &posterior, (held_out, moved)))
}

/// Checks what can be checked beforehand; how far each joint moves, and how much the torques vary, N·m.
fn check(
    robot: &Robot,
    touches: &[&[Sample]],
    torques: &ExternalTorqueConfig,
) -> Result<(Vec<f64>, f64), IdentifyError> {
    if torques.gravity == Gravity::Removed {
        return Err(IdentifyError::GravityRemoved);
    }
    let samples = || touches.iter().copied().flatten();
    let found = samples().count();
    if found < LEAST_SAMPLES {
        return Err(IdentifyError::TooShort { found, wanted: LEAST_SAMPLES });
    }
    for sample in samples() {
        let poses = robot.forward(&sample.q).map_err(palpate::TrackerError::from)?;
        torques.untared(robot, &poses, &sample.tau)?;
    }
    let range = |of: fn(&Sample) -> &[f64], joint: usize| {
        let ends = samples().map(|sample| of(sample)[joint]);
        let (low, high) =
            ends.fold((f64::MAX, f64::MIN), |(low, high), at| (at.min(low), at.max(high)));
        high - low
    };
    let moved: Vec<f64> =
        (0..robot.n_joints()).map(|joint| range(|sample| &sample.q, joint)).collect();
    if moved.iter().all(|way| *way < LEAST_MOTION) {
        return Err(IdentifyError::NoMotion { wanted: LEAST_MOTION });
    }
    if (0..robot.n_joints()).all(|joint| range(|sample| &sample.tau, joint) == 0.0) {
        return Err(IdentifyError::NoTorque(samples().next().map_or(0.0, |sample| sample.tau[0])));
    }
    let count = found as f64;
    let mean = |joint: usize| samples().map(|sample| sample.tau[joint]).sum::<f64>() / count;
    let square = |joint: usize| {
        let mean = mean(joint);
        samples().map(|sample| (sample.tau[joint] - mean).powi(2)).sum::<f64>() / count
    };
    let variation = (0..robot.n_joints()).map(square).sum::<f64>().sqrt();
    Ok((moved, variation))
}
