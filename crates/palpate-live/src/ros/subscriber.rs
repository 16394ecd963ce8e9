//! What palpate receives: joint states and requests for a tare, on a thread that never waits for the
//! mapper.

use std::collections::HashMap;
use std::fmt::Display;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ros2_client::gid::Gid;
use ros2_client::qos::WhenFull;
use ros2_client::service::Server;
use ros2_client::{MessageTypeName, QosProfile, ServiceTypeName, Subscription};
use rustdds::mio1::{Events, Interest, Poll, Token};

use super::network::{Network, NetworkError, parse};
use super::topic::TopicSeen;
use crate::message::{JointState, TriggerRequest, TriggerResponse};

/// Messages that may wait within DDS before the oldest are lost: two seconds of the fastest arms.
const DEPTH: usize = 2048;

/// Broken messages looked at in a row.
const MOST_BROKEN: u32 = 1000;

/// What was received.
#[derive(Debug)]
pub enum Received {
    /// A joint state.
    Joints(JointMessage),
    /// Somebody asks for a tare.
    Tare,
}

/// A joint state as it came.
#[derive(Debug)]
pub struct JointMessage {
    /// What it says, or why it cannot be decoded: it has another shape than its type.
    pub state: Result<JointState, String>,
    /// When it came.
    pub at: Instant,
    /// The same by the system's clock, s.
    pub at_s: f64,
}

/// The joint states, and the service that takes a tare.
pub struct Subscriber {
    joints: Subscription<JointState>,
    tare: Server<TriggerRequest, TriggerResponse>,
    poll: Poll,
    /// Number of the last message of each publisher.
    last: HashMap<Gid, i64>,
    received: u64,
    lost: u64,
}

impl Network {
    /// Subscribes to a topic of joint states, and offers the service that takes a tare.
    ///
    /// # Errors
    ///
    /// If its name is none, or DDS refuses.
    pub fn subscribe(&mut self, topic: &TopicSeen) -> Result<Subscriber, NetworkError> {
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

        let service = "/palpate/tare";
        let failed = |error: &dyn Display| NetworkError::open(service, &error);
        let reliable = QosProfile::publisher_default();
        let mut tare = self
            .node
            .create_server(
                self.services.mapping(),
                &parse(service)?,
                &ServiceTypeName::new("std_srvs", "Trigger"),
                reliable.clone(),
                reliable,
            )
            .map_err(|error| failed(&error))?;
        let poll = Poll::new().map_err(|error| failed(&error))?;
        let registry = poll.registry();
        registry
            .register(&mut joints, Token(0), Interest::READABLE)
            .and_then(|()| registry.register(&mut tare, Token(1), Interest::READABLE))
            .map_err(|error| failed(&error))?;
        Ok(Subscriber { joints, tare, poll, last: HashMap::new(), received: 0, lost: 0 })
    }
}

impl Subscriber {
    /// Waits for at most so long, and hands on all that came meanwhile.
    pub fn receive(&mut self, patience: Duration, mut hand_on: impl FnMut(Received)) {
        let mut events = Events::with_capacity(4);
        // Interrupted by a signal, it is asked again at once.
        let _ = self.poll.poll(&mut events, Some(patience));
        let mut broken = 0;
        while broken < MOST_BROKEN {
            let state = match self.joints.take() {
                Ok(Some((state, info))) => {
                    self.count(info.publisher_gid(), info.sequence_number());
                    Ok(state)
                }
                Ok(None) => break,
                Err(error) => {
                    broken += 1;
                    Err(error.to_string())
                }
            };
            hand_on(Received::Joints(JointMessage { state, at: Instant::now(), at_s: now_s() }));
        }
        while let Ok(Some((id, _))) = self.tare.receive_request() {
            hand_on(Received::Tare);
            let message = "hold the arm still and free of the object for at least five samples; \
                           the tare ends when it moves"
                .to_owned();
            // The client may have left.
            let _ = self.tare.send_response(id, TriggerResponse { success: true, message });
        }
    }

    /// Messages that came, and those that never did although later ones of the same publisher did.
    pub fn counts(&self) -> (u64, u64) {
        (self.received, self.lost)
    }

    fn count(&mut self, publisher: Gid, number: i64) {
        self.received += 1;
        if let Some(last) = self.last.insert(publisher, number) {
            self.lost += u64::try_from(number - last - 1).unwrap_or(0);
        }
    }
}

/// Time of the system's clock, s.
fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
