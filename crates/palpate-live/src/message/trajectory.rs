//! `trajectory_msgs`, and the service of palpate's own that asks about a trajectory.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

use super::{Header, Stamp};

/// `trajectory_msgs/msg/JointTrajectoryPoint`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// rad or m.
    pub positions: Vec<f64>,
    /// rad/s or m/s; empty if unknown.
    pub velocities: Vec<f64>,
    /// rad/s² or m/s²; empty if unknown.
    pub accelerations: Vec<f64>,
    /// N·m or N; empty if unknown.
    pub effort: Vec<f64>,
    /// `builtin_interfaces/msg/Duration`, which is laid out as a stamp.
    pub time_from_start: Stamp,
}

/// `trajectory_msgs/msg/JointTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// When, and in whose coordinates.
    pub header: Header,
    /// The joints, in the order of all numbers.
    pub joint_names: Vec<String>,
    /// The points.
    pub points: Vec<JointTrajectoryPoint>,
}

/// The request of `palpate_ros/srv/AskTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AskTrajectoryRequest {
    /// Positions of all joints at every point, by name.
    pub trajectory: JointTrajectory,
    /// Level of the band, 0 to 1; 0 is the field's default.
    pub level: f64,
}

impl Message for AskTrajectoryRequest {}

/// The response of `palpate_ros/srv/AskTrajectory`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AskTrajectoryResponse {
    /// Whether there is an answer.
    pub success: bool,
    /// Why there is none.
    pub message: String,
    /// The trajectory, with the predicted external torque as effort, N·m.
    pub predicted: JointTrajectory,
    /// The same with the half-width of the band as effort, N·m; without points if the field has no bands.
    pub half_width: JointTrajectory,
    /// Level of the band; 0 without one.
    pub level: f64,
    /// The largest predicted torque of a joint, N·m, without sign.
    pub peak: f64,
    /// The largest at the outer end of the band for largest torques, N·m; as `peak` without bands.
    pub peak_with_band: f64,
    /// Points of the lattice touched, at every point.
    pub contacts: Vec<u32>,
    /// Those of them that were touched when the field was learnt.
    pub known: Vec<u32>,
    /// Whether the trajectory goes on from what the arm touches now.
    pub goes_on: bool,
}

impl Message for AskTrajectoryResponse {}
