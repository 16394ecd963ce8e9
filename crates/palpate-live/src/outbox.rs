//! Messages that wait to be sent to the network process. Torques and wrenches wait in bounded queues, whose oldest are
//! dropped; of all other messages only the latest is kept.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::latest_queue::LatestQueue;
use crate::message::{DiagnosticArray, PointCloud2, WrenchStamped};
use crate::ros::{NetworkProcess, ToNetwork, TorqueMessage};

/// Capacity of the queues of torques and of wrenches, which belong to the same samples.
const TORQUES: usize = 256;

/// Messages that wait to be sent, and the state of the guard's flag as last sent.
#[derive(Debug)]
pub(crate) struct Outbox {
    /// The torques of samples.
    pub(crate) torques: LatestQueue<TorqueMessage>,
    /// The present contacts.
    pub(crate) contacts: LatestQueue<PointCloud2>,
    /// The field near the contacts.
    pub(crate) field: LatestQueue<PointCloud2>,
    /// The wrenches on links.
    pub(crate) wrenches: LatestQueue<Vec<WrenchStamped>>,
    /// Diagnostics of the session.
    pub(crate) diagnostics: LatestQueue<DiagnosticArray>,
    was_up: AtomicBool,
}

impl Default for Outbox {
    fn default() -> Self {
        Self {
            torques: LatestQueue::new(TORQUES),
            contacts: LatestQueue::new(1),
            field: LatestQueue::new(1),
            wrenches: LatestQueue::new(TORQUES),
            diagnostics: LatestQueue::new(1),
            was_up: AtomicBool::new(true),
        }
    }
}

impl Outbox {
    /// Wakes the publisher if the guard's flag has changed since it was last sent.
    pub(crate) fn wake_for_flag(&self, is_up: bool) {
        if self.was_up.load(Ordering::Relaxed) != is_up {
            self.torques.wake();
        }
    }

    /// Sends the guard's flag: up for a cause, down for `None`.
    pub(crate) fn flag(&self, network: &NetworkProcess, cause: Option<String>) {
        self.was_up.store(cause.is_some(), Ordering::Relaxed);
        network.send(&ToNetwork::Flag(cause));
    }

    /// Sends the waiting messages; waits for torques for at most `patience`.
    pub(crate) fn empty(&self, network: &NetworkProcess, patience: Duration) {
        let now = Duration::ZERO;
        let waiting = [
            self.torques.pop(patience).map(ToNetwork::Torques),
            self.contacts.pop(now).map(ToNetwork::Contacts),
            self.field.pop(now).map(ToNetwork::Field),
            self.wrenches.pop(now).map(ToNetwork::Wrenches),
            self.diagnostics.pop(now).map(ToNetwork::Diagnostics),
        ];
        for message in waiting.into_iter().flatten() {
            network.send(&message);
        }
    }
}
