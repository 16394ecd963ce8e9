//! Messages of `trajectory_msgs`, and palpate's service `AskTrajectory`.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

use super::{Header, Stamp};

/// `trajectory_msgs/msg/JointTrajectoryPoint`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct JointTrajectoryPoint {
    /// Joint positions, rad or m.
    pub positions: Vec<f64>,
    /// Joint velocities, rad/s or m/s; empty if unknown.
    pub velocities: Vec<f64>,
    /// Joint accelerations, rad/s² or m/s²; empty if unknown.
    pub accelerations: Vec<f64>,
    /// Joint efforts, N·m or N; empty if unknown.
    pub effort: Vec<f64>,
    /// `builtin_interfaces/msg/Duration`, which has the same fields as a stamp.
    pub time_from_start: Stamp,
}

/// `trajectory_msgs/msg/JointTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct JointTrajectory {
    /// Time and coordinate frame.
    pub header: Header,
    /// Joint names, in the order of the numbers of every point.
    pub joint_names: Vec<String>,
    /// The points.
    pub points: Vec<JointTrajectoryPoint>,
}

/// The request of `palpate_ros/srv/AskTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct AskTrajectoryRequest {
    /// The trajectory: positions of all joints at every point, in any order of joints.
    pub trajectory: JointTrajectory,
    /// Level of the band, from 0 to below 1; 0 stands for the default level of the field.
    pub level: f64,
}

impl Message for AskTrajectoryRequest {}

/// The response of `palpate_ros/srv/AskTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct AskTrajectoryResponse {
    /// Whether the request was answered.
    pub success: bool,
    /// The reason if it was not answered.
    pub message: String,
    /// The trajectory, with the predicted external torque as effort, N·m.
    pub predicted: JointTrajectory,
    /// The trajectory, with the half-width of the band as effort, N·m; without points if the field has no
    /// bands.
    pub half_width: JointTrajectory,
    /// Level of the band; 0 if the field has no bands.
    pub level: f64,
    /// Largest absolute predicted torque over joints and points, N·m.
    pub peak: f64,
    /// Largest absolute predicted torque plus half-width of the band for the largest torque of the path,
    /// N·m; equals `peak` if the field has no bands.
    pub peak_with_band: f64,
    /// Number of cells touched, at every point.
    pub contacts: Vec<u32>,
    /// Number of these cells that were touched when the field was learnt.
    pub known: Vec<u32>,
    /// Whether the trajectory continues from the present contacts of the arm.
    pub goes_on: bool,
}

impl Message for AskTrajectoryResponse {}
