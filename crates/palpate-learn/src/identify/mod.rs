//! What a URDF does not know of an arm, from logs of it in free motion: payload, masses, friction, bias, delay, gains.
//!
//! The torque that motors need is linear in most of it ([`palpate::TorqueModel`]), so this is a linear regression with a
//! Gaussian prior around the URDF (Atkeson, An and Hollerbach 1986; Gautier and Khalil 1990), and its posterior gives
//! the standard deviations. How far masses, friction, biases and gains may lie from what is assumed, and how large the
//! noise of each joint is, follows from the data: the evidence is maximised over them (MacKay 1992). Delay and gains
//! enter by Gauss-Newton steps. Masses and inertias are kept physically possible by a barrier (Wensing, Kim and Slotine
//! 2018: the pseudo-inertia is positive definite). Presliding distance and window are searched over a few values. Samples
//! in which something seems to be touched are left out.
//!
//! | file         | says                                                              |
//! |--------------|-------------------------------------------------------------------|
//! | `rows`       | samples as rows of the regression, summed up by joint and fold    |
//! | `prior`      | how far what is sought may lie from what is assumed               |
//! | `posterior`  | what the data say                                                 |
//! | `search`     | delay, presliding distances and window                            |
//! | `touched`    | samples in which something seems to be touched                    |
//! | `possible`   | inertias that are physically possible                             |
//! | `ripple`     | torque that comes back with the teeth of the gears                |
//! | `held_out`   | residuals on motion that was not used                             |
//! | `few`        | few samples that have most of the residual                        |
//! | `result`     | values with standard deviations, in the units that people read    |

mod few;
mod held_out;
mod possible;
mod posterior;
mod prior;
mod result;
mod ripple;
mod rows;
mod search;
mod touched;

pub use few::Few;
pub use held_out::HeldOut;
pub use result::{BodyEstimate, Identified, JointEstimate, PayloadEstimate, Value};

use palpate::unstable::{LinkId, with_read_times};
use palpate::{ExternalTorqueConfig, Gravity, Robot, Sample};
use serde::Serialize;

use prior::Start;
pub(crate) use prior::inertial_scales;
use search::Search;

use crate::error::Stop;

/// What to identify.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifyConfig {
    /// The link in whose frame the payload is given.
    pub payload_link: LinkId,
    /// The torques are the drives' currents: gains are not near 1, and follow from the masses of the URDF.
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
        "no joint moves by more than {wanted} rad, so nothing can be determined; move all of them, as `palpate excite` does"
    )]
    NoMotion { wanted: f64 },
    /// Torques that are all the same.
    #[error("the torques are {0} N·m throughout: there is nothing in them")]
    NoTorque(f64),
    /// Asked to stop.
    #[error("stopped")]
    Stopped,
    /// Torques without gravity.
    #[error(
        "the torques hold no gravity: the robot has taken it off, with masses and friction of its own; identification \
         wants the measured torques (of a Franka `tau_J`, not `tau_ext_hat_filtered`); if they do hold it, say --gravity \
         included"
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

/// Samples of a touch below which it gives no speeds.
const LEAST_OF_TOUCH: usize = 4;
/// Samples below which nothing is tried.
const LEAST_SAMPLES: usize = 20;
/// A joint that moves less, rad or m, does not move.
pub const LEAST_MOTION: f64 = 0.02;

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
    (stop, done): (Stop<'_>, &dyn Fn()),
) -> Result<Identified, IdentifyError> {
    let unless_stopped = || {
        done();
        if stop() { Err(IdentifyError::Stopped) } else { Ok(()) }
    };
    // Next to longer ones, touches that give no speeds would hide those of the others.
    let least =
        if touches.iter().any(|touch| touch.len() >= LEAST_OF_TOUCH) { LEAST_OF_TOUCH } else { 1 };
    let (numbers, logged): (Vec<usize>, Vec<&[Sample]>) =
        (touches.iter().copied().enumerate()).filter(|(_, touch)| touch.len() >= least).unzip();
    let motion = Checked::of(robot, &logged, torques)?;
    let read = logged.iter().map(|touch| {
        if stop() { Err(IdentifyError::Stopped) } else { Ok(with_read_times(robot, touch)) }
    });
    let read: Vec<Option<Vec<Sample>>> = read.collect::<Result<_, _>>()?;
    let touches: Vec<&[Sample]> =
        read.iter().zip(&logged).map(|(read, touch)| read.as_deref().unwrap_or(touch)).collect();
    let payload_body = robot.body_of(config.payload_link).ok_or(IdentifyError::PayloadLink)?;
    let start = Start::of(robot, payload_body, config.currents);
    let search = Search { robot, touches: &touches, sign: torques.torque_sign, start: &start };
    let none = touches.iter().map(|touch| vec![false; touch.len()]).collect();
    let all = search.run(none, &unless_stopped)?;
    let fit = touched::leave_out(&search, all, &unless_stopped)?;

    let mut held_out = held_out::of(
        robot,
        (&touches, &logged),
        torques,
        (&fit.rows, &fit.settings),
        &start,
        &unless_stopped,
    )?;
    if let Some(few) = &mut held_out.held_out.few {
        few.touch = numbers[few.touch];
    }
    let read_times = ReadTimes::new(&read, &logged);
    Ok(result::of(robot, config, &fit, held_out, (&motion, read_times)))
}

/// Stamps that are not the times at which the joints were read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadTimes {
    /// Number of touches whose times were corrected.
    pub corrected: usize,
    /// By how much, s: root mean square over their samples, but for what all samples of a touch share.
    pub rms_s: f64,
}

impl ReadTimes {
    /// Of touches as they were logged, where `read` has those whose times were corrected.
    fn new(read: &[Option<Vec<Sample>>], logged: &[&[Sample]]) -> Self {
        let mut found = Self { corrected: 0, rms_s: 0.0 };
        let (mut squares, mut count) = (0.0, 0.0);
        for (read, logged) in read.iter().zip(logged) {
            let Some(read) = read else { continue };
            let off = read.iter().zip(*logged).filter_map(|(a, b)| Some(a.time_s? - b.time_s?));
            let off: Vec<f64> = off.collect();
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            squares += off.iter().map(|off| (off - mean).powi(2)).sum::<f64>();
            count += off.len() as f64;
            found.corrected += 1;
        }
        if count > 0.0 {
            found.rms_s = f64::sqrt(squares / count);
        }
        found
    }

    /// Of touches of a robot, as they were logged.
    pub fn of(robot: &Robot, logged: &[&[Sample]]) -> Self {
        let read: Vec<_> = logged.iter().map(|touch| with_read_times(robot, touch)).collect();
        Self::new(&read, logged)
    }
}

/// What touches are like, before anything is found.
struct Checked {
    /// How far each joint moves within a touch, rad or m.
    moved: Vec<f64>,
    /// Standard deviation of each joint's torque as it is logged: with its gain.
    variation: Vec<f64>,
    /// Joints whose torque never varies: nothing measures it.
    silent: Vec<usize>,
}

impl Checked {
    fn of(
        robot: &Robot,
        touches: &[&[Sample]],
        torques: &ExternalTorqueConfig,
    ) -> Result<Self, IdentifyError> {
        let samples = || touches.iter().copied().flatten();
        let found = samples().count();
        if found < LEAST_SAMPLES {
            return Err(IdentifyError::TooShort { found, wanted: LEAST_SAMPLES });
        }
        for sample in samples() {
            let poses = robot.forward(&sample.q).map_err(palpate::TrackerError::from)?;
            torques.untared(robot, &poses, &sample.tau)?;
        }
        let joints = 0..robot.n_joints();
        if joints.clone().all(|joint| range(samples().map(|sample| sample.q[joint])) < LEAST_MOTION)
        {
            return Err(IdentifyError::NoMotion { wanted: LEAST_MOTION });
        }
        let silent: Vec<usize> = (joints.clone())
            .filter(|joint| range(samples().map(|sample| sample.tau[*joint])) == 0.0)
            .collect();
        if silent.len() == robot.n_joints() {
            return Err(IdentifyError::NoTorque(
                samples().next().map_or(0.0, |sample| sample.tau[0]) + 0.0, // no -0
            ));
        }
        if torques.gravity == Gravity::Removed {
            return Err(IdentifyError::GravityRemoved);
        }
        let moved = |joint: usize| {
            let of_touch = |touch: &&[Sample]| range(touch.iter().map(|sample| sample.q[joint]));
            touches.iter().map(of_touch).fold(0.0, f64::max)
        };
        let count = found as f64;
        let square = |joint: usize| {
            let mean = samples().map(|sample| sample.tau[joint]).sum::<f64>() / count;
            samples().map(|sample| (sample.tau[joint] - mean).powi(2)).sum::<f64>() / count
        };
        Ok(Self {
            moved: joints.clone().map(moved).collect(),
            variation: joints.map(|joint| square(joint).sqrt()).collect(),
            silent,
        })
    }
}

fn range(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) =
        values.fold((f64::MAX, f64::MIN), |(low, high), at| (at.min(low), at.max(high)));
    high - low
}
