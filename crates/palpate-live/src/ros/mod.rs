//! The ROS 2 network: discovers topics, receives joint states, publishes, and offers services.
//!
//! Uses DDS directly, through ros2-client; no ROS needs to be installed. Topics are discovered
//! before one is subscribed to, with their type and reliability: a subscriber that requests
//! reliable delivery from a best-effort publisher receives nothing.
//!
//! All of it runs in a separate process, the network process.

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

pub use names::TopicNames;
pub use network::{NetworkConfig, NetworkError, ServiceEncoding};
pub use parameters::{ParamValue, Parameter};
pub use process::run as run_network;
pub use publisher::FlagTopics;
pub(crate) use supervisor::Listener;
pub use supervisor::NetworkProcess;
pub use topic::{TopicSeen, choose};
pub(crate) use wire::{
    Arrival, Counts, FromNetwork, PendingRequest, Request, Response, ToNetwork, TorqueMessage,
    Trigger,
};
