//! What comes in: joint states and requests, on one thread that never waits for the mapper.

use std::collections::HashMap;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ros2_client::gid::Gid;
use ros2_client::qos::WhenFull;
use ros2_client::service::Server;
use ros2_client::{MessageTypeName, QosProfile, ServiceTypeName, Subscription};
use rustdds::mio1::{Events, Interest, Poll, Token};

use super::{Network, NetworkError, TopicSeen, parse};
use crate::message::{JointState, TriggerRequest, TriggerResponse};

/// Messages that may wait within DDS before the oldest are lost: two seconds of the fastest arms.
const DEPTH: usize = 2048;

/// Broken messages looked at in a row.
const MOST_BROKEN: u32 = 1000;

/// Something that was heard.
#[derive(Debug)]
pub enum Received {
    /// A joint state, when it came, and that as s of the system's clock.
    Joints(JointState, Instant, f64),
    /// Somebody asks for a tare.
    Tare,
    /// A message of another shape than its type says.
    Broken(String),
}

/// Listens to the joint states and to the service that asks for a tare.
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
    /// Begins to listen to a topic of joint states.
    ///
    /// # Errors
    ///
    /// If its name is none, or DDS refuses.
    pub fn listen(&mut self, topic: &TopicSeen) -> Result<Subscriber, NetworkError> {
        let history = ros2_client::qos::History::KeepLast { depth: DEPTH };
        let mut qos = QosProfile::subscription_default().history(history);
        if topic.reliable {
            qos = qos.reliability_reliable(WhenFull::DEFAULT);
        }
        let failed = |why: String| NetworkError::Open { topic: topic.name.clone(), why };
        let kind = MessageTypeName::new("sensor_msgs", "JointState");
        let opened = self
            .node
            .create_topic(&parse(&topic.name)?, kind, &qos)
            .and_then(|topic| self.node.create_subscription::<JointState>(&topic, Some(qos)));
        let mut joints = opened.map_err(|error| failed(error.to_string()))?;

        let reliable = QosProfile::publisher_default();
        let mut tare = self
            .node
            .create_server(
                self.services.mapping(),
                &parse("/palpate/tare")?,
                &ServiceTypeName::new("std_srvs", "Trigger"),
                reliable.clone(),
                reliable,
            )
            .map_err(|error| failed(error.to_string()))?;
        let poll = Poll::new().map_err(|error| failed(error.to_string()))?;
        let registry = poll.registry();
        registry
            .register(&mut joints, Token(0), Interest::READABLE)
            .and_then(|()| registry.register(&mut tare, Token(1), Interest::READABLE))
            .map_err(|error| failed(error.to_string()))?;
        Ok(Subscriber { joints, tare, poll, last: HashMap::new(), received: 0, lost: 0 })
    }
}

impl Subscriber {
    /// Waits for at most so long, and hands on all that came meanwhile.
    pub fn listen(&mut self, patience: Duration, mut hear: impl FnMut(Received)) {
        let mut events = Events::with_capacity(4);
        // Interrupted by a signal, it is asked again at once.
        let _ = self.poll.poll(&mut events, Some(patience));
        let mut broken = 0;
        while broken < MOST_BROKEN {
            match self.joints.take() {
                Ok(Some((state, info))) => {
                    self.count(info.publisher_gid(), info.sequence_number());
                    hear(Received::Joints(state, Instant::now(), now_s()));
                }
                Ok(None) => break,
                Err(error) => {
                    broken += 1;
                    hear(Received::Broken(error.to_string()));
                }
            }
        }
        while let Ok(Some((id, _))) = self.tare.receive_request() {
            hear(Received::Tare);
            let message = "hold the arm still and free of the object for at least five samples; \
                           the tare ends when it moves"
                .to_owned();
            // Whoever asked may have left.
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
