//! The network process: DDS in a separate process.
//!
//! Packets from the robot's network can make a DDS implementation allocate all memory, run in an endless
//! loop, or stop receiving. So it runs with a memory limit, separate from the mapper and the guard; a
//! fault ends only this process, and [`super::supervisor`] starts another.
//!
//! If palpate stops sending the state of the guard's flag, this process raises the flag itself.

use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::process;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use ros2_client::service::RmwRequestId;
use rustix::process::{Resource, Rlimit, setrlimit};

use super::network::{Network, NetworkError};
use super::publisher::Publishers;
use super::servers::Servers;
use super::subscriber::Subscriber;
use super::wire::{Counts, Frames, FromNetwork, Response, ToNetwork, send};
use crate::threads::lock;
use crate::timer::Timer;

/// Memory limit of the process, bytes. It begins with 14 MiB; with fifteen nodes of sixty topics and a
/// suspended subscriber it takes 47 MiB.
const MEMORY: u64 = 56 << 20;
/// Interval at which each thread checks for other work.
const LOOK: Duration = Duration::from_millis(20);
/// After this time without the state of the guard's flag, palpate counts as hanging.
const SILENCE: Duration = Duration::from_millis(100);
const STALLED: &str = "palpate does not answer";
/// Time for the last messages to be sent.
const FAREWELL: Duration = Duration::from_millis(60);

/// Runs the process, whose standard input is the socket to palpate, until palpate ends.
///
/// # Errors
///
/// If it is not palpate that has started it.
pub fn run() -> io::Result<()> {
    let stream = UnixStream::from(io::stdin().as_fd().try_clone_to_owned()?);
    stream.peer_addr()?;
    let limit = Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) };
    let _ = setrlimit(Resource::Data, limit); // some systems have no such limit
    // A panic of one thread ends the whole process.
    std::panic::set_hook(Box::new(|_| process::exit(101)));
    let mut frames = Frames::new(stream.try_clone()?);
    let first = frames.next(Duration::from_secs(10))?;
    let to_palpate = ToPalpate { stream: Arc::new(Mutex::new(stream)), start: Instant::now() };
    let (config, joints, flag, parameters) = match first {
        Some(ToNetwork::Join { config, joints, flag, parameters }) => {
            (config, joints, flag, parameters)
        }
        Some(ToNetwork::Describe { config, topic, patience }) => {
            let kept = Network::join(&config)
                .and_then(|mut network| network.latched_text(&topic, patience));
            let answer = kept.map_or_else(
                |error| FromNetwork::Failed(error.to_string()),
                FromNetwork::Description,
            );
            return to_palpate.send(&answer);
        }
        _ => return Err(io::Error::other("the first message does not say which network to join")),
    };
    let joined = Network::join(&config).and_then(|mut network| {
        let publishers = network.publish(joints, flag)?;
        let servers = network.serve_all(parameters)?;
        network.confine()?;
        Ok((network, publishers, servers))
    });
    let (network, publishers, servers) = match joined {
        Ok(joined) => joined,
        Err(error) => return to_palpate.send(&FromNetwork::Failed(error.to_string())),
    };
    let (to_subscriber, orders) = mpsc::channel();
    let unsent = Arc::new(AtomicU64::new(0));
    let outgoing = Outgoing {
        publishers,
        to_palpate: to_palpate.clone(),
        to_subscriber,
        unsent: Arc::clone(&unsent),
        flag_reported: flag.is_some().then(Instant::now),
        stalled: false,
    };
    thread::Builder::new()
        .name("outgoing".to_owned())
        .spawn(move || process::exit(outgoing.run(frames)))?;
    let ended = Incoming { network, servers, to_palpate, orders, unsent }.run();
    thread::sleep(2 * FAREWELL); // the other thread ends the process within this time
    ended
}

/// Sends messages to palpate.
#[derive(Clone)]
struct ToPalpate {
    stream: Arc<Mutex<UnixStream>>,
    start: Instant,
}

impl ToPalpate {
    fn send(&self, message: &FromNetwork) -> io::Result<()> {
        send(&lock(&self.stream), message)
    }
}

/// Messages to the subscriber's thread.
enum Order {
    Subscribe(super::TopicSeen),
    Answer(RmwRequestId, Response),
}

/// From palpate to the network.
struct Outgoing {
    publishers: Publishers,
    to_palpate: ToPalpate,
    to_subscriber: Sender<Order>,
    unsent: Arc<AtomicU64>,
    /// When palpate last sent the state of the flag, if there is a guard.
    flag_reported: Option<Instant>,
    /// Whether this process has raised the flag and palpate has not confirmed it yet.
    stalled: bool,
}

impl Outgoing {
    /// Runs until palpate ends; returns the exit code.
    fn run(mut self, mut frames: Frames) -> i32 {
        let mut repeat = Timer::new(LOOK);
        loop {
            match frames.next(LOOK) {
                Ok(Some(message)) => self.take(message),
                Ok(None) => {}
                Err(_) => {
                    self.flag(Some("palpate has ended"));
                    thread::sleep(FAREWELL);
                    return 0;
                }
            }
            let now = Instant::now();
            let is_silent = |at| now.saturating_duration_since(at) > SILENCE;
            if self.flag_reported.is_some_and(is_silent) && repeat.is_due(now) {
                self.stall();
            }
        }
    }

    fn take(&mut self, message: ToNetwork) {
        let publishers = &self.publishers;
        match message {
            ToNetwork::Flag(cause) => {
                self.flag_reported = Some(Instant::now());
                self.stalled &= cause.is_none();
                match self.stalled {
                    true => self.flag(Some(STALLED)),
                    false => self.flag(cause.as_deref()),
                }
            }
            ToNetwork::Torques(torques) => {
                let came = torques.came;
                self.count(publishers.predicted(&torques));
                let took = self.to_palpate.start.elapsed().saturating_sub(came.since_start);
                let _ = self.to_palpate.send(&FromNetwork::Published(took));
                self.count(publishers.external(&torques));
                self.count(publishers.detection(&torques));
            }
            ToNetwork::Contacts(cloud) => self.count(publishers.contacts.publish(cloud).is_ok()),
            ToNetwork::Field(cloud) => self.count(publishers.field.publish(cloud).is_ok()),
            ToNetwork::Diagnostics(array) => {
                self.count(publishers.diagnostics.publish(array).is_ok())
            }
            ToNetwork::Subscribe(topic) => drop(self.to_subscriber.send(Order::Subscribe(topic))),
            ToNetwork::Wrenches(wrenches) => self.count(publishers.wrenches(wrenches)),
            ToNetwork::Answer(id, response) => {
                let _ = self.to_subscriber.send(Order::Answer(id, response));
            }
            ToNetwork::Join { .. } | ToNetwork::Describe { .. } => {}
        }
    }

    /// Raises the flag until palpate has raised it too: palpate must not take it down by continuing after
    /// a pause.
    fn stall(&mut self) {
        if !self.stalled && self.publishers.flag_is_down() {
            self.stalled = true;
            let _ = self.to_palpate.send(&FromNetwork::Stalled);
        }
        self.flag(Some(STALLED));
    }

    fn flag(&mut self, cause: Option<&str>) {
        let unsent = self.publishers.flag(cause);
        self.unsent.fetch_add(unsent, Ordering::Relaxed);
    }

    fn count(&self, sent: bool) {
        self.unsent.fetch_add(u64::from(!sent), Ordering::Relaxed);
    }
}

/// From the network to palpate.
struct Incoming {
    network: Network,
    servers: Servers,
    to_palpate: ToPalpate,
    orders: Receiver<Order>,
    unsent: Arc<AtomicU64>,
}

impl Incoming {
    /// Runs until palpate does not listen any more.
    fn run(mut self) -> io::Result<()> {
        let mut subscriber: Option<Subscriber> = None;
        let (mut topics, mut counts) = (None, Counts::default());
        let mut counts_due = Timer::new(5 * LOOK);
        loop {
            for order in self.orders.try_iter() {
                match (order, &mut subscriber) {
                    (Order::Subscribe(topic), None) => {
                        let opened = self.network.subscribe(&topic, &mut self.servers);
                        match opened.and_then(|opened| self.network.confine().map(|()| opened)) {
                            Ok(opened) => subscriber = Some(opened),
                            Err(error) => return self.fail(&error),
                        }
                    }
                    (Order::Answer(id, response), _) => self.servers.answer(id, response),
                    (Order::Subscribe(_), Some(_)) => {}
                }
            }
            let mut sent = Ok(());
            let mut hand_on = |received| {
                if sent.is_ok() {
                    sent = self.to_palpate.send(&received);
                }
            };
            self.servers.receive(&mut hand_on);
            if let Some(subscriber) = &mut subscriber {
                subscriber.receive(LOOK, self.to_palpate.start, hand_on);
            }
            sent?;
            let Some(subscriber) = &subscriber else {
                let seen = self.network.topics();
                if topics.as_ref() != Some(&seen) {
                    self.to_palpate.send(&FromNetwork::Topics(seen.clone()))?;
                    topics = Some(seen);
                }
                thread::sleep(LOOK);
                continue;
            };
            let (received, lost) = subscriber.counts();
            let now = Counts { received, lost, unsent: self.unsent.load(Ordering::Relaxed) };
            if now != counts && counts_due.is_due(Instant::now()) {
                self.to_palpate.send(&FromNetwork::Counts(now))?;
                counts = now;
            }
        }
    }

    fn fail(&self, error: &NetworkError) -> io::Result<()> {
        self.to_palpate.send(&FromNetwork::Failed(error.to_string()))
    }
}
