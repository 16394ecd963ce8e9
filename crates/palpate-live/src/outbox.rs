//! Messages that wait to be sent to the network process. Torques queue up to a bound and the oldest leave; of
//! clouds and diagnostics only the latest is kept.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::inbox::Inbox;
use crate::message::{DiagnosticArray, PointCloud2, WrenchStamped};
use crate::ros::{NetworkProcess, ToNetwork, Torques};

/// Torques that may wait.
const TORQUES: usize = 256;

/// Messages that wait, and whether the guard's flag was up when it was last sent.
#[derive(Debug)]
pub(crate) struct Outbox {
    /// The torques of samples.
    pub(crate) torques: Inbox<Torques>,
    /// What the arm touches now.
    pub(crate) contacts: Inbox<PointCloud2>,
    /// The field near it.
    pub(crate) field: Inbox<PointCloud2>,
    /// What the object exerts on the links.
    pub(crate) wrenches: Inbox<Vec<WrenchStamped>>,
    /// How it goes.
    pub(crate) diagnostics: Inbox<DiagnosticArray>,
    was_up: AtomicBool,
}

impl Default for Outbox {
    fn default() -> Self {
        Self {
            torques: Inbox::new(TORQUES),
            contacts: Inbox::new(1),
            field: Inbox::new(1),
            wrenches: Inbox::new(1),
            diagnostics: Inbox::new(1),
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

    /// Sends why the guard's flag is up, or that it is down.
    pub(crate) fn flag(&self, network: &NetworkProcess, cause: Option<String>) {
        self.was_up.store(cause.is_some(), Ordering::Relaxed);
        network.send(&ToNetwork::Flag(cause));
    }

    /// Sends the messages that wait, after waiting for torques for at most so long.
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
