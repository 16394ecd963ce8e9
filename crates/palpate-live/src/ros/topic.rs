//! Chooses the topic of joint states among those on the network.

use serde::{Deserialize, Serialize};

/// The preferred type of joint states.
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
/// The type taken if no topic has the preferred one.
const DYNAMIC_JOINT_STATE: &str = "control_msgs/msg/DynamicJointState";

/// A topic that somebody publishes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicSeen {
    /// Name in ROS.
    pub name: String,
    /// Type in ROS.
    pub kind: String,
    /// Whether all its publishers are reliable, that is, resend lost messages.
    pub reliable: bool,
}

impl TopicSeen {
    /// From names in DDS; `None` for a topic that is not one of ROS.
    pub(super) fn of_dds(name: &str, kind: &str, reliable: bool) -> Option<Self> {
        let name = name.strip_prefix("rt/")?;
        let kind = kind.replace("::dds_::", "::").replace("::", "/");
        let kind = kind.strip_suffix('_').unwrap_or(&kind).to_owned();
        Some(Self { name: format!("/{name}"), kind, reliable })
    }

    /// Whether it is a topic of `DynamicJointState`, as ros2_control publishes.
    pub(super) fn is_dynamic(&self) -> bool {
        self.kind == DYNAMIC_JOINT_STATE
    }
}

/// Chooses the wanted topic, or the only one of joint states. `DynamicJointState` is considered only if nobody
/// publishes `JointState`.
///
/// # Errors
///
/// A message for the user if there is no such topic yet; the caller tries again later.
pub fn choose(topics: &[TopicSeen], wanted: Option<&str>) -> Result<TopicSeen, String> {
    let of_kind = |kind: &str| topics.iter().filter(|topic| topic.kind == kind).collect::<Vec<_>>();
    let (fitting, dynamic) = (of_kind(JOINT_STATE), of_kind(DYNAMIC_JOINT_STATE));
    if let Some(name) = wanted {
        if let Some(topic) = fitting.iter().chain(&dynamic).find(|topic| topic.name == name) {
            return Ok((*topic).clone());
        }
        return Err(match topics.iter().find(|topic| topic.name == name) {
            Some(other) => format!(
                "`{name}` is published as {}; wanted {JOINT_STATE} or {DYNAMIC_JOINT_STATE}{}",
                other.kind,
                others(topics)
            ),
            None => format!("nobody publishes `{name}`{}", others(topics)),
        });
    }
    let fitting = if fitting.is_empty() { dynamic } else { fitting };
    match fitting.as_slice() {
        [topic] => Ok((*topic).clone()),
        [] => Err(format!("nobody publishes {JOINT_STATE}{}", others(topics))),
        several => {
            let names: Vec<&str> = several.iter().map(|topic| topic.name.as_str()).collect();
            Err(format!(
                "several topics are {}: {}; choose one with --joint-states",
                several[0].kind,
                names.join(", ")
            ))
        }
    }
}

/// The end of an error message: the topics that were found.
fn others(topics: &[TopicSeen]) -> String {
    let listed: Vec<String> =
        topics.iter().map(|topic| format!("{} ({})", topic.name, topic.kind)).collect();
    if listed.is_empty() {
        "; no topic is seen at all: are the domain (--domain, ROS_DOMAIN_ID) and the network right?"
            .to_owned()
    } else {
        format!("; there are {}", listed.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(name: &str, kind: &str) -> TopicSeen {
        TopicSeen { name: name.to_owned(), kind: kind.to_owned(), reliable: true }
    }

    #[test]
    fn names_of_dds_become_those_of_ros() {
        let topic =
            TopicSeen::of_dds("rt/arm/joint_states", "sensor_msgs::msg::dds_::JointState_", true);
        assert_eq!(topic, Some(seen("/arm/joint_states", JOINT_STATE)));
        assert_eq!(TopicSeen::of_dds("ros_discovery_info", "x", true), None);
        assert_eq!(TopicSeen::of_dds("rq/addRequest", "x", true), None);
    }

    #[test]
    fn the_only_topic_that_fits_is_taken_and_a_dynamic_one_if_there_is_no_other() {
        let dynamic = seen("/dynamic_joint_states", DYNAMIC_JOINT_STATE);
        let mut topics = vec![seen("/camera", "sensor_msgs/msg/Image"), dynamic.clone()];
        assert_eq!(choose(&topics, None), Ok(dynamic.clone()));
        let arm = seen("/arm/joint_states", JOINT_STATE);
        topics.push(arm.clone());
        assert_eq!(choose(&topics, None), Ok(arm.clone()));
        assert_eq!(choose(&topics, Some("/dynamic_joint_states")), Ok(dynamic));
        topics.push(seen("/joint_states", JOINT_STATE));
        let why = choose(&topics, None).unwrap_err();
        assert!(why.contains("/arm/joint_states, /joint_states; choose one"), "{why}");
        assert_eq!(choose(&topics, Some("/arm/joint_states")), Ok(arm));
    }

    #[test]
    fn a_topic_that_is_missing_or_of_another_type_is_named_with_those_that_are_there() {
        let topics = [seen("/camera", "sensor_msgs/msg/Image")];
        for (wanted, words) in [
            (None, "nobody publishes sensor_msgs/msg/JointState; there are /camera (sensor_msgs"),
            (Some("/joints"), "nobody publishes `/joints`; there are /camera"),
            (Some("/camera"), "`/camera` is published as sensor_msgs/msg/Image; wanted sensor"),
        ] {
            let why = choose(&topics, wanted).unwrap_err();
            assert!(why.contains(words), "{why}");
        }
        let why = choose(&[], None).unwrap_err();
        assert!(why.contains("ROS_DOMAIN_ID"), "{why}");
    }
}
