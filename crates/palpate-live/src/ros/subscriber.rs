//! What palpate receives: joint states, and requests for a tare or to take the guard's flag back.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use ros2_client::gid::Gid;
use ros2_client::qos::WhenFull;
use ros2_client::service::Server;
use ros2_client::{MessageTypeName, QosProfile, ServiceTypeName, Subscription};
use rustdds::mio1::{Events, Interest, Poll, Token};

use super::network::{Network, NetworkError, parse};
use super::topic::TopicSeen;
use super::wire::{Arrival, Asked, FromNetwork, Service};
use crate::message::{JointState, Text, TriggerRequest, TriggerResponse};

/// Messages that may wait within DDS before the oldest are lost: two seconds of the fastest arms.
const DEPTH: usize = 2048;

/// Numbers of the largest joint state, and bytes of the longest name in it: so many may wait.
const MOST_JOINTS: usize = 1000;
const LONGEST_NAME: usize = 256;

/// Between two looks at a topic on which a text is awaited.
const PEEK: Duration = Duration::from_millis(200);

/// Broken messages looked at in a row.
const MOST_BROKEN: u32 = 1000;

/// The joint states, and the services.
pub(super) struct Subscriber {
    joints: Subscription<JointState>,
    tare: Server<TriggerRequest, TriggerResponse>,
    reset: Server<TriggerRequest, TriggerResponse>,
    poll: Poll,
    /// Number of the last message of each publisher.
    last: HashMap<Gid, i64>,
    received: u64,
    lost: u64,
}

impl Network {
    /// Subscribes to a topic of joint states, and offers the services that take a tare and reset the
    /// guard.
    ///
    /// # Errors
    ///
    /// If its name is none, or DDS refuses.
    pub(super) fn subscribe(&mut self, topic: &TopicSeen) -> Result<Subscriber, NetworkError> {
        let history = ros2_client::qos::History::KeepLast { depth: DEPTH };
        let mut qos = QosProfile::subscription_default().history(history);
        if topic.reliable {
            qos = qos.reliability_reliable(WhenFull::DEFAULT);
        }
        let kind = MessageTypeName::new("sensor_msgs", "JointState");
        let opened = self
            .node
            .create_topic(&parse(&topic.name)?, kind, &qos)
            .and_then(|topic| self.node.create_subscription::<JointState>(&topic, Some(qos)));
        let mut joints = opened.map_err(|error| NetworkError::open(&topic.name, &error))?;

        let mut tare = self.serve("/palpate/tare")?;
        let mut reset = self.serve("/palpate/reset")?;
        let failed = |error| NetworkError::open(&topic.name, &error);
        let poll = Poll::new().map_err(failed)?;
        let registry = poll.registry();
        registry
            .register(&mut joints, Token(0), Interest::READABLE)
            .and_then(|()| registry.register(&mut tare, Token(1), Interest::READABLE))
            .and_then(|()| registry.register(&mut reset, Token(2), Interest::READABLE))
            .map_err(failed)?;
        let last = HashMap::new();
        Ok(Subscriber { joints, tare, reset, poll, last, received: 0, lost: 0 })
    }

    /// A text that somebody keeps on a topic for those who come late, if it comes within so long.
    ///
    /// # Errors
    ///
    /// If the topic's name is none, or DDS refuses.
    pub(super) fn kept(
        &mut self,
        topic: &str,
        patience: Duration,
    ) -> Result<Option<String>, NetworkError> {
        let qos = QosProfile::subscription_default()
            .history(ros2_client::qos::History::KeepLast { depth: 1 })
            .durability(ros2_client::qos::Durability::TransientLocal)
            .reliability_reliable(WhenFull::DEFAULT);
        let kind = MessageTypeName::new("std_msgs", "String");
        let failed = |error: &dyn std::fmt::Display| NetworkError::open(topic, &error);
        let opened = self
            .node
            .create_topic(&parse(topic)?, kind, &qos)
            .and_then(|topic| self.node.create_subscription::<Text>(&topic, Some(qos)));
        let mut texts = opened.map_err(|error| failed(&error))?;
        let mut poll = Poll::new().map_err(|error| failed(&error))?;
        let registered = poll.registry().register(&mut texts, Token(0), Interest::READABLE);
        registered.map_err(|error| failed(&error))?;
        self.confine()?;
        let until = Instant::now() + patience;
        loop {
            if let Ok(Some((text, _))) = texts.take() {
                return Ok(Some(text.data));
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            // Interrupted by a signal, it is asked again at once; a change that DDS does not tell of is seen soon.
            let _ = poll.poll(&mut Events::with_capacity(4), Some(left.min(PEEK)));
        }
    }

    /// Offers a service that is asked for nothing but to do it.
    fn serve(
        &mut self,
        service: &str,
    ) -> Result<Server<TriggerRequest, TriggerResponse>, NetworkError> {
        let reliable = QosProfile::publisher_default();
        let served = self.node.create_server(
            self.services.mapping(),
            &parse(service)?,
            &ServiceTypeName::new("std_srvs", "Trigger"),
            reliable.clone(),
            reliable,
        );
        served.map_err(|error| NetworkError::open(service, &error))
    }
}

impl Subscriber {
    /// Waits for at most so long, and hands on all that came meanwhile to a process that began at
    /// `start`.
    pub(super) fn receive(
        &mut self,
        patience: Duration,
        start: Instant,
        mut hand_on: impl FnMut(FromNetwork),
    ) {
        let mut events = Events::with_capacity(4);
        // Interrupted by a signal, it is asked again at once.
        let _ = self.poll.poll(&mut events, Some(patience));
        let mut broken = 0;
        while broken < MOST_BROKEN {
            let state = match self.joints.take() {
                Ok(Some((state, info))) => {
                    self.count(info.publisher_gid(), info.sequence_number());
                    check_size(state)
                }
                Ok(None) => break,
                Err(error) => {
                    broken += 1;
                    Err(error.to_string())
                }
            };
            hand_on(FromNetwork::Joints { state, came: Arrival::now(start) });
        }
        for service in [Service::Tare, Service::Reset] {
            while let Ok(Some((id, _))) = self.server(service).receive_request() {
                hand_on(FromNetwork::Asked(Asked { service, id }));
            }
        }
    }

    /// Answers a request.
    pub(super) fn answer(&self, Asked { service, id }: Asked, response: TriggerResponse) {
        let _ = self.server(service).send_response(id, response); // the client may have left
    }

    fn server(&self, service: Service) -> &Server<TriggerRequest, TriggerResponse> {
        match service {
            Service::Tare => &self.tare,
            Service::Reset => &self.reset,
        }
    }

    /// Messages that came, and those that never did although later ones of the same publisher did.
    pub(super) fn counts(&self) -> (u64, u64) {
        (self.received, self.lost)
    }

    fn count(&mut self, publisher: Gid, number: i64) {
        self.received += 1;
        if let Some(last) = self.last.insert(publisher, number) {
            self.lost += u64::try_from(number - last - 1).unwrap_or(0);
        }
    }
}

/// A joint state without what nobody reads, or why it is none.
fn check_size(mut state: JointState) -> Result<JointState, String> {
    let most = state.name.len().max(state.position.len()).max(state.effort.len());
    if most > MOST_JOINTS || state.name.iter().any(|name| name.len() > LONGEST_NAME) {
        return Err(format!(
            "it has {most} numbers or names, of which some may be long; wanted at most \
             {MOST_JOINTS}, and names of at most {LONGEST_NAME} bytes"
        ));
    }
    state.velocity = Vec::new();
    state.header.frame_id = String::new();
    Ok(state)
}
