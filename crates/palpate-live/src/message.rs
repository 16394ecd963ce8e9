//! The ROS 2 messages that palpate sends and receives, with the fields that their packages define.
//!
//! ros2-client serializes them as CDR. Fields that palpate does not use are declared too: CDR has
//! no field names, so no field can be skipped.

use std::time::{SystemTime, UNIX_EPOCH};

use ros2_client::Message;
use serde::{Deserialize, Serialize};

mod trajectory;

pub(crate) use trajectory::{
    AskTrajectoryRequest, AskTrajectoryResponse, JointTrajectory, JointTrajectoryPoint,
};

/// `builtin_interfaces/msg/Time`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Seconds since the epoch of the clock.
    pub sec: i32,
    /// Nanoseconds in addition to the seconds.
    pub nanosec: u32,
}

impl Stamp {
    /// The present time of the system clock.
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { sec: since.as_secs() as i32, nanosec: since.subsec_nanos() }
    }

    /// A time in seconds since the epoch of the clock.
    pub fn at(seconds: f64) -> Self {
        let whole = seconds.floor();
        Self { sec: whole as i32, nanosec: ((seconds - whole) * 1e9) as u32 }
    }

    /// The time in seconds; `None` for zero, which means that the message has no stamp.
    pub fn seconds(self) -> Option<f64> {
        let seconds = f64::from(self.sec) + f64::from(self.nanosec) * 1e-9;
        (self != Self::default()).then_some(seconds)
    }
}

/// `std_msgs/msg/Header`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the data.
    pub stamp: Stamp,
    /// Coordinate frame of the data.
    pub frame_id: String,
}

/// `sensor_msgs/msg/JointState`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time of the joint state.
    pub header: Header,
    /// Joint names.
    pub name: Vec<String>,
    /// Joint positions, rad or m; empty if unknown.
    pub position: Vec<f64>,
    /// Joint velocities, rad/s or m/s; empty if unknown.
    pub velocity: Vec<f64>,
    /// Joint efforts, N·m or N; empty if unknown.
    pub effort: Vec<f64>,
}

impl Message for JointState {}

impl JointState {
    /// A joint state that contains only efforts.
    pub fn of_torques(header: Header, names: &[String], effort: Vec<f64>) -> Self {
        Self { header, name: names.to_vec(), effort, ..Self::default() }
    }
}

/// `control_msgs/msg/InterfaceValue`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct InterfaceValue {
    /// Interface names, such as `position`, `velocity` and `effort`.
    pub interface_names: Vec<String>,
    /// One value for each interface.
    pub values: Vec<f64>,
}

/// `control_msgs/msg/DynamicJointState`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct DynamicJointState {
    /// Time of the joint state.
    pub header: Header,
    /// Names of the joints, and of other components with interfaces.
    pub joint_names: Vec<String>,
    /// The interfaces of each joint, in the same order.
    pub interface_values: Vec<InterfaceValue>,
}

impl Message for DynamicJointState {}

impl DynamicJointState {
    /// The joints that have both a position and an effort.
    ///
    /// # Errors
    ///
    /// If the number of names differs from the number of values.
    pub(crate) fn joint_state(self) -> Result<JointState, String> {
        let (names, values) = (self.joint_names.len(), self.interface_values.len());
        if names != values {
            return Err(format!("it has the names of {names} joints and the values of {values}"));
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
pub(crate) struct Clock {
    /// The time of a simulation or a replay.
    pub clock: Stamp,
}

impl Message for Clock {}

/// `geometry_msgs/msg/Wrench`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Wrench {
    /// Force, N.
    pub force: [f64; 3],
    /// Torque, N·m.
    pub torque: [f64; 3],
}

/// `geometry_msgs/msg/WrenchStamped`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct WrenchStamped {
    /// Time, and the link in whose frame the wrench is given.
    pub header: Header,
    /// The wrench.
    pub wrench: Wrench,
}

impl Message for WrenchStamped {}

/// `sensor_msgs/msg/PointField`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PointField {
    /// Name of the field.
    pub name: String,
    /// Offset from the start of a point, bytes.
    pub offset: u32,
    /// Type of the values; 7 is `f32`.
    pub datatype: u8,
    /// Number of values.
    pub count: u32,
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct PointCloud2 {
    /// Time and coordinate frame.
    pub header: Header,
    /// Number of rows; 1 for an unordered cloud.
    pub height: u32,
    /// Number of points.
    pub width: u32,
    /// The fields of a point.
    pub fields: Vec<PointField>,
    /// Whether the data is big-endian.
    pub is_bigendian: bool,
    /// Size of a point, bytes.
    pub point_step: u32,
    /// Size of a row, bytes.
    pub row_step: u32,
    /// The points, as bytes.
    pub data: Vec<u8>,
    /// Whether all values are finite.
    pub is_dense: bool,
}

impl Message for PointCloud2 {}

/// `PointField.FLOAT32`.
const FLOAT32: u8 = 7;

impl PointCloud2 {
    /// A cloud whose points have `N` named `f32` values.
    pub(crate) fn of<const N: usize>(
        header: Header,
        names: [&str; N],
        points: &[[f32; N]],
    ) -> Self {
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
pub(crate) struct Bool {
    /// The value.
    pub data: bool,
}

impl Message for Bool {}

/// `std_msgs/msg/String`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Text {
    /// The text.
    pub data: String,
}

impl Message for Text {}

/// `diagnostic_msgs/msg/KeyValue`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct KeyValue {
    /// Name of the value.
    pub key: String,
    /// The value, as text.
    pub value: String,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct DiagnosticStatus {
    /// 0: OK, 1: warning, 2: error.
    pub level: u8,
    /// The component that reports.
    pub name: String,
    /// Summary in one line.
    pub message: String,
    /// Name of the robot.
    pub hardware_id: String,
    /// Names and values.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct DiagnosticArray {
    /// Time of the report.
    pub header: Header,
    /// One status for each component.
    pub status: Vec<DiagnosticStatus>,
}

impl Message for DiagnosticArray {}

/// The request of `std_srvs/srv/Trigger`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct TriggerRequest {
    /// Placeholder: a message must have a field.
    pub structure_needs_at_least_one_member: u8,
}

impl Message for TriggerRequest {}

/// The response of `std_srvs/srv/Trigger`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct TriggerResponse {
    /// Whether the request was carried out.
    pub success: bool,
    /// Explanation for the user.
    pub message: String,
}

impl Message for TriggerResponse {}
