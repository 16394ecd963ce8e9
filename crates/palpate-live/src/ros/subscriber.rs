//! palpate's subscriptions: joint states, of either type, and the time of a simulation.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use ros2_client::gid::Gid;
use ros2_client::qos::{History, WhenFull};
use ros2_client::ros2::ReadError;
use ros2_client::{MessageInfo, MessageTypeName, QosProfile, Subscription};
use rustdds::mio1::{Events, Interest, Poll, Registry, Token};

use super::clock::RosClock;
use super::network::{Network, NetworkError, parse};
use super::servers::Servers;
use super::topic::TopicSeen;
use super::wire::{Arrival, FromNetwork};
use crate::message::{Clock, DynamicJointState, JointState, Text};

/// Largest number of messages that wait within DDS; beyond, the oldest are lost. Two seconds at 1 kHz.
const DEPTH: usize = 2048;

/// Largest number of values or names of a joint state.
const MAX_JOINTS: usize = 1000;
/// Largest length of a joint name, bytes.
const LONGEST_NAME: usize = 256;

/// Interval between checks of a topic while waiting for a text.
const PEEK: Duration = Duration::from_millis(200);

/// Largest number of broken messages read in one call.
const MAX_BROKEN: u32 = 1000;

/// Subscriptions to joint states, and to `/clock` if time is simulated.
pub(super) struct Subscriber {
    joints: Joints,
    clock: Option<Subscription<Clock>>,
    now: RosClock,
    poll: Poll,
    /// Sequence number of the last message of each publisher.
    last: HashMap<Gid, i64>,
    received: u64,
    lost: u64,
}

/// A joint state, or why it cannot be decoded, with its publisher and sequence number.
type Taken = (Result<JointState, String>, MessageInfo);

/// A subscription to joint states, of either type.
enum Joints {
    Plain(Subscription<JointState>),
    Dynamic(Subscription<DynamicJointState>),
}

impl Joints {
    /// Takes the next message, if there is one.
    fn take(&self) -> Result<Option<Taken>, ReadError> {
        let plain = |(state, info)| (Ok(state), info);
        let dynamic = |(state, info): (DynamicJointState, _)| (state.joint_state(), info);
        match self {
            Self::Plain(joints) => Ok(joints.take()?.map(plain)),
            Self::Dynamic(joints) => Ok(joints.take()?.map(dynamic)),
        }
    }

    fn register(&mut self, registry: &Registry) -> std::io::Result<()> {
        match self {
            Self::Plain(joints) => registry.register(joints, JOINTS, Interest::READABLE),
            Self::Dynamic(joints) => registry.register(joints, JOINTS, Interest::READABLE),
        }
    }
}

/// Sources that wake the subscriber.
const JOINTS: Token = Token(0);
const SERVICES: Token = Token(1);
const CLOCK: Token = Token(2);

impl Network {
    /// Subscribes to a topic of joint states, and to `/clock` if time is simulated. Requests to `servers` wake the
    /// subscriber too.
    ///
    /// # Errors
    ///
    /// If a name is not allowed in ROS, or DDS refuses.
    pub(super) fn subscribe(
        &mut self,
        topic: &TopicSeen,
        servers: &mut Servers,
    ) -> Result<Subscriber, NetworkError> {
        let history = History::KeepLast { depth: DEPTH };
        let mut qos = QosProfile::subscription_default().history(history);
        if topic.reliable {
            qos = qos.reliability_reliable(WhenFull::DEFAULT);
        }
        let name = &topic.name;
        let mut joints = match topic.is_dynamic() {
            true => Joints::Dynamic(self.subscription(
                name,
                ("control_msgs", "DynamicJointState"),
                &qos,
            )?),
            false => Joints::Plain(self.subscription(name, ("sensor_msgs", "JointState"), &qos)?),
        };
        let latest = QosProfile::subscription_default().history(History::KeepLast { depth: 1 });
        let clock = self.names.of("/clock");
        let now = self.clock.clone();
        let mut clock = match now.is_simulated() {
            true => Some(self.subscription(&clock, ("rosgraph_msgs", "Clock"), &latest)?),
            false => None,
        };
        let failed = |error| NetworkError::open(name, &error);
        let poll = Poll::new().map_err(failed)?;
        let registry = poll.registry();
        joints.register(registry).map_err(failed)?;
        servers.register(registry, SERVICES).map_err(failed)?;
        if let Some(clock) = &mut clock {
            registry.register(clock, CLOCK, Interest::READABLE).map_err(failed)?;
        }
        let last = HashMap::new();
        Ok(Subscriber { joints, clock, now, poll, last, received: 0, lost: 0 })
    }

    fn subscription<M: 'static>(
        &mut self,
        topic: &str,
        (package, kind): (&str, &str),
        qos: &QosProfile,
    ) -> Result<Subscription<M>, NetworkError> {
        let opened = self
            .node
            .create_topic(&parse(topic)?, MessageTypeName::new(package, kind), qos)
            .and_then(|topic| self.node.create_subscription::<M>(&topic, Some(qos.clone())));
        opened.map_err(|error| NetworkError::open(topic, &error))
    }

    /// Receives a latched text (transient local) from a topic; `None` if none comes within `patience`.
    ///
    /// # Errors
    ///
    /// If the topic's name is not allowed in ROS, or DDS refuses.
    pub(super) fn latched_text(
        &mut self,
        topic: &str,
        patience: Duration,
    ) -> Result<Option<String>, NetworkError> {
        let qos = QosProfile::subscription_default()
            .history(History::KeepLast { depth: 1 })
            .durability(ros2_client::qos::Durability::TransientLocal)
            .reliability_reliable(WhenFull::DEFAULT);
        let failed = |error: &dyn std::fmt::Display| NetworkError::open(topic, &error);
        let mut texts = self.subscription::<Text>(topic, ("std_msgs", "String"), &qos)?;
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
            // An interruption by a signal only repeats the loop. The short wait also finds messages without an event.
            let _ = poll.poll(&mut Events::with_capacity(4), Some(left.min(PEEK)));
        }
    }
}

impl Subscriber {
    /// Waits for at most `patience`, or until a message or a request comes, and hands on all waiting joint states.
    /// `start` is when the process began.
    pub(super) fn receive(
        &mut self,
        patience: Duration,
        start: Instant,
        mut hand_on: impl FnMut(FromNetwork),
    ) {
        let mut events = Events::with_capacity(4);
        // After an interruption by a signal, the caller simply calls again.
        let _ = self.poll.poll(&mut events, Some(patience));
        while let Some(Ok(Some((clock, _)))) = self.clock.as_ref().map(Subscription::take) {
            self.now.set(clock);
        }
        let mut broken = 0;
        while broken < MAX_BROKEN {
            let state = match self.joints.take() {
                Ok(Some((state, info))) => {
                    self.count(info.publisher_gid(), info.sequence_number());
                    state.and_then(check_size)
                }
                Ok(None) => break,
                Err(error) => {
                    broken += 1;
                    Err(error.to_string())
                }
            };
            let came = Arrival { since_start: start.elapsed(), at_s: self.now.now_s() };
            hand_on(FromNetwork::Joints { state, came });
        }
    }

    /// Numbers of messages received, and of those lost: missing although later ones of the same publisher came.
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

/// Refuses a joint state that is too large; removes the values that are not used.
fn check_size(mut state: JointState) -> Result<JointState, String> {
    let most = state.name.len().max(state.position.len()).max(state.effort.len());
    if most > MAX_JOINTS || state.name.iter().any(|name| name.len() > LONGEST_NAME) {
        return Err(format!(
            "it has {most} names, positions or efforts, or a name is too long; wanted at most \
             {MAX_JOINTS}, and names of at most {LONGEST_NAME} bytes"
        ));
    }
    state.velocity = Vec::new();
    state.header.frame_id = String::new();
    Ok(state)
}
