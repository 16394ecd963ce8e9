//! What palpate and its network process say to each other: frames of postcard over a socket, each
//! after its length.

use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use ros2_client::service::RmwRequestId;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::network::NetworkConfig;
use super::parameters::Parameter;
use super::publisher::FlagTopics;
use super::topic::TopicSeen;
use crate::message::{
    AskTrajectoryRequest, AskTrajectoryResponse, DiagnosticArray, Header, JointState, PointCloud2,
    TriggerResponse, WrenchStamped,
};
use crate::session::Detection;

/// Bytes of the largest frame: a cloud of half a million points.
const LARGEST: usize = 16 << 20;
/// A peer that takes nothing for so long has hung.
const PATIENCE: Duration = Duration::from_millis(500);

/// Messages to the network process.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ToNetwork {
    /// Comes first: which network, the robot's joints, where a guard's flag goes, and the node's parameters.
    Join {
        config: NetworkConfig,
        joints: Vec<String>,
        flag: Option<FlagTopics>,
        parameters: Vec<Parameter>,
    },
    /// Comes first where a robot's description is all that is wanted: on which topic, and how long to wait for it.
    Describe {
        config: NetworkConfig,
        topic: String,
        patience: Duration,
    },
    Subscribe(TopicSeen),
    /// Why the guard's flag is up, if it is.
    Flag(Option<String>),
    Torques(Torques),
    Contacts(PointCloud2),
    Field(PointCloud2),
    Diagnostics(DiagnosticArray),
    Wrenches(Vec<WrenchStamped>),
    Answer(RmwRequestId, Response),
}

/// Messages from the network process.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum FromNetwork {
    /// There is no network to join, or a topic cannot be opened.
    Failed(String),
    /// A robot's description, if it came.
    Description(Option<String>),
    /// Who publishes what, after each change until it has subscribed.
    Topics(Vec<TopicSeen>),
    /// A joint state, or why it cannot be decoded, and when it came.
    Joints {
        state: Result<JointState, String>,
        came: Arrival,
    },
    Asked(Asked),
    Counts(Counts),
    /// From the arrival of a sample to the publishing of its prediction.
    Published(Duration),
    /// Nothing was said about a guard's flag for so long that the process has raised it.
    Stalled,
}

/// When a sample came.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Arrival {
    /// Since the network process began.
    pub(crate) since_start: Duration,
    /// By the system's clock, s.
    pub(crate) at_s: f64,
}

/// The torques of a sample.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Torques {
    /// Stamp of the sample.
    pub(crate) header: Header,
    /// When the sample came.
    pub(crate) came: Arrival,
    /// τ_ext, n_joints, N·m.
    pub(crate) external_n_m: Vec<f64>,
    /// τ̂, n_joints, N·m.
    pub(crate) predicted_n_m: Vec<f64>,
    /// How sure τ_ext is, and whether that is a contact, of an arm that was identified.
    pub(crate) detection: Option<Detection>,
}

/// A request that waits for an answer.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Asked {
    pub(crate) request: Request,
    pub(crate) id: RmwRequestId,
}

/// What is asked for.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Request {
    Trigger(Trigger),
    Trajectory(Box<AskTrajectoryRequest>),
}

/// What is answered.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Response {
    Trigger(Trigger, TriggerResponse),
    Trajectory(Box<AskTrajectoryResponse>),
}

/// What is asked for without another word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Trigger {
    Tare,
    Reset,
    Save,
}

impl Trigger {
    pub(crate) const ALL: [Self; 3] = [Self::Tare, Self::Reset, Self::Save];

    /// The service's name.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Tare => "/palpate/tare",
            Self::Reset => "/palpate/reset",
            Self::Save => "/palpate/save",
        }
    }
}

/// Messages of the joint states' topic and of palpate's own.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Counts {
    /// Those that came.
    pub(crate) received: u64,
    /// Those that never came although later ones of the same publisher did.
    pub(crate) lost: u64,
    /// Those for which there was no room on the way out.
    pub(crate) unsent: u64,
}

/// Sends a frame.
///
/// # Errors
///
/// If the other side has gone or hung. Part of a frame may have gone out: nothing can follow it.
pub(crate) fn send(mut stream: &UnixStream, message: &impl Serialize) -> io::Result<()> {
    let mut frame = postcard::to_extend(message, vec![0; 4]).map_err(io::Error::other)?;
    let length = u32::try_from(frame.len() - 4).map_err(io::Error::other)?;
    frame[..4].copy_from_slice(&length.to_le_bytes());
    stream.set_write_timeout(Some(PATIENCE))?;
    stream.write_all(&frame)
}

/// Receives frames.
#[derive(Debug)]
pub(crate) struct Frames {
    stream: UnixStream,
    bytes: Vec<u8>,
    /// Bytes that have been read into `bytes`.
    filled: usize,
}

impl Frames {
    pub(crate) fn new(stream: UnixStream) -> Self {
        Self { stream, bytes: vec![0; 1 << 16], filled: 0 }
    }

    /// The next frame, for which it waits for at most so long.
    ///
    /// # Errors
    ///
    /// If the other side has gone, or says what nobody understands.
    pub(crate) fn next<T: DeserializeOwned>(
        &mut self,
        patience: Duration,
    ) -> io::Result<Option<T>> {
        let until = Instant::now() + patience;
        loop {
            let wanted = self.wanted()?;
            if self.filled >= wanted && wanted > 4 {
                let message = postcard::from_bytes(&self.bytes[4..wanted]);
                self.bytes.copy_within(wanted..self.filled, 0);
                self.filled -= wanted;
                return message.map(Some).map_err(io::Error::other);
            }
            if self.bytes.len() < wanted {
                self.bytes.resize(wanted, 0);
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Ok(None);
            }
            self.stream.set_read_timeout(Some(left))?;
            match self.stream.read(&mut self.bytes[self.filled..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(read) => self.filled += read,
                Err(error)
                    if matches!(
                        error.kind(),
                        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                    ) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Bytes of the first frame with its length, as far as that is known.
    fn wanted(&self) -> io::Result<usize> {
        let Some(length) = self.bytes[..self.filled].first_chunk::<4>() else { return Ok(4) };
        let length = u32::from_le_bytes(*length) as usize;
        if length == 0 || length > LARGEST {
            return Err(io::Error::other(format!("a frame of {length} bytes")));
        }
        Ok(4 + length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    #[test]
    fn frames_of_any_size_come_as_they_were_sent_and_an_end_is_an_error() {
        let (ours, theirs) = UnixStream::pair().unwrap();
        let counts = |n: u64| Counts { received: n, lost: n / 2, unsent: u64::MAX - n };
        let text = "x".repeat(300_000);
        let long = FromNetwork::Failed(text.clone());
        let sender = thread::spawn(move || {
            (0..1000).for_each(|n| send(&theirs, &FromNetwork::Counts(counts(n))).unwrap());
            send(&theirs, &long).unwrap();
        });
        let mut frames = Frames::new(ours);
        let patience = Duration::from_secs(60);
        for n in 0..1000 {
            let Some(FromNetwork::Counts(found)) = frames.next(patience).unwrap() else { panic!() };
            assert_eq!(found, counts(n));
        }
        let Some(FromNetwork::Failed(found)) = frames.next(patience).unwrap() else { panic!() };
        assert_eq!(found, text);
        sender.join().unwrap();
        assert!(frames.next::<FromNetwork>(patience).is_err());
    }

    #[test]
    fn a_wait_ends_after_its_time_and_what_nobody_understands_is_an_error() {
        let (ours, theirs) = UnixStream::pair().unwrap();
        let mut frames = Frames::new(ours);
        let next = |frames: &mut Frames| frames.next::<FromNetwork>(Duration::from_millis(5));
        assert!(next(&mut frames).unwrap().is_none());
        (&theirs).write_all(&[3, 0, 0]).unwrap();
        assert!(next(&mut frames).unwrap().is_none(), "half a length");
        (&theirs).write_all(&[0, 200, 200, 200]).unwrap();
        assert!(next(&mut frames).is_err());
        (&theirs).write_all(&u32::MAX.to_le_bytes()).unwrap();
        assert!(next(&mut frames).is_err());
    }
}
