//! Logs one after another, with their joints in the robot's order.
//!
//! | file                  | content                                                                         |
//! |-----------------------|---------------------------------------------------------------------------------|
//! | `logs`                | the events of the logs, which can be read ahead                                 |
//! | `as_logged`           | checks of logs before their torques become external torques                     |
//! | `identified`          | external torques of an identified arm                                           |
//! | `conventions_of_logs` | missing joints and torque conventions, found from the logs before they are used |

mod as_logged;
mod conventions_of_logs;
mod identified;
mod logs;
mod recorded;

use std::collections::{HashSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::{Arm, ContactConfig, ExternalTorqueConfig, Lattice, MapperError, Sample, TorqueSign};
use palpate_io::input;
use palpate_io::log::{
    self, AngleUnit, Log, LogDescription, LogEvent, LogOptions, LogWarning, LoggedTorques,
    TimeUnit, reorder,
};

use crate::error::WorkError;
use crate::inspect::log::LogCheck;
use crate::pauses::Pauses;
use crate::progress::Progress;
use crate::settings::Settings;
use crate::settings::sections::LogSettings;
use identified::ExternalReader;
use logs::Logs;
use recorded::MemoryLog;

pub use conventions_of_logs::IfUndecided;
pub(crate) use recorded::reorder_joints;
pub use recorded::{RecordedTouch, TouchEvent};

/// Logs that are read as one.
#[derive(Default)]
pub struct Touches {
    logs: Logs,
    /// The log of the event that was handed on last.
    current: usize,
    joints: Vec<String>,
    permutation: Option<Vec<usize>>,
    /// The arm for which the logs are read, and its joint positions in the previous sample, rad or m.
    arm: Option<Arc<Arm>>,
    before: Option<Vec<f64>>,
    /// Joints of the touch that was started last, as the log names them.
    named: Option<Vec<String>>,
    /// Name of the touch that is being read, and how many of its samples were read.
    read: (String, u64),
    /// Splits touches at pauses, if that was asked for.
    pauses: Option<Pauses>,
    /// Events to be handed on.
    next: VecDeque<TouchEvent>,
    /// Name of the touch that was handed on last, and how many of its samples were handed on.
    touch: Option<String>,
    sample: u64,
    /// Whether torques are motor currents, whatever the names of their columns.
    currents: bool,
    /// Turns torques into external torques, if the arm was identified.
    identified: Option<ExternalReader>,
    /// Given unit of angles (default: rad), and whether it is an error if a log looks wrong.
    checked: (AngleUnit, bool),
    /// Codes of the findings that were reported already.
    reported: HashSet<&'static str>,
    /// Number of the first log whose unit of times was not noted yet.
    clocks_noted: usize,
}

impl Touches {
    /// Opens all logs, so that most defects show before any work is done.
    ///
    /// # Errors
    ///
    /// If a log cannot be opened or is given twice.
    pub fn open(paths: &[PathBuf], options: &LogOptions) -> Result<Self, WorkError> {
        let mut given = HashSet::new();
        let mut is_new =
            |path: &&PathBuf| path.canonicalize().map_or(true, |real| given.insert(real));
        if let Some(again) = paths.iter().find(|path| !is_new(path)) {
            let log = again.display();
            return Err(WorkError::Usage(format!(
                "`{log}` is given twice among the logs; its touches may count once only"
            )));
        }
        let open = |path: &PathBuf| Ok((path.clone(), log::open(path, options)?));
        let logs = paths.iter().map(open).collect::<Result<Vec<_>, WorkError>>()?;
        let logs = Logs::new(logs, Some(options));
        let checked = (options.angle_unit.unwrap_or_default(), false);
        Ok(Self { logs, checked, ..Self::default() })
    }

    /// Touches in memory, read one after another like a log; `name` is the name of the log in errors.
    pub fn in_memory(name: &str, touches: Vec<RecordedTouch>) -> Self {
        let log = Box::new(MemoryLog::new(touches));
        Self { logs: Logs::new(vec![(PathBuf::from(name), log)], None), ..Self::default() }
    }

    /// These touches, followed by those of `other`.
    ///
    /// Only logs that were not read from yet may be joined.
    #[must_use]
    pub fn then(mut self, other: Self) -> Self {
        self.logs.join(other.logs);
        self
    }

    /// The touches for an arm: joints in its order, without whole turns that sensors add, and split at pauses if the
    /// settings say so. `lattice` is the one whose points count as contacts at pauses.
    pub fn for_arm(
        mut self,
        arm: &Arc<Arm>,
        settings: &LogSettings,
        lattice: Lattice,
    ) -> Result<Self, WorkError> {
        self.reorder_to(arm);
        self.arm = Some(arm.clone());
        let parted = settings.pauses();
        self.pauses = parted.map(|config| Pauses::new(arm, lattice, config)).transpose()?;
        self.checked.1 = settings.strict.unwrap_or_default();
        Ok(self)
    }

    /// A check for what looks wrong with the touches; `set` is the convention of their torques.
    pub fn check(
        &self,
        arm: &Arc<Arm>,
        place: (Lattice, ContactConfig),
        set: &ExternalTorqueConfig,
    ) -> LogCheck {
        LogCheck::new(arm, place, set, self.checked).without_reported(&self.reported)
    }

    /// Whether the torques of any log are external torques, by its type of message or the names of its columns.
    pub fn are_external(&self) -> bool {
        self.logs.all().any(|log| external(log).is_some())
    }

    /// Whether the torques of any log are motor currents, by the names of their columns or because
    /// [`Self::treat_as_currents`] was called.
    pub fn are_currents(&self) -> bool {
        self.currents || self.logs.all().any(|log| is_of_currents(&log))
    }

    /// Takes the torques of all logs for motor currents.
    pub fn treat_as_currents(&mut self) {
        self.currents = true;
    }

    /// Puts joints into the arm's order, if the logs name them, and leaves out others.
    pub fn reorder_to(&mut self, arm: &Arm) {
        self.joints = arm.robot.joint_names().map(str::to_owned).collect();
    }

    /// Whether there is any log.
    pub(crate) fn has_logs(&self) -> bool {
        self.logs.all().next().is_some()
    }

    /// The joints of the touch that was started last, if the log names them; from now on, all touches are read in this
    /// order of joints.
    pub fn keep_joints(&mut self) -> Option<Vec<String>> {
        if self.joints.is_empty() {
            self.joints = self.named.clone().unwrap_or_default();
        }
        self.named.is_some().then(|| self.joints.clone())
    }

    /// Number of samples in all logs, if known.
    pub fn samples(&self) -> Option<u64> {
        self.logs.all().map(|(_, log)| log.describe().samples).sum()
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
            let (event, pauses) = (self.read_external()?, &mut self.pauses);
            match (event, pauses) {
                (Some(event), None) => self.next.push_back(event),
                (Some(event), Some(pauses)) => {
                    let taken = pauses.take(event, &mut self.next);
                    // `read` has the sample that failed; those handed on are earlier, since pauses hold samples back.
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

    /// The next event of the logs, with joints in order and without whole turns.
    fn read_on(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        match self.logs.next() {
            Ok(None) => Ok(None),
            Err((log, error)) => {
                self.current = log;
                Err(error.into())
            }
            Ok(Some((log, LogEvent::TouchStarts { name, joint_names }))) => {
                self.current = log;
                self.named.clone_from(&joint_names);
                self.read = (name.clone(), 0);
                self.before = None;
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
                // A sample of another robot is refused where it is used.
                let arm = self.arm.as_ref();
                if let Some(arm) = arm.filter(|arm| arm.robot.n_joints() == sample.q.len()) {
                    arm.robot.unwrap_angles(self.before.as_deref(), &mut sample.q);
                    self.before = Some(sample.q.clone());
                }
                Ok(Some(TouchEvent::Sample(sample)))
            }
        }
    }

    /// Reads all touches for an arm, and warns of what looked odd in the logs.
    ///
    /// # Errors
    ///
    /// If a log is broken or does not fit this arm.
    pub fn read_for(
        self,
        arm: &Arc<Arm>,
        settings: &Settings,
        progress: &dyn Progress,
    ) -> Result<Vec<RecordedTouch>, WorkError> {
        let config = settings.config()?;
        let mut touches = self.for_arm(arm, &settings.log, config.lattice)?;
        let recorded = touches.read(None)?;
        touches.report_warnings(progress);
        Ok(recorded)
    }

    /// As [`Self::read_for`], for all touches or the first `most`, and warns of what looks wrong with them.
    ///
    /// # Errors
    ///
    /// As there, or if something looks wrong and the settings are `strict`.
    pub fn read_to_learn(
        self,
        arm: &Arc<Arm>,
        settings: &Settings,
        most: Option<u32>,
        progress: &dyn Progress,
    ) -> Result<Vec<RecordedTouch>, WorkError> {
        let config = settings.config()?;
        let place = (config.lattice, config.contact);
        let mut touches = self.for_arm(arm, &settings.log, place.0.clone())?;
        let recorded = touches.read(most)?;
        touches.report_warnings(progress);
        touches.check(arm, place, &config.touch).of(&recorded).check(progress)?;
        Ok(recorded)
    }

    /// Reads all touches, or the first `most`.
    pub fn read(&mut self, most: Option<u32>) -> Result<Vec<RecordedTouch>, WorkError> {
        let mut touches = Vec::new();
        self.read_into(&mut touches, most)?;
        Ok(touches)
    }

    /// Reads all touches, or the first `most`; what was read before an error stays in `touches`.
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
                bytes += bytes_of(&sample);
                if bytes as u64 > input::largest() {
                    let (log, place) = (self.log().display(), self.place());
                    let too_large = input::too_large();
                    return Err(
                        format!("`{log}`: {place}: all touches together need {too_large}").into()
                    );
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
        self.logs.path(self.current)
    }

    /// The touch and sample that were handed on last, in words.
    pub fn place(&self) -> String {
        match (&self.touch, self.sample) {
            (None, _) => "before the first touch".to_owned(),
            (Some(touch), 0) => format!("touch `{touch}`"),
            (Some(touch), sample) => format!("touch `{touch}`, sample {} (from 0)", sample - 1),
        }
    }

    /// An error at the sample that was handed on last.
    pub fn fault(&self, source: impl Into<MapperError>) -> WorkError {
        WorkError::touch(self.log(), self.place(), source)
    }

    /// Description of the first log; there must be at least one.
    pub fn describe(&self) -> LogDescription {
        self.logs.all().next().expect("there is at least one").1.describe()
    }

    /// What looked odd in the logs so far.
    pub fn warnings(&self) -> impl Iterator<Item = &LogWarning> {
        self.logs.all().flat_map(|(_, log)| log.warnings())
    }

    /// The logs of whose times the unit was found so far, with this unit.
    pub(crate) fn found_time_units(&self) -> impl Iterator<Item = (&Path, TimeUnit)> {
        self.logs.all().filter_map(|(path, log)| Some((&**path, log.found_time_unit()?)))
    }

    /// The same logs, whose units of times were noted when they were opened before.
    #[must_use]
    pub fn with_noted_time_units(self) -> Self {
        Self { clocks_noted: usize::MAX, ..self }
    }

    /// Notes the unit of times that was found in the logs that were begun, once for each.
    fn note_time_units(&mut self, progress: &dyn Progress) {
        let begun = self.logs.begun();
        for (path, log) in self.logs.all().take(begun).skip(self.clocks_noted) {
            if let Some(unit) = log.found_time_unit() {
                let path = path.display();
                progress.note(&format!("times of `{path}` are read as {unit} (--time-unit)"));
            }
        }
        self.clocks_noted = self.clocks_noted.max(begun);
    }

    /// Warns of what looked odd in the logs.
    pub fn report_warnings(&mut self, progress: &dyn Progress) {
        self.note_time_units(progress);
        for (path, log) in self.logs.all() {
            for warning in log.warnings() {
                progress.warn(&format!("`{}`: {warning}", path.display()));
            }
        }
        let left_out = self.pauses.as_ref().map_or(0, Pauses::left_out);
        if left_out > 0 {
            progress.warn(&format!(
                "{left_out} samples were left out: in them, the arm moves and has not stood still before"
            ));
        }
    }
}

/// Size of a sample in memory, with the allocations of its vectors, bytes.
fn bytes_of(sample: &Sample) -> usize {
    let std = sample.tau_std.as_ref().map_or(0, |std| std.len() + 2);
    size_of::<Sample>() + 8 * (sample.q.len() + sample.tau.len() + std) + 32
}

/// Message and remedy for logs of motor currents.
pub(crate) const CURRENTS: [&str; 2] = [
    "by their names, these are motor currents; to become torques, they need a gain for each joint",
    "`palpate identify` finds the gains from free motion, and --arm reads the file that it writes; if they are torques, \
     name their columns in the setting columns (--columns), or call their array torques.npy",
];

/// Whether the torques of a log are motor currents, by the names of its columns or arrays.
fn is_of_currents((_, log): &&(PathBuf, Box<dyn Log>)) -> bool {
    log.describe().torques == LoggedTorques::Currents
}

/// For a log of external torques, by its type of message or the names of its columns: their sign, if the maker's
/// convention is known.
fn external((_, log): &(PathBuf, Box<dyn Log>)) -> Option<Option<TorqueSign>> {
    match log.describe().torques {
        LoggedTorques::External(sign) => Some(sign),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use palpate::Sample;

    use super::*;
    use crate::settings::sections::RobotSettings;

    #[test]
    fn a_sample_held_back_for_a_pause_is_named_as_in_its_log() {
        let robot = RobotSettings { no_cache: Some(true), ..RobotSettings::default() };
        let arm = Arc::new(crate::robot::load_with_report(&robot).unwrap().arm);
        let sample = |joints: usize| Sample::new(None, vec![0.0; joints], vec![0.0; joints]);
        let samples = vec![sample(7), sample(7), sample(6)];
        let touch = RecordedTouch { name: "push".to_owned(), samples, ..RecordedTouch::default() };
        let config = Settings::default().config().unwrap();
        let settings = LogSettings { split_idle: Some(true), ..LogSettings::default() };
        let touches = Touches::in_memory("day.csv", vec![touch]);
        let mut touches = touches.for_arm(&arm, &settings, config.lattice).unwrap();
        let error = touches.advance().err().unwrap().to_string();
        assert!(error.starts_with("`day.csv`: touch `push`, sample 2 (from 0): "), "{error}");
    }
}
