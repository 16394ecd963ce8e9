//! State shared by the threads of a session, and the two threads that receive from and send to the network process.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, TrySendError};

use crate::checkpoint::Written;
use crate::figures::SessionEvent;
use crate::guard::{Cause, Guard, JointStateMonitor};
use crate::latest_queue::LatestQueue;
use crate::message::{AskTrajectoryResponse, JointState, TriggerResponse};
use crate::outbox::Outbox;
use crate::ros::{
    Arrival, Counts, FromNetwork, Listener, NetworkProcess, PendingRequest, Request, Response,
    ToNetwork, Trigger, choose,
};
use crate::timer::Timer;

/// Interval at which waiting threads check whether the session has ended.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// Capacity of the queue of events.
const EVENTS: usize = 64;
/// Interval between two messages with the state of the guard's flag. Listeners take 50 ms of silence
/// for a flag that is up.
const FLAG: Duration = Duration::from_millis(20);

/// Time for the discovery of topics, before a missing topic is reported.
const DISCOVERY: Duration = Duration::from_secs(2);
/// After this time without a joint state the network process is replaced, since it may no longer
/// receive messages or discover publishers. The robot may also have stopped publishing: so each
/// further process has twice the time.
const DEAF: Duration = Duration::from_secs(3);
/// Upper limit of this time.
const DEAFEST: Duration = Duration::from_secs(8);
/// This time before the first joint state of the session: the robot may not be switched on yet.
const PATIENT: Duration = Duration::from_secs(30);
/// Smallest interval between the starts of two network processes.
const RESTART: Duration = Duration::from_millis(500);

/// A received joint state.
#[derive(Debug)]
pub(crate) struct JointMessage {
    /// The joint state, or why it cannot be decoded.
    pub(crate) state: Result<JointState, String>,
    /// Arrival at the network process.
    pub(crate) came: Arrival,
    /// Arrival at this process.
    pub(crate) at: Instant,
}

/// State shared by the threads.
pub(crate) struct Shared {
    /// Joint states on their way to the mapper.
    pub(crate) samples: LatestQueue<JointMessage>,
    pub(crate) outbox: Outbox,
    pub(crate) guard: Option<Guard>,
    pub(crate) events: LatestQueue<SessionEvent>,
    /// Times from the arrival of a sample to the publishing of its prediction.
    pub(crate) latencies: LatestQueue<Duration>,
    /// Counts of all network processes that have ended, and of the present one.
    counts: Mutex<[Counts; 2]>,
    /// Whether a tare was requested.
    pub(crate) tare: AtomicBool,
    /// Questions whose answers are being computed.
    pub(crate) answering: AtomicUsize,
    stopping: AtomicBool,
    over: AtomicBool,
    pub(crate) written: Written,
}

impl Shared {
    pub(crate) fn new(queue: usize, guard: Option<Guard>) -> Self {
        Self {
            samples: LatestQueue::new(queue),
            outbox: Outbox::default(),
            guard,
            events: LatestQueue::new(EVENTS),
            latencies: LatestQueue::new(queue),
            counts: Mutex::default(),
            tare: AtomicBool::new(false),
            answering: AtomicUsize::new(0),
            stopping: AtomicBool::new(false),
            over: AtomicBool::new(false),
            written: Written::default(),
        }
    }

    /// Whether the session was not stopped yet.
    pub(crate) fn is_running(&self) -> bool {
        !self.stopping.load(Ordering::Relaxed)
    }

    /// Stops the session. The threads that send the guard's flag continue, with the flag up.
    pub(crate) fn stop(&self) {
        self.stopping.store(true, Ordering::Relaxed);
        self.guard.as_ref().inspect(|guard| guard.end());
    }

    /// Stops the session and the threads that send the guard's flag.
    pub(crate) fn end(&self) {
        self.stop();
        self.over.store(true, Ordering::Relaxed);
    }

    /// Whether the threads that receive from and send to the network process shall end too.
    pub(crate) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// Messages received, lost and unsent, over all network processes.
    pub(crate) fn counts(&self) -> Counts {
        let [before, now] = *lock(&self.counts);
        Counts {
            received: before.received + now.received,
            lost: before.lost + now.lost,
            unsent: before.unsent + now.unsent,
        }
    }

    /// Takes the counts of the present network process; with `ends`, adds them to those of the ended ones.
    fn count(&self, counts: Option<Counts>, ends: bool) {
        let all = ends.then(|| self.counts());
        let mut both = lock(&self.counts);
        match all {
            Some(all) => *both = [all, Counts::default()],
            None => both[1] = counts.unwrap_or(both[1]),
        }
    }

    /// Why the guard's flag is up; `None` if it is down or there is no guard.
    pub(crate) fn cause(&self) -> Option<Cause> {
        self.guard.as_ref()?.cause(Instant::now())
    }

    /// Wakes the publisher if the guard's flag has changed since it was last sent.
    pub(crate) fn wake_for_flag(&self) {
        if self.guard.is_some() {
            self.outbox.wake_for_flag(self.cause().is_some());
        }
    }

    /// Takes the guard's flag down, if it is safe.
    fn reset(&self) -> TriggerResponse {
        let done = match &self.guard {
            Some(guard) => guard.reset(Instant::now()).map_err(|cause| cause.to_string()),
            None => Err("there is no guard: palpate was started without --guard".to_owned()),
        };
        TriggerResponse {
            success: done.is_ok(),
            message: done.err().unwrap_or_else(|| "the flag is down".to_owned()),
        }
    }

    /// Requests a tare at the next pause, which also takes the guard's flag down.
    fn tare(&self) -> TriggerResponse {
        self.guard.as_ref().inspect(|guard| guard.reset_with_tare());
        self.tare.store(true, Ordering::Relaxed);
        let message = "hold the arm still, without contact, until palpate maps or the flag is down";
        TriggerResponse { success: true, message: message.to_owned() }
    }

    pub(crate) fn note(&self, note: impl Into<String>) {
        self.events.push(SessionEvent::Note(note.into()));
    }
}

/// The thread that receives from the network process, watches the measured torque, and replaces a
/// process that has ended or no longer receives joint states.
pub(crate) fn listen(
    network: &NetworkProcess,
    first: Listener<'_>,
    (topic, to_services): (Option<&str>, Sender<PendingRequest>),
    monitor: Option<JointStateMonitor>,
    shared: &Shared,
) {
    let (patience, notes) = (PATIENT, HashSet::new());
    let mut hearing = Hearing { network, topic, to_services, monitor, shared, patience, notes };
    let mut listener = Some(first);
    while !shared.is_over() {
        let started = Instant::now();
        let ended = match listener.take().map_or_else(|| network.start(), Ok) {
            Ok(mut listener) => {
                let ended = hearing.hear(&mut listener);
                let status = listener.end();
                shared.count(None, true);
                ended.and_then(|why| match (why, status) {
                    (Ended::Deaf { subscribed }, _) => subscribed
                        .then(|| "no joint state comes; palpate subscribes again".to_owned()),
                    (Ended::Gone, Some(status)) => Some(format!(
                        "the network process has ended ({status}); another one is started"
                    )),
                    (Ended::Gone, None) => Some("the network process is replaced".to_owned()),
                })
            }
            Err(error) => Some(error.to_string()),
        };
        if let Some(why) = ended {
            hearing.note(why);
        }
        while !shared.is_over() && started.elapsed() < RESTART {
            thread::sleep(LOOK);
        }
    }
}

/// Why a network process is replaced.
enum Ended {
    /// No joint state came for too long, or no topic of joint states was found.
    Deaf {
        subscribed: bool,
    },
    Gone,
}

/// State of the receiving thread.
struct Hearing<'a> {
    network: &'a NetworkProcess,
    topic: Option<&'a str>,
    /// Requests for the thread that answers slow requests.
    to_services: Sender<PendingRequest>,
    monitor: Option<JointStateMonitor>,
    shared: &'a Shared,
    /// Time without a joint state after which the network process is replaced.
    patience: Duration,
    /// Notes since the last joint state: each is reported once.
    notes: HashSet<String>,
}

impl Hearing<'_> {
    /// Receives from a network process until it must be replaced; returns `None` if the session ends.
    fn hear(&mut self, listener: &mut Listener<'_>) -> Option<Ended> {
        let started = Instant::now();
        let (mut heard, mut subscribed, mut waiting) = (started, false, String::new());
        while !self.shared.is_over() {
            match listener.next(LOOK) {
                Err(_) => return Some(Ended::Gone),
                Ok(Some(FromNetwork::Joints { state, came })) => {
                    (heard, self.patience) = (Instant::now(), DEAF);
                    self.notes.clear();
                    self.take(JointMessage { state, came, at: heard });
                }
                Ok(Some(FromNetwork::Topics(topics))) if !subscribed => {
                    let clock = self.network.lacks_clock(&topics);
                    match choose(&topics, self.topic) {
                        Ok(topic) => {
                            let how = if topic.reliable { "reliable" } else { "best effort" };
                            self.note(format!("listening to `{}` ({how})", topic.name));
                            clock.into_iter().for_each(|lacks| self.note(lacks));
                            subscribed = self.network.send(&ToNetwork::Subscribe(topic));
                            heard = Instant::now();
                        }
                        Err(why) => waiting = why,
                    }
                }
                Ok(Some(FromNetwork::Asked(asked))) => self.answer(asked),
                Ok(Some(FromNetwork::Counts(counts))) => self.shared.count(Some(counts), false),
                Ok(Some(FromNetwork::Published(latency))) => self.shared.latencies.push(latency),
                Ok(Some(FromNetwork::Stalled)) => {
                    self.shared.guard.as_ref().inspect(|guard| guard.stalled());
                }
                Ok(Some(FromNetwork::Failed(why))) => {
                    self.note(why);
                    return Some(Ended::Gone);
                }
                Ok(Some(FromNetwork::Topics(_) | FromNetwork::Description(_)) | None) => {}
            }
            if !subscribed && !waiting.is_empty() && started.elapsed() > DISCOVERY {
                self.note(format!("waiting: {}", std::mem::take(&mut waiting)));
            }
            if heard.elapsed() > self.patience {
                if self.patience < PATIENT {
                    self.patience = (2 * self.patience).min(DEAFEST);
                }
                return Some(Ended::Deaf { subscribed });
            }
        }
        None
    }

    /// Answers a request at once, or passes it to the thread for slow requests.
    fn answer(&self, asked: PendingRequest) {
        const BUSY: &str = "too many requests wait for an answer; try again";
        let id = asked.id;
        let response = match &asked.request {
            Request::Trigger(trigger @ Trigger::Tare) => {
                Response::Trigger(*trigger, self.shared.tare())
            }
            Request::Trigger(trigger @ Trigger::Reset) => {
                Response::Trigger(*trigger, self.shared.reset())
            }
            _ => match self.to_services.try_send(asked).map_err(TrySendError::into_inner) {
                Ok(()) => return,
                Err(PendingRequest { request: Request::Trigger(trigger), .. }) => {
                    Response::Trigger(
                        trigger,
                        TriggerResponse { success: false, message: BUSY.to_owned() },
                    )
                }
                Err(_) => Response::Trajectory(Box::new(AskTrajectoryResponse {
                    message: BUSY.to_owned(),
                    ..AskTrajectoryResponse::default()
                })),
            },
        };
        self.network.send(&ToNetwork::Answer(id, response));
    }

    fn take(&mut self, message: JointMessage) {
        if let Some(monitor) = &mut self.monitor {
            let state = message.state.as_ref().map_err(String::as_str);
            monitor.see(state, message.at, message.came.at_s);
            self.shared.wake_for_flag();
        }
        self.shared.samples.push(message);
    }

    /// Reports a note, once until the next joint state.
    fn note(&mut self, note: String) {
        if self.notes.insert(note.clone()) {
            self.shared.note(note);
        }
    }
}

/// The thread that sends messages to be published to the network process.
pub(crate) fn publish(network: &NetworkProcess, shared: &Shared) {
    let (mut due, mut was_up) = (Timer::new(FLAG), None);
    while !shared.is_over() {
        let (now, mut patience) = (Instant::now(), LOOK);
        if let Some(guard) = &shared.guard {
            let cause = guard.cause(now);
            let changes = was_up != Some(cause.is_some());
            if due.is_due(now) || changes {
                shared.outbox.flag(network, cause.as_ref().map(Cause::to_string));
            }
            if changes {
                was_up = Some(cause.is_some());
                shared.note(match cause {
                    Some(cause) => format!("STOP: {cause}"),
                    None => "no reason to stop the robot".to_owned(),
                });
            }
            patience = due.left(now).min(LOOK);
        }
        shared.outbox.empty(network, patience);
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

/// Locks a mutex. No thread panics while it holds the lock; after a panic the data would still be valid.
pub(crate) fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}
