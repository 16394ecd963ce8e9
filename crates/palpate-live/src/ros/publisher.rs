//! palpate's publishers. They never wait for a subscriber: if the queue of DDS is full because a
//! reliable subscriber does not keep up, the message is dropped.

use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{MessageTypeName, Publisher, QosProfile};
use serde::{Deserialize, Serialize};

use super::clock::RosClock;
use super::network::{Network, NetworkError, parse};
use super::wire::TorqueMessage;
use crate::diagnostics;
use crate::message::{Bool, DiagnosticArray, JointState, PointCloud2, Text, WrenchStamped};

/// The topic on which MoveIt receives requests to stop.
const MOVEIT: &str = "/trajectory_execution_event";

/// Further topics for the guard's flag, beside palpate's own.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlagTopics {
    /// Whether stop requests are also sent to MoveIt, which then stops the trajectory that it executes.
    pub moveit: bool,
}

/// palpate's publishers.
pub(super) struct Publishers {
    joints: Vec<String>,
    external: Publisher<JointState>,
    predicted: Publisher<JointState>,
    /// Standard deviation of τ_ext, for an identified arm.
    std: Publisher<JointState>,
    touched: Publisher<Bool>,
    /// Publishers of the guard's flag, if there is a guard.
    flag: Option<FlagPublishers>,
    pub(super) contacts: Publisher<PointCloud2>,
    pub(super) field: Publisher<PointCloud2>,
    wrench: Publisher<WrenchStamped>,
    pub(super) diagnostics: Publisher<DiagnosticArray>,
    clock: RosClock,
}

/// Publishers of the guard's flag and of its cause.
struct FlagPublishers {
    stop: Publisher<Bool>,
    why: Publisher<DiagnosticArray>,
    /// Publisher of stop requests to MoveIt, if wanted.
    moveit: Option<Publisher<Text>>,
    /// Whether the flag was up when last published.
    was_up: bool,
}

impl Network {
    /// Creates the publishers, for a robot with these joints; with a guard's flag if `flag` is given.
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
        // Clouds are large, and a slow subscriber needs only the newest.
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
    /// Publishes the guard's flag, up if there is a cause; returns the number of messages that were
    /// dropped.
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

    /// Whether there is a guard's flag, and it was down when last published.
    pub(super) fn flag_is_down(&self) -> bool {
        self.flag.as_ref().is_some_and(|flag| !flag.was_up)
    }

    /// Publishes the predicted torque of a sample; returns false if the message was dropped.
    pub(super) fn predicted(&self, torques: &TorqueMessage) -> bool {
        let predicted = torques.predicted_n_m.clone();
        self.predicted.publish(self.joint_state(torques, predicted)).is_ok()
    }

    /// Publishes the external torque of a sample; returns false if the message was dropped.
    pub(super) fn external(&self, torques: &TorqueMessage) -> bool {
        let external = torques.external_n_m.clone();
        self.external.publish(self.joint_state(torques, external)).is_ok()
    }

    /// Publishes standard deviation and detected contact, if known; returns false if a message was dropped.
    pub(super) fn detection(&self, torques: &TorqueMessage) -> bool {
        let Some(detection) = &torques.detection else { return true };
        let std = self.joint_state(torques, detection.std_n_m.clone());
        let std = self.std.publish(std).is_ok();
        self.touched.publish(Bool { data: detection.touched }).is_ok() && std
    }

    fn joint_state(&self, torques: &TorqueMessage, effort: Vec<f64>) -> JointState {
        JointState::of_torques(torques.header.clone(), &self.joints, effort)
    }

    /// Publishes the wrench on each link; returns false if a message was dropped.
    pub(super) fn wrenches(&self, wrenches: Vec<WrenchStamped>) -> bool {
        let unsent =
            wrenches.into_iter().filter(|wrench| self.wrench.publish(wrench.clone()).is_err());
        unsent.count() == 0
    }
}
