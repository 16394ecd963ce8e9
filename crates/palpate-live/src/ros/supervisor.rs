//! palpate's side of the network process: starts it, and another one when it has ended, hung or gone
//! deaf.

use std::io;
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use super::network::{NetworkConfig, NetworkError};
use super::parameters::Parameter;
use super::publisher::FlagTopics;
use super::topic::TopicSeen;
use super::wire::{Frames, FromNetwork, ToNetwork, send};

/// How long the process may take to join.
const JOIN: Duration = Duration::from_secs(10);
/// How long a robot's description may be on its way.
const DESCRIPTION: Duration = Duration::from_secs(10);
/// How long it may take to end, before it is ended.
const END: Duration = Duration::from_millis(300);

/// How to start the network process, and what it is to do.
pub struct NetworkProcess {
    command: Box<dyn Fn() -> Command + Send + Sync>,
    config: NetworkConfig,
    joints: Vec<String>,
    flag: Option<FlagTopics>,
    parameters: Vec<Parameter>,
    link: Mutex<Option<UnixStream>>,
}

impl NetworkProcess {
    /// A process that `command` starts: it calls [`super::run_network`]. For a robot of these
    /// joints, with a guard's flag or without.
    pub fn new(
        command: impl Fn() -> Command + Send + Sync + 'static,
        config: NetworkConfig,
        joints: Vec<String>,
        flag: Option<FlagTopics>,
    ) -> Self {
        let (command, link) = (Box::new(command), Mutex::default());
        Self { command, config, joints, flag, parameters: Vec::new(), link }
    }

    /// The same, of a node with parameters.
    #[must_use]
    pub fn with_parameters(self, parameters: Vec<Parameter>) -> Self {
        Self { parameters, ..self }
    }

    /// Starts it.
    ///
    /// # Errors
    ///
    /// If it cannot be started, or cannot join.
    pub(crate) fn start(&self) -> Result<Listener<'_>, NetworkError> {
        let (config, joints) = (self.config.clone(), self.joints.clone());
        let parameters = self.parameters.clone();
        let join = ToNetwork::Join { config, joints, flag: self.flag, parameters };
        let mut listener = self.spawn(&join).map_err(|error| NetworkError::process(&error))?;
        match listener.frames.next(JOIN) {
            Ok(Some(FromNetwork::Failed(why))) => Err(NetworkError::Failed { why }),
            Ok(Some(first)) => {
                listener.first = Some(first);
                Ok(listener)
            }
            Ok(None) => Err(NetworkError::process(&"it does not answer")),
            Err(error) => Err(NetworkError::process(&error)),
        }
    }

    /// The URDF that somebody keeps on a topic, as `robot_state_publisher` does on `/robot_description`. `is_over` is
    /// asked every now and then whether to go on waiting.
    ///
    /// # Errors
    ///
    /// If nobody publishes it within ten seconds, or there is no network.
    pub fn description(
        &self,
        topic: &str,
        is_over: impl Fn() -> bool,
    ) -> Result<String, NetworkError> {
        let (config, topic) = (self.config.clone(), topic.to_owned());
        let describe = ToNetwork::Describe { config, topic: topic.clone(), patience: DESCRIPTION };
        let mut listener = self.spawn(&describe).map_err(|error| NetworkError::process(&error))?;
        let until = Instant::now() + DESCRIPTION + JOIN;
        while Instant::now() < until && !is_over() {
            match listener.frames.next(Duration::from_millis(100)) {
                Ok(Some(FromNetwork::Description(Some(text)))) => return Ok(text),
                Ok(Some(FromNetwork::Failed(why))) => return Err(NetworkError::Failed { why }),
                Ok(Some(_)) => break,
                Ok(None) => {}
                Err(error) => return Err(NetworkError::process(&error)),
            }
        }
        Err(NetworkError::NoDescription { topic, seconds: DESCRIPTION.as_secs() })
    }

    fn spawn(&self, first: &ToNetwork) -> io::Result<Listener<'_>> {
        let (ours, theirs) = UnixStream::pair()?;
        let child = (self.command)()
            .stdin(Stdio::from(OwnedFd::from(theirs)))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .process_group(0) // Ctrl-C is for palpate
            .spawn()?;
        let mut listener =
            Listener { process: self, child, frames: Frames::new(ours.try_clone()?), first: None };
        if let Err(error) = send(&ours, first) {
            listener.end();
            return Err(error);
        }
        *self.link() = Some(ours);
        Ok(listener)
    }

    /// The note for the user if time is that of `/clock` and nobody publishes it.
    pub(crate) fn lacks_clock(&self, topics: &[TopicSeen]) -> Option<String> {
        let name = self.config.names.of("/clock");
        let lacks = self.config.sim_time && !topics.iter().any(|topic| topic.name == name);
        lacks.then(|| {
            format!(
                "nobody publishes `{name}` yet, whose time is to be taken (--sim-time): joint states without a stamp \
                 cannot be used until then"
            )
        })
    }

    /// Sends the process a message; whether it could be sent.
    pub(crate) fn send(&self, message: &ToNetwork) -> bool {
        let mut link = self.link();
        let sent = link.as_ref().is_some_and(|stream| send(stream, message).is_ok());
        if !sent && let Some(stream) = link.take() {
            let _ = stream.shutdown(Shutdown::Both); // whoever listens sees it end
        }
        sent
    }

    fn link(&self) -> MutexGuard<'_, Option<UnixStream>> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Hears a network process, which ends with it.
pub(crate) struct Listener<'a> {
    process: &'a NetworkProcess,
    child: Child,
    frames: Frames,
    /// What it has said at its start.
    first: Option<FromNetwork>,
}

impl Listener<'_> {
    /// What the process says next, for which it waits for at most so long.
    ///
    /// # Errors
    ///
    /// If it has ended, or lost its head.
    pub(crate) fn next(&mut self, patience: Duration) -> io::Result<Option<FromNetwork>> {
        match self.first.take() {
            Some(first) => Ok(Some(first)),
            None => self.frames.next(patience),
        }
    }

    /// Ends the process, and says how it has ended.
    pub(crate) fn end(&mut self) -> Option<ExitStatus> {
        if let Some(stream) = self.process.link().take() {
            let _ = stream.shutdown(Shutdown::Both);
        }
        let until = Instant::now() + END;
        while Instant::now() < until {
            match self.child.try_wait() {
                Ok(None) => thread::sleep(Duration::from_millis(5)),
                Ok(status) => return status,
                Err(_) => break,
            }
        }
        let _ = self.child.kill();
        self.child.wait().ok()
    }
}

impl Drop for Listener<'_> {
    fn drop(&mut self) {
        self.end();
    }
}
