//! What the threads of a session share, and those that receive and publish.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::Duration;

use crate::checkpoint::Written;
use crate::figures::News;
use crate::guard::{Guard, Sentry, Trip};
use crate::inbox::Inbox;
use crate::ros::{JointMessage, Outbox, Publishers, Received, Subscriber};

/// How often a thread that waits looks whether the session goes on.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// News that may wait.
const NEWS: usize = 64;

/// What the threads share.
pub(crate) struct Shared {
    /// Joint states on their way to the mapper.
    pub(crate) samples: Inbox<JointMessage>,
    pub(crate) outbox: Outbox,
    guard: Option<Guard>,
    pub(crate) news: Inbox<News>,
    /// From the arrival of a sample to the publishing of its prediction.
    pub(crate) latencies: Inbox<Duration>,
    /// Messages that came.
    pub(crate) received: AtomicU64,
    /// Messages that never came.
    pub(crate) lost: AtomicU64,
    /// Whether somebody asks for a tare.
    pub(crate) tare: AtomicBool,
    /// Questions whose answers are being computed.
    pub(crate) answering: AtomicUsize,
    stopping: AtomicBool,
    pub(crate) written: Written,
}

impl Shared {
    pub(crate) fn new(queue: usize, guard: Option<Guard>) -> Self {
        Self {
            samples: Inbox::new(queue),
            outbox: Outbox::default(),
            guard,
            news: Inbox::new(NEWS),
            latencies: Inbox::new(queue),
            received: AtomicU64::new(0),
            lost: AtomicU64::new(0),
            tare: AtomicBool::new(false),
            answering: AtomicUsize::new(0),
            stopping: AtomicBool::new(false),
            written: Written::default(),
        }
    }

    /// Whether the session goes on.
    pub(crate) fn goes_on(&self) -> bool {
        !self.stopping.load(Ordering::Relaxed)
    }

    /// Ends the session.
    pub(crate) fn stop(&self) {
        self.stopping.store(true, Ordering::Relaxed);
    }

    /// Whether the guard's flag is up.
    pub(crate) fn is_stopped(&self) -> bool {
        self.guard.as_ref().is_some_and(Guard::is_up)
    }

    /// Publishes that a limit was passed, then reports it.
    pub(crate) fn tripped(&self, trip: &Trip) {
        self.outbox.flag();
        let what = if trip.predicted { "predicted" } else { "measured" };
        self.note(format!(
            "STOP: the {what} external torque of joint {} is {:.2} N·m; a new tare takes the flag \
             back",
            trip.joint, trip.torque_n_m
        ));
    }

    pub(crate) fn note(&self, note: impl Into<String>) {
        self.news.push(News::Note(note.into()));
    }
}

/// The thread that receives, and watches the measured torque.
pub(crate) fn receive(mut subscriber: Subscriber, mut sentry: Option<Sentry>, shared: &Shared) {
    while shared.goes_on() {
        subscriber.receive(LOOK, |received| match received {
            Received::Joints(message) => {
                if let Some(sentry) = &mut sentry
                    && let Ok(state) = &message.state
                    && let Some(trip) = sentry.see(state, message.at_s)
                {
                    shared.tripped(&trip);
                }
                shared.samples.push(message);
            }
            Received::Tare => shared.tare.store(true, Ordering::Relaxed),
        });
        let (received, lost) = subscriber.counts();
        shared.received.store(received, Ordering::Relaxed);
        shared.lost.store(lost, Ordering::Relaxed);
    }
}

/// The thread that publishes.
pub(crate) fn publish(publishers: &Publishers, shared: &Shared) {
    while shared.goes_on() {
        let published = |latency| shared.latencies.push(latency);
        publishers.publish(&shared.outbox, LOOK, || shared.is_stopped(), published);
    }
}

/// Starts a thread of the session; tools that list threads show its name.
///
/// # Panics
///
/// If the system has no thread to spare, as [`Scope::spawn`] does.
pub(crate) fn spawn<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    name: &str,
    work: impl FnOnce() -> T + Send + 'scope,
) -> ScopedJoinHandle<'scope, T> {
    let thread = thread::Builder::new().name(name.to_owned());
    thread.spawn_scoped(scope, work).expect("a thread to spare")
}
