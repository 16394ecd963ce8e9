//! Messages between palpate and its network process: frames of postcard over a socket, each preceded
//! by its length.

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

/// Largest frame, bytes: a cloud of half a million points.
const LARGEST: usize = 16 << 20;
/// A peer that does not read for this time counts as hanging.
const PATIENCE: Duration = Duration::from_millis(500);

/// Messages to the network process.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ToNetwork {
    /// First message: the network, joint names, topics of the guard's flag, and parameters of the node.
    Join {
        config: NetworkConfig,
        joints: Vec<String>,
        flag: Option<FlagTopics>,
        parameters: Vec<Parameter>,
    },
    /// First message if only a robot's description is wanted: its topic, and how long to wait for it.
    Describe {
        config: NetworkConfig,
        topic: String,
        patience: Duration,
    },
    Subscribe(TopicSeen),
    /// The guard's flag: up for a cause, down for `None`.
    Flag(Option<String>),
    Torques(TorqueMessage),
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
    /// A robot's description; `None` if it did not come in time.
    Description(Option<String>),
    /// The topics with a publisher; sent after each change until one is subscribed to.
    Topics(Vec<TopicSeen>),
    /// A joint state, or why it cannot be decoded, and its arrival.
    Joints {
        state: Result<JointState, String>,
        came: Arrival,
    },
    Asked(PendingRequest),
    Counts(Counts),
    /// Time from the arrival of a sample to the publishing of its prediction.
    Published(Duration),
    /// The process has raised the guard's flag, since its state was not sent for too long.
    Stalled,
}

/// Arrival of a sample at the network process.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Arrival {
    /// Time since the network process began.
    pub(crate) since_start: Duration,
    /// Time of the system clock, or of `/clock` if time is simulated, s.
    pub(crate) at_s: f64,
}

/// The torques of a sample.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct TorqueMessage {
    /// Stamp of the sample.
    pub(crate) header: Header,
    /// Arrival of the sample.
    pub(crate) came: Arrival,
    /// τ_ext, n_joints, N·m.
    pub(crate) external_n_m: Vec<f64>,
    /// τ̂, n_joints, N·m.
    pub(crate) predicted_n_m: Vec<f64>,
    /// Standard deviation of τ_ext and detected contact, for an identified arm.
    pub(crate) detection: Option<Detection>,
}

/// A request that waits for an answer.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct PendingRequest {
    pub(crate) request: Request,
    pub(crate) id: RmwRequestId,
}

/// Content of a request.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Request {
    Trigger(Trigger),
    Trajectory(Box<AskTrajectoryRequest>),
}

/// Answer to a request.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) enum Response {
    Trigger(Trigger, TriggerResponse),
    Trajectory(Box<AskTrajectoryResponse>),
}

/// A request without arguments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Trigger {
    Tare,
    Reset,
    Save,
}

impl Trigger {
    pub(crate) const ALL: [Self; 3] = [Self::Tare, Self::Reset, Self::Save];

    /// Name of the service.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Tare => "/palpate/tare",
            Self::Reset => "/palpate/reset",
            Self::Save => "/palpate/save",
        }
    }
}

/// Numbers of messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Counts {
    /// Received on the topic of joint states.
    pub(crate) received: u64,
    /// Lost on this topic: missing although later ones of the same publisher came.
    pub(crate) lost: u64,
    /// Not published since a queue was full.
    pub(crate) unsent: u64,
}

/// Sends a frame.
///
/// # Errors
///
/// If the other side has ended or hangs. Part of a frame may have been sent: the stream is then unusable.
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
    /// Number of bytes read into `bytes`.
    filled: usize,
}

impl Frames {
    pub(crate) fn new(stream: UnixStream) -> Self {
        Self { stream, bytes: vec![0; 1 << 16], filled: 0 }
    }

    /// The next frame; `None` if none comes within `patience`.
    ///
    /// # Errors
    ///
    /// If the other side has ended, or sends an invalid frame.
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

    /// Size of the first frame with its length prefix, bytes; only of the prefix while that is incomplete.
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
    fn a_read_ends_after_its_time_out_and_an_invalid_frame_is_an_error() {
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
