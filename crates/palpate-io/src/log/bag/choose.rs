//! Choice of the topics of a bag that are read.

use std::path::{Path, PathBuf};

use super::reading::{has_joints, is_joint_state};
use super::topic::{TOUCH_TOPIC, Topic};
use crate::log::error::BagError;
use crate::log::options::LogOptions;

/// The topics that are read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ChosenTopics {
    pub(super) samples: Topic,
    pub(super) markers: Option<Topic>,
}

impl ChosenTopics {
    /// The names of the topics of samples and of markers.
    pub(super) fn names(&self) -> [Option<String>; 2] {
        let markers = self.markers.as_ref().map(|topic| topic.name.clone());
        [Some(self.samples.name.clone()), markers]
    }
}

/// Chooses the topics to read. `torques` is the number of joints with torques in the first messages of a topic.
pub(super) fn choose(
    path: &Path,
    topics: &[Topic],
    options: &LogOptions,
    torques: &dyn Fn(&Topic) -> usize,
) -> Result<ChosenTopics, BagError> {
    let samples = match &options.topic {
        Some(name) => {
            let topic = named(path, topics, name)?;
            if !has_joints(&topic.kind) {
                let reason = format!(
                    "`{name}` holds messages of `{}`, which are not joint states",
                    topic.kind
                );
                return Err(unclear(path, reason, topics));
            }
            topic
        }
        None => only(path, topics, torques)?,
    };
    let markers = match &options.touch_topic {
        Some(name) => Some(named(path, topics, name)?),
        None => topics.iter().find(|topic| topic.name == TOUCH_TOPIC),
    };
    Ok(ChosenTopics { samples: samples.clone(), markers: markers.cloned() })
}

/// The topic with this name, with or without a leading slash.
fn named<'a>(path: &Path, topics: &'a [Topic], name: &str) -> Result<&'a Topic, BagError> {
    let bare = |name: &str| name.trim_start_matches('/').to_owned();
    let found = topics.iter().find(|topic| bare(&topic.name) == bare(name));
    found.ok_or_else(|| unclear(path, format!("there is no topic `{name}`"), topics))
}

/// The only topic with a supported type of joint states and with messages, or the only one of them with joint states of
/// ROS, which drivers publish beside messages of their own types. But joint states without torques, or of a gripper
/// alone, have torques of fewer joints than those of the driver, and are left out.
fn only<'a>(
    path: &Path,
    topics: &'a [Topic],
    torques: &dyn Fn(&Topic) -> usize,
) -> Result<&'a Topic, BagError> {
    let fit = |topic: &&Topic| has_joints(&topic.kind) && topic.messages != Some(0);
    let fitting: Vec<&Topic> = topics.iter().filter(fit).collect();
    let (mut of_ros, of_makers): (Vec<&Topic>, Vec<&Topic>) =
        fitting.iter().partition(|topic| is_joint_state(&topic.kind));
    if let Some(most) = of_makers.iter().map(|topic| torques(topic)).max() {
        of_ros.retain(|topic| torques(topic) >= most);
    }
    match (&of_ros[..], &of_makers[..]) {
        ([topic], _) | ([], [topic]) => Ok(topic),
        ([], []) => Err(unclear(path, "no topic holds joint states".to_owned(), topics)),
        _ => {
            let names: Vec<&str> = fitting.iter().map(|topic| topic.name.as_str()).collect();
            let reason = format!(
                "more than one topic holds joints; choose with --topic: {}",
                names.join(", ")
            );
            Err(unclear(path, reason, topics))
        }
    }
}

fn unclear(path: &Path, reason: String, topics: &[Topic]) -> BagError {
    let description = |topic: &Topic| match topic.messages {
        Some(count) => format!("`{}` ({}, {count} messages)", topic.name, topic.kind),
        None => format!("`{}` ({})", topic.name, topic.kind),
    };
    let topics = match topics {
        [] => "none".to_owned(),
        topics => topics.iter().map(description).collect::<Vec<_>>().join(", "),
    };
    BagError::Topic { path: PathBuf::from(path), reason, topics }
}
