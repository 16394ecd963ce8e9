//! The robot's ROS 2 network: what is on it, what palpate receives there and what it publishes.
//!
//! Pure DDS by ros2-client; no ROS needs to be installed. Topics are looked at before one is
//! subscribed to: which there are, of which type, and whether they are sent reliably, since a
//! subscriber that asks for more than is offered receives nothing at all.
//!
//! All of it runs in a process of its own, the network process.

mod clock;
mod loopback;
mod names;
mod network;
mod parameters;
mod process;
mod publisher;
mod servers;
mod subscriber;
mod supervisor;
mod topic;
mod wire;

pub use names::Names;
pub use network::{NetworkConfig, NetworkError, Services};
pub use parameters::{Parameter, Value};
pub use process::run as run_network;
pub use publisher::FlagTopics;
pub(crate) use supervisor::Listener;
pub use supervisor::NetworkProcess;
pub use topic::{TopicSeen, choose};
pub(crate) use wire::{
    Arrival, Asked, Counts, FromNetwork, Request, Response, ToNetwork, Torques, Trigger,
};
