//! The threads of a live session.
//!
//! ```text
//! network ──► listen ──► LatestQueue ──► mapper ──► Outbox ──► publish ──► network
//! process   (one thread)           (one thread)   │     (one thread)     process
//!                                     ▲           ├──► checkpoints (one thread)
//!                       questions ────┘           ├──► elastic body (two threads)
//!                                                 ├──► frames for a viewer
//!                                                 └──► events, to the caller
//! ```
//!
//! No thread waits for a slower one: every queue is bounded, and most keep the newest items.

use std::sync::Arc;
use std::thread::{self, ScopedJoinHandle};

use crossbeam_channel::bounded;
use palpate::Sample;
use palpate_learn::tune::FixedSettings;

use crate::body::LiveElasticBody;
use crate::checkpoint::{self, CheckpointConfig, Checkpoints};
use crate::choose::Chooser;
use crate::figures::SessionEvent;
use crate::guard::JointStateMonitor;
use crate::latest_queue::LatestQueue;
use crate::mapping::Mapping;
use crate::query_server::{QueryServer, QuerySocket};
use crate::ros::{NetworkError, NetworkProcess};
use crate::services::{self, ServiceHandler};
use crate::session::{Session, SessionState};
use crate::threads::{LOOK, Shared, listen, publish, spawn};
use crate::view_feed::ViewFrame;

/// Settings of a session.
#[derive(Debug, Clone)]
pub struct LiveConfig {
    /// The topic of joint states; `None` takes the only one on the network.
    pub joint_states: Option<String>,
    /// Largest number of samples that wait for the mapper.
    pub queue: usize,
    /// File and interval of checkpoints; `None` for no checkpoints.
    pub checkpoint: Option<CheckpointConfig>,
    /// Queue for frames of a viewer, if there is one.
    pub view: Option<Arc<LatestQueue<ViewFrame>>>,
    /// Queue for mapped samples, if the caller wants them.
    pub mapped: Option<Arc<LatestQueue<MappedSample>>>,
    /// The object as an elastic body, if its shape is known.
    pub body: Option<Arc<LiveElasticBody>>,
    /// If settings are chosen by cross-validation during the session: those that the user has given, which stay.
    pub choose: Option<FixedSettings>,
}

/// A mapped sample and its outcome.
#[derive(Debug, Clone)]
pub struct MappedSample {
    /// The sample.
    pub sample: Sample,
    /// Number of cells that it touches.
    pub contacts: usize,
    /// State of the session after the sample.
    pub state: SessionState,
    /// Whether a touch begins with it.
    pub begins: bool,
    /// Samples of the pause with which a touch begins, including this one; empty if no touch begins, or if it
    /// begins without a pause.
    pub tare: Vec<Sample>,
    /// Whether the session could use the sample.
    pub is_usable: bool,
}

/// Largest number of requests that wait for the mapper.
const REQUESTS: usize = 16;

/// Maps what a robot publishes until `stop` returns true; returns the session, whose touch is ended, and
/// the error if a thread panicked, which ends the session early.
///
/// `report` is called on the calling thread, and may block.
///
/// # Errors
///
/// If the network process cannot be started or cannot join the network, or the mapper's thread panicked.
pub fn run(
    network: &NetworkProcess,
    session: Session,
    config: &LiveConfig,
    ask: Option<&QuerySocket>,
    stop: impl Fn() -> bool,
    mut report: impl FnMut(SessionEvent),
) -> Result<(Session, Option<NetworkError>), NetworkError> {
    let arm = Arc::clone(session.mapper().arm());
    let guard = session.guard().cloned();
    let shared = Shared::new(config.queue, guard.clone());
    let listener = network.start()?;
    thread::scope(|scope| {
        let ending = EndOnDrop(&shared);
        let mapper = session.mapper();
        let joints = arm.robot.joint_names().map(str::to_owned).collect();
        let monitor =
            guard.map(|guard| JointStateMonitor::new(guard, arm, mapper.config().touch.clone()));
        let checker = mapper.path_checker();
        let (checkpoints, to_write) = config.checkpoint.as_ref().map(Checkpoints::new).unzip();
        let (to_mapper, requests) = bounded(REQUESTS);
        let chooser =
            config.choose.map(|given| Chooser::new(mapper, given, to_mapper.clone(), &shared));
        let mapping = Mapping::new(&shared, (session, config), checkpoints, requests);
        let (shared, body) = (&shared, config.body.as_deref());
        let queries = QueryServer { mapper: to_mapper, checker, shared, body: config.body.clone() };
        let services = ServiceHandler {
            queries: queries.clone(),
            joints,
            has_file: config.checkpoint.is_some(),
        };
        let (to_services, asked) = bounded(services::REQUESTS);
        let heard = (config.joint_states.as_deref(), to_services);
        let mut threads = vec![
            spawn(scope, "publisher", || publish(network, shared)),
            spawn(scope, "listener", move || listen(network, listener, heard, monitor, shared)),
            spawn(scope, "services", move || services.run(network, &asked)),
        ];
        if let (Some(config), Some(to_write)) = (&config.checkpoint, to_write) {
            let written = &shared.written;
            threads.push(spawn(scope, "checkpoints", move || {
                checkpoint::write(&config.path, (to_write, body), written)
            }));
        }
        threads.extend(ask.map(|ask| spawn(scope, "ask", move || ask.run(&queries))));
        if let Some(body) = body {
            threads.push(spawn(scope, "body", move || body.follow(shared)));
            threads.push(spawn(scope, "body learner", move || body.learn(shared)));
        }
        threads.extend(chooser.map(|chooser| spawn(scope, "choose", move || chooser.run())));
        let mapper = spawn(scope, "mapper", || mapping.run());
        while !mapper.is_finished() {
            if let Some(event) = shared.events.pop(LOOK) {
                report(event);
            }
            if stop() || threads.iter().any(ScopedJoinHandle::is_finished) {
                shared.stop();
            }
        }
        let session = mapper.join();
        drop(ending);
        let defect = join_all(threads);
        match session {
            Ok(session) => Ok((session, defect)),
            Err(_) => Err(NetworkError::Defect { thread: "mapper".to_owned() }),
        }
    })
}

/// Waits for the threads; an error names one that panicked.
fn join_all(threads: Vec<ScopedJoinHandle<'_, ()>>) -> Option<NetworkError> {
    let mut defect = None;
    for thread in threads {
        let thread_name = thread.thread().name().unwrap_or_default().to_owned();
        if thread.join().is_err() {
            defect = Some(NetworkError::Defect { thread: thread_name });
        }
    }
    defect
}

/// Ends all threads when their scope is left, also by a panic: otherwise the scope would wait forever.
struct EndOnDrop<'a>(&'a Shared);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}
