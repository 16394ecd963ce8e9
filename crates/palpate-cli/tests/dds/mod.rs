//! A robot that CycloneDDS plays, and a session beside it, on loopback.

use std::fs;
use std::net::{Ipv4Addr, UdpSocket};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::SystemTime;

use serde_json::Value;

use crate::common::{interrupt, names, palpate, plant, python, root, succeed, wait_until};

/// A DDS domain that no other test uses, in this process or another, and no other program.
///
/// Domain d has the UDP ports from 7400 + 250 d on. A test that holds the last of them, which DDS
/// would give to the 120th participant only, has taken the domain.
pub(crate) struct Domain {
    pub(crate) number: u16,
    _lock: UdpSocket,
}

impl Domain {
    /// Higher domains have ports that Linux assigns to any program.
    const LAST: u16 = 100;

    pub(crate) fn take() -> Self {
        let first = std::process::id() as u16 % Self::LAST;
        let mut numbers = (0..Self::LAST).map(|number| (first + number) % Self::LAST + 1);
        numbers.find_map(Self::lock).expect("a DDS domain that nobody uses")
    }

    fn lock(number: u16) -> Option<Self> {
        let bind = |port| UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 7400 + 250 * number + port));
        let lock = bind(249).ok()?;
        drop(bind(10).ok()?); // that of the first participant
        Some(Self { number, _lock: lock })
    }
}

/// The robot: plays the bundled touches and prints what it received.
pub(crate) fn robot(domain: &Domain, arguments: &[&str]) -> Command {
    let mut command = python();
    command.arg(root().join("scripts/dds_robot.py")).arg(plant());
    command.args(["--domain", &domain.number.to_string()]).args(arguments);
    command
}

/// A session that is ended with the test.
pub(crate) struct Live {
    pub(crate) child: Child,
    pub(crate) folder: tempfile::TempDir,
}

impl Live {
    pub(crate) fn start(domain: &Domain, arguments: &[&str]) -> Self {
        Self::start_in(tempfile::tempdir().unwrap(), domain, arguments)
    }

    pub(crate) fn start_in(folder: tempfile::TempDir, domain: &Domain, arguments: &[&str]) -> Self {
        let lines = fs::File::create(folder.path().join("lines.json")).unwrap();
        let output = ["--output".into(), folder.path().join("field.npz").into_os_string()];
        let child = palpate()
            .args(["live", "--localhost", "--domain", &domain.number.to_string(), "--json-lines"])
            // Samples wait on a busy machine; none is dropped.
            .args(["--queue", "1000000"])
            .args(arguments)
            .args(if arguments.contains(&"--no-map") { &[][..] } else { &output })
            .stdout(lines)
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Self { child, folder }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Continues from a field that has learnt a touch, and so has bands.
    pub(crate) fn resume(domain: &Domain, arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut map = palpate();
        map.arg("map").arg(plant().join("seq_000")).args(["--replays", "2", "-o"]);
        succeed(map.arg(folder.path().join("field.npz")));
        let going_on = ["--resume", "--replays", "2"];
        Self::start_in(folder, domain, &[&going_on, arguments].concat())
    }

    /// All lines so far.
    pub(crate) fn lines(&self) -> String {
        fs::read_to_string(self.path("lines.json")).unwrap()
    }

    /// Waits until some words are printed.
    #[track_caller]
    pub(crate) fn wait_for(&self, words: &str) {
        wait_until(words, || self.lines().contains(words));
    }

    /// Waits for figures that meet a condition.
    #[track_caller]
    pub(crate) fn wait_for_figures(&self, what: &str, holds: impl Fn(&Value) -> bool) {
        wait_until(what, || {
            let lines = self.lines();
            // The last line may be half written.
            let mut lines = lines.lines().filter_map(|line| serde_json::from_str(line).ok());
            lines.any(|line: Value| line["state"].is_string() && holds(&line))
        });
    }

    /// Waits until a checkpoint is written that is newer than the one of the time `then`.
    pub(crate) fn wait_for_checkpoint(&self, then: Option<SystemTime>) {
        wait_until("another checkpoint", || self.written() != then);
    }

    /// Time at which the current checkpoint was written.
    pub(crate) fn written(&self) -> Option<SystemTime> {
        Some(self.path("field.npz").metadata().ok()?.modified().unwrap())
    }

    /// Waits until a checkpoint is being written.
    pub(crate) fn wait_for_writing(&self) {
        wait_until("a checkpoint that is being written", || {
            names(self.folder.path()).iter().any(|name| name.ends_with(".partial"))
        });
    }

    pub(crate) fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Ends the session with Ctrl-C, and returns the last line.
    pub(crate) fn end(&mut self) -> Value {
        interrupt(&self.child);
        assert!(self.child.wait().unwrap().success(), "{}", self.lines());
        serde_json::from_str(self.lines().lines().last().unwrap()).unwrap()
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}", self.lines());
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A robot that plays while a test goes on, and stops with it.
pub(crate) struct Playing(Child);

impl Playing {
    pub(crate) fn start(mut robot: Command) -> Self {
        Self(robot.stdout(Stdio::null()).spawn().unwrap())
    }
}

impl Drop for Playing {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
