//! palpate's node on a ROS 2 network, and the discovery of topics.

use std::fmt::Display;
use std::net::{IpAddr, Ipv4Addr};

use ros2_client::{Context, Name, Node, NodeName, NodeOptions, ServiceMapping};
use rustdds::DomainParticipantBuilder;
use rustdds::policy::Reliability;
use serde::{Deserialize, Serialize};

use super::clock::RosClock;
use super::loopback;
use super::names::TopicNames;
use super::topic::TopicSeen;

/// Settings for joining the network.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NetworkConfig {
    /// DDS domain, `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// Communicate with processes on this machine only.
    pub localhost: bool,
    /// Wire format of service requests.
    pub services: ServiceEncoding,
    /// Names of node and topics.
    pub names: TopicNames,
    /// Whether to take the time from `/clock`.
    pub sim_time: bool,
}

/// Wire format of service requests, which differs between DDS implementations of ROS 2.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ServiceEncoding {
    /// Of `rmw_fastrtps_cpp` and `rmw_connextdds`: the request id is sent beside the data.
    #[default]
    Enhanced,
    /// Of `rmw_cyclonedds_cpp`: the request id is sent within the data.
    Cyclone,
}

impl ServiceEncoding {
    pub(super) fn mapping(self) -> ServiceMapping {
        match self {
            Self::Enhanced => ServiceMapping::Enhanced,
            Self::Cyclone => ServiceMapping::Cyclone,
        }
    }
}

/// Why the network cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum NetworkError {
    #[error(
        "DDS domain {domain} cannot be joined: {why}; is there a network interface, and is the domain from 0 to 232?"
    )]
    Join { domain: u16, why: String },
    #[error("`{topic}` cannot be a name in ROS: {why}")]
    Name { topic: String, why: String },
    #[error("`{topic}` cannot be opened: {why}")]
    Open { topic: String, why: String },
    #[error("sockets cannot be bound to the loopback interface (--localhost): {why}")]
    Localhost { why: String },
    #[error(
        "there is no file `{topic}`, and nobody has published a robot's description on this topic \
         (std_msgs/msg/String) within {seconds} s; is robot_state_publisher running, and is the domain (--domain, ROS_DOMAIN_ID) right?"
    )]
    NoDescription { topic: String, seconds: u64 },
    /// An error message from the network process.
    #[error("{why}")]
    Failed { why: String },
    #[error("the network process cannot be used: {why}")]
    Process { why: String },
    /// A thread panicked; the panic has printed its message.
    #[error("the session ended because of a defect of palpate, in the thread `{thread}`")]
    Defect { thread: String },
}

impl NetworkError {
    pub(super) fn process(why: &impl Display) -> Self {
        Self::Process { why: why.to_string() }
    }

    pub(super) fn open(topic: &str, why: &impl Display) -> Self {
        Self::Open { topic: topic.to_owned(), why: why.to_string() }
    }
}

/// palpate's node.
pub(super) struct Network {
    context: Context,
    pub(super) node: Node,
    pub(super) services: ServiceEncoding,
    pub(super) names: TopicNames,
    pub(super) clock: RosClock,
    localhost: bool,
}

/// Largest DDS domain: higher ones would need ports above 65535.
const MAX_DOMAIN: u16 = 232;

impl Network {
    /// Joins the network.
    ///
    /// # Errors
    ///
    /// If there is no network, the domain is too large, or a name is not allowed in ROS.
    pub(super) fn join(config: &NetworkConfig) -> Result<Self, NetworkError> {
        let failed =
            |why: &dyn Display| NetworkError::Join { domain: config.domain, why: why.to_string() };
        if config.domain > MAX_DOMAIN {
            return Err(failed(&"there is no such domain"));
        }
        let mut builder = DomainParticipantBuilder::new(config.domain);
        if config.localhost {
            builder = builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let participant = builder.build().map_err(|error| failed(&error))?;
        let context =
            Context::from_domain_participant(participant).map_err(|error| failed(&error))?;
        let names = config.names.clone();
        let namespace = if names.namespace.is_empty() { "/" } else { &names.namespace };
        let name = NodeName::new(namespace, &names.node).map_err(|why| NetworkError::Name {
            topic: format!("{namespace} {}", names.node),
            why: format!("{why:?}"),
        })?;
        let options = NodeOptions::new().enable_rosout(false);
        let node = context.new_node(name, options).map_err(|error| failed(&error))?;
        let (services, localhost) = (config.services, config.localhost);
        let clock = RosClock::new(config.sim_time);
        Ok(Self { context, node, services, names, clock, localhost })
    }

    /// With `localhost`, binds all sockets opened so far to the loopback interface.
    ///
    /// # Errors
    ///
    /// If the system refuses.
    pub(super) fn confine(&self) -> Result<(), NetworkError> {
        if !self.localhost {
            return Ok(());
        }
        loopback::bind_all().map_err(|error| NetworkError::Localhost { why: error.to_string() })
    }

    /// The topics with a publisher, sorted by name, without palpate's own.
    pub(super) fn topics(&self) -> Vec<TopicSeen> {
        let writers = self.context.domain_participant().discovered_writers();
        let mut topics: Vec<TopicSeen> = Vec::new();
        for writer in writers {
            let data = &writer.publication_topic_data;
            // Reliable is the default of publishers.
            let reliable = data.reliability != Some(Reliability::BestEffort);
            let Some(seen) = TopicSeen::of_dds(&data.topic_name, &data.type_name, reliable) else {
                continue;
            };
            match topics
                .iter_mut()
                .find(|other| (&other.name, &other.kind) == (&seen.name, &seen.kind))
            {
                Some(other) => other.reliable &= seen.reliable,
                None => topics.push(seen),
            }
        }
        topics.retain(|topic| !self.names.are_own(&topic.name));
        topics.sort_by(|a, b| a.name.cmp(&b.name));
        topics
    }
}

/// Parses the name of a topic or service.
pub(super) fn parse(topic: &str) -> Result<Name, NetworkError> {
    Name::parse(topic)
        .map_err(|why| NetworkError::Name { topic: topic.to_owned(), why: format!("{why:?}") })
}
