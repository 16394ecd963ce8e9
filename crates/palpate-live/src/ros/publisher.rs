//! What palpate publishes. Nothing here waits for a subscriber: a message for which DDS has no room,
//! since a reliable subscriber does not keep up, is left out.

use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{MessageTypeName, Publisher, QosProfile};
use serde::{Deserialize, Serialize};

use super::clock::RosClock;
use super::network::{Network, NetworkError, parse};
use super::wire::Torques;
use crate::diagnostics;
use crate::message::{Bool, DiagnosticArray, JointState, PointCloud2, Text, WrenchStamped};

/// Where MoveIt listens for those who want it to stop.
const MOVEIT: &str = "/trajectory_execution_event";

/// Where a guard's flag goes, beside palpate's own topics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlagTopics {
    /// To MoveIt as well, which then stops what it executes.
    pub moveit: bool,
}

/// palpate's publishers.
pub(super) struct Publishers {
    joints: Vec<String>,
    external: Publisher<JointState>,
    predicted: Publisher<JointState>,
    /// Of arms that were identified.
    std: Publisher<JointState>,
    touched: Publisher<Bool>,
    /// The guard's, if there is one.
    flag: Option<FlagPublishers>,
    contacts: Publisher<PointCloud2>,
    field: Publisher<PointCloud2>,
    wrench: Publisher<WrenchStamped>,
    diagnostics: Publisher<DiagnosticArray>,
    clock: RosClock,
}

/// Publishers of a flag to stop, and why it is up.
struct FlagPublishers {
    stop: Publisher<Bool>,
    why: Publisher<DiagnosticArray>,
    /// MoveIt's, if it is to stop what it executes.
    moveit: Option<Publisher<Text>>,
    /// Whether the flag was up when it was published last.
    was_up: bool,
}

impl Network {
    /// Begins to publish, for a robot of these joints, with a guard's flag or without.
    ///
    /// # Errors
    ///
    /// If DDS refuses.
    pub(super) fn publish(
        &mut self,
        joints: Vec<String>,
        flag: Option<FlagTopics>,
    ) -> Result<Publishers, NetworkError> {
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 100 });
        // Clouds are large, and a subscriber that falls behind wants the newest.
        let clouds = qos.clone().history(History::KeepLast { depth: 4 });
        let latched = qos
            .clone()
            .durability(Durability::TransientLocal)
            .history(History::KeepLast { depth: 1 });
        let flag = flag.map(|FlagTopics { moveit }| {
            let moveit = moveit.then(|| self.publisher(MOVEIT, "std_msgs/String", &qos));
            Ok(FlagPublishers {
                stop: self.publisher("/palpate/stop", "std_msgs/Bool", &latched)?,
                why: self.publisher(
                    "/palpate/guard",
                    "diagnostic_msgs/DiagnosticArray",
                    &latched,
                )?,
                moveit: moveit.transpose()?,
                was_up: true,
            })
        });
        Ok(Publishers {
            joints,
            clock: self.clock.clone(),
            flag: flag.transpose()?,
            external: self.publisher("/palpate/torque_external", "sensor_msgs/JointState", &qos)?,
            predicted: self.publisher(
                "/palpate/torque_predicted",
                "sensor_msgs/JointState",
                &qos,
            )?,
            std: self.publisher("/palpate/torque_std", "sensor_msgs/JointState", &qos)?,
            touched: self.publisher("/palpate/touched", "std_msgs/Bool", &qos)?,
            contacts: self.publisher("/palpate/contacts", "sensor_msgs/PointCloud2", &clouds)?,
            field: self.publisher("/palpate/field", "sensor_msgs/PointCloud2", &latched)?,
            wrench: self.publisher("/palpate/wrench", "geometry_msgs/WrenchStamped", &qos)?,
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
        let topic = &*self.names.of(topic);
        let opened = self
            .node
            .create_topic(&parse(topic)?, MessageTypeName::new(package, name), qos)
            .and_then(|topic| self.node.create_publisher::<M>(&topic, Some(qos.clone())));
        opened.map_err(|error| NetworkError::open(topic, &error))
    }
}

impl Publishers {
    /// Publishes a guard's flag, with the cause that it is up, and with the time; returns how many
    /// messages had no room.
    pub(super) fn flag(&mut self, cause: Option<&str>) -> u64 {
        let stamp = self.clock.stamp();
        let Some(flag) = &mut self.flag else { return 0 };
        let stop = cause.is_some();
        let mut sent = vec![
            flag.stop.publish(Bool { data: stop }).is_ok(),
            flag.why.publish(diagnostics::of_guard(cause, stamp)).is_ok(),
        ];
        if stop
            && !flag.was_up
            && let Some(moveit) = &flag.moveit
        {
            sent.push(moveit.publish(Text { data: "stop".to_owned() }).is_ok());
        }
        flag.was_up = stop;
        sent.iter().filter(|sent| !**sent).count() as u64
    }

    /// Whether a guard's flag was down when it was published last.
    pub(super) fn flag_is_down(&self) -> bool {
        self.flag.as_ref().is_some_and(|flag| !flag.was_up)
    }

    /// Publishes what was predicted for a sample; whether there was room.
    pub(super) fn predicted(&self, torques: &Torques) -> bool {
        let predicted = torques.predicted_n_m.clone();
        self.predicted.publish(self.joint_state(torques, predicted)).is_ok()
    }

    /// Publishes what was measured; whether there was room.
    pub(super) fn external(&self, torques: &Torques) -> bool {
        let external = torques.external_n_m.clone();
        self.external.publish(self.joint_state(torques, external)).is_ok()
    }

    /// Publishes how sure that is, and whether something is touched, if it is known; whether there was room.
    pub(super) fn detection(&self, torques: &Torques) -> bool {
        let Some(detection) = &torques.detection else { return true };
        let std = self.joint_state(torques, detection.std_n_m.clone());
        let std = self.std.publish(std).is_ok();
        self.touched.publish(Bool { data: detection.touched }).is_ok() && std
    }

    fn joint_state(&self, torques: &Torques, effort: Vec<f64>) -> JointState {
        JointState::of_torques(torques.header.clone(), &self.joints, effort)
    }

    /// Publishes the contacts; whether there was room.
    pub(super) fn contacts(&self, cloud: PointCloud2) -> bool {
        self.contacts.publish(cloud).is_ok()
    }

    /// Publishes the field; whether there was room.
    pub(super) fn field(&self, cloud: PointCloud2) -> bool {
        self.field.publish(cloud).is_ok()
    }

    /// Publishes the wrench on each touched link; whether there was room for all.
    pub(super) fn wrenches(&self, wrenches: Vec<WrenchStamped>) -> bool {
        let unsent =
            wrenches.into_iter().filter(|wrench| self.wrench.publish(wrench.clone()).is_err());
        unsent.count() == 0
    }

    /// Publishes diagnostics; whether there was room.
    pub(super) fn diagnostics(&self, array: DiagnosticArray) -> bool {
        self.diagnostics.publish(array).is_ok()
    }
}
