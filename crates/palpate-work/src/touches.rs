//! Logs one after another, with their joints in the robot's order.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::{Arm, ContactConfig, Gravity, Lattice, MapperError, Sample};
use palpate_io::log::{
    self, Format, Log, LogDescription, LogError, LogEvent, LogOptions, LogWarning, LoggedTorques,
    reorder,
};

use crate::error::WorkError;
use crate::pauses::Pauses;
use crate::progress::Progress;
use crate::settings::sections::{LogSettings, TouchSettings};

/// What happens next.
pub enum TouchEvent {
    /// A touch of this name starts.
    Touch(String),
    /// The touch goes on.
    Sample(Sample),
}

/// One touch, whole: read from a log, or held by a program.
#[derive(Debug, Clone, Default)]
pub struct RecordedTouch {
    /// The log that it is in; empty if a program holds it.
    pub log: PathBuf,
    /// Its name.
    pub name: String,
    /// Names of the joints in the order of the samples, if they are known.
    pub joint_names: Option<Vec<String>>,
    /// Its samples in order.
    pub samples: Vec<Sample>,
}

impl RecordedTouch {
    /// An error at a place of this touch.
    pub fn fault(&self, place: String, source: MapperError) -> WorkError {
        WorkError::Touch { log: self.log.clone(), place, source: Box::new(source) }
    }
}

/// Puts the joints of a sample into another order.
pub(crate) fn reorder_joints(sample: &mut Sample, order: &[usize]) {
    for values in [&mut sample.q, &mut sample.tau] {
        *values = order.iter().map(|&place| values[place]).collect();
    }
}

/// Touches that a program holds, read as any log is.
struct MemoryLog {
    touches: VecDeque<RecordedTouch>,
    samples: VecDeque<Sample>,
    /// Touches and samples that there were at the beginning.
    size: (usize, u64),
}

impl Iterator for MemoryLog {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(sample) = self.samples.pop_front() {
            return Some(Ok(LogEvent::Sample(sample)));
        }
        let RecordedTouch { name, joint_names, samples, .. } = self.touches.pop_front()?;
        self.samples = samples.into();
        Some(Ok(LogEvent::TouchStarts { name, joint_names }))
    }
}

impl Log for MemoryLog {
    fn describe(&self) -> LogDescription {
        let (touches, samples) = self.size;
        LogDescription {
            path: PathBuf::new(),
            format: Format::Memory,
            touches: Some(touches),
            samples: Some(samples),
            joints: None,
            torques: LoggedTorques::Unsaid,
        }
    }

    fn warnings(&self) -> &[LogWarning] {
        &[]
    }
}

/// Logs that are read as one.
pub struct Touches {
    logs: Vec<(PathBuf, Box<dyn Log>)>,
    current: usize,
    joints: Vec<String>,
    permutation: Option<Vec<usize>>,
    /// Joints of the touch that was started last, as the log names them.
    named: Option<Vec<String>>,
    /// Parts touches at pauses, if that was asked for, and what it has made of them.
    pauses: Option<Pauses>,
    next: VecDeque<TouchEvent>,
    touch: Option<String>,
    sample: u64,
}

impl Touches {
    /// Opens all logs, so that most defects show before any work is done.
    pub fn open(paths: &[PathBuf], options: &LogOptions) -> Result<Self, WorkError> {
        let open = |path: &PathBuf| Ok((path.clone(), log::open(path, options)?));
        let logs = paths.iter().map(open).collect::<Result<Vec<_>, WorkError>>()?;
        Ok(Self { logs, ..Self::empty() })
    }

    /// Touches that a program holds, after each other, which errors call by this name.
    pub fn held(name: &str, touches: Vec<RecordedTouch>) -> Self {
        let samples = touches.iter().map(|touch| touch.samples.len() as u64).sum();
        let count = touches.len();
        let log =
            MemoryLog { touches: touches.into(), samples: VecDeque::new(), size: (count, samples) };
        Self { logs: vec![(PathBuf::from(name), Box::new(log))], ..Self::empty() }
    }

    fn empty() -> Self {
        Self {
            logs: Vec::new(),
            current: 0,
            joints: Vec::new(),
            permutation: None,
            named: None,
            pauses: None,
            next: VecDeque::new(),
            touch: None,
            sample: 0,
        }
    }

    /// These touches, then those of others.
    ///
    /// Only logs that were not read from yet may be joined.
    #[must_use]
    pub fn then(mut self, other: Self) -> Self {
        self.logs.extend(other.logs);
        self
    }

    /// Takes from the logs what the settings leave open: torques that are external ones hold no
    /// gravity.
    pub fn gravity_of_logs(
        &self,
        settings: &mut TouchSettings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let external = |log: &dyn Log| log.describe().torques == LoggedTorques::External;
        let Some((path, _)) = self.logs.iter().find(|(_, log)| external(log.as_ref())) else {
            return Ok(());
        };
        let path = path.display();
        match settings.gravity {
            Some(Gravity::Removed) => return Ok(()),
            Some(Gravity::Included) => {
                return Err(WorkError::Usage(format!(
                    "`{path}` holds external torques, out of which the robot has taken gravity; \
                     say --gravity removed, or leave it out"
                )));
            }
            None => {}
        }
        if !self.logs.iter().all(|(_, log)| external(log.as_ref())) {
            return Err(WorkError::Usage(format!(
                "`{path}` holds external torques, without gravity, and other logs do not say so; \
                 give --gravity if it holds for all, or read them one after the other"
            )));
        }
        progress.note(&format!("`{path}` holds external torques: gravity is not taken off them"));
        settings.gravity = Some(Gravity::Removed);
        Ok(())
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
        Ok(self)
    }

    /// Whether any log says that its torques are external ones.
    pub fn are_external(&self) -> bool {
        let mut logs = self.logs.iter();
        logs.any(|(_, log)| log.describe().torques == LoggedTorques::External)
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

    /// The next moment, `None` at the end.
    pub fn advance(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        while self.next.is_empty() {
            let (moment, pauses) = (self.read_on()?, &mut self.pauses);
            match (moment, pauses) {
                (Some(moment), None) => self.next.push_back(moment),
                (Some(moment), Some(pauses)) => {
                    let taken = pauses.take(moment, &mut self.next);
                    taken.map_err(|error| self.fault(error))?;
                }
                (None, Some(pauses)) => {
                    pauses.finish(&mut self.next);
                    if self.next.is_empty() {
                        return Ok(None);
                    }
                }
                (None, None) => return Ok(None),
            }
        }
        let moment = self.next.pop_front();
        match &moment {
            Some(TouchEvent::Touch(name)) => (self.touch, self.sample) = (Some(name.clone()), 0),
            Some(TouchEvent::Sample(_)) => self.sample += 1,
            None => {}
        }
        Ok(moment)
    }

    /// What the logs say next.
    fn read_on(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        while let Some((path, log)) = self.logs.get_mut(self.current) {
            match log.next().transpose()? {
                None => self.current += 1,
                Some(LogEvent::TouchStarts { name, joint_names }) => {
                    self.named.clone_from(&joint_names);
                    self.permutation = match joint_names {
                        Some(names) if !self.joints.is_empty() => {
                            let order = reorder(&self.joints, &names);
                            let at = path.display();
                            Some(
                                order
                                    .map_err(|error| format!("`{at}`: touch `{name}`: {error}"))?,
                            )
                        }
                        _ => None,
                    };
                    return Ok(Some(TouchEvent::Touch(name)));
                }
                Some(LogEvent::Sample(mut sample)) => {
                    if let Some(order) = &self.permutation {
                        reorder_joints(&mut sample, order);
                    }
                    return Ok(Some(TouchEvent::Sample(sample)));
                }
            }
        }
        Ok(None)
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
        while let Some(moment) = self.advance()? {
            match moment {
                TouchEvent::Touch(_) if touches.len() == most => break,
                TouchEvent::Touch(name) => {
                    let (log, joint_names) = (self.log().to_owned(), self.joint_names());
                    touches.push(RecordedTouch { log, name, joint_names, samples: Vec::new() });
                }
                TouchEvent::Sample(sample) => {
                    let touch = touches.last_mut();
                    touch.expect("samples come after the start of a touch").samples.push(sample);
                }
            }
        }
        Ok(())
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
        let (log, place) = (self.log().to_owned(), self.place());
        WorkError::Touch { log, place, source: Box::new(source.into()) }
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
