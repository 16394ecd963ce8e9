//! Logs one after another, with their joints in the robot's order.

use std::path::{Path, PathBuf};

use palpate::mapper::MapperError;
use palpate::touch::Sample;
use palpate_io::log::{self, Log, LogEvent, LogOptions, LogWarning, reorder};

use crate::error::CliError;
use crate::output::Output;

/// What happens next.
pub(crate) enum Moment {
    /// A touch of this name starts.
    Touch(String),
    /// The touch goes on.
    Sample(Sample),
}

/// One touch of a log, whole.
pub(crate) struct Recorded {
    /// The log that it is in.
    pub log: PathBuf,
    /// Its name.
    pub name: String,
    /// Its samples in order.
    pub samples: Vec<Sample>,
}

impl Recorded {
    /// An error at a place of this touch.
    pub(crate) fn fault(&self, place: String, source: MapperError) -> CliError {
        CliError::Touch { log: self.log.clone(), place, source: Box::new(source) }
    }
}

/// Logs that are read as one.
pub(crate) struct Touches {
    logs: Vec<(PathBuf, Box<dyn Log>)>,
    current: usize,
    joints: Vec<String>,
    permutation: Option<Vec<usize>>,
    touch: Option<String>,
    sample: u64,
}

impl Touches {
    /// Opens all logs, so that most defects show before any work is done.
    pub(crate) fn open(paths: &[PathBuf], options: &LogOptions) -> Result<Self, CliError> {
        let open = |path: &PathBuf| Ok((path.clone(), log::open(path, options)?));
        let logs = paths.iter().map(open).collect::<Result<Vec<_>, CliError>>()?;
        let (joints, permutation, touch) = (Vec::new(), None, None);
        Ok(Self { logs, current: 0, joints, permutation, touch, sample: 0 })
    }

    /// The same touches for a robot whose joints, by name, are these.
    pub(crate) fn for_joints<'a>(mut self, names: impl Iterator<Item = &'a str>) -> Self {
        self.joints = names.map(str::to_owned).collect();
        self
    }

    /// Samples in all logs, if they know.
    pub(crate) fn samples(&self) -> Option<u64> {
        self.logs.iter().map(|(_, log)| log.describe().samples).sum()
    }

    /// The next moment, `None` at the end.
    pub(crate) fn advance(&mut self) -> Result<Option<Moment>, CliError> {
        while let Some((path, log)) = self.logs.get_mut(self.current) {
            match log.next().transpose()? {
                None => self.current += 1,
                Some(LogEvent::TouchStarts { name, joint_names }) => {
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
                    (self.touch, self.sample) = (Some(name.clone()), 0);
                    return Ok(Some(Moment::Touch(name)));
                }
                Some(LogEvent::Sample(mut sample)) => {
                    if let Some(order) = &self.permutation {
                        sample.q = order.iter().map(|&place| sample.q[place]).collect();
                        sample.tau = order.iter().map(|&place| sample.tau[place]).collect();
                    }
                    self.sample += 1;
                    return Ok(Some(Moment::Sample(sample)));
                }
            }
        }
        Ok(None)
    }

    /// Reads all touches, or the first so many.
    pub(crate) fn read(&mut self, most: Option<u32>) -> Result<Vec<Recorded>, CliError> {
        let most = most.map_or(usize::MAX, |most| most as usize);
        let mut touches: Vec<Recorded> = Vec::new();
        while let Some(moment) = self.advance()? {
            match moment {
                Moment::Touch(_) if touches.len() == most => break,
                Moment::Touch(name) => {
                    let log = self.log().to_owned();
                    touches.push(Recorded { log, name, samples: Vec::new() });
                }
                Moment::Sample(sample) => {
                    let touch = touches.last_mut();
                    touch.expect("samples come after the start of a touch").samples.push(sample);
                }
            }
        }
        Ok(touches)
    }

    /// The log of the touch that was started last.
    pub(crate) fn log(&self) -> &Path {
        let last = self.logs.len().saturating_sub(1);
        &self.logs[self.current.min(last)].0
    }

    /// Where the reading stands.
    pub(crate) fn place(&self) -> String {
        match (&self.touch, self.sample) {
            (None, _) => "before the first touch".to_owned(),
            (Some(touch), 0) => format!("touch `{touch}`"),
            (Some(touch), sample) => format!("touch `{touch}`, sample {} (from 0)", sample - 1),
        }
    }

    /// An error of what was read last.
    pub(crate) fn fault(&self, source: impl Into<MapperError>) -> CliError {
        let (log, place) = (self.log().to_owned(), self.place());
        CliError::Touch { log, place, source: Box::new(source.into()) }
    }

    /// Tells what looked odd in the logs.
    pub(crate) fn tell_warnings(&self, output: &Output) {
        for (path, log) in &self.logs {
            for warning in log.warnings() {
                output.note(&format!("`{}`: {}", path.display(), describe(warning)));
            }
        }
    }
}

fn describe(warning: &LogWarning) -> String {
    match warning {
        LogWarning::TimeNotIncreasing { touch, row, before_s, now_s, count } => format!(
            "touch `{touch}`: the clock goes from {before_s} s to {now_s} s in row {row} (from \
             0), and does not advance {count} times in all; the order of the rows was believed"
        ),
        other => format!("{other:?}"),
    }
}
