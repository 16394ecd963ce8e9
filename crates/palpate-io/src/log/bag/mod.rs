//! Touches in bags of ROS 2: joint states on one topic, and markers of the starts of touches on
//! another.
//!
//! | file      | content                                                     |
//! |-----------|-------------------------------------------------------------|
//! | `file`    | the files of a bag, and the storage format of each          |
//! | `mcap`    | topics and messages of a file in MCAP                       |
//! | `sqlite`  | topics and messages of a file in SQLite                     |
//! | `topic`   | topics and messages, common to both                         |
//! | `choose`  | choice of the topics that are read                          |
//! | `layout`  | extraction of fields of a message, by its definition        |
//! | `reading` | conversion of messages to samples, for each supported type  |
//! | `write`   | writing of joint states and stiff points as MCAP            |
//!
//! A bag is one touch, unless markers on another topic say where touches start. Messages are read
//! in the order in which they were recorded. The time of a sample is that of the message header, or
//! the time of recording if the headers have none. Chunks and pages stream: memory does not grow
//! with the bag.

mod choose;
mod file;
mod layout;
mod mcap;
mod reading;
#[cfg(feature = "formats")]
mod sqlite;
mod topic;
pub mod write;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use super::error::{BagError, LogError};
use super::event::{LogDescription, LogEvent, LogWarning};
use super::names::UniqueNames;
use super::options::LogOptions;
use super::reader::Source;
use choose::ChosenTopics;
use reading::{Joints, Marker, MessageReader};
use topic::{Message, Messages, Topic, TopicRole};

pub(super) use file::is_bag;

/// Number of messages that are read first to find the joints of a bag.
const LOOKED_AT: usize = 100;

/// Reads the events of a bag.
pub(super) struct BagLog {
    description: LogDescription,
    until_break: bool,
    chosen: ChosenTopics,
    reading: MessageReader,
    marker: Option<Marker>,
    joints: Joints,
    /// Files that are not read yet, in reverse order.
    ahead: Vec<PathBuf>,
    current: Option<(PathBuf, Messages)>,
    /// Name of the touch that starts with the next sample.
    next_touch: Option<String>,
    /// Whether a touch has started.
    is_touching: bool,
    names: UniqueNames,
    markers: u64,
    /// Number of messages of the samples' topic so far, and of those without a sample, by reason.
    messages: u64,
    other_joints: u64,
    before_touch: u64,
    /// Times of the first and the last sample, s.
    times_s: Option<[f64; 2]>,
}

impl BagLog {
    /// Finds topics, definitions and joints; reading then begins with the first message.
    pub(super) fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let files = file::files(path)?;
        let (mut topics, mut format) = (Vec::new(), None);
        for file in &files {
            let stored = file::format(file)?;
            format = format.or(Some(stored));
            topic::merge(&mut topics, file::topics(file, stored)?);
        }
        let Some(format) = format else { return Err(LogError::Empty { path: path.to_owned() }) };
        let torques = |topic: &Topic| {
            let first = first_messages(&files, &topic.name);
            MessageReader::of(topic, options).map_or(0, |reading| reading.torques_of(&first))
        };
        let chosen = choose::choose(path, &topics, options, &torques)?;
        let reading = MessageReader::of(&chosen.samples, options).map_err(|reason| {
            let Topic { name, kind, .. } = chosen.samples.clone();
            BagError::Layout { path: path.to_owned(), topic: name, kind, reason }
        })?;
        let marker = chosen.markers.as_ref().map(Marker::of);
        let joints = reading
            .joints(&first_messages(&files, &chosen.samples.name), options.joints.as_deref());
        let markers = chosen.markers.as_ref().and_then(|topic| topic.messages);
        let description = LogDescription {
            path: path.to_owned(),
            format,
            touches: marker.as_ref().map_or(Some(1), |_| markers.map(|count| count as usize)),
            samples: chosen.samples.messages,
            joints: Some(joints.count).filter(|&count| count > 0),
            torques: reading.torques,
            angle_unit: reading.angle_unit,
            columns: None,
        };
        let next_touch = marker.is_none().then(|| stem(path));
        Ok(Self {
            description,
            until_break: options.until_break,
            chosen,
            reading,
            marker,
            joints,
            ahead: files.into_iter().rev().collect(),
            current: None,
            next_touch,
            is_touching: false,
            names: UniqueNames::default(),
            markers: 0,
            messages: 0,
            other_joints: 0,
            before_touch: 0,
            times_s: None,
        })
    }

    /// Processes a message: a marker, or a sample.
    fn take(&mut self, message: &Message, to: &mut VecDeque<LogEvent>) -> Result<(), LogError> {
        if message.which == TopicRole::Sample {
            return self.take_sample(message, to);
        }
        let marker = self.marker.as_ref().zip(self.chosen.markers.as_ref());
        let Some((marker, topic)) = marker else { return Ok(()) };
        let (number, text) = (self.markers, marker.text(&message.data));
        let text = text.map_err(|reason| self.refused(topic, number, reason))?;
        self.markers += 1;
        self.names.start(&text.unwrap_or_else(|| format!("touch_{number:03}")));
        self.next_touch = Some(self.names.latest().to_owned());
        Ok(())
    }

    fn take_sample(
        &mut self,
        message: &Message,
        to: &mut VecDeque<LogEvent>,
    ) -> Result<(), LogError> {
        let number = self.messages;
        self.messages += 1;
        let sample = self.reading.sample(&message.data, message.time_ns, &self.joints);
        let sample = sample.map_err(|reason| self.refused(&self.chosen.samples, number, reason))?;
        let Some(sample) = sample else {
            self.other_joints += 1;
            return Ok(());
        };
        if let Some(name) = self.next_touch.take() {
            self.is_touching = true;
            let joint_names = self.joints.names.clone();
            to.push_back(LogEvent::TouchStarts { name, joint_names });
        }
        if !self.is_touching {
            self.before_touch += 1;
            return Ok(());
        }
        if let Some(time_s) = sample.time_s {
            self.times_s = Some([self.times_s.map_or(time_s, |[first, _]| first), time_s]);
        }
        to.push_back(LogEvent::Sample(sample));
        Ok(())
    }

    /// Ends a bag that breaks off: an error, unless the options accept the part before the break.
    fn break_off(
        &mut self,
        reason: String,
        warnings: &mut Vec<LogWarning>,
    ) -> Result<(), LogError> {
        let path = self.current.as_ref().map_or_else(PathBuf::new, |(path, _)| path.clone());
        let seconds = self.times_s.map_or(0.0, |[first, last]| last - first);
        let (topic, messages) = (self.chosen.samples.name.clone(), self.messages);
        if !self.until_break {
            return Err(BagError::Broken { path, topic, messages, seconds, reason }.into());
        }
        warnings.push(LogWarning::BrokenOff { messages, seconds, reason });
        self.ahead.clear();
        self.finish(warnings)
    }

    /// Ends the bag; an error if it had no sample.
    fn finish(&mut self, warnings: &mut Vec<LogWarning>) -> Result<(), LogError> {
        self.current = None;
        let (other_joints, before_touch) = (self.other_joints, self.before_touch);
        if other_joints > 0 || before_touch > 0 {
            warnings.push(LogWarning::LeftOut { other_joints, before_touch });
        }
        if self.is_touching {
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
                "has {n} messages on topic `{topic}`, all of them before the first message on the \
                 topic of touches; name another topic with --touch-topic"
            ),
        };
        Err(BagError::Storage { path, reason }.into())
    }

    fn refused(&self, topic: &Topic, message: u64, reason: String) -> LogError {
        let path = self.current.as_ref().map_or_else(PathBuf::new, |(path, _)| path.clone());
        BagError::Message { path, topic: topic.name.clone(), message, reason }.into()
    }
}

impl Source for BagLog {
    fn describe(&self) -> LogDescription {
        self.description.clone()
    }

    fn read_on(
        &mut self,
        events: &mut VecDeque<LogEvent>,
        warnings: &mut Vec<LogWarning>,
    ) -> Result<(), LogError> {
        while events.is_empty() {
            match self.current.as_mut().and_then(|(_, messages)| messages.next()) {
                Some(Ok(message)) => self.take(&message, events)?,
                Some(Err(reason)) => return self.break_off(reason, warnings),
                None => match self.ahead.pop() {
                    Some(path) => {
                        let messages = file::messages(&path, self.chosen.names())?;
                        self.current = Some((path, messages));
                    }
                    None => return self.finish(warnings),
                },
            }
        }
        Ok(())
    }
}

/// At most [`LOOKED_AT`] messages from the start of a topic, as far as they can be read.
fn first_messages(files: &[PathBuf], topic: &str) -> Vec<Vec<u8>> {
    let only = [Some(topic.to_owned()), None];
    let messages = files.iter().filter_map(|file| file::messages(file, only.clone()).ok());
    let messages = messages.flat_map(|messages| messages.map_while(Result::ok));
    messages.take(LOOKED_AT).map(|message| message.data).collect()
}

/// The name of a bag without its extension.
fn stem(path: &Path) -> String {
    let named = super::npy_folder::name_of(path);
    let ending = [".mcap", ".db3"].iter().find_map(|ending| named.strip_suffix(ending));
    ending.map_or_else(|| named.clone(), str::to_owned)
}
