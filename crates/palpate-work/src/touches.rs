//! Logs one after another, with their joints in the robot's order.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::{
    Arm, ContactConfig, ExternalTorqueConfig, Gravity, Lattice, MapperError, Sample, TorqueSign,
};
use palpate_io::input;
use palpate_io::log::{
    self, AngleUnit, Log, LogDescription, LogError, LogEvent, LogOptions, LogWarning,
    LoggedTorques, reorder,
};

use crate::conventions::{self, Evidence, Given};
use crate::error::WorkError;
use crate::inspect::is_misread;
use crate::inspect::log::LogCheck;
use crate::pauses::Pauses;
use crate::progress::Progress;
use crate::recorded::{MemoryLog, reorder_joints};
use crate::robot;
use crate::settings::OrAuto;
use crate::settings::sections::{LogSettings, RobotSettings, TouchSettings};

pub use crate::recorded::{RecordedTouch, TouchEvent};

/// Samples that are read ahead to find out how torques count: 20 MB of seven joints.
const AHEAD: usize = 100_000;

/// What to do where data fit two conventions of torques alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Undecided {
    /// Nobody else says which it is.
    IsAnError,
    /// A field says which it is.
    LeavesThem,
}

/// Logs that are read as one.
#[derive(Default)]
pub struct Touches {
    logs: Vec<(PathBuf, Box<dyn Log>)>,
    /// The log that was read from last, and that of the event that was handed on last.
    reading: usize,
    current: usize,
    /// What was read and not handed on yet, with the log that it is of, and the error behind it.
    ahead: VecDeque<(usize, LogEvent)>,
    failed: Option<(usize, LogError)>,
    joints: Vec<String>,
    permutation: Option<Vec<usize>>,
    /// Joints of the touch that was started last, as the log names them.
    named: Option<Vec<String>>,
    /// The touch that the log is in, and how many of its samples were read.
    read: (String, u64),
    /// Parts touches at pauses, if that was asked for, and what it has made of them.
    pauses: Option<Pauses>,
    next: VecDeque<TouchEvent>,
    touch: Option<String>,
    sample: u64,
    /// The unit that angles were said to be in, and whether what looks wrong is an error.
    checked: (AngleUnit, bool),
}

impl Touches {
    /// Opens all logs, so that most defects show before any work is done.
    pub fn open(paths: &[PathBuf], options: &LogOptions) -> Result<Self, WorkError> {
        let open = |path: &PathBuf| Ok((path.clone(), log::open(path, options)?));
        let logs = paths.iter().map(open).collect::<Result<Vec<_>, WorkError>>()?;
        Ok(Self { logs, checked: (options.angle_unit, false), ..Self::default() })
    }

    /// Touches that a program holds, after each other, which errors call by this name.
    pub fn held(name: &str, touches: Vec<RecordedTouch>) -> Self {
        let log = Box::new(MemoryLog::new(touches));
        Self { logs: vec![(PathBuf::from(name), log)], ..Self::default() }
    }

    /// These touches, then those of others.
    ///
    /// Only logs that were not read from yet may be joined.
    #[must_use]
    pub fn then(mut self, other: Self) -> Self {
        self.logs.extend(other.logs);
        self
    }

    /// The arm with those joints standing still that the logs do not hold, which a note names; they go into the settings.
    ///
    /// # Errors
    ///
    /// Never of logs that do not serve the arm, which shows where they are read.
    pub fn arm_of_logs(
        &mut self,
        arm: Arc<Arm>,
        settings: &mut RobotSettings,
        progress: &dyn Progress,
    ) -> Result<Arc<Arm>, WorkError> {
        self.look_ahead(1);
        let mut names = None;
        let mut count = None;
        for (_, event) in &self.ahead {
            match event {
                LogEvent::TouchStarts { joint_names, .. } => names = joint_names.as_deref(),
                LogEvent::Sample(sample) => {
                    count = Some(sample.q.len());
                    break;
                }
            }
        }
        let Some(count) = count else { return Ok(arm) };
        if let Some((log, own)) = names.and_then(|names| robot::other_prefix(&arm.robot, names)) {
            progress.note(&format!(
                "joints are matched without what their names begin with: `{log}` is `{own}`, and so on"
            ));
        }
        let held = robot::not_in_log(&arm.robot, names, count);
        if held.is_empty() {
            return Ok(arm);
        }
        let arm = Arc::new(robot::holding(&arm, &held)?);
        robot::tell_held(&arm, &held, "the log", progress);
        settings.hold.get_or_insert_default().extend(held);
        Ok(arm)
    }

    /// Takes from the logs what the settings leave open of the torques: what a type of message says, else what the
    /// data tell, of which a note says why.
    ///
    /// # Errors
    ///
    /// If the settings contradict what the logs say, or the data fit two conventions alike and `undecided` is an
    /// error; else it is left open.
    pub fn conventions(
        &mut self,
        arm: &Arm,
        settings: &mut TouchSettings,
        undecided: Undecided,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        self.conventions_of_messages(settings, progress)?;
        let (torque_sign, gravity) = (settings.torque_sign_given(), settings.gravity_given());
        if torque_sign.is_some() && gravity.is_some() {
            return Ok(());
        }
        self.look_ahead(AHEAD);
        let path =
            self.logs.first().map(|(path, _)| path.display().to_string()).unwrap_or_default();
        let set = settings.over_config(&ExternalTorqueConfig::default());
        let Some(mut touches) = self.touches_ahead(arm) else { return Ok(()) };
        let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
        let Some(evidence) = Evidence::of(&arm.robot, &samples, set.still_rad) else {
            return Ok(());
        };
        if is_misread(&mut touches, &arm.robot, (self.checked.0, &set)) {
            return Ok(()); // which is warned of
        }
        match evidence.decide(Given { torque_sign, gravity }) {
            Ok(found) => {
                progress.note(&format!("`{path}`: {found}"));
                settings.torque_sign = Some(OrAuto::Is(found.torque_sign));
                settings.gravity = Some(OrAuto::Is(found.gravity));
            }
            // What is given is wrong, which is warned of.
            Err(_) if evidence.decide(Given::default()).is_ok() => {}
            Err(told @ conventions::Undecided::Nothing(_)) => {
                progress.warn(&format!("`{path}`: {told}"));
            }
            Err(told) => match undecided {
                Undecided::IsAnError => return Err(WorkError::Usage(format!("`{path}`: {told}"))),
                Undecided::LeavesThem => progress.note(&format!("`{path}`: {told}")),
            },
        }
        Ok(())
    }

    /// Torques that a type of message says are external ones hold no gravity, and count as the motors' do:
    /// libfranka's `tau_ext_hat_filtered` is what the motors exert beyond the model.
    fn conventions_of_messages(
        &self,
        settings: &mut TouchSettings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let Some((path, _)) = self.logs.iter().find(is_external) else { return Ok(()) };
        let path = path.display();
        match settings.gravity_given() {
            Some(Gravity::Removed) => {}
            Some(Gravity::Included) => {
                return Err(WorkError::Usage(format!(
                    "`{path}` holds external torques, out of which the robot has taken gravity; \
                     say --gravity removed, or leave it out"
                )));
            }
            None if !self.logs.iter().all(|log| is_external(&log)) => {
                return Err(WorkError::Usage(format!(
                    "`{path}` holds external torques, without gravity, and other logs do not say so; \
                     give --gravity if it holds for all, or read them one after the other"
                )));
            }
            None => {
                progress.note(&format!(
                    "`{path}` holds external torques: gravity is not taken off them"
                ));
                settings.gravity = Some(OrAuto::Is(Gravity::Removed));
            }
        }
        let told = "external torques of a Franka count as the motors' do";
        match settings.torque_sign_given() {
            None if self.logs.iter().all(|log| is_external(&log)) => {
                progress.note(&format!("{told}: their sign is minus"));
                settings.torque_sign = Some(OrAuto::Is(TorqueSign::Minus));
            }
            Some(TorqueSign::Plus) => {
                progress.warn(&format!("`{path}`: {told}, and --torque-sign is plus"));
            }
            _ => {}
        }
        Ok(())
    }

    /// Reads what comes next without handing it on.
    fn look_ahead(&mut self, most: usize) {
        let is_sample = |event: &LogEvent| matches!(event, LogEvent::Sample(_));
        let mut samples = self.ahead.iter().filter(|(_, event)| is_sample(event)).count();
        while samples < most && self.failed.is_none() {
            match self.next_of_logs() {
                Ok(Some((log, event))) => {
                    samples += usize::from(is_sample(&event));
                    self.ahead.push_back((log, event));
                }
                Ok(None) => break,
                Err(failed) => self.failed = Some(failed),
            }
        }
    }

    /// What was read ahead, joints in the arm's order; `None` if they are not the arm's.
    fn touches_ahead(&self, arm: &Arm) -> Option<Vec<RecordedTouch>> {
        let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
        let mut touches: Vec<RecordedTouch> = Vec::new();
        let mut order = None;
        for (_, event) in &self.ahead {
            match event {
                LogEvent::TouchStarts { joint_names, .. } => {
                    let names = joint_names.as_ref().map(|names| reorder(&joints, names));
                    order = names.transpose().ok()?;
                    touches.push(RecordedTouch::default());
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

    /// The next event of the logs, and which log it is of.
    fn next_of_logs(&mut self) -> Result<Option<(usize, LogEvent)>, (usize, LogError)> {
        while let Some((_, log)) = self.logs.get_mut(self.reading) {
            match log.next().transpose() {
                Ok(None) => self.reading += 1,
                Ok(Some(event)) => return Ok(Some((self.reading, event))),
                Err(error) => return Err((self.reading, error)),
            }
        }
        Ok(None)
    }

    /// The same touches for an arm: joints in its order, and parted where it pauses in this box,
    /// if the settings say so.
    pub fn for_arm(
        mut self,
        arm: &Arc<Arm>,
        settings: &LogSettings,
        place: (Lattice, ContactConfig),
    ) -> Result<Self, WorkError> {
        self.joints = arm.robot.joint_names().map(str::to_owned).collect();
        let parted = settings.pauses();
        self.pauses = parted.map(|config| Pauses::new(arm, place, config)).transpose()?;
        self.checked.1 = settings.strict.unwrap_or_default();
        Ok(self)
    }

    /// Looks for what is wrong with the touches; `set` is what their torques are said to be.
    pub fn check(
        &self,
        arm: &Arc<Arm>,
        place: (Lattice, ContactConfig),
        set: &ExternalTorqueConfig,
    ) -> LogCheck {
        LogCheck::new(arm, place, set, self.checked)
    }

    /// Whether any log says that its torques are external ones.
    pub fn are_external(&self) -> bool {
        self.logs.iter().any(|log| is_external(&log))
    }

    /// The joints of the touch that was started last, if the log names them; from now on, all
    /// touches have theirs in this order.
    pub fn keep_joints(&mut self) -> Option<Vec<String>> {
        if self.joints.is_empty() {
            self.joints = self.named.clone().unwrap_or_default();
        }
        self.named.is_some().then(|| self.joints.clone())
    }

    /// Samples in all logs, if they know.
    pub fn samples(&self) -> Option<u64> {
        self.logs.iter().map(|(_, log)| log.describe().samples).sum()
    }

    /// The next event, `None` at the end.
    pub fn advance(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        self.peek()?;
        let event = self.next.pop_front();
        match &event {
            Some(TouchEvent::Touch(name)) => (self.touch, self.sample) = (Some(name.clone()), 0),
            Some(TouchEvent::Sample(_)) => self.sample += 1,
            None => {}
        }
        Ok(event)
    }

    /// The event that [`Self::advance`] gives next.
    fn peek(&mut self) -> Result<Option<&TouchEvent>, WorkError> {
        while self.next.is_empty() {
            let (event, pauses) = (self.read_on()?, &mut self.pauses);
            match (event, pauses) {
                (Some(event), None) => self.next.push_back(event),
                (Some(event), Some(pauses)) => {
                    let taken = pauses.take(event, &mut self.next);
                    // What pauses hold back was read, and not handed on yet.
                    taken.map_err(|error| {
                        let (touch, samples) = &self.read;
                        let sample = samples.saturating_sub(1);
                        let place = format!("touch `{touch}`, sample {sample} (from 0)");
                        WorkError::touch(self.log(), place, error)
                    })?;
                }
                (None, pauses) => {
                    if let Some(pauses) = pauses {
                        pauses.finish(&mut self.next);
                    }
                    break;
                }
            }
        }
        Ok(self.next.front())
    }

    /// What the logs say next.
    fn read_on(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        let next = match (self.ahead.pop_front(), self.failed.take()) {
            (Some(next), failed) => {
                self.failed = failed;
                Ok(Some(next))
            }
            (None, Some(failed)) => Err(failed),
            (None, None) => self.next_of_logs(),
        };
        match next {
            Ok(None) => Ok(None),
            Err((log, error)) => {
                self.current = log;
                Err(error.into())
            }
            Ok(Some((log, LogEvent::TouchStarts { name, joint_names }))) => {
                self.current = log;
                self.named.clone_from(&joint_names);
                self.read = (name.clone(), 0);
                let names = joint_names.filter(|_| !self.joints.is_empty());
                let order = names.map(|names| reorder(&self.joints, &names)).transpose();
                self.permutation = order.map_err(|error| {
                    format!("`{}`: touch `{name}`: {error}", self.log().display())
                })?;
                Ok(Some(TouchEvent::Touch(name)))
            }
            Ok(Some((log, LogEvent::Sample(mut sample)))) => {
                self.current = log;
                self.read.1 += 1;
                if let Some(order) = &self.permutation {
                    reorder_joints(&mut sample, order);
                }
                Ok(Some(TouchEvent::Sample(sample)))
            }
        }
    }

    /// Reads all touches, or the first so many.
    pub fn read(&mut self, most: Option<u32>) -> Result<Vec<RecordedTouch>, WorkError> {
        let mut touches = Vec::new();
        self.read_into(&mut touches, most)?;
        Ok(touches)
    }

    /// Reads all touches, or the first so many; what was read before an error stays in `touches`.
    pub fn read_into(
        &mut self,
        touches: &mut Vec<RecordedTouch>,
        most: Option<u32>,
    ) -> Result<(), WorkError> {
        let most = most.map_or(usize::MAX, |most| most as usize);
        let mut bytes = 0;
        while touches.len() < most
            && let Some(TouchEvent::Touch(name)) = self.advance()?
        {
            touches.push(self.begun(&name));
            while matches!(self.peek()?, Some(TouchEvent::Sample(_)))
                && let Some(TouchEvent::Sample(sample)) = self.advance()?
            {
                // Both vectors are allocations of their own.
                bytes += size_of::<Sample>() + 8 * (sample.q.len() + sample.tau.len()) + 32;
                if bytes as u64 > input::largest() {
                    let (log, place) = (self.log().display(), self.place());
                    let too_large = input::too_large();
                    return Err(format!("`{log}`: {place}: all touches want {too_large}").into());
                }
                touches.last_mut().expect("pushed above").samples.push(sample);
            }
        }
        Ok(())
    }

    /// The touch that was started last, without its samples.
    pub(crate) fn begun(&self, name: &str) -> RecordedTouch {
        RecordedTouch {
            log: self.log().to_owned(),
            name: name.to_owned(),
            joint_names: self.joint_names(),
            samples: Vec::new(),
        }
    }

    /// The joints of the samples of the touch that was started last, if the log names them.
    fn joint_names(&self) -> Option<Vec<String>> {
        if self.permutation.is_some() { Some(self.joints.clone()) } else { self.named.clone() }
    }

    /// The log of the touch that was started last.
    pub fn log(&self) -> &Path {
        let last = self.logs.len().saturating_sub(1);
        &self.logs[self.current.min(last)].0
    }

    /// Where the reading stands.
    pub fn place(&self) -> String {
        match (&self.touch, self.sample) {
            (None, _) => "before the first touch".to_owned(),
            (Some(touch), 0) => format!("touch `{touch}`"),
            (Some(touch), sample) => format!("touch `{touch}`, sample {} (from 0)", sample - 1),
        }
    }

    /// An error of what was read last.
    pub fn fault(&self, source: impl Into<MapperError>) -> WorkError {
        WorkError::touch(self.log(), self.place(), source)
    }

    /// What the first of the logs says of itself; there is at least one.
    pub fn describe(&self) -> LogDescription {
        self.logs[0].1.describe()
    }

    /// What looked odd in the logs so far.
    pub fn warnings(&self) -> impl Iterator<Item = &LogWarning> {
        self.logs.iter().flat_map(|(_, log)| log.warnings())
    }

    /// Tells what looked odd in the logs.
    pub fn tell_warnings(&self, progress: &dyn Progress) {
        for (path, log) in &self.logs {
            for warning in log.warnings() {
                progress.warn(&format!("`{}`: {warning}", path.display()));
            }
        }
        let left_out = self.pauses.as_ref().map_or(0, Pauses::left_out);
        if left_out > 0 {
            progress.warn(&format!(
                "{left_out} samples were left out: the arm moved in them before it had stood still"
            ));
        }
    }
}

/// Whether a log says that its torques are external ones.
fn is_external((_, log): &&(PathBuf, Box<dyn Log>)) -> bool {
    log.describe().torques == LoggedTorques::External
}

#[cfg(test)]
mod tests {
    use palpate::Sample;

    use super::*;
    use crate::settings::Settings;
    use crate::settings::sections::RobotSettings;

    #[test]
    fn a_sample_held_back_for_a_pause_is_named_as_in_its_log() {
        let robot = RobotSettings { no_cache: Some(true), ..RobotSettings::default() };
        let arm = Arc::new(crate::robot::load_with_report(&robot).unwrap().arm);
        let sample = |joints: usize| Sample::new(None, vec![0.0; joints], vec![0.0; joints]);
        let samples = vec![sample(7), sample(7), sample(6)];
        let touch = RecordedTouch { name: "push".to_owned(), samples, ..RecordedTouch::default() };
        let config = Settings::default().config().unwrap();
        let place = (config.lattice, config.contact);
        let settings = LogSettings { split_idle: Some(true), ..LogSettings::default() };
        let touches = Touches::held("day.csv", vec![touch]);
        let mut touches = touches.for_arm(&arm, &settings, place).unwrap();
        let error = touches.advance().err().unwrap().to_string();
        assert!(error.starts_with("`day.csv`: touch `push`, sample 2 (from 0): "), "{error}");
    }
}
