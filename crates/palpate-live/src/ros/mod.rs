//! The robot's ROS 2 network: what is on it, what palpate receives there and what it publishes.
//!
//! Pure DDS by ros2-client; no ROS needs to be installed. Topics are looked at before one is
//! subscribed to: which there are, of which type, and whether they are sent reliably, since a
//! subscriber that asks for more than is offered receives nothing at all.

mod network;
mod publisher;
mod subscriber;
mod topic;

pub use network::{Network, NetworkConfig, NetworkError, Services};
pub use publisher::{Outbox, Publishers, Torques};
pub use subscriber::{JointMessage, Received, Subscriber};
pub use topic::{TopicSeen, choose};
