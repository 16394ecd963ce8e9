//! Questions about planned motions while the robot moves, over a Unix socket: a line of JSON each
//! way.
//!
//! | a line with         | is answered with                                                          |
//! |---------------------|---------------------------------------------------------------------------|
//! | `{"path": [[q…]…]}` | `torque`, `torque_std` (N × n_joints, N·m, to a millionth), `contacts`, `known` (N), `goes_on`, `ms` |
//! | `{"path_f64": "…"}` | the same, with `torque_f64` and `torque_std_f64`                          |
//! | either, of a field with bands | `level`, `half_width` and `peak_half_width`, or both with `_f64`, as well (N × n_joints, N·m); `"level": 0.8` beside the path chooses the level |
//! | `{"tare": true}`    | `{"taring": true}`                                                        |
//! | anything else       | `{"error": …}`, and the next line is read                                 |
//!
//! What ends in `_f64` are the bytes of the numbers as base64: float64, little-endian, point by
//! point. For 200 points of 7 joints that saves Python two milliseconds of reading and writing
//! numbers.
//!
//! A path is joint positions (N × n_joints, rad or m) in the order of the URDF, from where the arm
//! is or from a place free of contact ([`palpate::PathPredictor`]). `"exact": true` beside it looks at
//! every point with every spring, which takes some twenty times as long. ROS types would have to be
//! built into every robot that asks; a socket and JSON are everywhere.
//!
//! The mapper hands out what a question needs, some nanoseconds a touched cell, and goes on; the
//! answer is computed by a thread of the connection and by all of rayon's that have time. Replays wait
//! meanwhile, since nobody waits for them.

use std::error::Error;
use std::fmt::Display;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use palpate::unstable::PathChecker;
use palpate::{CLUSTER_WEIGHT, PathConfig, PathPrediction, PathPredictor};
use rustix::fs::Mode;
use serde_json::json;

use crate::body::LiveBody;
use crate::question::{MOST_POINTS, PathReply, Question};
use crate::threads::{Shared, spawn};

/// Who may ask at the same time.
const MOST_ASKERS: usize = 8;
/// Bytes of a number in the longest line, and of what else it holds.
const NUMBER: usize = 26;
const REST: usize = 4096;
/// How long the mapper may take to hand out a path predictor, and an asker to read its answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// Between two looks at whether the session goes on.
const LOOK: Duration = Duration::from_millis(50);
/// Between two looks at whether somebody connects.
const ACCEPT: Duration = Duration::from_millis(2);

/// Asks the mapper's thread for the field and the arm as they are, with one spring in so many.
#[derive(Debug)]
pub(crate) enum Request {
    /// A path predictor with clusters of that weight.
    Predictor(f64, Sender<PathPredictor>),
    /// That the field is saved, with the number that it is written under; `None` if the last one is not written yet.
    Save(Sender<Option<u64>>),
}

/// How far a joint of a path may be beyond its limits, rad or m: arms stand there now and then.
const LIMIT_MARGIN: f64 = 0.05;

/// Answers questions; knows the session's side of it.
#[derive(Clone)]
pub(crate) struct QueryServer<'a> {
    /// The mapper's thread.
    pub(crate) mapper: Sender<Request>,
    /// Whether its path predictors can answer a path.
    pub(crate) checker: PathChecker,
    pub(crate) shared: &'a Shared,
    pub(crate) body: Option<Arc<LiveBody>>,
}

/// The socket, which goes away with this.
#[derive(Debug)]
pub struct AskSocket {
    listener: UnixListener,
    path: PathBuf,
    /// Device and number of its file.
    file: (u64, u64),
}

impl AskSocket {
    /// Opens a socket. One that a process which is no more has left behind is replaced.
    ///
    /// # Errors
    ///
    /// If somebody listens there already, or it cannot be made.
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
        // For its owner alone, from the moment that it is there.
        let umask = rustix::process::umask(Mode::RWXG | Mode::RWXO | Mode::XUSR);
        let listener = UnixListener::bind(path);
        rustix::process::umask(umask);
        let listener = listener?;
        listener.set_nonblocking(true)?;
        let file = file_at(path)?;
        Ok(Self { listener, path: path.to_owned(), file })
    }

    /// Answers for as long as the session goes on.
    pub(crate) fn run(&self, server: &QueryServer<'_>) {
        let askers = &Askers::default();
        thread::scope(|scope| {
            while server.shared.goes_on() {
                let Ok((stream, _)) = self.listener.accept() else {
                    thread::sleep(ACCEPT);
                    continue;
                };
                let stream = Arc::new(stream);
                let Some(asker) = askers.admit(&stream) else {
                    let _ = send(&stream, error("too many ask at once; try again"));
                    continue;
                };
                spawn(scope, "answer", move || {
                    // A client may leave in the middle of a line.
                    let conversation = || drop(converse(&asker, server));
                    if catch_unwind(AssertUnwindSafe(conversation)).is_err() {
                        server.shared.note("a question was not answered, by a defect of palpate");
                    }
                });
            }
        });
    }
}

/// Those who are connected.
#[derive(Default)]
struct Askers(Mutex<Vec<Seat>>);

/// One of them, as the others see it.
struct Seat {
    stream: Arc<UnixStream>,
    /// Since when it has asked nothing; `None` while it is answered.
    idle: Option<Instant>,
}

/// One of them, as its own thread does.
struct Asker<'a> {
    askers: &'a Askers,
    stream: Arc<UnixStream>,
}

impl Askers {
    /// Lets somebody in; if there are too many, the one that has asked nothing for longest leaves.
    fn admit(&self, stream: &Arc<UnixStream>) -> Option<Asker<'_>> {
        let mut seats = self.seats();
        if seats.len() >= MOST_ASKERS {
            let idle = seats.iter().enumerate().filter_map(|(n, seat)| Some((seat.idle?, n)));
            let (_, longest) = idle.min()?;
            let seat = seats.swap_remove(longest);
            let _ = seat.stream.shutdown(Shutdown::Both);
        }
        seats.push(Seat { stream: Arc::clone(stream), idle: Some(Instant::now()) });
        Some(Asker { askers: self, stream: Arc::clone(stream) })
    }

    fn seats(&self) -> MutexGuard<'_, Vec<Seat>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Asker<'_> {
    /// Notes whether it waits for an answer.
    fn set_idle(&self, idle: bool) {
        let mut seats = self.askers.seats();
        if let Some(seat) = seats.iter_mut().find(|seat| Arc::ptr_eq(&seat.stream, &self.stream)) {
            seat.idle = idle.then(Instant::now);
        }
    }
}

impl Drop for Asker<'_> {
    fn drop(&mut self) {
        self.askers.seats().retain(|seat| !Arc::ptr_eq(&seat.stream, &self.stream));
    }
}

/// One of those that are counted, until it is dropped, by a panic too.
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

impl Drop for AskSocket {
    fn drop(&mut self) {
        // Somebody may have removed the file, and another process put its own there.
        if file_at(&self.path).is_ok_and(|file| file == self.file) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Device and number of the file at a path, which no other file has.
fn file_at(path: &Path) -> io::Result<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    let metadata = path.symlink_metadata()?;
    Ok((metadata.dev(), metadata.ino()))
}

/// Answers one asker, line by line.
fn converse(asker: &Asker<'_>, server: &QueryServer<'_>) -> io::Result<()> {
    let stream = &*asker.stream;
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let longest = MOST_POINTS * server.checker.n_joints() * NUMBER + REST;
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    while server.shared.goes_on() {
        let room = longest.saturating_sub(line.len()) as u64;
        match reader.by_ref().take(room).read_until(b'\n', &mut line) {
            Ok(0) if room == 0 => {
                let why = format!("a line of more than {longest} bytes; ask in pieces");
                return send(stream, error(why));
            }
            Ok(0) => return Ok(()),
            Ok(_) if line.ends_with(b"\n") => {
                asker.set_idle(false);
                let answer = answer(&line, server);
                line = Vec::new(); // the longest would stay
                asker.set_idle(true);
                send(stream, answer)?;
            }
            Ok(_) => {}
            // The rest of the line is still to come.
            Err(error)
                if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Writes a line.
fn send(mut stream: &UnixStream, mut line: String) -> io::Result<()> {
    line.push('\n');
    stream.write_all(line.as_bytes())
}

/// The line that says why there is no answer.
fn error(why: impl Display) -> String {
    json!({ "error": why.to_string() }).to_string()
}

/// The answer to a line.
fn answer(line: &[u8], server: &QueryServer<'_>) -> String {
    let started = Instant::now();
    let answer = match serde_json::from_slice(line) {
        Ok(Question { tare: true, .. }) => {
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
    /// Works something out on a thread that nobody joins: the session does not wait for it at its end.
    fn aside<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, String> + Send + 'static,
    ) -> Result<T, String> {
        let (to_asker, result) = bounded(1);
        let work = move || {
            let result = catch_unwind(AssertUnwindSafe(work));
            let _ = to_asker.send(result); // the asker may have left
        };
        thread::Builder::new().name("path".to_owned()).spawn(work).map_err(|e| e.to_string())?;
        loop {
            match result.recv_timeout(LOOK) {
                Ok(result) => return result.map_err(|_| "it met a defect of palpate")?,
                Err(RecvTimeoutError::Timeout) if self.shared.goes_on() => {}
                Err(_) => return Err("the session has ended".to_owned()),
            }
        }
    }

    /// What torques a path would meet, as a line.
    fn torques(&self, mut question: Question, started: Instant) -> Result<String, Box<dyn Error>> {
        let (path, form) = question.path(self.checker.n_joints())?;
        let answer = self.predict(path, question.exact)?;
        Ok(serde_json::to_string(&PathReply::new(&answer, (form, question.level), started)?)?)
    }

    /// What torques a path would meet, by all springs or by clusters.
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
                "point {point} of the path: joint {joint} (from 0) is at {:.3}, beyond its limits, {low} to {high}; is it in \
                 another unit?",
                path[point][joint]
            ));
        }
        // The mapper gets on with it while the path is checked.
        let (to_asker, from_mapper) = bounded(1);
        let request = Request::Predictor(cluster_weight, to_asker);
        self.mapper.send(request).map_err(|_| "the mapper has stopped")?;
        let (checker, body) = (self.checker.clone(), self.body.clone());
        let predict = move || {
            let path = checker.check(&path, &config).map_err(|error| error.to_string())?;
            let predictor = from_mapper
                .recv_timeout(PATIENCE)
                .map_err(|_| "the mapper has no time for an answer now; ask again")?;
            let predictor = match &body {
                Some(body) => body.with_body(predictor),
                None => predictor,
            };
            predictor.answer(&path).map_err(|error| error.to_string())
        };
        // Replays do not wait for a body that is bent: that takes seconds for a long path.
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

    /// A socket without a mapper; returns whether it was asked for a tare.
    fn served(test: impl FnOnce(&Path)) -> bool {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ask");
        let socket = AskSocket::bind(&path).unwrap();
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
    fn a_line_that_is_no_question_is_answered_with_an_error_and_the_next_one_read() {
        let tare = served(|path| {
            let mut stream = BufReader::new(UnixStream::connect(path).unwrap());
            for (line, words) in [
                ("what\n", "wanted a line of JSON"),
                ("{\"path\": [[1, null]]}\n", "wanted a line of JSON"),
                ("{\"way\": []}\n", "unknown field `way`"),
                ("{}\n", "neither a path nor a tare"),
                ("\u{0}\u{1}\n", "wanted a line of JSON"),
                ("{\"path\": [[1]], \"path_f64\": \"\"}\n", "ask about one"),
                ("{\"path_f64\": \"{}\"}\n", "is no base64"),
                ("{\"path_f64\": \"AAAA\"}\n", "has 3 bytes, no multiple of the 8 of a point"),
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
    fn who_has_asked_nothing_for_longest_leaves_for_one_more_and_the_socket_is_its_owners() {
        use std::os::unix::fs::PermissionsExt;
        served(|path| {
            let mode = path.metadata().unwrap().permissions().mode();
            assert_eq!(mode & 0o777, 0o600);
            let connect = || BufReader::new(UnixStream::connect(path).unwrap());
            let asks =
                |stream: &mut BufReader<UnixStream>| ask(stream, "{}\n")["error"].is_string();
            let mut crowd: Vec<_> = (0..MOST_ASKERS).map(|_| connect()).collect();
            assert!(crowd.iter_mut().rev().all(asks)); // the last has been idle for longest
            assert!(asks(&mut connect()));
            let mut gone = String::new();
            assert_eq!(crowd.pop().unwrap().read_line(&mut gone).unwrap(), 0);
            assert!(crowd.iter_mut().all(asks), "the others stay");
        });
    }

    #[test]
    fn a_socket_that_was_left_behind_is_replaced_but_no_other_and_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ask");
        drop(UnixListener::bind(&path).unwrap()); // its file stays
        let socket = AskSocket::bind(&path).unwrap();
        let error = AskSocket::bind(&path).unwrap_err().to_string();
        assert!(error.contains("another process listens there"), "{error}");
        let aside = folder.path().join("aside");
        std::fs::rename(&path, &aside).unwrap();
        let next = AskSocket::bind(&path).unwrap();
        drop(socket);
        assert!(UnixStream::connect(&path).is_ok(), "another's socket stays");
        drop(next);
        assert!(!path.exists());
        std::fs::write(&path, "precious").unwrap();
        assert!(AskSocket::bind(&path).unwrap_err().to_string().contains("it is a file"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "precious");
    }
}
