//! Identification of an arm from logs in free motion: payload, masses, friction, bias, delay and gains.
//!
//! The motor torque is linear in most of them ([`palpate::TorqueModel`]), so this is a linear regression with a
//! Gaussian prior around the URDF (Atkeson, An and Hollerbach 1986; Gautier and Khalil 1990); its posterior gives the
//! standard deviations. The prior widths of masses, friction, biases and gains, and the noise of each joint, are
//! estimated by maximising the evidence (MacKay 1992). Delay and gains enter by Gauss-Newton steps. A barrier keeps
//! masses and inertias physically possible (Wensing, Kim and Slotine 2018: the pseudo-inertia is positive definite).
//! Presliding distance and window are searched over a few values. Samples in which something seems to be touched are
//! left out.
//!
//! | file                   | content                                                        |
//! |------------------------|----------------------------------------------------------------|
//! | `rows`                 | samples as rows of the regression, summed up by joint and fold |
//! | `prior`                | prior means and widths of the unknowns                         |
//! | `posterior`            | posterior of the unknowns, and noise                           |
//! | `search`               | delay, presliding distances and window                         |
//! | `contact_samples`      | samples in which something seems to be touched                 |
//! | `physical_consistency` | constraint to physically possible inertias                     |
//! | `ripple`               | torque that is periodic with the teeth of the gears            |
//! | `held_out`             | residuals on held-out motion                                   |
//! | `outliers`             | whether few samples have most of the residual                  |
//! | `result`               | values with standard deviations, in common units               |
//! | `notes`                | what is suspect, what cannot be determined, and why            |

mod contact_samples;
mod held_out;
mod notes;
mod outliers;
mod physical_consistency;
mod posterior;
mod prior;
mod result;
mod ripple;
mod rows;
mod search;

pub use held_out::HeldOutResiduals;
pub use outliers::ResidualOutliers;
pub use result::{Estimate, IdentifiedArm, InertiaEstimate, JointEstimate, PayloadEstimate};

use palpate::unstable::{LinkId, with_read_times};
use palpate::{ExternalTorqueConfig, Gravity, Robot, Sample};
use serde::Serialize;

use prior::Start;
pub(crate) use prior::inertial_scales;
use search::Search;

use crate::error::Stop;

/// Settings of the identification.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifyConfig {
    /// The link in whose frame the payload is given.
    pub payload_link: LinkId,
    /// Whether the torques are motor currents: gains are then not near 1, and follow from the masses of the URDF.
    pub currents: bool,
}

/// Why nothing could be identified.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum IdentifyError {
    /// Too few samples.
    #[error("found {found} samples; wanted at least {wanted}")]
    TooShort { found: usize, wanted: usize },
    /// No joint moves.
    #[error(
        "no joint moves by more than {wanted} rad, so nothing can be determined; move all of them, as \
         `palpate excite` does"
    )]
    NoMotion { wanted: f64 },
    /// All torques are constant.
    #[error("the torques are {0} N·m in all samples: were they recorded?")]
    NoTorque(f64),
    /// Stopped by the caller.
    #[error("stopped")]
    Stopped,
    /// Gravity is already subtracted from the torques.
    #[error(
        "the torques contain no gravity: the robot has subtracted it, with its own values of masses and friction; \
         identification needs the measured torques (of a Franka `tau_J`, not `tau_ext_hat_filtered`); if the torques \
         do contain gravity, give --gravity included"
    )]
    GravityRemoved,
    /// A payload on a link that does not move.
    #[error("no joint moves the link of the payload")]
    PayloadLink,
    /// A sample that does not fit the robot.
    #[error(transparent)]
    Sample(#[from] palpate::TrackerError),
    /// The regression has no finite solution.
    #[error(
        "the regression has no finite solution: does the log contain numbers that are far too large?"
    )]
    Unsolvable,
}

/// Touches with fewer samples give no speeds; they are ignored if there are longer ones.
const MIN_OF_TOUCH: usize = 4;
/// With fewer samples, identification is refused ([`IdentifyError::TooShort`]).
const MIN_SAMPLES: usize = 20;
/// A joint that moves by less, rad or m, counts as not moving.
pub const MIN_MOTION: f64 = 0.02;

/// Identifies an arm from touches in free motion, joints in the robot's order.
///
/// `stop` is polled, and `done` is called before each step, for a progress bar.
///
/// # Errors
///
/// If the touches cannot be used: too short, without motion, with constant torques or torques without gravity.
pub fn identify(
    robot: &Robot,
    touches: &[&[Sample]],
    torques: &ExternalTorqueConfig,
    config: &IdentifyConfig,
    (stop, done): (Stop<'_>, &dyn Fn()),
) -> Result<IdentifiedArm, IdentifyError> {
    let unless_stopped = || {
        done();
        if stop() { Err(IdentifyError::Stopped) } else { Ok(()) }
    };
    // One touch without speeds would make the regression ignore the speeds of all touches.
    let least =
        if touches.iter().any(|touch| touch.len() >= MIN_OF_TOUCH) { MIN_OF_TOUCH } else { 1 };
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
    let fit = contact_samples::leave_out(&search, all, &unless_stopped)?;

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

/// Correction of time stamps that differ from the times at which the joints were read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadTimes {
    /// Number of touches whose times were corrected.
    pub corrected: usize,
    /// Size of the correction, s: root mean square over their samples, after subtraction of each touch's mean.
    pub rms_s: f64,
}

impl ReadTimes {
    /// Compares logged touches with `read`, which has the corrected ones (`None`: not corrected).
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

    /// Finds the correction for logged touches of a robot.
    pub fn of(robot: &Robot, logged: &[&[Sample]]) -> Self {
        let read: Vec<_> = logged.iter().map(|touch| with_read_times(robot, touch)).collect();
        Self::new(&read, logged)
    }
}

/// Statistics of the touches, computed while they are checked.
struct Checked {
    /// Largest range of each joint within a touch, rad or m.
    moved: Vec<f64>,
    /// Standard deviation of each joint's logged torque, not divided by its gain.
    variation: Vec<f64>,
    /// Joints whose logged torque is constant, so it is not measured.
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
        if found < MIN_SAMPLES {
            return Err(IdentifyError::TooShort { found, wanted: MIN_SAMPLES });
        }
        for sample in samples() {
            let poses = robot.forward(&sample.q).map_err(palpate::TrackerError::from)?;
            torques.untared(robot, &poses, &sample.tau)?;
        }
        let joints = 0..robot.n_joints();
        if joints.clone().all(|joint| range(samples().map(|sample| sample.q[joint])) < MIN_MOTION) {
            return Err(IdentifyError::NoMotion { wanted: MIN_MOTION });
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
