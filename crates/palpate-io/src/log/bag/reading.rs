//! Converts messages to samples and to names of touches, for each supported type.
//!
//! | type                                | positions                            | torques                |
//! |-------------------------------------|--------------------------------------|------------------------|
//! | `sensor_msgs/JointState`            | `position`                           | `effort`               |
//! | `franka_msgs/FrankaRobotState`      | `measured_joint_state.position`, `q` | `tau_ext_hat_filtered` |
//! | `lbr_fri_idl/LBRState`              | `measured_joint_position`            | `external_torque`      |
//! | `kortex_driver/BaseCyclic_Feedback` | `actuators.position`, degrees        | `actuators.torque`     |
//!
//! Messages are read by their definitions, since most of these types have had several layouts. Torques of Franka and
//! KUKA are external ones, without gravity. Markers are messages whose field `data`, if there is one, names the touch.

use std::collections::HashSet;

use palpate::{Sample, TorqueSign};

use super::layout::{Layout, Slot, Taken, plain};
use super::topic::Topic;
use crate::log::event::LoggedTorques;
use crate::log::options::{AngleUnit, LogOptions};

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

/// What is read from messages of a type. A type that has had several layouts occurs once for each.
struct Fields {
    kinds: &'static [&'static str],
    slots: &'static [(&'static str, Slot)],
    torques: LoggedTorques,
    /// Field of measured torques with gravity, in messages whose `torques` are external ones.
    measured: Option<&'static str>,
    /// Unit of the positions, if it is not that of ROS.
    angle_unit: Option<AngleUnit>,
}

impl Fields {
    /// The fields to read and the kind of their torques, with `measured` torques if the message holds any.
    fn chosen(&self, measured: bool) -> (Vec<(&'static str, Slot)>, LoggedTorques) {
        let Some(field) = self.measured.filter(|_| measured) else {
            return (self.slots.to_vec(), self.torques);
        };
        let others = self.slots.iter().filter(|(_, slot)| *slot != Slot::Torques);
        (others.copied().chain([(field, Slot::Torques)]).collect(), LoggedTorques::Unknown)
    }
}

const JOINT_STATE_TYPE: &str = "sensor_msgs/JointState";
const SEC: (&str, Slot) = ("header.stamp.sec", Slot::Seconds);
const NANOSEC: (&str, Slot) = ("header.stamp.nanosec", Slot::Nanoseconds);

const KNOWN: [Fields; 5] = [
    Fields {
        kinds: &[JOINT_STATE_TYPE],
        slots: &[
            SEC,
            NANOSEC,
            ("name", Slot::Names),
            ("position", Slot::Positions),
            ("effort", Slot::Torques),
        ],
        torques: LoggedTorques::Unknown,
        measured: None,
        angle_unit: None,
    },
    Fields {
        kinds: FRANKA,
        slots: &[
            SEC,
            NANOSEC,
            ("measured_joint_state.name", Slot::Names),
            ("measured_joint_state.position", Slot::Positions),
            ("tau_ext_hat_filtered.effort", Slot::Torques),
        ],
        torques: LoggedTorques::External(Some(TorqueSign::Minus)),
        measured: Some("measured_joint_state.effort"),
        angle_unit: None,
    },
    Fields {
        kinds: FRANKA,
        slots: &[SEC, NANOSEC, ("q", Slot::Positions), ("tau_ext_hat_filtered", Slot::Torques)],
        torques: LoggedTorques::External(Some(TorqueSign::Minus)),
        measured: Some("tau_J"),
        angle_unit: None,
    },
    Fields {
        kinds: &["lbr_fri_idl/LBRState", "lbr_fri_msgs/LBRState"],
        slots: &[
            ("time_stamp_sec", Slot::Seconds),
            ("time_stamp_nano_sec", Slot::Nanoseconds),
            ("measured_joint_position", Slot::Positions),
            ("external_torque", Slot::Torques),
        ],
        torques: LoggedTorques::External(Some(TorqueSign::Plus)),
        measured: Some("measured_torque"),
        angle_unit: None,
    },
    Fields {
        kinds: &["kortex_driver/BaseCyclic_Feedback", "kortex_driver/BaseCyclicFeedback"],
        slots: &[("actuators.position", Slot::Positions), ("actuators.torque", Slot::Torques)],
        torques: LoggedTorques::Unknown,
        measured: None,
        angle_unit: Some(AngleUnit::Deg),
    },
];
const FRANKA: &[&str] = &["franka_msgs/FrankaRobotState"];

/// What may be read from messages of a type; nothing if it is not known.
fn known(kind: &str) -> impl Iterator<Item = &'static Fields> {
    let kind = plain(kind);
    KNOWN.iter().filter(move |fields| fields.kinds.contains(&kind.as_str()))
}

/// Whether joint states can be read from messages of this type.
pub(super) fn has_joints(kind: &str) -> bool {
    known(kind).next().is_some()
}

/// Whether messages of this type are joint states of ROS.
pub(super) fn is_joint_state(kind: &str) -> bool {
    plain(kind) == JOINT_STATE_TYPE
}

/// Conversion of the messages of a topic to samples.
#[derive(Debug, Clone)]
pub(super) struct MessageReader {
    layout: Layout,
    pub(super) torques: LoggedTorques,
    /// Unit of the positions in the messages, if it is not that of ROS.
    pub(super) angle_unit: Option<AngleUnit>,
    /// Unit from which positions are converted to radians.
    converted: Option<AngleUnit>,
    /// Whether messages contain joint names.
    named: bool,
}

/// The joints of a bag, and the clock of their times.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Joints {
    /// `None` if the messages contain no joint names.
    pub(super) names: Option<Vec<String>>,
    pub(super) count: usize,
    /// Whether the messages have no time, so that the time of recording is used.
    pub(super) by_log_time: bool,
}

impl MessageReader {
    /// The conversion for a topic whose type [`has_joints`]. Positions of a type with another unit than that of ROS
    /// become radians, unless the options give a unit. The error is the end of a message.
    pub(super) fn of(topic: &Topic, options: &LogOptions) -> Result<Self, String> {
        let kind = plain(&topic.kind);
        let standard = || is_joint_state(&kind).then(joint_state);
        let Some(definition) = topic.definition.clone().or_else(standard) else {
            return Err(
                "the bag does not contain the definition of this type, which has several versions; \
                 record it as MCAP or with a newer rosbag2, which store the definition"
                    .to_owned(),
            );
        };
        let mut refused = None;
        for fields in known(&kind) {
            let (slots, torques) = fields.chosen(options.measured_torques);
            match Layout::of(&kind, &definition, &slots) {
                Ok(layout) => {
                    let angle_unit = fields.angle_unit;
                    let converted = angle_unit.filter(|_| options.angle_unit.is_none());
                    let named = slots.iter().any(|(_, slot)| *slot == Slot::Names);
                    return Ok(Self { layout, torques, angle_unit, converted, named });
                }
                Err(reason) => refused = refused.or(Some(reason)),
            }
        }
        Err(refused.unwrap_or_else(|| "messages of this type are not joint states".to_owned()))
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

    /// Largest number of joints with finite torques in one of these messages.
    pub(super) fn torques_of(&self, first: &[Vec<u8>]) -> usize {
        let taken = first.iter().filter_map(|data| self.layout.take(data).ok());
        let finite = taken.map(|taken| taken.torques.iter().filter(|tau| tau.is_finite()).count());
        finite.max().unwrap_or(0)
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
        let mut q = finite("position", &taken.positions)?;
        self.converted.unwrap_or_default().into_rad(&mut q);
        let tau = finite("torque", &taken.torques)?;
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
