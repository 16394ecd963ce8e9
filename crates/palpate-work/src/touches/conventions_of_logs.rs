//! What is found from the logs before they are used, so that the user need not give it: joints that are not in them,
//! the unit of angles, and the convention of torques.

use std::path::Path;
use std::slice;
use std::sync::Arc;

use palpate::{Arm, ExternalTorqueConfig, Gravity, Robot, Sample, TorqueSign};
use palpate_io::log::{AngleUnit, LogEvent, reorder};

use super::{RecordedTouch, Touches, external, is_of_currents};
use crate::conventions::{ConventionEvidence, KnownConvention, TorqueConvention, Undecided};
use crate::error::WorkError;
use crate::held_joints;
use crate::inspect::{are_degrees, are_radians, is_misread, word};
use crate::progress::Progress;
use crate::settings::sections::{RobotSettings, TouchSettings};
use crate::settings::{OrAuto, Settings};
use crate::touches::reorder_joints;

/// Most samples that are read ahead to find the conventions: 20 MB for seven joints.
pub(super) const AHEAD: usize = 100_000;

/// What to do if the data do not decide the torque convention.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IfUndecided {
    /// Return an error, since the convention is not known from elsewhere.
    Refuse,
    /// Go on, since a field has the convention.
    LeaveOpen,
    /// The same error, but torques that follow gravity as motor currents do are taken for currents: the arm is to be
    /// identified.
    TakeForCurrents,
}

impl Touches {
    /// The arm in which the joints that are not in the logs stand still. A note names them, and they are added to the
    /// settings.
    ///
    /// # Errors
    ///
    /// If a joint cannot be made to stand still. Logs that do not fit the arm are not refused here, but when they are
    /// read.
    pub fn arm_of_logs(
        &mut self,
        arm: Arc<Arm>,
        settings: &mut RobotSettings,
        progress: &dyn Progress,
    ) -> Result<Arc<Arm>, WorkError> {
        let mut names = None;
        let mut count = None;
        for event in self.logs.look_ahead(1) {
            match event {
                LogEvent::TouchStarts { joint_names, .. } => names = joint_names.as_deref(),
                LogEvent::Sample(sample) => {
                    count = Some(sample.q.len());
                    break;
                }
            }
        }
        let Some(count) = count else { return Ok(arm) };
        if let Some((log, own)) = names.and_then(|names| held_joints::other_name(&arm.robot, names))
        {
            progress.note(&format!(
                "joints are matched by the parts of their names that differ from joint to joint: `{log}` is `{own}`, \
                 and so on"
            ));
        }
        let held = held_joints::not_in_log(&arm.robot, names, count);
        if held.is_empty() {
            return Ok(arm);
        }
        let arm = Arc::new(held_joints::holding(&arm, &held)?);
        held_joints::note_held(&arm, &held, "the log", progress);
        settings.hold.get_or_insert_default().extend(held);
        Ok(arm)
    }

    /// Finds out whether positions are in degrees, if neither the settings nor the names of columns give the unit. If
    /// so, they are read as degrees, the settings get that unit, and a note says why. Another note names the unit of
    /// times, if it was found from the data.
    ///
    /// # Errors
    ///
    /// If the settings give degrees for an arm with a prismatic joint, or some touches are in degrees and others in
    /// radians.
    pub fn angle_unit(
        &mut self,
        arm: &Arm,
        settings: &mut Settings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        settings.log.check_for(&arm.robot)?;
        self.logs.look_ahead(AHEAD).for_each(drop);
        self.note_time_units(progress);
        if settings.log.angle_unit_given().is_some() {
            return Ok(());
        }
        let path = self.first_path();
        let set = settings.touch.over_config(&ExternalTorqueConfig::default());
        let events = self.logs.look_ahead_in_unknown_unit(AHEAD);
        let Some(mut touches) = touches_of(events.into_iter(), &arm.robot) else { return Ok(()) };
        let why = are_degrees(&mut touches, &arm.robot, &set);
        if let Some((log, touch)) = self.touch_in_another_unit(&arm.robot, &set, why.is_some()) {
            let [own, others] =
                if why.is_some() { ["radians", "degrees"] } else { ["degrees", "radians"] };
            return Err(WorkError::Usage(format!(
                "`{}`: the angles of touch `{touch}` look like {own}, and most others like {others}; convert all to \
                 one unit first, as `palpate convert --angle-unit deg` does, or give the unit (--angle-unit)",
                log.display()
            )));
        }
        if let Some(why) = why {
            progress.note(&format!("`{path}`: {why}; they are read as degrees (--angle-unit)"));
            self.logs.are_in_degrees();
            settings.log.angle_unit = Some(OrAuto::Is(AngleUnit::Deg));
        }
        Ok(())
    }

    /// The first touch whose positions alone seem to be in another unit than those of all touches together, and its
    /// log: in radians if these are degrees, and the other way round.
    fn touch_in_another_unit(
        &self,
        robot: &Robot,
        set: &ExternalTorqueConfig,
        are_all_degrees: bool,
    ) -> Option<(&Path, String)> {
        let is_other = |touch: &mut RecordedTouch| match are_all_degrees {
            true => are_radians(slice::from_mut(touch), robot, set),
            false => are_degrees(slice::from_mut(touch), robot, set).is_some(),
        };
        let logs = self.logs.all().enumerate().filter(|(log, _)| self.logs.lacks_unit(*log));
        let touches = logs.flat_map(|(log, (path, _))| {
            let touches = touches_of(self.logs.ahead_of(log), robot).unwrap_or_default();
            touches.into_iter().map(move |touch| (&**path, touch))
        });
        let mut touches = touches.map(|(path, mut touch)| (path, is_other(&mut touch), touch.name));
        touches.find(|(_, is_other, _)| *is_other).map(|(path, _, name)| (path, name))
    }

    /// What gravity shows of two logs with different conventions; `None` if there are no such logs.
    fn logs_of_two_conventions(
        &self,
        robot: &Robot,
        still_rad: f64,
        given: KnownConvention,
    ) -> Option<String> {
        let of_log = |log: usize, path: &Path| {
            let touches = touches_of(self.logs.ahead_of(log), robot)?;
            let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
            let found = ConventionEvidence::of(robot, &samples, still_rad)?.decide(given).ok()?;
            found.is_by_gravity().then(|| (path.display().to_string(), found))
        };
        self.logs.all().nth(1)?; // one log has one convention
        let logs = self.logs.all().enumerate();
        let found: Vec<(String, TorqueConvention)> =
            logs.filter_map(|(log, (path, _))| of_log(log, path)).collect();
        let (first, one) = found.first()?;
        let differs = |other: &TorqueConvention| {
            let has_gravity = one.gravity == Gravity::Included;
            other.gravity != one.gravity || has_gravity && other.torque_sign != one.torque_sign
        };
        let (second, other) = found.iter().find(|(_, other)| differs(other))?;
        Some(format!(
            "`{first}`: {one}; but `{second}`: {other}; give these logs to separate commands"
        ))
    }

    pub(super) fn first_path(&self) -> String {
        self.logs.all().next().map_or(String::new(), |(path, _)| path.display().to_string())
    }

    /// Completes the torque convention in the settings: from the type of message in the logs, else from the data, with
    /// a note that says why. `of_arm` is the convention of an identified arm, which counts where gravity shows none.
    ///
    /// # Errors
    ///
    /// If the settings contradict the type of message, logs of different kinds or conventions are mixed, or the data do
    /// not decide the convention and that is to be refused.
    pub(crate) fn conventions(
        &mut self,
        (arm, of_arm): (&Arm, KnownConvention),
        settings: &mut TouchSettings,
        if_undecided: IfUndecided,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        self.conventions_of_external(settings, progress)?;
        self.conventions_of_currents(of_arm, settings, progress)?;
        let (torque_sign, gravity) = (settings.torque_sign_given(), settings.gravity_given());
        if torque_sign.is_some() && gravity.is_some() {
            return Ok(());
        }
        let path = self.first_path();
        let set = settings.over_config(&ExternalTorqueConfig::default());
        let Some(mut touches) = touches_of(self.logs.look_ahead(AHEAD), &arm.robot) else {
            return Ok(());
        };
        let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
        let Some(evidence) = ConventionEvidence::of(&arm.robot, &samples, set.still_rad) else {
            return Ok(());
        };
        if is_misread(&mut touches, &arm.robot, (self.checked.0, &set)) {
            return Ok(()); // the check of the log warns of it
        }
        let given = KnownConvention { torque_sign, gravity };
        let decided = evidence.decide(given);
        match self.logs_of_two_conventions(&arm.robot, set.still_rad, given) {
            Some(differ) if decided.is_err() => return Err(WorkError::Usage(differ)),
            Some(differ) => progress.warn(&differ),
            None => {}
        }
        if let Some((torque_sign, gravity)) = convention_of_arm(decided, given, of_arm) {
            progress.note(&format!(
                "`{path}`: gravity does not show the sign of these torques, so it is taken from the torques from which \
                 the arm was identified (--arm): {}; gravity: {}",
                word(torque_sign),
                word(gravity)
            ));
            self.reported.insert("torque_sign"); // their work may show the other sign
            settings.torque_sign = Some(OrAuto::Is(torque_sign));
            settings.gravity = Some(OrAuto::Is(gravity));
            return Ok(());
        }
        match decided {
            Ok(found) => {
                let by_work = evidence.sign_by_work().filter(|_| found.gravity == Gravity::Removed);
                // If the given sign contradicts the work, the check of the log warns.
                if by_work.is_none_or(|own| own == found.torque_sign) {
                    report(&path, found, torque_sign.is_some(), progress);
                }
                settings.torque_sign = Some(OrAuto::Is(found.torque_sign));
                settings.gravity = Some(OrAuto::Is(found.gravity));
                Ok(())
            }
            Err(Undecided::NoFit(of))
                if of.is_like_currents() && if_undecided == IfUndecided::TakeForCurrents =>
            {
                self.take_for_currents(&of, settings, progress);
                Ok(())
            }
            // The given part is wrong, and the check of the log warns of it.
            Err(_) if evidence.decide(KnownConvention::default()).is_ok() => Ok(()),
            Err(undecided) => refuse_or_report(&path, undecided, if_undecided, progress),
        }
    }

    /// Takes torques that follow gravity as motor currents do for currents, with the sign that gravity shows.
    fn take_for_currents(
        &mut self,
        evidence: &ConventionEvidence,
        settings: &mut TouchSettings,
        progress: &dyn Progress,
    ) {
        let torque_sign = settings.torque_sign_given().unwrap_or(evidence.sign_of_slope());
        progress.note(&format!(
            "`{}`: the torques are {:.2} times those of gravity, so they are taken for motor currents (--currents), \
             with gravity and the sign {}",
            self.first_path(),
            evidence.slope(),
            word(torque_sign)
        ));
        settings.torque_sign = Some(OrAuto::Is(torque_sign));
        settings.gravity = Some(OrAuto::Is(Gravity::Included));
        self.treat_as_currents();
    }

    /// The convention of motor currents, with gravity: the sign of those from which the arm was identified, else that of
    /// motor torques (minus).
    fn conventions_of_currents(
        &self,
        of_arm: KnownConvention,
        settings: &mut TouchSettings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let named = self.logs.all().find(is_of_currents);
        let Some((path, _)) = named.or_else(|| self.logs.all().next().filter(|_| self.currents))
        else {
            return Ok(());
        };
        let path = path.display();
        if let Some((other, _)) = self.logs.all().find(|log| external(log).is_some()) {
            let other = other.display();
            return Err(WorkError::Usage(format!(
                "`{other}` holds external torques; wanted motor currents (because of --currents, or the file of --arm)"
            )));
        }
        if named.is_some() && !self.logs.all().all(|log| is_of_currents(&log)) {
            return Err(WorkError::Usage(format!(
                "`{path}` holds motor currents, other logs do not; give these logs to separate commands"
            )));
        }
        let are = match named {
            Some(_) => "by their names, these are",
            None => "the torques are assumed to be",
        };
        let mut assumed = Vec::new();
        if settings.torque_sign_given().is_none() {
            let sign = of_arm.torque_sign.unwrap_or(TorqueSign::Minus);
            settings.torque_sign = Some(OrAuto::Is(sign));
            assumed.push(match sign {
                TorqueSign::Minus => "their sign is that of the motors' torques (minus)",
                TorqueSign::Plus => "their sign is that of the identified arm (plus)",
            });
        }
        if settings.gravity_given().is_none() {
            settings.gravity = Some(OrAuto::Is(Gravity::Included));
            assumed.push("they contain gravity");
        }
        let colon = if assumed.is_empty() { "" } else { ": " };
        progress.note(&format!("`{path}`: {are} motor currents{colon}{}", assumed.join(", and ")));
        Ok(())
    }

    /// The convention of external torques, by the type of message or the names of columns: no gravity, and the sign of
    /// the maker, if it is known.
    fn conventions_of_external(
        &self,
        settings: &mut TouchSettings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let logs = || self.logs.all().map(|log| (&log.0, external(log)));
        let Some((path, Some(sign))) = logs().find(|(_, sign)| sign.is_some()) else {
            return Ok(());
        };
        let path = path.display();
        let all = logs().all(|(_, sign)| sign.is_some());
        match settings.gravity_given() {
            Some(Gravity::Removed) => {}
            Some(Gravity::Included) => {
                return Err(WorkError::Usage(format!(
                    "`{path}` holds external torques, from which the robot has subtracted gravity; \
                     give --gravity removed, or leave --gravity out"
                )));
            }
            None if !all => {
                return Err(WorkError::Usage(format!(
                    "`{path}` holds external torques, without gravity, but for other logs this is not known; \
                     give --gravity if it is right for all, or give these logs to separate commands"
                )));
            }
            None => {
                progress.note(&format!(
                    "`{path}` holds external torques: gravity is not subtracted from them"
                ));
                settings.gravity = Some(OrAuto::Is(Gravity::Removed));
            }
        }
        let given = settings.torque_sign_given();
        if let Some((other, _)) = logs().find(|(_, other)| other.is_some_and(|own| own != sign))
            && given.is_none()
        {
            return Err(WorkError::Usage(format!(
                "`{path}` and `{}` hold external torques whose signs may differ; give --torque-sign if it is right \
                 for all, or give these logs to separate commands",
                other.display()
            )));
        }
        let Some(sign) = sign else { return Ok(()) };
        let why = match sign {
            TorqueSign::Minus => {
                "external torques of a Franka have the sign of the motors' torques, minus"
            }
            TorqueSign::Plus => {
                "external torques of a KUKA are what the object exerts on the joints: their sign is plus"
            }
        };
        match given {
            None if all => {
                progress.note(why);
                settings.torque_sign = Some(OrAuto::Is(sign));
            }
            Some(given) if given != sign => {
                progress.warn(&format!("`{path}`: {why}, but --torque-sign is {}", word(given)));
            }
            _ => {}
        }
        Ok(())
    }
}

/// Notes the convention that was found; `is_given`: whether the settings give the sign.
fn report(path: &str, found: TorqueConvention, is_given: bool, progress: &dyn Progress) {
    if found.is_without_torque() {
        progress.warn(&format!("`{path}`: {found}"));
        return;
    }
    let unless_led = if found.is_by_work() && !is_given {
        "; if a person or another machine moved the arm, the sign is the other one (--torque-sign)"
    } else {
        ""
    };
    progress.note(&format!("`{path}`: {found}{unless_led}"));
}

/// Says why the convention is not decided: as an error, or as a warning or note if the command goes on.
fn refuse_or_report(
    path: &str,
    undecided: Undecided,
    if_undecided: IfUndecided,
    progress: &dyn Progress,
) -> Result<(), WorkError> {
    let text = format!("`{path}`: {undecided}");
    match (undecided, if_undecided) {
        // Perhaps only the unit or the payload is wrong.
        (Undecided::NoFit(of), _) if of.negated_joints().is_none() && !of.is_like_currents() => {
            progress.warn(&text);
        }
        (Undecided::NoFit(_), IfUndecided::LeaveOpen) => progress.warn(&text),
        (_, IfUndecided::LeaveOpen) => progress.note(&text),
        _ => return Err(WorkError::Usage(text)),
    }
    Ok(())
}

/// The convention of an identified arm, where the data show no other by gravity: of torques without gravity only the
/// sign, since a person may have moved the arm, and then their work does not show it.
fn convention_of_arm(
    decided: Result<TorqueConvention, Undecided>,
    given: KnownConvention,
    of_arm: KnownConvention,
) -> Option<(TorqueSign, Gravity)> {
    let sign = of_arm.torque_sign.filter(|_| given.torque_sign.is_none())?;
    let gravity = given.gravity.or(of_arm.gravity)?;
    match decided {
        Ok(found) if found.is_without_torque() || !found.is_by_work() => None,
        Ok(found) if found.is_by_gravity() => Some((sign, found.gravity)),
        Err(Undecided::Sign(of)) if of.shows_gravity() => Some((sign, Gravity::Removed)),
        Err(Undecided::NoFit(_)) => None,
        _ => Some((sign, gravity)),
    }
}

/// Events as touches, joints in the robot's order; `None` if the joints do not match those of the robot.
pub(super) fn touches_of<'a>(
    events: impl Iterator<Item = &'a LogEvent>,
    robot: &Robot,
) -> Option<Vec<RecordedTouch>> {
    let joints: Vec<String> = robot.joint_names().map(str::to_owned).collect();
    let mut touches: Vec<RecordedTouch> = Vec::new();
    let mut order = None;
    for event in events {
        match event {
            LogEvent::TouchStarts { name, joint_names } => {
                let names = joint_names.as_ref().map(|names| reorder(&joints, names));
                order = names.transpose().ok()?;
                let joint_names = joint_names.as_ref().map(|_| joints.clone());
                touches.push(RecordedTouch {
                    name: name.clone(),
                    joint_names,
                    ..RecordedTouch::default()
                });
            }
            LogEvent::Sample(sample) => {
                let mut sample = sample.clone();
                if let Some(order) = &order {
                    reorder_joints(&mut sample, order);
                }
                if sample.q.len() != joints.len() || sample.tau.len() != joints.len() {
                    return None;
                }
                touches.last_mut()?.samples.push(sample);
            }
        }
    }
    touches.retain(|touch| !touch.samples.is_empty());
    Some(touches)
}
