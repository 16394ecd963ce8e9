//! The threads of a live session.
//!
//! ```text
//! network ──► Subscriber ──► Inbox ──► mapper ──► Outbox ──► Publishers ──► network
//!             (one thread)      (one thread)   │    (one thread)
//!                                  ▲           ├──► checkpoints (one thread)
//!                    questions ────┘           │
//!                                              ├──► what is drawn, by whoever draws
//!                                              └──► news, to whoever called
//! ```
//!
//! Arrows never wait: every queue is bounded and keeps the newest. The mapper's replays fill the
//! time until the next sample; when samples come faster than it can follow, it makes none.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, bounded};
use palpate_io::field::Saved;

use crate::checkpoint::{CheckpointConfig, Checkpoints, Written};
use crate::cloud;
use crate::diagnostics;
use crate::figures::{Figures, Tally};
use crate::guard::{Guard, Sentry, Trip};
use crate::inbox::Inbox;
use crate::joints::JointReader;
use crate::message::{Header, JointState};
use crate::query_server::{AskSocket, QueryServer, Request};
use crate::ros::{
    Choice, Network, NetworkError, Outbox, Publishers, Received, Subscriber, TopicSeen, Torques,
    choose,
};
use crate::session::{Session, State};
use crate::view_feed::{Picker, ViewFrame};

/// How a session is run.
#[derive(Debug, Clone)]
pub struct LiveConfig {
    /// The topic of joint states; `None` takes the only one there is.
    pub joint_states: Option<String>,
    /// Samples that may wait for the mapper.
    pub queue: usize,
    /// Where checkpoints go, if anywhere.
    pub checkpoint: Option<CheckpointConfig>,
    /// Where what is to be drawn goes, if anywhere.
    pub seen: Option<Arc<Inbox<ViewFrame>>>,
}

/// What is told while a session runs.
#[derive(Debug, Clone)]
pub enum News {
    /// How it goes.
    Figures(Box<Figures>),
    /// Something that the user may want to do something about.
    Note(String),
}

/// Between two looks at a flag, or at the network.
const LOOK: Duration = Duration::from_millis(20);
/// The mapper's wait for a sample, and so the longest that a question waits for the mapper.
const PAUSE: Duration = Duration::from_millis(2);
/// Questions that may wait.
const REQUESTS: usize = 16;
/// Between two sets of figures.
const FIGURES: Duration = Duration::from_millis(200);
/// Between two diagnostics.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// Between two clouds of contacts, and two of the field.
const CONTACTS: Duration = Duration::from_millis(100);
const FIELD: Duration = Duration::from_secs(1);
/// Samples that wait while clouds are still made.
const BACKLOG: usize = 4;
/// News that may wait.
const NEWS: usize = 64;

/// Maps what a robot says until `stop` says so; returns the session, whose touch has ended.
///
/// `tell` is called on this thread, and may take its time.
///
/// # Errors
///
/// If the network refuses.
pub fn run(
    mut network: Network,
    session: Session,
    config: &LiveConfig,
    ask: Option<&AskSocket>,
    stop: impl Fn() -> bool,
    mut tell: impl FnMut(News),
) -> Result<Session, NetworkError> {
    let arm = session.mapper().arm();
    let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
    let publisher = network.speak(joints.clone())?;
    let Some(topic) = find_topic(&network, config, &stop, &mut tell) else { return Ok(session) };
    let subscriber = network.listen(&topic)?;
    let how = if topic.reliable { "reliable" } else { "best effort" };
    tell(News::Note(format!("listening to `{}` ({how})", topic.name)));

    let guard = session.guard().cloned();
    let checker = session.mapper().path_checker();
    let touch = &session.mapper().config().touch;
    let sentry = guard.clone().map(|guard| Sentry::new(guard, Arc::clone(arm), touch.clone()));
    let shared = Shared::new(config.queue, guard);
    let (checkpoints, writer) = config.checkpoint.as_ref().map(Checkpoints::new).unzip();
    let (to_mapper, requests) = bounded(REQUESTS);
    let frame_id = arm.robot.links()[0].name.clone(); // the world of all poses
    let mut mapping = Mapping {
        shared: &shared,
        session,
        reader: JointReader::new(joints),
        tally: Tally::default(),
        checkpoints,
        seen: config.seen.clone().map(Picker::new),
        requests,
        header: Header { frame_id, ..Header::default() },
        now: Now::default(),
        timers: Timers::default(),
    };
    let goes_on = || shared.goes_on();
    thread::scope(|scope| {
        spawn(scope, "subscriber", || hear(subscriber, sentry, &shared));
        spawn(scope, "publisher", || speak(&publisher, &shared));
        if let Some(writer) = writer {
            spawn(scope, "checkpoints", || writer.run(&shared.written));
        }
        if let Some(ask) = ask {
            let (answering, goes_on) = (&shared.answering, &goes_on);
            let server = QueryServer { mapper: to_mapper, checker, answering, goes_on };
            spawn(scope, "ask", move || ask.run(&server));
        }
        let mapper = spawn(scope, "mapper", move || {
            mapping.run();
            mapping.session
        });
        while !mapper.is_finished() {
            if let Some(news) = shared.news.pop(LOOK) {
                tell(news);
            }
            if stop() {
                shared.stopping.store(true, Ordering::Relaxed);
            }
        }
        let session = mapper.join();
        shared.stopping.store(true, Ordering::Relaxed); // if the mapper stopped by itself
        session.map_err(|_| NetworkError::Defect)
    })
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

/// Waits for the topic to appear.
fn find_topic(
    network: &Network,
    config: &LiveConfig,
    stop: &impl Fn() -> bool,
    tell: &mut impl FnMut(News),
) -> Option<TopicSeen> {
    let started = Instant::now();
    let mut told = String::new();
    while !stop() {
        match choose(&network.topics(), config.joint_states.as_deref()) {
            Choice::Take(topic) => return Some(topic),
            // Whoever is on the network takes a moment to say so.
            Choice::Wait(why) if why != told && started.elapsed() > Duration::from_secs(2) => {
                tell(News::Note(format!("waiting: {why}")));
                told = why;
            }
            Choice::Wait(_) => {}
        }
        thread::sleep(LOOK);
    }
    None
}

/// What the threads share.
struct Shared {
    samples: Inbox<Arrived>,
    outbox: Outbox,
    guard: Option<Guard>,
    news: Inbox<News>,
    published: Inbox<Duration>,
    /// Messages that came, and those that never did.
    counts: Mutex<(u64, u64)>,
    tare: AtomicBool,
    /// Questions whose answers are being worked out.
    answering: AtomicUsize,
    stopping: AtomicBool,
    written: Written,
}

/// A joint state on its way to the mapper.
enum Arrived {
    Joints(JointState, Instant, f64),
    Broken(String),
}

impl Shared {
    fn new(queue: usize, guard: Option<Guard>) -> Self {
        Self {
            samples: Inbox::new(queue),
            outbox: Outbox::default(),
            guard,
            news: Inbox::new(NEWS),
            published: Inbox::new(queue),
            counts: Mutex::default(),
            tare: AtomicBool::new(false),
            answering: AtomicUsize::new(0),
            stopping: AtomicBool::new(false),
            written: Written::default(),
        }
    }

    fn goes_on(&self) -> bool {
        !self.stopping.load(Ordering::Relaxed)
    }

    fn is_stopped(&self) -> bool {
        self.guard.as_ref().is_some_and(Guard::is_up)
    }

    /// Publishes that a limit was passed, then says so.
    fn tripped(&self, trip: &Trip) {
        self.outbox.flag();
        let what = if trip.predicted { "predicted" } else { "measured" };
        self.note(format!(
            "STOP: the {what} external torque of joint {} is {:.2} N·m; a new tare takes the flag \
             back",
            trip.joint, trip.torque_n_m
        ));
    }

    fn note(&self, note: String) {
        self.news.push(News::Note(note));
    }

    fn counts(&self) -> MutexGuard<'_, (u64, u64)> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The thread that listens, and keeps watch.
fn hear(mut subscriber: Subscriber, mut sentry: Option<Sentry>, shared: &Shared) {
    while shared.goes_on() {
        subscriber.listen(LOOK, |heard| match heard {
            Received::Joints(state, at, at_s) => {
                if let Some(trip) = sentry.as_mut().and_then(|sentry| sentry.see(&state, at_s)) {
                    shared.tripped(&trip);
                }
                shared.samples.push(Arrived::Joints(state, at, at_s));
            }
            Received::Broken(why) => shared.samples.push(Arrived::Broken(why)),
            Received::Tare => shared.tare.store(true, Ordering::Relaxed),
        });
        *shared.counts() = subscriber.counts();
    }
}

/// The thread that publishes.
fn speak(publisher: &Publishers, shared: &Shared) {
    while shared.goes_on() {
        let said = |latency| shared.published.push(latency);
        publisher.speak(&shared.outbox, LOOK, || shared.is_stopped(), said);
    }
}

/// What the last sample said.
#[derive(Debug, Default)]
struct Now {
    contacts: usize,
    external_n_m: Option<f64>,
    predicted_n_m: Option<f64>,
}

/// When things are due again.
#[derive(Debug, Default)]
struct Timers {
    figures: Option<Instant>,
    diagnostics: Option<Instant>,
    contacts: Option<Instant>,
    field: Option<Instant>,
}

/// Whether something is due that was last done then; it then is done now.
fn due(last: &mut Option<Instant>, every: Duration) -> bool {
    let due = last.is_none_or(|last| last.elapsed() >= every);
    if due {
        *last = Some(Instant::now());
    }
    due
}

/// The thread that maps.
struct Mapping<'a> {
    shared: &'a Shared,
    session: Session,
    reader: JointReader,
    tally: Tally,
    checkpoints: Option<Checkpoints>,
    seen: Option<Picker>,
    requests: Receiver<Request>,
    /// Frame and stamp of the last sample.
    header: Header,
    now: Now,
    timers: Timers,
}

impl Mapping<'_> {
    fn run(&mut self) {
        self.shared.outbox.flag();
        while self.shared.goes_on() {
            if self.shared.tare.swap(false, Ordering::Relaxed) {
                self.session.tare();
                self.shared.outbox.flag();
                self.shared.note("taring as asked: the arm must stand still and free".to_owned());
            }
            self.answer();
            // Somebody waits for an answer, but nobody for replays.
            let answering = self.shared.answering.load(Ordering::Relaxed) > 0;
            let spare = self.session.has_spare() && !answering;
            let patience = if spare { Duration::ZERO } else { PAUSE };
            match self.shared.samples.pop(patience) {
                Some(arrived) => self.arrived(arrived),
                None if spare && self.session.spare() => self.tally.replay(),
                None => {}
            }
            self.tell();
        }
        self.session.finish();
    }

    /// Hands out what questions need.
    fn answer(&mut self) {
        while let Ok(request) = self.requests.try_recv() {
            match request {
                Request::Tare => self.shared.tare.store(true, Ordering::Relaxed),
                // Whoever asked may have left.
                Request::PathPredictor { cluster_weight, to_asker } => {
                    drop(
                        to_asker.send(self.session.mapper().coarse_path_predictor(cluster_weight)),
                    );
                }
            }
        }
    }

    fn arrived(&mut self, arrived: Arrived) {
        let (state, at, at_s) = match arrived {
            Arrived::Joints(state, at, at_s) => (state, at, at_s),
            Arrived::Broken(why) => {
                return self.refuse("broken", &format!("it cannot be decoded: {why}"));
            }
        };
        let read = match self.reader.read(&state, at_s) {
            Ok(read) => read,
            Err(refusal) => return self.refuse(refusal.name(), &refusal.to_string()),
        };
        if read.set_back {
            self.session.wait();
            self.shared.note("the clock was set back; waiting for the arm to pause".to_owned());
        }
        self.header.stamp = state.header.stamp;
        let started = Instant::now();
        let told = self.session.take(&read.sample);
        self.tally.step(started.elapsed());
        if let Some(trip) = &told.trip {
            self.shared.tripped(trip);
        }
        if let Some(seen) = &mut self.seen {
            let (state, mapper) = (self.session.state(), self.session.mapper());
            seen.sample((&read.sample, at), (&told, state, mapper));
        }
        self.now.contacts = told.contacts;
        (self.now.external_n_m, self.now.predicted_n_m) = (None, None);
        if let Some((external, predicted)) = told.torques {
            self.now.external_n_m = Some(external.norm());
            self.now.predicted_n_m = Some(predicted.norm());
            if told.contacts > 0 {
                self.tally.compare(&external, &predicted);
            }
            self.shared.outbox.torques(Torques {
                header: self.header.clone(),
                received: at,
                external_n_m: external.data.into(),
                predicted_n_m: predicted.data.into(),
            });
        }
        if told.begins {
            self.tally.touch();
        }
        if let Some(fault) = told.fault
            && self.tally.refuse("not followed")
        {
            self.shared.note(format!("a sample cannot be followed: {fault}"));
        }
    }

    /// Counts a message that cannot be used, and tells the first for each reason.
    fn refuse(&mut self, reason: &'static str, why: &str) {
        if self.tally.refuse(reason) {
            self.shared.note(format!("a message cannot be used: {why} (told once)"));
        }
    }

    /// All that is told now and then.
    fn tell(&mut self) {
        let (shared, session) = (self.shared, &self.session);
        while let Some(latency) = shared.published.pop(Duration::ZERO) {
            self.tally.published(latency);
        }
        if let Some(checkpoints) = &mut self.checkpoints {
            checkpoints.tick(|| Saved::of_mapper(session.mapper()));
        }
        // Whatever is late is later still if clouds are made meanwhile.
        if shared.samples.len() <= BACKLOG && session.state() == State::Mapping {
            self.clouds();
        }
        if due(&mut self.timers.figures, FIGURES) {
            let figures = self.figures();
            if let Some(why) = shared.written.failure() {
                shared.note(format!("the checkpoint could not be written: {why}"));
            }
            if due(&mut self.timers.diagnostics, DIAGNOSTICS) {
                let robot = self.session.mapper().arm().robot.name();
                let header = Header { stamp: self.header.stamp, ..Header::default() };
                shared.outbox.diagnostics(diagnostics::of(&figures, robot, header));
            }
            shared.news.push(News::Figures(Box::new(figures)));
        }
    }

    /// What is touched now, and the field near it.
    fn clouds(&mut self) {
        let (outbox, mapper) = (&self.shared.outbox, self.session.mapper());
        if due(&mut self.timers.contacts, CONTACTS) {
            outbox.contacts(cloud::contacts(mapper, &self.header));
        }
        if due(&mut self.timers.field, FIELD)
            && let Some(near) = cloud::field_near_contacts(mapper, &self.header)
        {
            outbox.field(near);
        }
    }

    fn figures(&mut self) -> Figures {
        let (received, lost) = *self.shared.counts();
        let mapper = self.session.mapper();
        Figures {
            state: self.session.state(),
            dropped: self.shared.samples.dropped(),
            lost,
            contacts: self.now.contacts,
            cells: mapper.n_cells(),
            external_n_m: self.now.external_n_m,
            predicted_n_m: self.now.predicted_n_m,
            stopped: self.shared.is_stopped(),
            unsent: self.shared.outbox.unsent(),
            checkpoint_s: self.shared.written.age_s(),
            ..self.tally.figures(received)
        }
    }
}
