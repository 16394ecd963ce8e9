//! Touches in bags of ROS 2: joint states on a topic, and what parts them into touches.
//!
//! | file      | says                                                        |
//! |-----------|-------------------------------------------------------------|
//! | `file`    | which files make up a bag, and how each is stored           |
//! | `mcap`    | MCAP: its topics and messages                               |
//! | `sqlite`  | SQLite: the same                                            |
//! | `topic`   | which topics are read                                       |
//! | `layout`  | fields of a message, by its definition                      |
//! | `reading` | messages to samples: what is known of single types          |
//! | `write`   | joint states and stiff points as MCAP                       |
//!
//! A bag is one touch, unless messages on another topic say where touches start. Messages come in
//! the order in which they were recorded; time is that of their headers, or of the recording where
//! the headers have none. Chunks and pages stream: memory does not grow with the bag.

mod file;
mod layout;
mod mcap;
mod reading;
mod sqlite;
mod topic;
pub mod write;

use std::collections::{HashMap, VecDeque};
use std::path::{Path, PathBuf};

use super::{Clock, Log, LogDescription, LogError, LogEvent, LogOptions, LogWarning};
use file::Messages;
use reading::{Joints, Marker, Reading};
use topic::{Chosen, Topic};

pub(super) use file::is_bag;

/// So many messages are looked at to learn which joints a bag holds.
const LOOKED_AT: usize = 100;

/// What can be wrong with a bag.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum BagError {
    /// A file that cannot be read as a bag.
    #[error("`{path}` {reason}")]
    Storage { path: PathBuf, reason: String },
    /// A topic that is not there, or not the only one.
    #[error("`{path}`: {reason}. Its topics are {topics}. Name the one to read with --topic")]
    Topic { path: PathBuf, reason: String, topics: String },
    /// Messages whose type cannot be followed.
    #[error("`{path}`: topic `{topic}` holds messages of `{kind}`, but {reason}")]
    Layout { path: PathBuf, topic: String, kind: String, reason: String },
    /// A message that cannot be used.
    #[error("`{path}`: message {message} (from 0) of topic `{topic}`: {reason}")]
    Message { path: PathBuf, topic: String, message: u64, reason: String },
    /// A bag that breaks off.
    #[error(
        "`{path}` breaks off after {messages} messages of topic `{topic}` and {seconds:.1} s: \
         {reason}. What lies before can be read (--until-break)"
    )]
    Broken { path: PathBuf, topic: String, messages: u64, seconds: f64, reason: String },
}

/// Of which topic a message is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Which {
    Sample,
    Marker,
}

/// A message of one of the topics that are read.
#[derive(Debug, Clone)]
struct Message {
    which: Which,
    /// When it was recorded.
    time_ns: i64,
    data: Vec<u8>,
}

/// A bag being read.
pub(super) struct BagLog {
    description: LogDescription,
    options: LogOptions,
    chosen: Chosen,
    reading: Reading,
    marker: Option<Marker>,
    joints: Joints,
    /// Files to come, the last one first.
    ahead: Vec<PathBuf>,
    current: Option<(PathBuf, Messages)>,
    touch: TouchState,
    /// A sample whose touch has just been announced.
    waiting: VecDeque<LogEvent>,
    /// Messages of the samples' topic so far, and what became of those that gave no sample.
    messages: u64,
    other_joints: u64,
    before_touch: u64,
    times_s: Option<[f64; 2]>,
    clock: Clock,
    warnings: Vec<LogWarning>,
}

/// Where the reading of touches stands.
#[derive(Debug, Default)]
struct TouchState {
    /// Name of the touch under way.
    name: Option<String>,
    /// Name of the touch that starts with the next sample.
    next: Option<String>,
    /// How often each name was given.
    given: HashMap<String, u32>,
    markers: u32,
    row: u64,
}

impl TouchState {
    /// A name that no other touch has.
    fn unique(&mut self, name: String) -> String {
        let times = self.given.entry(name.clone()).or_insert(0);
        *times += 1;
        if *times == 1 { name } else { format!("{name}_{times}") }
    }
}

impl BagLog {
    /// Finds topics, definitions and joints, then stands before the first message.
    pub(super) fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let files = file::files(path)?;
        let (mut topics, mut format) = (Vec::new(), None);
        for file in &files {
            let storage = file::storage(file)?;
            format = format.or(Some(storage.format()));
            topic::merge(&mut topics, file::topics(file, storage)?);
        }
        let Some(format) = format else { return Err(LogError::Empty { path: path.to_owned() }) };
        let chosen = topic::choose(path, &topics, options)?;
        let refused = |topic: &Topic, reason: String| BagError::Layout {
            path: path.to_owned(),
            topic: topic.name.clone(),
            kind: topic.kind.clone(),
            reason,
        };
        let reading =
            Reading::of(&chosen.samples).map_err(|reason| refused(&chosen.samples, reason))?;
        let marker = match &chosen.markers {
            Some(topic) => Some(Marker::of(topic).map_err(|reason| refused(topic, reason))?),
            None => None,
        };
        let joints = reading.joints(&first_messages(&files, &chosen), options.joints.as_deref());
        let markers = chosen.markers.as_ref().and_then(|topic| topic.messages);
        let description = LogDescription {
            path: path.to_owned(),
            format,
            touches: marker.as_ref().map_or(Some(1), |_| markers.map(|count| count as usize)),
            samples: chosen.samples.messages,
            joints: Some(joints.count).filter(|&count| count > 0),
            torques: reading.torques,
        };
        let mut touch = TouchState::default();
        if marker.is_none() {
            touch.next = Some(stem(path));
        }
        let (ahead, waiting) = (files.into_iter().rev().collect(), VecDeque::new());
        Ok(Self {
            description,
            options: options.clone(),
            chosen,
            reading,
            marker,
            joints,
            ahead,
            current: None,
            touch,
            waiting,
            messages: 0,
            other_joints: 0,
            before_touch: 0,
            times_s: None,
            clock: Clock::default(),
            warnings: Vec::new(),
        })
    }

    /// The next event, or `None` at the end.
    fn advance(&mut self) -> Result<Option<LogEvent>, LogError> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                return Ok(Some(event));
            }
            let message = match &mut self.current {
                Some((_, messages)) => messages.next(),
                None => None,
            };
            match message {
                Some(Ok(message)) => self.take(&message)?,
                Some(Err(reason)) => return self.break_off(reason).map(|()| None),
                None => match self.ahead.pop() {
                    Some(path) => {
                        let messages = Messages::open(&path, &self.chosen.names())?;
                        self.current = Some((path, messages));
                    }
                    None => return self.finish().map(|()| None),
                },
            }
        }
    }

    /// Takes a message: a marker, or a sample.
    fn take(&mut self, message: &Message) -> Result<(), LogError> {
        match (message.which, &self.marker) {
            (Which::Marker, Some(marker)) => {
                let text = marker.text(&message.data);
                let number = self.touch.markers;
                self.touch.markers += 1;
                let topic = self.chosen.markers.as_ref().unwrap_or(&self.chosen.samples);
                let text = text.map_err(|reason| self.refused(topic, number.into(), reason))?;
                let name = text.unwrap_or_else(|| format!("touch_{number:03}"));
                self.touch.next = Some(self.touch.unique(name));
                Ok(())
            }
            (Which::Marker, None) => Ok(()),
            (Which::Sample, _) => self.take_sample(message),
        }
    }

    fn take_sample(&mut self, message: &Message) -> Result<(), LogError> {
        let number = self.messages;
        self.messages += 1;
        let unit = self.options.angle_unit;
        let sample = self.reading.sample(&message.data, message.time_ns, &self.joints, unit);
        let sample = sample.map_err(|reason| self.refused(&self.chosen.samples, number, reason))?;
        let Some(sample) = sample else {
            self.other_joints += 1;
            return Ok(());
        };
        if let Some(name) = self.touch.next.take() {
            self.touch.name = Some(name.clone());
            (self.touch.row, self.clock) = (0, Clock::default());
            let joint_names = self.joints.names.clone();
            self.waiting.push_back(LogEvent::TouchStarts { name, joint_names });
        }
        let Some(touch) = &self.touch.name else {
            self.before_touch += 1;
            return Ok(());
        };
        if let Some(time_s) = sample.time_s {
            self.times_s = Some([self.times_s.map_or(time_s, |[first, _]| first), time_s]);
        }
        self.clock.tick(sample.time_s, touch, self.touch.row, &mut self.warnings);
        self.touch.row += 1;
        self.waiting.push_back(LogEvent::Sample(sample));
        Ok(())
    }

    /// The end of a bag that breaks off: an error, unless what lies before was asked for.
    fn break_off(&mut self, reason: String) -> Result<(), LogError> {
        let path = self.current.as_ref().map_or_else(PathBuf::new, |(path, _)| path.clone());
        let seconds = self.times_s.map_or(0.0, |[first, last]| last - first);
        let (topic, messages) = (self.chosen.samples.name.clone(), self.messages);
        if !self.options.until_break {
            return Err(BagError::Broken { path, topic, messages, seconds, reason }.into());
        }
        self.warnings.push(LogWarning::BrokenOff { messages, seconds, reason });
        self.ahead.clear();
        self.finish()
    }

    /// The end of the bag.
    fn finish(&mut self) -> Result<(), LogError> {
        self.current = None;
        let outside = [self.other_joints, self.before_touch];
        if outside != [0, 0] {
            let [other_joints, before_touch] = outside;
            self.warnings.push(LogWarning::LeftOut { other_joints, before_touch });
        }
        if self.touch.name.is_some() {
            return Ok(());
        }
        let path = self.description.path.clone();
        let topic = self.chosen.samples.name.clone();
        let reason = match (self.messages, self.before_touch) {
            (0, _) => format!("has no message on topic `{topic}`; record again"),
            (n, 0) => {
                let joints = self.joints.names.clone().unwrap_or_default().join(", ");
                format!("has {n} messages on topic `{topic}`, none of them of the joints {joints}")
            }
            (n, _) => format!(
                "has {n} messages on topic `{topic}`, all of them before the first on the topic of \
                 touches; name another with --touch-topic"
            ),
        };
        Err(BagError::Storage { path, reason }.into())
    }

    fn refused(&self, topic: &Topic, message: u64, reason: String) -> LogError {
        let path = self.current.as_ref().map_or_else(PathBuf::new, |(path, _)| path.clone());
        BagError::Message { path, topic: topic.name.clone(), message, reason }.into()
    }
}

impl Chosen {
    /// The names of the topics of samples and of markers.
    fn names(&self) -> [Option<String>; 2] {
        let markers = self.markers.as_ref().map(|topic| topic.name.clone());
        [Some(self.samples.name.clone()), markers]
    }
}

/// The first messages of the topic of samples, as far as they can be read.
fn first_messages(files: &[PathBuf], chosen: &Chosen) -> Vec<Vec<u8>> {
    let only_samples = [chosen.names()[0].clone(), None];
    let messages = files.iter().filter_map(|file| Messages::open(file, &only_samples).ok());
    let messages = messages.flat_map(|messages| messages.map_while(Result::ok));
    messages.take(LOOKED_AT).map(|message| message.data).collect()
}

/// The name of a bag without its ending.
fn stem(path: &Path) -> String {
    let named = super::npy_folder::name_of(path);
    let ending = [".mcap", ".db3"].iter().find_map(|ending| named.strip_suffix(ending));
    ending.map_or_else(|| named.clone(), str::to_owned)
}

impl Iterator for BagLog {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.current.is_none() && self.ahead.is_empty() && self.waiting.is_empty() {
            return None;
        }
        let event = self.advance();
        if !matches!(event, Ok(Some(_))) {
            self.current = None;
            self.ahead.clear();
            self.waiting.clear();
        }
        event.transpose()
    }
}

impl Log for BagLog {
    fn describe(&self) -> LogDescription {
        self.description.clone()
    }

    fn warnings(&self) -> &[LogWarning] {
        &self.warnings
    }
}
