//! What palpate publishes: torques, contacts, field and diagnostics, on a thread of its own.
//!
//! Nothing here waits for a subscriber. Torques queue up to a bound and the oldest leave; of clouds
//! and diagnostics only the latest is kept; the flag to stop goes before all of them. A message for
//! which DDS has no room, since a reliable subscriber does not keep up, is counted and left out.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{MessageTypeName, Publisher, QosProfile};
use serde::Serialize;

use super::network::{Network, NetworkError, parse};
use crate::inbox::Inbox;
use crate::message::{Bool, DiagnosticArray, Header, JointState, PointCloud2};

/// Torques that may wait.
const TORQUES: usize = 256;

/// The torques of a sample.
#[derive(Debug, Clone)]
pub struct Torques {
    /// Stamp of the sample.
    pub header: Header,
    /// When the sample came.
    pub received: Instant,
    /// τ_ext, n_joints, N·m.
    pub external_n_m: Vec<f64>,
    /// τ̂, n_joints, N·m.
    pub predicted_n_m: Vec<f64>,
}

/// What waits to be published.
#[derive(Debug)]
pub struct Outbox {
    /// The torques of samples.
    pub torques: Inbox<Torques>,
    /// What the arm touches now.
    pub contacts: Inbox<PointCloud2>,
    /// The field near it.
    pub field: Inbox<PointCloud2>,
    /// How it goes.
    pub diagnostics: Inbox<DiagnosticArray>,
    flag: AtomicBool,
    unsent: AtomicU64,
}

impl Default for Outbox {
    fn default() -> Self {
        Self {
            torques: Inbox::new(TORQUES),
            contacts: Inbox::new(1),
            field: Inbox::new(1),
            diagnostics: Inbox::new(1),
            flag: AtomicBool::new(false),
            unsent: AtomicU64::new(0),
        }
    }
}

impl Outbox {
    /// Publishes the flag to stop, which may have changed: at once, whatever else waits.
    pub fn flag(&self) {
        self.flag.store(true, Ordering::Release);
        self.torques.wake();
    }

    /// Torques, clouds and diagnostics that were left out because there was no room for them.
    pub fn unsent(&self) -> u64 {
        self.unsent.load(Ordering::Relaxed) + self.torques.dropped()
    }

    fn count(&self, sent: bool) {
        self.unsent.fetch_add(u64::from(!sent), Ordering::Relaxed);
    }
}

/// palpate's publishers.
pub struct Publishers {
    joints: Vec<String>,
    external: Publisher<JointState>,
    predicted: Publisher<JointState>,
    stop: Publisher<Bool>,
    contacts: Publisher<PointCloud2>,
    field: Publisher<PointCloud2>,
    diagnostics: Publisher<DiagnosticArray>,
}

impl Network {
    /// Begins to publish, for a robot of these joints.
    ///
    /// # Errors
    ///
    /// If DDS refuses.
    pub fn publish(&mut self, joints: Vec<String>) -> Result<Publishers, NetworkError> {
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 100 });
        let latched = qos
            .clone()
            .durability(Durability::TransientLocal)
            .history(History::KeepLast { depth: 1 });
        Ok(Publishers {
            joints,
            external: self.publisher("/palpate/torque_external", "sensor_msgs/JointState", &qos)?,
            predicted: self.publisher(
                "/palpate/torque_predicted",
                "sensor_msgs/JointState",
                &qos,
            )?,
            stop: self.publisher("/palpate/stop", "std_msgs/Bool", &latched)?,
            contacts: self.publisher("/palpate/contacts", "sensor_msgs/PointCloud2", &qos)?,
            field: self.publisher("/palpate/field", "sensor_msgs/PointCloud2", &latched)?,
            diagnostics: self.publisher("/diagnostics", "diagnostic_msgs/DiagnosticArray", &qos)?,
        })
    }

    fn publisher<M: Serialize>(
        &mut self,
        topic: &str,
        kind: &str,
        qos: &QosProfile,
    ) -> Result<Publisher<M>, NetworkError> {
        let (package, name) = kind.split_once('/').expect("kinds are written package/Name");
        let opened = self
            .node
            .create_topic(&parse(topic)?, MessageTypeName::new(package, name), qos)
            .and_then(|topic| self.node.create_publisher::<M>(&topic, Some(qos.clone())));
        opened.map_err(|error| NetworkError::open(topic, &error))
    }
}

impl Publishers {
    /// Publishes what waits, the most urgent first, waiting for something for at most so long;
    /// `stopped` says whether the flag to stop is up, and `published` gets the time from the arrival
    /// of a sample until its prediction went out.
    pub fn publish(
        &self,
        outbox: &Outbox,
        patience: Duration,
        stopped: impl FnOnce() -> bool,
        published: impl FnOnce(Duration),
    ) {
        let torques = outbox.torques.pop(patience);
        // Asked for after the note that it changed is taken: a change after that leaves another.
        if outbox.flag.swap(false, Ordering::AcqRel) {
            outbox.count(self.stop.publish(Bool { data: stopped() }).is_ok());
        }
        if let Some(Torques { header, received, external_n_m, predicted_n_m }) = torques {
            let state = |torques| JointState::of_torques(header.clone(), &self.joints, torques);
            outbox.count(self.predicted.publish(state(predicted_n_m)).is_ok());
            published(received.elapsed());
            outbox.count(self.external.publish(state(external_n_m)).is_ok());
        }
        for (cloud, publisher) in [(&outbox.contacts, &self.contacts), (&outbox.field, &self.field)]
        {
            if let Some(cloud) = cloud.pop(Duration::ZERO) {
                outbox.count(publisher.publish(cloud).is_ok());
            }
        }
        if let Some(diagnostics) = outbox.diagnostics.pop(Duration::ZERO) {
            outbox.count(self.diagnostics.publish(diagnostics).is_ok());
        }
    }
}
