//! What the threads of a session share, and those that receive from and send to the network process.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, TrySendError};

use crate::checkpoint::Written;
use crate::figures::News;
use crate::guard::{Cause, Guard, Sentry};
use crate::inbox::Inbox;
use crate::message::{AskTrajectoryResponse, JointState, TriggerResponse};
use crate::outbox::Outbox;
use crate::ros::{
    Arrival, Asked, Counts, FromNetwork, Listener, NetworkProcess, Request, Response, ToNetwork,
    Trigger, choose,
};
use crate::timer::Timer;

/// How often a thread that waits looks whether the session goes on.
pub(crate) const LOOK: Duration = Duration::from_millis(20);
/// News that may wait.
const NEWS: usize = 64;
/// Between two messages that say whether the guard's flag is up. Listeners take 50 ms of silence for
/// a flag that is up.
const FLAG: Duration = Duration::from_millis(20);

/// How long the topics of a network may take to appear before the user reads that there is none.
const DISCOVERY: Duration = Duration::from_secs(2);
/// A network process that hears no joint state for so long is replaced, since it may have gone deaf,
/// to them or to who publishes them. The robot may have stopped to send them as well: then the next
/// process has twice the time, and so on.
const DEAF: Duration = Duration::from_secs(3);
const DEAFEST: Duration = Duration::from_secs(8);
/// The same before any joint state has come in the session: the robot may not be on yet.
const PATIENT: Duration = Duration::from_secs(30);
/// Between the starts of two network processes, at least.
const RESTART: Duration = Duration::from_millis(500);

/// A joint state as it came.
#[derive(Debug)]
pub(crate) struct JointMessage {
    /// What it says, or why it cannot be decoded: it has another shape than its type.
    pub(crate) state: Result<JointState, String>,
    /// When it came to the network process, and here.
    pub(crate) came: Arrival,
    pub(crate) at: Instant,
}

/// What the threads share.
pub(crate) struct Shared {
    /// Joint states on their way to the mapper.
    pub(crate) samples: Inbox<JointMessage>,
    pub(crate) outbox: Outbox,
    pub(crate) guard: Option<Guard>,
    pub(crate) news: Inbox<News>,
    /// From the arrival of a sample to the publishing of its prediction.
    pub(crate) latencies: Inbox<Duration>,
    /// Of the network processes that have ended, and of the one that runs.
    counts: Mutex<[Counts; 2]>,
    /// Whether somebody asks for a tare.
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
            samples: Inbox::new(queue),
            outbox: Outbox::default(),
            guard,
            news: Inbox::new(NEWS),
            latencies: Inbox::new(queue),
            counts: Mutex::default(),
            tare: AtomicBool::new(false),
            answering: AtomicUsize::new(0),
            stopping: AtomicBool::new(false),
            over: AtomicBool::new(false),
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
        self.guard.as_ref().inspect(|guard| guard.end());
    }

    /// Ends those threads too that say that the robot must stop while others end.
    pub(crate) fn end(&self) {
        self.stop();
        self.over.store(true, Ordering::Relaxed);
    }

    /// Whether all has ended but the threads that receive from and send to the network process.
    pub(crate) fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    /// Messages that came, were lost, and could not be sent.
    pub(crate) fn counts(&self) -> Counts {
        let [before, now] = *self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        Counts {
            received: before.received + now.received,
            lost: before.lost + now.lost,
            unsent: before.unsent + now.unsent,
        }
    }

    /// Takes the counts of the network process that runs; `ends`: and that will be no more.
    fn count(&self, counts: Option<Counts>, ends: bool) {
        let all = ends.then(|| self.counts());
        let mut both = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        match all {
            Some(all) => *both = [all, Counts::default()],
            None => both[1] = counts.unwrap_or(both[1]),
        }
    }

    /// Why the guard's flag is up, if it is.
    pub(crate) fn cause(&self) -> Option<Cause> {
        self.guard.as_ref()?.cause(Instant::now())
    }

    /// Wakes the publisher if the guard's flag has changed since it was last sent.
    pub(crate) fn wake_for_flag(&self) {
        if self.guard.is_some() {
            self.outbox.wake_for_flag(self.cause().is_some());
        }
    }

    /// Takes the guard's flag back, if it is safe.
    fn reset(&self) -> TriggerResponse {
        let done = match &self.guard {
            Some(guard) => guard.reset(Instant::now()).map_err(|cause| cause.to_string()),
            None => Err("there is no guard (--guard)".to_owned()),
        };
        TriggerResponse {
            success: done.is_ok(),
            message: done.err().unwrap_or_else(|| "the flag is down".to_owned()),
        }
    }

    /// Takes a tare at the next pause, which takes the guard's flag back.
    fn tare(&self) -> TriggerResponse {
        self.guard.as_ref().inspect(|guard| guard.reset_with_tare());
        self.tare.store(true, Ordering::Relaxed);
        let message =
            "hold the arm still, and free of the object, until it maps or the flag is down";
        TriggerResponse { success: true, message: message.to_owned() }
    }

    pub(crate) fn note(&self, note: impl Into<String>) {
        self.news.push(News::Note(note.into()));
    }
}

/// The thread that hears the network process, watches the measured torque, and replaces a process
/// that has ended or gone deaf.
pub(crate) fn listen(
    network: &NetworkProcess,
    first: Listener<'_>,
    (topic, to_services): (Option<&str>, Sender<Asked>),
    sentry: Option<Sentry>,
    shared: &Shared,
) {
    let (patience, notes) = (PATIENT, HashSet::new());
    let mut hearing = Hearing { network, topic, to_services, sentry, shared, patience, notes };
    let mut listener = Some(first);
    while !shared.is_over() {
        let started = Instant::now();
        let ended = match listener.take().map_or_else(|| network.start(), Ok) {
            Ok(mut listener) => {
                let ended = hearing.hear(&mut listener);
                let status = listener.end();
                shared.count(None, true);
                ended.and_then(|why| match (why, status) {
                    (Ended::Deaf { subscribed }, _) => {
                        subscribed.then(|| "no joint state comes; listening anew".to_owned())
                    }
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

/// Why a network process is heard no more.
enum Ended {
    /// Nothing was heard of joint states, or of who publishes them.
    Deaf {
        subscribed: bool,
    },
    Gone,
}

/// What is heard.
struct Hearing<'a> {
    network: &'a NetworkProcess,
    topic: Option<&'a str>,
    /// Requests that take time.
    to_services: Sender<Asked>,
    sentry: Option<Sentry>,
    shared: &'a Shared,
    /// How long the network process may hear nothing.
    patience: Duration,
    /// Notes to the user since the last joint state.
    notes: HashSet<String>,
}

impl Hearing<'_> {
    /// Hears a network process until it ends or is deaf, or the session ends: then `None`.
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

    /// Answers a request, or has it answered by the thread for those that take time.
    fn answer(&self, asked: Asked) {
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
                Err(Asked { request: Request::Trigger(trigger), .. }) => Response::Trigger(
                    trigger,
                    TriggerResponse { success: false, message: BUSY.to_owned() },
                ),
                Err(_) => Response::Trajectory(Box::new(AskTrajectoryResponse {
                    message: BUSY.to_owned(),
                    ..AskTrajectoryResponse::default()
                })),
            },
        };
        self.network.send(&ToNetwork::Answer(id, response));
    }

    fn take(&mut self, message: JointMessage) {
        if let Some(sentry) = &mut self.sentry {
            let state = message.state.as_ref().map_err(String::as_str);
            sentry.see(state, message.at, message.came.at_s);
            self.shared.wake_for_flag();
        }
        self.shared.samples.push(message);
    }

    /// Notes something for the user, once while no joint state comes.
    fn note(&mut self, note: String) {
        if self.notes.insert(note.clone()) {
            self.shared.note(note);
        }
    }
}

/// The thread that sends the network process what to publish.
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
