//! Converts messages to samples and to names of touches, for each supported type.
//!
//! | type                           | positions                            | torques                |
//! |--------------------------------|--------------------------------------|------------------------|
//! | `sensor_msgs/JointState`       | `position`                           | `effort`               |
//! | `franka_msgs/FrankaRobotState` | `measured_joint_state.position`, `q` | `tau_ext_hat_filtered` |
//!
//! Franka's robot state has had several layouts; each is read by its definition. Its torques are
//! external ones, without gravity. Markers are messages whose field `data`, if there is one, names
//! the touch.

use std::collections::HashSet;

use palpate::{Sample, TorqueSign};

use super::layout::{Layout, Slot, Taken, plain};
use super::topic::Topic;
use crate::log::event::LoggedTorques;

/// Definition of a joint state for bags that contain none, and for writing; [`HEADER`] is appended.
const JOINT_STATE: &str = "std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
";
/// Definitions of the header and its parts, appended to the definition of a message with a header.
pub(super) const HEADER: &str =
    "================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// The complete definition of a joint state.
pub(super) fn joint_state() -> String {
    [JOINT_STATE, HEADER].concat()
}

const JOINT_STATE_TYPE: &str = "sensor_msgs/JointState";
const ROBOT_STATE_TYPE: &str = "franka_msgs/FrankaRobotState";
const STAMP: [(&str, Slot); 2] =
    [("header.stamp.sec", Slot::Seconds), ("header.stamp.nanosec", Slot::Nanoseconds)];

/// Whether joint states can be read from messages of this type.
pub(super) fn has_joints(kind: &str) -> bool {
    [JOINT_STATE_TYPE, ROBOT_STATE_TYPE].contains(&plain(kind).as_str())
}

/// Conversion of the messages of a topic to samples.
#[derive(Debug, Clone)]
pub(super) struct MessageReader {
    layout: Layout,
    pub(super) torques: LoggedTorques,
    /// Whether messages contain joint names.
    named: bool,
}

/// The joints of a bag, and the clock of their times.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Joints {
    /// `None` if the messages contain no joint names.
    pub(super) names: Option<Vec<String>>,
    pub(super) count: usize,
    /// Whether the headers have no time, so that the time of recording is used.
    pub(super) by_log_time: bool,
}

impl MessageReader {
    /// The conversion for a topic whose type [`has_joints`]. The error is the end of a message.
    pub(super) fn of(topic: &Topic) -> Result<Self, String> {
        let kind = plain(&topic.kind);
        let with_stamp = |fields: &[(&'static str, Slot)]| [&STAMP[..], fields].concat();
        if kind == JOINT_STATE_TYPE {
            let fields =
                [("name", Slot::Names), ("position", Slot::Positions), ("effort", Slot::Torques)];
            let definition = topic.definition.clone().unwrap_or_else(joint_state);
            let layout = Layout::of(&kind, &definition, &with_stamp(&fields))?;
            return Ok(Self { layout, torques: LoggedTorques::Unknown, named: true });
        }
        let Some(definition) = &topic.definition else {
            return Err(
                "the bag does not contain the definition of this type, which has several versions; \
                 record it as MCAP or with a newer rosbag2, which store the definition"
                    .to_owned(),
            );
        };
        let torques = LoggedTorques::External(Some(TorqueSign::Minus));
        let nested = [
            ("measured_joint_state.name", Slot::Names),
            ("measured_joint_state.position", Slot::Positions),
            ("tau_ext_hat_filtered.effort", Slot::Torques),
        ];
        let refused = match Layout::of(&kind, definition, &with_stamp(&nested)) {
            Ok(layout) => return Ok(Self { layout, torques, named: true }),
            Err(reason) => reason,
        };
        let plain = [("q", Slot::Positions), ("tau_ext_hat_filtered", Slot::Torques)];
        match Layout::of(&kind, definition, &with_stamp(&plain)) {
            Ok(layout) => Ok(Self { layout, torques, named: false }),
            Err(_) => Err(refused),
        }
    }

    /// The joints `wanted`, or else those of the message with the most joints among the `first`
    /// messages, so that a gripper on the same topic is not taken for the arm. Joints that never
    /// have a finite torque are left out.
    pub(super) fn joints(&self, first: &[Vec<u8>], wanted: Option<&[String]>) -> Joints {
        let mut joints = Joints { by_log_time: true, ..Joints::default() };
        let mut with_torque: HashSet<String> = HashSet::new();
        for taken in first.iter().filter_map(|data| self.layout.take(data).ok()) {
            joints.by_log_time &= taken.seconds == 0 && taken.nanoseconds == 0;
            if taken.positions.len() > joints.count {
                joints.count = taken.positions.len();
                joints.names = self.named.then(|| taken.names.clone());
                with_torque.clear();
            }
            if joints.names.as_ref().is_some_and(|names| names.len() == taken.names.len()) {
                let torques = taken.names.into_iter().zip(&taken.torques);
                let finite = torques.filter(|(_, tau)| tau.is_finite());
                with_torque.extend(finite.map(|(name, _)| name));
            }
        }
        // Broadcasters of joint states publish NaN for torques that a gripper does not measure.
        if let Some(names) = &mut joints.names
            && names.iter().any(|name| with_torque.contains(name))
        {
            names.retain(|name| with_torque.contains(name));
            joints.count = names.len();
        }
        if let (Some(wanted), true) = (wanted, self.named) {
            joints.count = wanted.len();
            joints.names = Some(wanted.to_vec());
        }
        joints
    }

    /// The sample of these joints; `None` if one of them is not in the message. The error is the end
    /// of a message to the user.
    pub(super) fn sample(
        &self,
        data: &[u8],
        time_ns: i64,
        joints: &Joints,
    ) -> Result<Option<Sample>, String> {
        let taken = self.layout.take(data)?;
        let places = match &joints.names {
            Some(names) => {
                let place = |name| taken.names.iter().position(|held| held == name);
                match names.iter().map(place).collect::<Option<Vec<usize>>>() {
                    Some(places) => places,
                    None => return Ok(None),
                }
            }
            None => (0..joints.count).collect(),
        };
        let held = if self.named { taken.names.len() } else { joints.count };
        check_lengths(&taken, held)?;
        let time_s = if joints.by_log_time {
            time_ns as f64 / 1e9
        } else {
            taken.seconds as f64 + taken.nanoseconds as f64 / 1e9
        };
        let finite = |what: &str, values: &[f64]| -> Result<Vec<f64>, String> {
            let value = |&place: &usize| match values[place] {
                value if value.is_finite() => Ok(value),
                value => {
                    let name = taken.names.get(place).cloned().unwrap_or((place + 1).to_string());
                    Err(format!(
                        "the {what} of joint `{name}` is {value}; every number must be finite: if \
                         it is not a joint of the arm, name the joints of the arm with --joints"
                    ))
                }
            };
            places.iter().map(value).collect()
        };
        let (q, tau) = (finite("position", &taken.positions)?, finite("torque", &taken.torques)?);
        Ok(Some(Sample::new(Some(time_s), q, tau)))
    }
}

/// Refuses a message whose numbers of positions and torques differ from the number of joints.
fn check_lengths(taken: &Taken, joints: usize) -> Result<(), String> {
    let (q, tau) = (taken.positions.len(), taken.torques.len());
    match (q == joints, tau == joints, tau) {
        (true, true, _) => Ok(()),
        (_, _, 0) => Err(format!(
            "it has {q} positions and no effort; torques are needed: have the driver publish \
             efforts, and record again"
        )),
        _ => Err(format!("it has {joints} joints, {q} positions and {tau} torques")),
    }
}

/// Reads the name of a touch from a marker.
#[derive(Debug, Clone)]
pub(super) struct Marker {
    /// `None` if the type has no readable field `data`.
    layout: Option<Layout>,
}

impl Marker {
    /// The reader for a topic of markers.
    pub(super) fn of(topic: &Topic) -> Self {
        let kind = plain(&topic.kind);
        let data = [("data", Slot::Text)];
        let known = match kind.as_str() {
            "std_msgs/String" => "string data",
            "std_msgs/Bool" => "bool data",
            "std_msgs/Int32" => "int32 data",
            _ => "",
        };
        let definition = topic.definition.as_deref().unwrap_or(known);
        Self { layout: Layout::of(&kind, definition, &data).ok() }
    }

    /// The text of a marker, if it has any. The error is the end of a message to the user.
    pub(super) fn text(&self, data: &[u8]) -> Result<Option<String>, String> {
        let Some(layout) = &self.layout else { return Ok(None) };
        Ok(layout.take(data)?.text.filter(|text| !text.trim().is_empty()))
    }
}
