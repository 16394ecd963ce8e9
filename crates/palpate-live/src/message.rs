//! The ROS 2 messages that palpate sends and receives, field by field as their packages define them.
//!
//! Serialized by ros2-client as CDR. Only what is read or written here; arrays that palpate does
//! not look at are still there, since CDR has no names to skip by.

use std::time::{SystemTime, UNIX_EPOCH};

use ros2_client::Message;
use serde::{Deserialize, Serialize};

mod trajectory;

pub use trajectory::{
    AskTrajectoryRequest, AskTrajectoryResponse, JointTrajectory, JointTrajectoryPoint,
};

/// `builtin_interfaces/msg/Time`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Seconds since the epoch of the clock.
    pub sec: i32,
    /// And nanoseconds.
    pub nanosec: u32,
}

impl Stamp {
    /// By the system's clock.
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { sec: since.as_secs() as i32, nanosec: since.subsec_nanos() }
    }

    /// At so many seconds since the epoch of the clock.
    pub fn at(seconds: f64) -> Self {
        let whole = seconds.floor();
        Self { sec: whole as i32, nanosec: ((seconds - whole) * 1e9) as u32 }
    }

    /// As seconds; `None` for zero, which means that nobody stamped the message.
    pub fn seconds(self) -> Option<f64> {
        let seconds = f64::from(self.sec) + f64::from(self.nanosec) * 1e-9;
        (self != Self::default()).then_some(seconds)
    }
}

/// `std_msgs/msg/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When it was.
    pub stamp: Stamp,
    /// Whose coordinates they are.
    pub frame_id: String,
}

/// `sensor_msgs/msg/JointState`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// When the joints were so.
    pub header: Header,
    /// Their names.
    pub name: Vec<String>,
    /// rad or m; empty if unknown.
    pub position: Vec<f64>,
    /// rad/s or m/s; empty if unknown.
    pub velocity: Vec<f64>,
    /// N·m or N; empty if unknown.
    pub effort: Vec<f64>,
}

impl Message for JointState {}

impl JointState {
    /// Torques of joints at the time of a sample.
    pub fn of_torques(header: Header, names: &[String], effort: Vec<f64>) -> Self {
        Self { header, name: names.to_vec(), effort, ..Self::default() }
    }
}

/// `control_msgs/msg/InterfaceValue`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct InterfaceValue {
    /// Such as `position`, `velocity` and `effort`.
    pub interface_names: Vec<String>,
    /// Their values.
    pub values: Vec<f64>,
}

/// `control_msgs/msg/DynamicJointState`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct DynamicJointState {
    /// When the joints were so.
    pub header: Header,
    /// Their names, and those of whatever else has interfaces.
    pub joint_names: Vec<String>,
    /// What is known of each.
    pub interface_values: Vec<InterfaceValue>,
}

impl Message for DynamicJointState {}

impl DynamicJointState {
    /// The joints of which position and effort are known.
    ///
    /// # Errors
    ///
    /// If there are more names than values somewhere, or fewer.
    pub fn joint_state(self) -> Result<JointState, String> {
        let (names, values) = (self.joint_names.len(), self.interface_values.len());
        if names != values {
            return Err(format!("it has {names} joints and the values of {values}"));
        }
        let mut state = JointState { header: self.header, ..JointState::default() };
        for (joint, InterfaceValue { interface_names, values }) in
            self.joint_names.into_iter().zip(self.interface_values)
        {
            if interface_names.len() != values.len() {
                let (names, found) = (interface_names.len(), values.len());
                return Err(format!("joint `{joint}` has {names} interfaces and {found} values"));
            }
            let value = |wanted: &str| {
                let place = interface_names.iter().position(|name| name == wanted)?;
                Some(values[place])
            };
            if let (Some(position), Some(effort)) = (value("position"), value("effort")) {
                state.name.push(joint);
                state.position.push(position);
                state.effort.push(effort);
            }
        }
        Ok(state)
    }
}

/// `rosgraph_msgs/msg/Clock`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// The time of a simulation or a replay.
    pub clock: Stamp,
}

impl Message for Clock {}

/// `geometry_msgs/msg/Wrench`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// N.
    pub force: [f64; 3],
    /// N·m.
    pub torque: [f64; 3],
}

/// `geometry_msgs/msg/WrenchStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WrenchStamped {
    /// When, and in the coordinates of which link.
    pub header: Header,
    /// The wrench.
    pub wrench: Wrench,
}

impl Message for WrenchStamped {}

/// `sensor_msgs/msg/PointField`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// Its name.
    pub name: String,
    /// Byte within a point.
    pub offset: u32,
    /// 7: `f32`.
    pub datatype: u8,
    /// Numbers.
    pub count: u32,
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// When, and in whose coordinates.
    pub header: Header,
    /// 1: the points have no order of rows.
    pub height: u32,
    /// Points.
    pub width: u32,
    /// What a point holds.
    pub fields: Vec<PointField>,
    /// Order of bytes.
    pub is_bigendian: bool,
    /// Bytes of a point.
    pub point_step: u32,
    /// Bytes of all.
    pub row_step: u32,
    /// The points.
    pub data: Vec<u8>,
    /// Whether all are finite.
    pub is_dense: bool,
}

impl Message for PointCloud2 {}

/// `PointField.FLOAT32`.
const FLOAT32: u8 = 7;

impl PointCloud2 {
    /// Points of so many named `f32` each.
    pub fn of<const N: usize>(header: Header, names: [&str; N], points: &[[f32; N]]) -> Self {
        let float = size_of::<f32>() as u32;
        let field = |(place, name): (usize, &&str)| PointField {
            name: (*name).to_owned(),
            offset: place as u32 * float,
            datatype: FLOAT32,
            count: 1,
        };
        let data: Vec<u8> =
            points.iter().flatten().flat_map(|number| number.to_le_bytes()).collect();
        Self {
            header,
            height: 1,
            width: points.len() as u32,
            fields: names.iter().enumerate().map(field).collect(),
            is_bigendian: false,
            point_step: N as u32 * float,
            row_step: data.len() as u32,
            data,
            is_dense: true,
        }
    }
}

/// `std_msgs/msg/Bool`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bool {
    /// The value.
    pub data: bool,
}

impl Message for Bool {}

/// `std_msgs/msg/String`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text {
    /// The text.
    pub data: String,
}

impl Message for Text {}

/// `diagnostic_msgs/msg/KeyValue`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 well, 1 a warning, 2 an error.
    pub level: u8,
    /// Which component reports.
    pub name: String,
    /// In a line.
    pub message: String,
    /// Of which arm.
    pub hardware_id: String,
    /// Figures.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// When.
    pub header: Header,
    /// The reports.
    pub status: Vec<DiagnosticStatus>,
}

impl Message for DiagnosticArray {}

/// The request of `std_srvs/srv/Trigger`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// A structure without a field cannot be sent.
    pub structure_needs_at_least_one_member: u8,
}

impl Message for TriggerRequest {}

/// The response of `std_srvs/srv/Trigger`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it was done.
    pub success: bool,
    /// In words.
    pub message: String,
}

impl Message for TriggerResponse {}
