//! Content of a log, touch by touch, and what looks wrong with it.
//!
//! | file             | content                                                  |
//! |------------------|----------------------------------------------------------|
//! | `joints`         | joints matched by name                                   |
//! | `frames`         | repeated frames, clock, stamps                           |
//! | `sensors`        | torques that are constant or cut off while the arm moves |
//! | `delay`          | torques that come later than positions                   |
//! | `motion`         | positions and speeds beyond the robot's limits           |
//! | `unit`           | degrees or radians                                       |
//! | `reading`        | sign, gravity and order of joints that fit best          |
//! | `gravity`        | the findings from these                                  |
//! | `mounting`       | whether the arm is mounted as its URDF says              |
//! | `payload`        | what weight would explain torques that gravity does not  |
//! | `figures`        | start, tare, noise, push, contacts and end of each touch |
//! | `touch_findings` | the findings from these figures                          |
//! | `check`          | all checks while a log is being learnt from              |
//!
//! Most defects show only in comparison with the whole log, so it is read into memory: 200 bytes for a frame of seven
//! joints.
//!
//! A defect is reported once: if the log seems to be in degrees, or its torques to have the other sign, the remaining
//! checks are made as if that had been corrected.

mod check;
mod delay;
mod figures;
mod frames;
mod gravity;
mod joints;
mod motion;
mod mounting;
mod payload;
mod reading;
mod sensors;
mod touch_findings;
mod unit;

pub(crate) use motion::LIMIT_MARGIN;
pub(crate) use unit::{are_degrees, are_radians};

use std::cmp::Reverse;
use std::sync::Arc;

use palpate::{
    Arm, ContactConfig, ExternalTorqueConfig, Gravity, Lattice, MapperConfig, Robot, TorqueSign,
};
use palpate_io::log::{
    AngleUnit, CsvColumns, LogDescription, LogFormat, LogWarning, LoggedTorques,
};
use serde::Serialize;

use super::field::LatticeFacts;
use super::finding::Finding;
use crate::contact_counts::ContactFigures;
use crate::conventions::KnownConvention;
use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::Settings;
use crate::touches::{CURRENTS, RecordedTouch, Touches};
pub use check::LogCheck;
pub(crate) use check::{looks_wrong_as_logged, warn_of};
pub use figures::TouchFacts;
pub use frames::ClockFacts;
pub use joints::Matching;
pub use reading::{ConventionFit, ConventionFits, LogInterpretation};

/// Facts about a log.
#[derive(Debug, Serialize)]
pub struct LogFacts {
    /// Its format.
    pub format: LogFormat,
    /// The columns that are read, if it is a table.
    pub columns: Option<CsvColumns>,
    /// Name of the robot with which it is compared.
    pub robot: String,
    /// Number of frames of all touches.
    pub frames: usize,
    /// The clock, if there is one.
    pub clock: Option<ClockFacts>,
    /// Names of the joints, in the order of all lists by joint: that of the robot, if the joints match.
    pub joints: Vec<String>,
    /// How they were matched to the robot's.
    pub matching: Matching,
    /// How the log should be read; only if the joints match the robot's.
    pub reading: Option<LogInterpretation>,
    /// The lattice in which contacts are simulated.
    pub lattice: LatticeFacts,
    /// Counts of touched points and cells, as `map` would find; only if the joints match the robot's.
    pub touched: Option<ContactFigures>,
    /// The touches, in their order.
    pub touches: Vec<TouchFacts>,
}

/// Inspects a log, or the error of opening it: returns its facts, if anything of it can be read, and findings, errors
/// first.
///
/// # Errors
///
/// If a setting is out of its range, or the progress stops it. What is wrong with the log itself is
/// a finding.
pub fn inspect(
    mut log: Result<Touches, WorkError>,
    (settings, config): (&Settings, &MapperConfig),
    (arm, progress): (&Arc<Arm>, &dyn Progress),
) -> Result<(Option<LogFacts>, Vec<Finding>), WorkError> {
    let arm = match &mut log {
        Ok(touches) => {
            touches.arm_of_logs(Arc::clone(arm), &mut settings.robot.clone(), progress)?
        }
        Err(_) => Arc::clone(arm),
    };
    let mut inspector =
        LogInspector { settings, config, arm: &arm, progress, findings: Vec::new() };
    let log = match log {
        Ok(touches) => inspector.inspect(touches)?,
        Err(error) => {
            inspector.findings.push(unreadable(&error));
            None
        }
    };
    let mut findings = inspector.findings;
    findings.sort_by_key(|finding| Reverse(finding.level));
    Ok((log, findings))
}

struct LogInspector<'a> {
    settings: &'a Settings,
    config: &'a MapperConfig,
    arm: &'a Arc<Arm>,
    progress: &'a dyn Progress,
    findings: Vec<Finding>,
}

impl LogInspector<'_> {
    fn inspect(&mut self, mut log: Touches) -> Result<Option<LogFacts>, WorkError> {
        let (robot, settings) = (&self.arm.robot, &self.settings.log);
        let mut touches = self.read(&mut log);
        self.findings.extend(log.warnings().filter_map(left_out));
        self.findings.extend(frames::found_time_units(&log));
        if log.are_currents() {
            let [what, remedy] = CURRENTS;
            self.findings.push(Finding::warning("currents", what.to_owned(), remedy));
        }
        if touches.is_empty() {
            return Ok(None);
        }
        if let Err(error) = settings.check_for(robot) {
            let remedy = "a log of a robot with a prismatic joint must be in radians and metres";
            self.findings.push(Finding::error("angle_unit", error.to_string(), remedy));
        }
        let (matching, unmatched) = joints::match_joints(&mut touches, robot);
        self.findings.extend(unmatched);
        let mut facts = LogFacts::new(&log, &touches, matching, (robot, self.config));
        if matching == Matching::Unmatched || log.are_currents() {
            self.findings.extend(frames::findings(&touches));
            self.findings.extend(sensors::findings(&touches, &facts.joints, None));
            return Ok(Some(facts));
        }
        if settings.pauses().is_some() {
            let lattice = self.config.lattice.clone();
            let whole = Touches::in_memory(&log.log().to_string_lossy(), touches);
            touches = self.read(&mut whole.for_arm(self.arm, settings, lattice)?);
        }
        if !touches.is_empty() {
            let LogDescription { torques, angle_unit, .. } = log.describe();
            let given = self.given(torques);
            let mut set = self.config.touch.clone();
            set.torque_sign = given.torque_sign.unwrap_or(set.torque_sign);
            set.gravity = given.gravity.unwrap_or(set.gravity);
            let read = Read {
                arm: self.arm,
                place: &(self.config.lattice.clone(), self.config.contact.clone()),
                set: &set,
                given,
                angle_unit: settings.angle_unit_given().or(angle_unit),
                matching,
                is_identified: self.settings.robot.arm.is_some(),
            };
            let judged = read.judge(&mut touches, None, self.progress)?;
            self.findings.extend(judged.findings);
            self.findings.extend(frames::stamps(&touches, robot));
            (facts.touched, facts.touches) = (Some(judged.touched), judged.touches);
            facts.reading = Some(judged.reading);
        }
        Ok(Some(facts))
    }

    /// The part of the torque convention that is given, or known from the kind of torques.
    fn given(&self, torques: LoggedTorques) -> KnownConvention {
        let touch = &self.settings.touch;
        let (sign, gravity) = match torques {
            LoggedTorques::External(sign) => (sign, Some(Gravity::Removed)),
            _ => (None, None),
        };
        KnownConvention {
            torque_sign: touch.torque_sign_given().or(sign),
            gravity: touch.gravity_given().or(gravity),
        }
    }

    /// Reads the touches that have frames, up to the end or the first error.
    fn read(&mut self, log: &mut Touches) -> Vec<RecordedTouch> {
        let mut touches = Vec::new();
        let read = log.read_into(&mut touches, None);
        self.findings.extend(read.err().as_ref().map(unreadable));
        touches.retain(|touch| !touch.samples.is_empty());
        touches
    }
}

/// Lattice and contact model in which contacts are simulated.
type Place = (Lattice, ContactConfig);

/// Under which settings touches with the robot's joints are checked.
struct Read<'a> {
    arm: &'a Arc<Arm>,
    place: &'a Place,
    /// The torque convention; where it is not given, the one from which the search begins.
    set: &'a ExternalTorqueConfig,
    given: KnownConvention,
    /// Unit of angles, if given by the settings or by the names of columns.
    angle_unit: Option<AngleUnit>,
    matching: Matching,
    /// Whether the arm was identified, so that touches need no start at rest.
    is_identified: bool,
}

/// Facts and findings about touches.
struct Judged {
    reading: LogInterpretation,
    touched: ContactFigures,
    touches: Vec<TouchFacts>,
    findings: Vec<Finding>,
}

impl Read<'_> {
    /// Checks touches, and converts them to the unit and the order of joints that they seem to have. `contacts` is the
    /// number of touched points of each frame as it was read, by touch, if known.
    fn judge(
        &self,
        touches: &mut [RecordedTouch],
        contacts: Option<&[Vec<usize>]>,
        progress: &dyn Progress,
    ) -> Result<Judged, WorkError> {
        let (robot, set) = (&self.arm.robot, self.set);
        let AsLogged { reading, as_read, period_s, mut findings } =
            AsLogged::of(touches, robot, (set, self.given), (self.angle_unit, self.matching));
        let contacts = contacts.filter(|_| as_read);
        let fits = &reading.fits;
        findings.extend(delay::finding(touches, robot, (fits, set.still_rad), period_s));
        // Late torques and negated columns do work on the arm, too, and are reported already.
        let explained = |of: &Finding| ["joint_sign", "delay"].contains(&of.code);
        if fits.has_enough_gravity() && !fits.misfit() && !findings.iter().any(explained) {
            findings.extend(mounting::finding(touches, robot, (&fits.accepted(), set.still_rad)));
        }
        let figures = figures::Figures::new(self.arm, self.place, (set, fits.accepted()))?;
        let (facts, touched, cells) = figures.of_all(touches, contacts, progress)?;
        let nothing = touched.nothing(&self.place.0);
        let moves = figures::last_link_box(touches, robot);
        let figured = touch_findings::JudgedFigures {
            robot,
            touches: &facts,
            tare: set.tare,
            is_identified: self.is_identified,
            fits,
        };
        findings.extend(figured.findings(nothing, moves));
        Ok(Judged { touched: touched.figures(cells), touches: facts, reading, findings })
    }
}

/// Facts and findings about touches for which no contacts are simulated.
struct AsLogged {
    reading: LogInterpretation,
    /// Whether unit and order of joints are those in which the touches were read.
    as_read: bool,
    period_s: Option<f64>,
    findings: Vec<Finding>,
}

impl AsLogged {
    /// Checks touches with the robot's joints, and converts them to the unit and the order of joints that they seem to
    /// have.
    fn of(
        touches: &mut [RecordedTouch],
        robot: &Robot,
        (set, given): (&ExternalTorqueConfig, KnownConvention),
        (angle_unit, matching): (Option<AngleUnit>, Matching),
    ) -> Self {
        let unwrap_angles = |touches: &mut [RecordedTouch]| {
            touches.iter_mut().for_each(|touch| touch.unwrap_angles(robot));
        };
        let (angle_unit, wrong_unit) = unit::correct(touches, robot, angle_unit, set);
        unwrap_angles(touches);
        let (reading, by_gravity) =
            gravity::judge(touches, robot, (set, given), (angle_unit, matching));
        unwrap_angles(touches); // again: the order of joints may have changed
        let as_read = wrong_unit.is_none() && reading.order.is_none();
        let mut findings = Vec::from_iter(wrong_unit);
        findings.extend(by_gravity);
        let joints: Vec<String> = robot.joint_names().map(str::to_owned).collect();
        let period_s = frames::clock(touches).map(|clock| clock.period_s);
        findings.extend(frames::findings(touches));
        findings.extend(sensors::findings(touches, &joints, Some(robot)));
        findings.extend(motion::findings(touches, robot, period_s));
        Self { reading, as_read, period_s, findings }
    }
}

/// Whether touches seem to be in another unit than `unit`, or in another order of joints than the robot's.
pub(crate) fn is_misread(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    (unit, set): (AngleUnit, &ExternalTorqueConfig),
) -> bool {
    if unit::correct(touches, robot, Some(unit), set).1.is_some() {
        return true;
    }
    let rests = reading::rests(touches, set.still_rad);
    let straight: Vec<usize> = (0..robot.n_joints()).collect();
    let fits = reading::fits(robot, &rests, &straight, set);
    reading::other_order(robot, &rests, set, &fits).is_some()
}

impl LogFacts {
    /// Facts that do not need matched joints.
    fn new(
        log: &Touches,
        touches: &[RecordedTouch],
        matching: Matching,
        (robot, config): (&Robot, &MapperConfig),
    ) -> Self {
        let LogDescription { format, columns, .. } = log.describe();
        let first = &touches[0];
        let numbered = || (1..=first.n_joints()).map(|joint| format!("joint {joint}")).collect();
        Self {
            format,
            columns,
            robot: robot.name().to_owned(),
            frames: touches.iter().map(RecordedTouch::frames).sum(),
            clock: frames::clock(touches),
            joints: match matching {
                Matching::Unmatched => first.joint_names.clone().unwrap_or_else(numbered),
                _ => robot.joint_names().map(str::to_owned).collect(),
            },
            matching,
            reading: None,
            lattice: LatticeFacts::new(&config.lattice),
            touched: None,
            touches: Vec::new(),
        }
    }
}

fn unreadable(error: &WorkError) -> Finding {
    let remedy =
        "correct what the message names; this report is only about what could be read before it";
    Finding::error("unreadable", error.to_string(), remedy)
}

/// A finding for a warning of the reader; `None` for the clock, which has its own finding.
fn left_out(odd: &LogWarning) -> Option<Finding> {
    let remedy = "nothing to do if this is intended; otherwise check --joints, --touch-topic and the recording";
    let clock = matches!(odd, LogWarning::TimeNotIncreasing { .. });
    (!clock).then(|| Finding::warning("left_out", odd.to_string(), remedy))
}

impl RecordedTouch {
    fn frames(&self) -> usize {
        self.samples.len()
    }

    fn n_joints(&self) -> usize {
        self.samples.first().map_or(0, |sample| sample.q.len())
    }

    /// Times of the frames that have one, s.
    fn times_s(&self) -> impl Iterator<Item = f64> {
        self.samples.iter().filter_map(|sample| sample.time_s)
    }

    /// Number of frames from the first on in which no joint has moved by more than `still_rad`.
    fn still_frames(&self, still_rad: f64) -> usize {
        let Some(start) = self.samples.first() else { return 0 };
        let moved =
            self.samples.iter().position(|sample| farthest(&sample.q, &start.q) > still_rad);
        moved.unwrap_or(self.frames())
    }
}

/// Largest |difference| of two joint vectors over the joints.
pub(crate) fn farthest(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The mean of each column of some rows.
pub(crate) fn mean<T>(rows: &[T], of: impl Fn(&T) -> &[f64]) -> Vec<f64> {
    let columns = rows.first().map_or(0, |row| of(row).len());
    let mean = |j: usize| rows.iter().map(|row| of(row)[j]).sum::<f64>() / rows.len() as f64;
    (0..columns).map(mean).collect()
}

/// Factor that gives logged torques the sign of external torques.
fn sign(torque_sign: TorqueSign) -> f64 {
    match torque_sign {
        TorqueSign::Plus => 1.0,
        TorqueSign::Minus => -1.0,
    }
}
