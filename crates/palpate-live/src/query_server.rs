//! Answers questions about planned motions while the robot moves, over a Unix socket: one line of
//! JSON for each question and each answer.
//!
//! | a line with         | is answered with                                                                     |
//! |---------------------|--------------------------------------------------------------------------------------|
//! | `{"path": [[q…]…]}` | `torque`, `torque_std` (N × n_joints, N·m), `contacts`, `known` (N), `goes_on`, `ms` |
//! | `{"path_f64": "…"}` | the same, with `torque_f64` and `torque_std_f64` as base64                           |
//! | `{"tare": true}`    | `{"taring": true}`                                                                   |
//! | anything else       | `{"error": …}`, and the next line is read                                            |
//!
//! If the field has bands, an answer about a path also has `level`, and `half_width` and
//! `peak_half_width` (N × n_joints, N·m), or both with `_f64`; `"level": 0.8` beside the path
//! chooses the level. Torques in lists are rounded to 1e-6 N·m.
//!
//! Values whose names end in `_f64` are the bytes of the numbers as base64: float64, little-endian,
//! point by point. For 200 points of 7 joints this saves a Python client 2 ms of formatting and
//! parsing.
//!
//! A path is joint positions (N × n_joints, rad or m) in the order of the URDF. It starts where the
//! arm is, or free of contact ([`palpate::PathPredictor`]). `"exact": true` beside it uses
//! every point and every spring, which takes about twenty times as long. The interface is a socket
//! with JSON because ROS message types would have to be built for every client.
//!
//! The mapper only copies what a question needs, some nanoseconds for each touched cell, and
//! continues; another thread computes the answer, with the threads of rayon. Replays pause
//! meanwhile, since they are not urgent.

use std::error::Error;
use std::fmt::Display;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use palpate::unstable::{LogPosition, PathChecker, TouchLog};
use palpate::{CLUSTER_WEIGHT, Mapper, MapperError, PathConfig, PathPrediction, PathPredictor};
use rustix::fs::Mode;
use serde_json::json;

use crate::body::LiveElasticBody;
use crate::question::{MAX_POINTS, PathReply, PathRequest};
use crate::session::Succession;
use crate::threads::{Shared, lock, spawn};

/// Largest number of connected clients.
const MAX_CLIENTS: usize = 8;
/// Bytes allowed for a number in the longest line.
const NUMBER: usize = 26;
/// Bytes allowed for the rest of the longest line.
const REST: usize = 4096;
/// Largest time for the mapper to hand out a path predictor, and for a client to take its answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Interval between checks whether the session has ended.
const LOOK: Duration = Duration::from_millis(50);
/// Interval between checks for new connections.
const ACCEPT: Duration = Duration::from_millis(2);

/// A request to the mapper's thread.
pub(crate) enum Request {
    /// Hand out a path predictor with clusters of this weight, in average springs.
    Predictor(f64, Sender<PathPredictor>),
    /// Save the field; the answer is the number of the checkpoint, or `None` if an earlier one still waits for the
    /// writer.
    Save(Sender<Option<u64>>),
    /// How far the mapper has learnt.
    Position(Sender<LogPosition>),
    /// The samples of touches from a position on.
    Log(LogPosition, Sender<Result<TouchLog, MapperError>>),
    /// Go on with another mapper.
    GoOnWith(Box<Mapper>, Sender<Result<Succession, (MapperError, Box<Mapper>)>>),
}

/// Largest distance of a path beyond a joint limit, rad or m: real arms exceed the limits slightly.
const LIMIT_MARGIN: f64 = 0.05;

/// Answers the questions of all connections.
#[derive(Clone)]
pub(crate) struct QueryServer<'a> {
    /// Requests to the mapper's thread.
    pub(crate) mapper: Sender<Request>,
    /// Checks whether a path can be predicted.
    pub(crate) checker: PathChecker,
    pub(crate) shared: &'a Shared,
    pub(crate) body: Option<Arc<LiveElasticBody>>,
}

/// The socket; dropping it removes its file.
#[derive(Debug)]
pub struct QuerySocket {
    listener: UnixListener,
    path: PathBuf,
    /// Device and inode of its file.
    file: (u64, u64),
}

impl QuerySocket {
    /// Opens a socket. The file of a socket whose process has ended is replaced.
    ///
    /// # Errors
    ///
    /// If another process listens there, another file is there, or the socket cannot be created.
    pub fn bind(path: &Path) -> io::Result<Self> {
        use std::os::unix::fs::FileTypeExt;
        if let Ok(metadata) = path.symlink_metadata() {
            let alive = UnixStream::connect(path).is_ok();
            if alive || !metadata.file_type().is_socket() {
                return Err(io::Error::new(
                    io::ErrorKind::AddrInUse,
                    if alive { "another process listens there" } else { "it is a file" },
                ));
            }
            std::fs::remove_file(path)?;
        }
        // Only the owner may access the file, from its creation on.
        let umask = rustix::process::umask(Mode::RWXG | Mode::RWXO | Mode::XUSR);
        let listener = UnixListener::bind(path);
        rustix::process::umask(umask);
        let listener = listener?;
        listener.set_nonblocking(true)?;
        let file = file_at(path)?;
        Ok(Self { listener, path: path.to_owned(), file })
    }

    /// Answers questions until the session ends.
    pub(crate) fn run(&self, server: &QueryServer<'_>) {
        let clients = &Clients::default();
        thread::scope(|scope| {
            while server.shared.is_running() {
                let Ok((stream, _)) = self.listener.accept() else {
                    thread::sleep(ACCEPT);
                    continue;
                };
                let stream = Arc::new(stream);
                let Some(client) = clients.admit(&stream) else {
                    let _ =
                        send(&stream, error("too many programs are connected; try again later"));
                    continue;
                };
                spawn(scope, "answer", move || {
                    // Errors are ignored: a client may disconnect at any time.
                    let conversation = || drop(converse(&client, server));
                    if catch_unwind(AssertUnwindSafe(conversation)).is_err() {
                        server
                            .shared
                            .note("a question was not answered, because of a defect of palpate");
                    }
                });
            }
        });
    }
}

/// The connected clients.
#[derive(Default)]
struct Clients(Mutex<Vec<ClientSlot>>);

/// Entry of a client in the list of [`Clients`].
struct ClientSlot {
    stream: Arc<UnixStream>,
    /// Time since which it has asked nothing; `None` while it is being answered.
    idle: Option<Instant>,
}

/// Handle of a client in the thread of its connection; dropping it removes the client from the list.
struct Client<'a> {
    clients: &'a Clients,
    stream: Arc<UnixStream>,
}

impl Clients {
    /// Adds a client. If the list is full, disconnects the client that has been idle for longest; returns
    /// `None` if none is idle.
    fn admit(&self, stream: &Arc<UnixStream>) -> Option<Client<'_>> {
        let mut slots = lock(&self.0);
        if slots.len() >= MAX_CLIENTS {
            let idle = slots.iter().enumerate().filter_map(|(n, slot)| Some((slot.idle?, n)));
            let (_, longest) = idle.min()?;
            let slot = slots.swap_remove(longest);
            let _ = slot.stream.shutdown(Shutdown::Both);
        }
        slots.push(ClientSlot { stream: Arc::clone(stream), idle: Some(Instant::now()) });
        Some(Client { clients: self, stream: Arc::clone(stream) })
    }
}

impl Client<'_> {
    /// Records whether the client is idle, that is, does not wait for an answer.
    fn set_idle(&self, idle: bool) {
        let mut slots = lock(&self.clients.0);
        if let Some(slot) = slots.iter_mut().find(|slot| Arc::ptr_eq(&slot.stream, &self.stream)) {
            slot.idle = idle.then(Instant::now);
        }
    }
}

impl Drop for Client<'_> {
    fn drop(&mut self) {
        lock(&self.clients.0).retain(|slot| !Arc::ptr_eq(&slot.stream, &self.stream));
    }
}

/// Raises a count by one until it is dropped, also by a panic.
struct Counted<'a>(&'a AtomicUsize);

impl<'a> Counted<'a> {
    fn among(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Drop for QuerySocket {
    fn drop(&mut self) {
        // The file may have been removed and replaced by that of another process.
        if file_at(&self.path).is_ok_and(|file| file == self.file) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Device and inode of the file at a path, which identify it.
fn file_at(path: &Path) -> io::Result<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    let metadata = path.symlink_metadata()?;
    Ok((metadata.dev(), metadata.ino()))
}

/// Answers one client, line by line.
fn converse(client: &Client<'_>, server: &QueryServer<'_>) -> io::Result<()> {
    let stream = &*client.stream;
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let longest = MAX_POINTS * server.checker.n_joints() * NUMBER + REST;
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    while server.shared.is_running() {
        let room = longest.saturating_sub(line.len()) as u64;
        match reader.by_ref().take(room).read_until(b'\n', &mut line) {
            Ok(0) if room == 0 => {
                let why = format!(
                    "the line has more than {longest} bytes; divide the path and ask about each part"
                );
                return send(stream, error(why));
            }
            Ok(0) => return Ok(()),
            Ok(_) if line.ends_with(b"\n") => {
                client.set_idle(false);
                let answer = answer(&line, server);
                line = Vec::new(); // frees the memory of a long line
                client.set_idle(true);
                send(stream, answer)?;
            }
            Ok(_) => {}
            // The rest of the line has not arrived yet.
            Err(error)
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Sends a line.
fn send(mut stream: &UnixStream, mut line: String) -> io::Result<()> {
    line.push('\n');
    stream.write_all(line.as_bytes())
}

/// An answer that reports an error.
fn error(why: impl Display) -> String {
    json!({ "error": why.to_string() }).to_string()
}

/// The answer to a line.
fn answer(line: &[u8], server: &QueryServer<'_>) -> String {
    let started = Instant::now();
    let answer = match serde_json::from_slice(line) {
        Ok(PathRequest { tare: true, .. }) => {
            server.shared.tare.store(true, Ordering::Relaxed);
            Ok(json!({ "taring": true }).to_string())
        }
        Ok(question) => server.torques(question, started),
        Err(error) => Err(format!(
            "{error}; wanted a line of JSON such as {{\"path\": [[0.1, 0.2], [0.1, 0.3]]}}, \
             positions of all joints at every point, or {{\"tare\": true}}"
        )
        .into()),
    };
    answer.unwrap_or_else(error)
}

impl QueryServer<'_> {
    /// Computes something on a detached thread, so that the end of the session does not wait for it.
    fn aside<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, String> + Send + 'static,
    ) -> Result<T, String> {
        let (to_client, result) = bounded(1);
        let work = move || {
            let result = catch_unwind(AssertUnwindSafe(work));
            let _ = to_client.send(result); // fails if the session has ended
        };
        thread::Builder::new().name("path".to_owned()).spawn(work).map_err(|e| e.to_string())?;
        loop {
            match result.recv_timeout(LOOK) {
                Ok(result) => {
                    return result.map_err(
                        |_| "the question was not answered, because of a defect of palpate",
                    )?;
                }
                Err(RecvTimeoutError::Timeout) if self.shared.is_running() => {}
                Err(_) => return Err("the session has ended".to_owned()),
            }
        }
    }

    /// Predicts the torques along a path; returns the answer as a line.
    fn torques(
        &self,
        mut question: PathRequest,
        started: Instant,
    ) -> Result<String, Box<dyn Error>> {
        let (path, form) = question.path(self.checker.n_joints())?;
        let answer = self.predict(path, question.exact)?;
        Ok(serde_json::to_string(&PathReply::new(&answer, (form, question.level), started)?)?)
    }

    /// Predicts the torques along a path, with all springs (`exact`) or with clusters.
    pub(crate) fn predict(
        &self,
        path: Vec<Vec<f64>>,
        exact: bool,
    ) -> Result<PathPrediction, String> {
        let config = PathConfig::default();
        let (cluster_weight, resolution_cells) = match exact {
            true => (1.0, 0.0),
            false => (CLUSTER_WEIGHT, config.resolution_cells),
        };
        let config = PathConfig::new(resolution_cells, config.start_cells);
        if let Some((point, joint, [low, high])) = self.checker.beyond_limits(&path, LIMIT_MARGIN) {
            return Err(format!(
                "point {point} of the path: joint {joint} (from 0) is at {:.3}, beyond its limits, {low} to {high}; \
                 is it in another unit?",
                path[point][joint]
            ));
        }
        // The mapper prepares the predictor while the path is checked.
        let (to_client, from_mapper) = bounded(1);
        let request = Request::Predictor(cluster_weight, to_client);
        self.mapper.send(request).map_err(|_| "the mapper has stopped")?;
        let (checker, body) = (self.checker.clone(), self.body.clone());
        let predict = move || {
            let path = checker.check(&path, &config).map_err(|error| error.to_string())?;
            let predictor = from_mapper
                .recv_timeout(PATIENCE)
                .map_err(|_| "the mapper is too busy to answer now; ask again")?;
            let predictor = match &body {
                Some(body) => body.with_body(predictor),
                None => predictor,
            };
            predictor.answer(&path).map_err(|error| error.to_string())
        };
        // Replays continue while an elastic body is bent: that takes seconds for a long path.
        let is_short = self.body.is_none();
        let _answering = is_short.then(|| Counted::among(&self.shared.answering));
        self.aside(predict)
    }
}

#[cfg(test)]
mod tests {
    use palpate::{Arm, BakeConfig, EstimatorKind, Mapper, MapperConfig, Robot};
    use serde_json::Value;

    use super::*;

    fn checker() -> PathChecker {
        let ball = "<geometry><sphere radius='0.1'/></geometry>";
        let urdf = format!(
            "<robot name='r'><link name='a'/><link name='b'><collision>{ball}</collision></link>\
             <joint name='j' type='continuous'><parent link='a'/><child link='b'/></joint></robot>"
        );
        let robot = Robot::from_urdf(&urdf).unwrap();
        let arm = Arm::bake(robot, &BakeConfig::default(), |_| unreachable!("no meshes"));
        let mapper = Mapper::new(Arc::new(arm.unwrap().0), MapperConfig::of(EstimatorKind::Map));
        mapper.unwrap().path_checker()
    }

    /// Runs a test against a socket without a mapper; returns whether a tare was requested.
    fn served(test: impl FnOnce(&Path)) -> bool {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ask");
        let socket = QuerySocket::bind(&path).unwrap();
        let shared = Shared::new(1, None);
        let (mapper, _requests) = bounded(8);
        let server = QueryServer { mapper, checker: checker(), shared: &shared, body: None };
        thread::scope(|scope| {
            scope.spawn(|| socket.run(&server));
            test(&path);
            shared.stop();
        });
        shared.tare.into_inner()
    }

    fn ask(stream: &mut BufReader<UnixStream>, line: &str) -> Value {
        stream.get_mut().write_all(line.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_line(&mut answer).unwrap();
        serde_json::from_str(&answer).unwrap()
    }

    #[test]
    fn an_invalid_line_is_answered_with_an_error_and_the_next_one_is_read() {
        let tare = served(|path| {
            let mut stream = BufReader::new(UnixStream::connect(path).unwrap());
            for (line, words) in [
                ("what\n", "wanted a line of JSON"),
                ("{\"path\": [[1, null]]}\n", "wanted a line of JSON"),
                ("{\"way\": []}\n", "unknown field `way`"),
                ("{}\n", "neither a path nor a tare"),
                ("\u{0}\u{1}\n", "wanted a line of JSON"),
                ("{\"path\": [[1]], \"path_f64\": \"\"}\n", "give only one"),
                ("{\"path_f64\": \"{}\"}\n", "is not base64"),
                (
                    "{\"path_f64\": \"AAAA\"}\n",
                    "has 3 bytes, which is not a multiple of the 8 bytes of a point",
                ),
                ("{\"path_f64\": \"\"}\n", "the path has no points"),
                ("{\"path_f64\": \"AAAAAAAA+H8=\"}\n", "point 0 of the path"), // NaN
            ] {
                let answer = ask(&mut stream, line);
                let error = answer["error"].as_str().unwrap_or_default();
                assert!(error.contains(words), "{line}: {answer}");
            }
            assert_eq!(ask(&mut stream, "{\"tare\": true}\n"), json!({ "taring": true }));
        });
        assert!(tare);
    }

    #[test]
    fn the_client_idle_for_longest_is_disconnected_for_a_new_one_and_the_socket_is_private() {
        use std::os::unix::fs::PermissionsExt;
        served(|path| {
            let mode = path.metadata().unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
            let connect = || BufReader::new(UnixStream::connect(path).unwrap());
            let asks =
                |stream: &mut BufReader<UnixStream>| ask(stream, "{}\n")["error"].is_string();
            let mut crowd: Vec<_> = (0..MAX_CLIENTS).map(|_| connect()).collect();
            assert!(crowd.iter_mut().rev().all(asks)); // the last has been idle for longest
            assert!(asks(&mut connect()));
            let mut gone = String::new();
            assert_eq!(crowd.pop().unwrap().read_line(&mut gone).unwrap(), 0);
            assert!(crowd.iter_mut().all(asks), "the others stay");
        });
    }

    #[test]
    fn the_socket_of_an_ended_process_is_replaced_but_no_socket_in_use_and_no_other_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ask");
        drop(UnixListener::bind(&path).unwrap()); // its file stays
        let socket = QuerySocket::bind(&path).unwrap();
        let error = QuerySocket::bind(&path).unwrap_err().to_string();
        assert!(error.contains("another process listens there"), "{error}");
        let aside = folder.path().join("aside");
        std::fs::rename(&path, &aside).unwrap();
        let next = QuerySocket::bind(&path).unwrap();
        drop(socket);
        assert!(UnixStream::connect(&path).is_ok(), "another's socket stays");
        drop(next);
        assert!(!path.exists());
        std::fs::write(&path, "precious").unwrap();
        assert!(QuerySocket::bind(&path).unwrap_err().to_string().contains("it is a file"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
    }
}
