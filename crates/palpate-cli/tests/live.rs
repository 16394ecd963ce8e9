//! `palpate live` beside a robot that CycloneDDS plays, on loopback. The other side is Python, in
//! the environment that ./setup makes. What a slow machine would fail, latencies, is not tested here
//! but measured by `scripts/dds_robot.py`; BENCHMARKS.md has the figures.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use common::{palpate, refuse, succeed};
use serde_json::Value;

/// Each test has a DDS domain of its own.
static DOMAIN: AtomicU16 = AtomicU16::new(0);

fn domain() -> String {
    let first = 20 + 8 * (std::process::id() % 16) as u16;
    (first + DOMAIN.fetch_add(1, Ordering::Relaxed)).to_string()
}

/// The robot: plays the bundled touches and tells what it heard.
fn robot(domain: &str, arguments: &[&str]) -> Command {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let python = target.join("interop-venv/bin/python");
    assert!(python.is_file(), "{} is missing: run ./setup first", python.display());
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut command = Command::new(python);
    command.arg(root.join("scripts/dds_robot.py")).arg(root.join("data/plant_a"));
    command.args(["--domain", domain]).args(arguments);
    command
}

/// A session that is ended with the test.
struct Live {
    child: Child,
    folder: tempfile::TempDir,
}

impl Live {
    fn start(domain: &str, arguments: &[&str]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), domain, arguments)
    }

    fn start_in(folder: tempfile::TempDir, domain: &str, arguments: &[&str]) -> Self {
        let told = fs::File::create(folder.path().join("told.jsonl")).unwrap();
        let child = palpate()
            .args(["live", "--localhost", "--domain", domain, "--json-lines"])
            .args(arguments)
            .arg("--output")
            .arg(folder.path().join("field.npz"))
            .stdout(told)
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Self { child, folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// All lines so far.
    fn told(&self) -> String {
        fs::read_to_string(self.path("told.jsonl")).unwrap()
    }

    /// Waits until something is told.
    fn wait_for(&self, words: &str) {
        let patience = Instant::now() + Duration::from_secs(60);
        while !self.told().contains(words) {
            assert!(Instant::now() < patience, "no `{words}` in {}", self.told());
            thread::sleep(Duration::from_millis(50));
        }
    }

    fn kill(&mut self, signal: &str) {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
    }

    /// Ends it as Ctrl-C does; the last line.
    fn end(&mut self) -> Value {
        self.kill("-INT");
        assert!(self.child.wait().unwrap().success(), "{}", self.told());
        serde_json::from_str(self.told().lines().last().unwrap()).unwrap()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A robot that plays while a test goes on, and stops with it.
struct Playing(Child);

impl Playing {
    fn start(mut robot: Command) -> Self {
        Self(robot.stdout(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Playing {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn heard(command: &mut Command) -> Value {
    serde_json::from_str(&succeed(command)).unwrap()
}

#[test]
fn a_robot_hears_every_topic_and_no_sample_is_lost() {
    let domain = domain();
    let mut live = Live::start(&domain, &["--guard", "1", "--checkpoint", "1"]);
    let robot = heard(&mut robot(&domain, &["--rate", "100", "--seconds", "9"]));
    let end = live.end();
    let figures = &end["figures"];
    assert_eq!((&figures["received"], &figures["mapped"]), (&robot["sent"], &robot["sent"]));
    assert_eq!((&figures["dropped"], &figures["lost"]), (&0.into(), &0.into()), "{figures}");
    assert!(figures["avg_error"].as_f64() < figures["zero_avg_error"].as_f64(), "{figures}");
    for (topic, count) in robot["heard"].as_object().unwrap() {
        assert!(count.as_u64() > Some(0), "{topic}: {robot}");
    }
    let torques = |name: &str| robot["heard"][format!("rt/palpate/torque_{name}")].as_u64();
    assert!(torques("predicted") > Some(400) && torques("predicted") == torques("external"));
    assert_eq!(robot["stops"].as_array().unwrap().last(), Some(&true.into()), "{robot}");
    assert_eq!(robot["diagnostics"]["samples dropped"], "0");
    assert!(robot["points"]["rt/palpate/field"].as_u64() > Some(1000), "{robot}");
    let report = succeed(palpate().arg("inspect").arg(live.path("field.npz")).arg("--json"));
    assert!(report.contains("kinova_gen3"), "{report}");
}

#[test]
fn a_broken_stream_is_told_of_and_the_rest_is_mapped() {
    for (broken, reason, words) in [
        ("nan", "not finite", "the effort of joint `Actuator1` is NaN"),
        ("effort", "length", "0 efforts for 7 joints"),
        ("names", "joints", "the robot's joint `Actuator1` is not in the log"),
        ("still", "duplicate", "each moment counts once"),
        ("clock", "", "the clock was set back; waiting for the arm to pause"),
    ] {
        let domain = domain();
        let mut live = Live::start(&domain, &[]);
        let robot = heard(&mut robot(
            &domain,
            &["--rate", "100", "--seconds", "4", "--break", broken, "--best-effort"],
        ));
        let (end, told) = (live.end(), live.told());
        assert!(told.contains(words), "{broken}: {told}");
        let figures = &end["figures"];
        assert!(figures["mapped"].as_u64() > Some(100), "{figures}");
        if broken != "clock" {
            let refused = figures["refused"][reason].as_u64().unwrap();
            assert!(refused >= robot["sent"].as_u64().unwrap() / 50, "{figures}");
        }
    }
}

#[test]
fn a_topic_of_another_type_and_a_field_that_is_there_are_told() {
    let domain = domain();
    let live = Live::start(&domain, &["--joint-states", "/joints"]);
    let _robot = Playing::start(robot(&domain, &["--rate", "20", "--seconds", "60"]));
    live.wait_for("nobody publishes `/joints`");
    live.wait_for("there are /joint_states (sensor_msgs/msg/JointState)");

    let folder = tempfile::tempdir().unwrap();
    let field = folder.path().join("field.npz");
    fs::write(&field, "precious").unwrap();
    let mut again = palpate();
    again.args(["live", "--localhost", "--domain", &domain, "-o"]).arg(&field);
    refuse(&mut again, 2, &["is there already", "--resume"]);
    refuse(again.arg("--resume"), 1, &["field.npz"]);
    assert_eq!(fs::read_to_string(&field).unwrap(), "precious");
}

#[test]
fn another_type_on_the_topic_is_told_and_the_robot_is_mapped_beside_it() {
    let domain = domain();
    let mut live = Live::start(&domain, &["--joint-states", "/joint_states"]);
    let robot = heard(&mut robot(&domain, &["--rate", "100", "--seconds", "4", "--stranger"]));
    let (end, told) = (live.end(), live.told());
    let words = "`/joint_states` is published as std_msgs/msg/Bool; wanted sensor_msgs";
    assert!(told.contains(words), "{told}");
    let figures = &end["figures"];
    assert_eq!(figures["mapped"], robot["sent"], "{told}");
}

#[test]
fn a_client_of_the_service_gets_its_answer_and_the_tare() {
    let domain = domain();
    let mut live = Live::start(&domain, &["--services", "cyclone"]);
    let arguments = ["--rate", "100", "--seconds", "4", "--still", "3", "--tare", "2"];
    let robot = heard(&mut robot(&domain, &arguments));
    live.end();
    let answers = robot["tare"].as_array().unwrap();
    for (answer, number) in answers.iter().zip([1, 2]) {
        let [client, sequence, taring, words] = answer.as_array().unwrap().as_slice() else {
            panic!("{robot}")
        };
        assert_eq!((client.as_i64(), sequence.as_i64()), (Some(4711), Some(number)), "{robot}");
        assert_eq!(taring.as_bool(), Some(true), "{robot}");
        assert!(words.as_str().unwrap().contains("hold the arm still"), "{robot}");
    }
    assert_eq!(answers.len(), 2, "{robot}");
    // One tare is enough for both if the mapper has not got round to the first.
    let tares = live.told().matches("taring as asked").count();
    assert!((1..=2).contains(&tares), "{}", live.told());
}

#[test]
fn whoever_asks_is_answered_while_it_maps() {
    let domain = domain();
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("ask");
    let live = Live::start(&domain, &["--ask", socket.to_str().unwrap()]);
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "12"]));
    live.wait_for("\"state\":\"mapping\"");
    let mut stream = BufReader::new(UnixStream::connect(&socket).unwrap());
    let mut ask = |line: String| -> Value {
        stream.get_mut().write_all(line.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_line(&mut answer).unwrap();
        serde_json::from_str(&answer).unwrap()
    };
    let start = [1.362, -0.5258, 2.1044, -2.0491, 0.5411, 0.1605, 0.2473];
    let path: Vec<Vec<f64>> =
        (0..50).map(|i| start.map(|q| q + 0.004 * f64::from(i)).to_vec()).collect();
    let answer = ask(format!("{}\n", serde_json::json!({ "path": path })));
    let rows = answer["torque"].as_array().unwrap_or_else(|| panic!("{answer}"));
    assert_eq!((rows.len(), rows[0].as_array().unwrap().len()), (50, 7));
    let stds: Vec<f64> =
        answer["torque_std"][49].as_array().unwrap().iter().map(|s| s.as_f64().unwrap()).collect();
    assert!(stds.iter().all(|&std| std >= 0.0) && stds.iter().any(|&std| std > 0.0), "{stds:?}");
    let bytes: Vec<u8> = path.concat().iter().flat_map(|q| q.to_le_bytes()).collect();
    let path_f64 = BASE64_STANDARD.encode(bytes);
    let answer = ask(format!("{}\n", serde_json::json!({ "path_f64": path_f64 })));
    let bytes = BASE64_STANDARD.decode(answer["torque_f64"].as_str().unwrap()).unwrap();
    assert_eq!((bytes.len(), answer["contacts"].as_array().unwrap().len()), (50 * 7 * 8, 50));
    assert!(
        ask("{\"path\": [[1, 2]]}\n".to_owned())["error"].as_str().unwrap().contains("point 0")
    );
    assert_eq!(ask("{\"tare\": true}\n".to_owned())["taring"], true);
    live.wait_for("taring as asked");
}

#[test]
fn however_it_is_killed_it_goes_on_from_a_whole_checkpoint() {
    let domain = domain();
    let mut folder = tempfile::tempdir().unwrap();
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "600"]));
    let mut cells = 0;
    for round in 0..20_u64 {
        let arguments = ["--resume", "--checkpoint", "0.3", "--replays", "2"];
        let mut live = Live::start_in(folder, &domain, &arguments);
        live.wait_for(if round == 0 { "\"state\":\"mapping\"" } else { "\"state\":\"" });
        // Moments without a pattern, the first of them late enough for a checkpoint.
        let after_ms = if round == 0 { 3000 } else { 100 + (round * 7919) % 1700 };
        thread::sleep(Duration::from_millis(after_ms));
        live.kill("-KILL");
        live.child.wait().unwrap();
        let field = live.path("field.npz");
        // One every 0.3 s, and a second for a slow machine to write it.
        let age = field.metadata().unwrap().modified().unwrap().elapsed().unwrap();
        let oldest = Duration::from_millis(1300);
        assert!(age < oldest || after_ms < 1300, "round {round}: {age:?} after {after_ms} ms");
        let report = succeed(palpate().arg("inspect").arg(&field).arg("--json"));
        let report: Value = serde_json::from_str(&report).unwrap();
        let now = report["paths"][0]["cells"].as_u64().unwrap_or_else(|| panic!("{report}"));
        assert!(now >= cells && now > 0, "round {round}: {now} cells after {cells}");
        cells = now;
        let kept = tempfile::tempdir().unwrap();
        fs::copy(&field, kept.path().join("field.npz")).unwrap();
        let leftovers: Vec<_> = fs::read_dir(live.folder.path()).unwrap().collect();
        assert!(leftovers.len() <= 4, "{leftovers:?}");
        folder = kept;
    }
}
