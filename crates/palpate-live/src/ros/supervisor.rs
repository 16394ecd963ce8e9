//! palpate's side of the network process: starts it, exchanges messages with it, and ends it.

use std::io;
use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use super::network::{NetworkConfig, NetworkError};
use super::parameters::Parameter;
use super::publisher::FlagTopics;
use super::topic::TopicSeen;
use super::wire::{Frames, FromNetwork, ToNetwork, send};
use crate::threads::lock;

/// Largest time for the process to join the network.
const JOIN: Duration = Duration::from_secs(10);
/// Largest time to wait for a robot's description.
const DESCRIPTION: Duration = Duration::from_secs(10);
/// Time for the process to end by itself, before it is killed.
const END: Duration = Duration::from_millis(300);

/// The network process: how to start it, and its settings.
pub struct NetworkProcess {
    command: Box<dyn Fn() -> Command + Send + Sync>,
    config: NetworkConfig,
    joints: Vec<String>,
    flag: Option<FlagTopics>,
    parameters: Vec<Parameter>,
    link: Mutex<Option<UnixStream>>,
}

impl NetworkProcess {
    /// A process that `command` starts, whose program must call [`super::run_network`], for a robot with
    /// these joints; with a guard's flag if `flag` is given.
    pub fn new(
        command: impl Fn() -> Command + Send + Sync + 'static,
        config: NetworkConfig,
        joints: Vec<String>,
        flag: Option<FlagTopics>,
    ) -> Self {
        let (command, link) = (Box::new(command), Mutex::default());
        Self { command, config, joints, flag, parameters: Vec::new(), link }
    }

    /// Adds parameters to the node.
    #[must_use]
    pub fn with_parameters(self, parameters: Vec<Parameter>) -> Self {
        Self { parameters, ..self }
    }

    /// Starts the process.
    ///
    /// # Errors
    ///
    /// If it cannot be started, or cannot join the network.
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

    /// Receives the URDF from a latched topic, such as `/robot_description` of `robot_state_publisher`. Stops waiting
    /// when `is_over` returns true.
    ///
    /// # Errors
    ///
    /// If it does not come within ten seconds, waiting was stopped, or there is no network.
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
        *lock(&self.link) = Some(ours);
        Ok(listener)
    }

    /// A note for the user if time is taken from `/clock` and nobody publishes it.
    pub(crate) fn lacks_clock(&self, topics: &[TopicSeen]) -> Option<String> {
        let name = self.config.names.of("/clock");
        let lacks = self.config.sim_time && !topics.iter().any(|topic| topic.name == name);
        lacks.then(|| {
            format!(
                "nobody publishes `{name}` yet, which gives the time (--sim-time): joint states without a time stamp \
                 cannot be used until then"
            )
        })
    }

    /// Sends the process a message; returns whether it could be sent.
    pub(crate) fn send(&self, message: &ToNetwork) -> bool {
        let mut link = lock(&self.link);
        let sent = link.as_ref().is_some_and(|stream| send(stream, message).is_ok());
        if !sent && let Some(stream) = link.take() {
            let _ = stream.shutdown(Shutdown::Both); // the listener then sees the end
        }
        sent
    }
}

/// Receives from a network process; dropping it ends the process.
pub(crate) struct Listener<'a> {
    process: &'a NetworkProcess,
    child: Child,
    frames: Frames,
    /// The first message of the process, received at its start.
    first: Option<FromNetwork>,
}

impl Listener<'_> {
    /// The next message of the process; `None` if none comes within `patience`.
    ///
    /// # Errors
    ///
    /// If it has ended, or sends invalid data.
    pub(crate) fn next(&mut self, patience: Duration) -> io::Result<Option<FromNetwork>> {
        match self.first.take() {
            Some(first) => Ok(Some(first)),
            None => self.frames.next(patience),
        }
    }

    /// Ends the process; returns its exit status.
    pub(crate) fn end(&mut self) -> Option<ExitStatus> {
        if let Some(stream) = lock(&self.process.link).take() {
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
