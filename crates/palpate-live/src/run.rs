//! The threads of a live session.
//!
//! ```text
//! network ──► Subscriber ──► Inbox ──► mapper ──► Outbox ──► Publishers ──► network
//!             (one thread)      (one thread)   │    (one thread)
//!                                  ▲           ├──► checkpoints (one thread)
//!                    questions ────┘           │
//!                                              ├──► frames for a viewer
//!                                              └──► news, to the caller
//! ```
//!
//! Nobody waits for a slower thread: every queue is bounded and keeps the newest.

use std::sync::Arc;
use std::thread::{self, ScopedJoinHandle};
use std::time::{Duration, Instant};

use crossbeam_channel::bounded;

use crate::checkpoint::{self, CheckpointConfig, Checkpoints};
use crate::figures::News;
use crate::guard::Sentry;
use crate::inbox::Inbox;
use crate::mapping::Mapping;
use crate::query_server::{AskSocket, QueryServer};
use crate::ros::{Network, NetworkError, TopicSeen, choose};
use crate::session::Session;
use crate::threads::{LOOK, Shared, publish, receive, spawn};
use crate::view_feed::ViewFrame;

/// How a session is run.
#[derive(Debug, Clone)]
pub struct LiveConfig {
    /// The topic of joint states; `None` takes the only one there is.
    pub joint_states: Option<String>,
    /// Samples that may wait for the mapper.
    pub queue: usize,
    /// Where checkpoints go, if anywhere.
    pub checkpoint: Option<CheckpointConfig>,
    /// Where frames for a viewer go, if anywhere.
    pub view: Option<Arc<Inbox<ViewFrame>>>,
}

/// Questions that may wait.
const REQUESTS: usize = 16;
/// How long the topics of a network may take to appear before the user reads that there is none.
const DISCOVERY: Duration = Duration::from_secs(2);

/// Maps what a robot publishes until `stop` is true; returns the session, whose touch has ended, and
/// the defect that ended it before, if one did.
///
/// `report` is called on this thread, and may take its time.
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
    mut report: impl FnMut(News),
) -> Result<(Session, Option<NetworkError>), NetworkError> {
    let mapper = session.mapper();
    let arm = Arc::clone(mapper.arm());
    let publishers = network.publish(arm.robot.joint_names().map(str::to_owned).collect())?;
    let Some(topic) = find_topic(&network, config, &stop, &mut report) else {
        return Ok((session, None));
    };
    let subscriber = network.subscribe(&topic)?;
    let how = if topic.reliable { "reliable" } else { "best effort" };
    report(News::Note(format!("listening to `{}` ({how})", topic.name)));

    let guard = session.guard().cloned();
    let sentry = guard.clone().map(|guard| Sentry::new(guard, arm, mapper.config().touch.clone()));
    let checker = mapper.path_checker();
    let shared = Shared::new(config.queue, guard);
    let (checkpoints, to_write) = config.checkpoint.as_ref().map(Checkpoints::new).unzip();
    let (to_mapper, requests) = bounded(REQUESTS);
    let mapping = Mapping::new(&shared, session, checkpoints, config.view.clone(), requests);
    thread::scope(|scope| {
        let stopping = StopOnDrop(&shared);
        let mut threads = vec![
            spawn(scope, "subscriber", || receive(subscriber, sentry, &shared)),
            spawn(scope, "publisher", || publish(&publishers, &shared)),
        ];
        if let (Some(config), Some(to_write)) = (&config.checkpoint, to_write) {
            threads.push(spawn(scope, "checkpoints", || {
                checkpoint::write(&config.path, to_write, &shared.written)
            }));
        }
        if let Some(ask) = ask {
            let server = QueryServer { mapper: to_mapper, checker, shared: &shared };
            threads.push(spawn(scope, "ask", move || ask.run(&server)));
        }
        let mapper = spawn(scope, "mapper", || mapping.run());
        while !mapper.is_finished() {
            if let Some(news) = shared.news.pop(LOOK) {
                report(news);
            }
            if stop() || threads.iter().any(ScopedJoinHandle::is_finished) {
                shared.stop();
            }
        }
        let session = mapper.join();
        drop(stopping);
        let mut defect = None;
        for thread in threads {
            let thread_name = thread.thread().name().unwrap_or_default().to_owned();
            if thread.join().is_err() {
                defect = Some(NetworkError::Defect { thread: thread_name });
            }
        }
        match session {
            Ok(session) => Ok((session, defect)),
            Err(_) => Err(NetworkError::Defect { thread: "mapper".to_owned() }),
        }
    })
}

/// Ends the session when the scope of its threads is left, even by a panic: the scope waits for them.
struct StopOnDrop<'a>(&'a Shared);

impl Drop for StopOnDrop<'_> {
    fn drop(&mut self) {
        self.0.stop();
    }
}

/// Waits for the topic to appear.
fn find_topic(
    network: &Network,
    config: &LiveConfig,
    stop: &impl Fn() -> bool,
    report: &mut impl FnMut(News),
) -> Option<TopicSeen> {
    let started = Instant::now();
    let mut reported = String::new();
    while !stop() {
        match choose(&network.topics(), config.joint_states.as_deref()) {
            Ok(topic) => return Some(topic),
            Err(why) if why != reported && started.elapsed() > DISCOVERY => {
                report(News::Note(format!("waiting: {why}")));
                reported = why;
            }
            Err(_) => {}
        }
        thread::sleep(LOOK);
    }
    None
}
