//! Questions while the robot moves, over a Unix socket: a line of JSON each way.
//!
//! | a line with         | is answered with                                                          |
//! |---------------------|---------------------------------------------------------------------------|
//! | `{"path": [[q…]…]}` | `torque`, `torque_std` (N × n_joints, N·m, to a millionth), `contacts`, `known` (N), `goes_on`, `ms` |
//! | `{"path_f64": "…"}` | the same, with `torque_f64` and `torque_std_f64`                          |
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
//! answer is worked out by the thread of whoever asks and all of rayon's that have time. Replays wait
//! meanwhile, since nobody waits for them.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use crossbeam_channel::{Receiver, Sender, bounded};
use nalgebra::DVector;
use palpate::unstable::PathChecker;
use palpate::{CLUSTER_WEIGHT, PathConfig, PathPoint, PathPredictor};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::run::spawn;

/// Who may ask at the same time.
const MOST_ASKERS: usize = 8;
/// Bytes of the longest line: 100,000 points of 14 joints.
const LONGEST: u64 = 64 << 20;
/// How long the mapper may take to hand out an path predictor.
const PATIENCE: Duration = Duration::from_secs(2);
/// Between two looks at whether to stop.
const LOOK: Duration = Duration::from_millis(50);

/// What is asked of the mapper's thread.
#[derive(Debug)]
pub(crate) enum Request {
    /// The field and the arm as they are, with one spring in so many.
    PathPredictor { cluster_weight: f64, to_asker: Sender<PathPredictor> },
    /// A tare.
    Tare,
}

/// A line that was asked.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Question {
    path: Option<Vec<Vec<f64>>>,
    path_f64: Option<String>,
    #[serde(default)]
    exact: bool,
    #[serde(default)]
    tare: bool,
}

/// How a path is written, and its torques are.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    /// A list of numbers a point.
    Lists,
    /// The numbers' bytes as base64.
    F64,
}

/// What is answered about a path.
#[derive(Debug, Serialize)]
struct PathAnswer {
    #[serde(flatten)]
    torques: Torques,
    contacts: Vec<usize>,
    known: Vec<usize>,
    goes_on: bool,
    ms: f64,
}

/// Torques and their standard deviations, as the path was written.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Torques {
    Lists { torque: Vec<Vec<f64>>, torque_std: Vec<Vec<f64>> },
    F64 { torque_f64: String, torque_std_f64: String },
}

impl Question {
    /// The path that is asked about, and how it is written.
    fn path(&mut self, n_joints: usize) -> Result<(Vec<Vec<f64>>, Form), String> {
        match (self.path.take(), self.path_f64.take()) {
            (Some(path), None) => Ok((path, Form::Lists)),
            (None, Some(base64)) => Ok((path_from(&base64, n_joints)?, Form::F64)),
            (None, None) => Err("neither a path nor a tare is asked for".to_owned()),
            (Some(_), Some(_)) => Err("both `path` and `path_f64`; ask about one".to_owned()),
        }
    }
}

/// The points of a path whose bytes are given as base64.
fn path_from(base64: &str, n_joints: usize) -> Result<Vec<Vec<f64>>, String> {
    const WANTED: &str = "wanted the path as float64, little-endian, point by point";
    let bytes = BASE64_STANDARD.decode(base64);
    let bytes = bytes.map_err(|error| format!("`path_f64` is no base64 ({error}); {WANTED}"))?;
    let (numbers, rest) = bytes.as_chunks::<8>();
    let n_joints = n_joints.max(1); // a robot without joints has no path
    if !rest.is_empty() || !numbers.len().is_multiple_of(n_joints) {
        return Err(format!(
            "`path_f64` has {} bytes, no multiple of the {} of a point of {n_joints} joints; {WANTED}",
            bytes.len(),
            8 * n_joints
        ));
    }
    let point =
        |point: &[[u8; 8]]| point.iter().map(|number| f64::from_le_bytes(*number)).collect();
    Ok(numbers.chunks_exact(n_joints).map(point).collect())
}

impl Torques {
    /// Of the points of an answer.
    fn of(points: &[PathPoint], form: Form) -> Self {
        match form {
            Form::Lists => {
                let rows = |torques: fn(&PathPoint) -> &DVector<f64>| {
                    let row = |point| torques(point).iter().copied().map(to_a_millionth).collect();
                    points.iter().map(row).collect()
                };
                let [torque, torque_std] =
                    [rows(|point| &point.torque), rows(|point| &point.torque_std)];
                Self::Lists { torque, torque_std }
            }
            Form::F64 => {
                let bytes = |torques: fn(&PathPoint) -> &DVector<f64>| {
                    let numbers = points.iter().flat_map(|point| torques(point).iter());
                    BASE64_STANDARD
                        .encode(numbers.flat_map(|n| n.to_le_bytes()).collect::<Vec<_>>())
                };
                Self::F64 {
                    torque_f64: bytes(|point| &point.torque),
                    torque_std_f64: bytes(|point| &point.torque_std),
                }
            }
        }
    }
}

/// Who asks, seen from the session.
pub(crate) struct QueryServer<'a> {
    /// The mapper's thread.
    pub(crate) mapper: Sender<Request>,
    /// Whether its path predictors can answer a path.
    pub(crate) checker: PathChecker,
    /// Questions whose answers are being worked out.
    pub(crate) answering: &'a AtomicUsize,
    /// Whether the session goes on.
    pub(crate) goes_on: &'a (dyn Fn() -> bool + Sync),
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
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        let file = file_at(path)?;
        Ok(Self { listener, path: path.to_owned(), file })
    }

    /// Answers for as long as the session goes on.
    pub(crate) fn run(&self, server: &QueryServer<'_>) {
        let askers = Arc::new(AtomicUsize::new(0));
        thread::scope(|scope| {
            while (server.goes_on)() {
                let Ok((stream, _)) = self.listener.accept() else {
                    thread::sleep(Duration::from_millis(2));
                    continue;
                };
                if askers.fetch_add(1, Ordering::Relaxed) >= MOST_ASKERS {
                    askers.fetch_sub(1, Ordering::Relaxed);
                    let _ = say(
                        &stream,
                        json!({ "error": "too many ask at once; try again" }).to_string(),
                    );
                    continue;
                }
                let askers = Arc::clone(&askers);
                spawn(scope, "answer", move || {
                    // Whoever leaves in the middle of a line has no question.
                    let _ = converse(&stream, server);
                    askers.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
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

/// Device and number of the file at a path, which tell it from any other.
fn file_at(path: &Path) -> io::Result<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    let metadata = path.symlink_metadata()?;
    Ok((metadata.dev(), metadata.ino()))
}

/// Answers one asker, line by line.
fn converse(stream: &UnixStream, server: &QueryServer<'_>) -> io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    while (server.goes_on)() {
        let room = LONGEST.saturating_sub(line.len() as u64);
        match reader.by_ref().take(room).read_until(b'\n', &mut line) {
            Ok(0) if room == 0 => {
                let error = "a line of more than 64 MiB; ask in pieces";
                return say(stream, json!({ "error": error }).to_string());
            }
            Ok(0) => return Ok(()),
            Ok(_) if line.ends_with(b"\n") => {
                say(stream, answer(&line, server))?;
                line.clear();
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
fn say(mut stream: &UnixStream, mut answer: String) -> io::Result<()> {
    answer.push('\n');
    stream.write_all(answer.as_bytes())
}

/// The answer to a line.
fn answer(line: &[u8], server: &QueryServer<'_>) -> String {
    let started = Instant::now();
    let answered = serde_json::from_slice(line)
        .map_err(|error| {
            format!(
                "{error}; wanted a line of JSON such as {{\"path\": [[0.1, 0.2], [0.1, 0.3]]}}, \
                 positions of all joints at every point, or {{\"tare\": true}}"
            )
        })
        .and_then(|mut question: Question| {
            if question.tare {
                server.mapper.send(Request::Tare).map_err(|_| GONE.to_owned())?;
                return Ok(json!({ "taring": true }).to_string());
            }
            let (path, form) = question.path(server.checker.n_joints())?;
            server.answering.fetch_add(1, Ordering::Relaxed);
            let answer = torque_of(&path, question.exact, form, server, started);
            server.answering.fetch_sub(1, Ordering::Relaxed);
            answer
        });
    answered.unwrap_or_else(|error: String| json!({ "error": error }).to_string())
}

/// What there is to say once the mapper has stopped.
const GONE: &str = "the mapper has stopped";

/// What torque a path would meet.
fn torque_of(
    path: &[Vec<f64>],
    exact: bool,
    form: Form,
    server: &QueryServer<'_>,
    started: Instant,
) -> Result<String, String> {
    let (to_me, from_mapper): (_, Receiver<PathPredictor>) = bounded(1);
    let (cluster_weight, resolution_cells) = match exact {
        true => (1.0, 0.0),
        false => (CLUSTER_WEIGHT, PathConfig::default().resolution_cells),
    };
    let config = PathConfig::new(resolution_cells, PathConfig::default().start_cells);
    // The mapper gets on with it while the path is checked.
    let request = Request::PathPredictor { cluster_weight, to_asker: to_me };
    server.mapper.send(request).map_err(|_| GONE.to_owned())?;
    let path = server.checker.check(path, &config).map_err(|error| error.to_string())?;
    let predictor = from_mapper
        .recv_timeout(PATIENCE)
        .map_err(|_| "the mapper has no time for an answer now; ask again".to_owned())?;
    let answer = predictor.answer(&path).map_err(|error| error.to_string())?;
    let told = PathAnswer {
        torques: Torques::of(&answer.points, form),
        contacts: answer.points.iter().map(|point| point.contacts).collect(),
        known: answer.points.iter().map(|point| point.known).collect(),
        goes_on: answer.goes_on,
        ms: started.elapsed().as_secs_f64() * 1e3,
    };
    serde_json::to_string(&told).map_err(|error| error.to_string())
}

/// A number that is written in few digits: 17 of them take whoever reads them a millisecond.
fn to_a_millionth(number: f64) -> f64 {
    (number * 1e6).round() / 1e6
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

    /// A socket whose mapper only counts tares.
    fn served(test: impl FnOnce(&Path)) -> usize {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ask");
        let socket = AskSocket::bind(&path).unwrap();
        let (to_mapper, from_askers) = bounded(8);
        let done = std::sync::atomic::AtomicBool::new(false);
        thread::scope(|scope| {
            let (socket, done) = (&socket, &done);
            scope.spawn(move || {
                let goes_on = || !done.load(Ordering::Relaxed);
                let answering = AtomicUsize::new(0);
                let (mapper, checker) = (to_mapper, checker());
                let server =
                    QueryServer { mapper, checker, answering: &answering, goes_on: &goes_on };
                socket.run(&server);
            });
            let counted = scope
                .spawn(move || from_askers.iter().filter(|r| matches!(r, Request::Tare)).count());
            test(&path);
            done.store(true, Ordering::Relaxed);
            counted.join().unwrap()
        })
    }

    fn ask(stream: &mut BufReader<UnixStream>, line: &str) -> Value {
        stream.get_mut().write_all(line.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_line(&mut answer).unwrap();
        serde_json::from_str(&answer).unwrap()
    }

    #[test]
    fn what_is_no_question_is_told_and_the_next_line_is_read() {
        let tares = served(|path| {
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
                let told = answer["error"].as_str().unwrap_or_default();
                assert!(told.contains(words), "{line}: {answer}");
            }
            assert_eq!(ask(&mut stream, "{\"tare\": true}\n"), json!({ "taring": true }));
        });
        assert_eq!(tares, 1);
    }

    #[test]
    fn lists_and_bytes_say_the_same() {
        let path = vec![vec![0.1, -1e-300, 3.0], vec![f64::MAX, 0.25, -7.5]];
        let bytes: Vec<u8> = path.concat().iter().flat_map(|number| number.to_le_bytes()).collect();
        assert_eq!(path_from(&BASE64_STANDARD.encode(bytes), 3).unwrap(), path);
        assert!(path_from("", 0).unwrap().is_empty());
        let points: Vec<PathPoint> = (0..5)
            .map(|n| {
                let mut point = PathPoint::default();
                point.torque = DVector::from_vec(vec![f64::from(n) / 3.0, -40.0]);
                point.torque_std = DVector::from_vec(vec![0.0, 1e-7 + f64::from(n)]);
                point
            })
            .collect();
        let [lists, bytes] = [Form::Lists, Form::F64]
            .map(|form| serde_json::to_value(Torques::of(&points, form)).unwrap());
        for name in ["torque", "torque_std"] {
            let of = |point: &PathPoint| match name {
                "torque" => point.torque.as_slice().to_vec(),
                _ => point.torque_std.as_slice().to_vec(),
            };
            let wanted: Vec<Vec<f64>> = points.iter().map(of).collect();
            let base64 = bytes[format!("{name}_f64")].as_str().unwrap();
            assert_eq!(path_from(base64, 2).unwrap(), wanted);
            let rows: Vec<Vec<f64>> = serde_json::from_value(lists[name].clone()).unwrap();
            assert_eq!(rows.len(), wanted.len());
            let off = rows.concat().into_iter().zip(wanted.concat()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 5.1e-7);
        }
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
