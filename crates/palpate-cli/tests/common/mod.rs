//! A tiny arm, tiny logs of it, and the command run on them.
#![allow(dead_code)] // every test file takes what it needs
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::thread;
use std::time::{Duration, Instant};

use palpate_io::log::{LogOptions, Sample};
use palpate_work::touches::{RecordedTouch, Touches};
use tempfile::TempDir;

/// Two links that swing about vertical axes, so that gravity does not reach the joints.
pub(crate) const URDF: &str = r#"<robot name="tiny">
  <link name="base"/>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
  </joint>
  <link name="upper">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.06 0.06"/></geometry></collision>
  </link>
  <joint name="elbow" type="continuous">
    <origin xyz="0.4 0 0"/><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>
  </joint>
  <link name="fore">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.05 0.05"/></geometry></collision>
  </link>
</robot>"#;

/// A folder with the arm, a few touches of it, and room for results.
pub(crate) struct Scene {
    folder: TempDir,
}

impl Scene {
    /// The arm and two touches, `log/seq_0` and `log/seq_1`.
    pub(crate) fn new() -> Self {
        let scene = Self { folder: tempfile::tempdir().unwrap() };
        fs::write(scene.path("tiny.urdf"), URDF).unwrap();
        scene.touch("log/seq_0", 40, 0.0);
        scene.touch("log/seq_1", 40, -0.4);
        fs::create_dir(scene.path("out")).unwrap();
        scene
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(crate) fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    /// Writes a touch: eight still frames, then the shoulder swings into something springy.
    pub(crate) fn touch(&self, name: &str, frames: usize, elbow: f64) {
        let swing = |frame: usize| 0.5 * frame.saturating_sub(8) as f64 / frames as f64;
        let angles = (0..frames).map(|frame| [swing(frame), elbow]);
        let torques = (0..frames).map(|frame| {
            let push = (swing(frame) - 0.05).max(0.0);
            [0.3 - 12.0 * push, 0.1 - 4.0 * push]
        });
        self.arrays(name, &angles.collect::<Vec<_>>(), &torques.collect::<Vec<_>>());
    }

    /// Writes the two arrays of a touch.
    pub(crate) fn arrays<const N: usize>(
        &self,
        name: &str,
        angles: &[[f64; N]],
        torques: &[[f64; N]],
    ) {
        fs::create_dir_all(self.path(name)).unwrap();
        npy(&self.path(name).join("angles.npy"), &[angles.len(), N], angles.as_flattened());
        npy(&self.path(name).join("torques.npy"), &[torques.len(), N], torques.as_flattened());
    }

    /// The settings that make every command fast.
    pub(crate) fn settings(&self) -> Vec<String> {
        let robot = self.text("tiny.urdf");
        ["--robot", &robot, "--no-cache", "--bake-spacing-m", "0.01"].map(str::to_owned).to_vec()
    }

    /// A subcommand on some logs, with these settings.
    pub(crate) fn command(&self, name: &str, logs: &[&str]) -> Command {
        let mut command = palpate();
        command.arg(name).args(logs.iter().map(|log| self.path(log))).args(self.settings());
        command
    }

    /// `palpate map` of some logs into `out/field.npz`.
    pub(crate) fn map(&self, logs: &[&str], more: &[&str]) -> Command {
        let mut command = self.command("map", logs);
        command.args(["--spacing-m", "0.03"]);
        if !more.contains(&"-o") {
            command.arg("-o").arg(self.path("out/field.npz"));
        }
        command.args(more);
        command
    }

    /// `palpate predict` of some logs from `out/field.npz`.
    pub(crate) fn predict(&self, logs: &[&str], more: &[&str]) -> Command {
        let mut command = self.command("predict", &[&["out/field.npz"], logs].concat());
        command.args(more);
        command
    }

    /// Names of the files in `out`.
    pub(crate) fn results(&self) -> Vec<String> {
        names(&self.path("out"))
    }
}

/// The root of the project.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// Folder of the bundled data set.
pub(crate) fn plant() -> PathBuf {
    root().join("data/plant_a")
}

/// The Python with which tests exchange files.
pub(crate) fn python() -> Command {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap();
    let python = target.join("interop-venv/bin/python");
    assert!(python.is_file(), "{} is missing: run ./setup first", python.display());
    Command::new(python)
}

/// The touches of a log.
pub(crate) fn touches(log: &Path) -> Vec<RecordedTouch> {
    let touches = Touches::open(&[log.to_owned()], &LogOptions::default());
    touches.unwrap().read(None).unwrap()
}

/// The samples of a log of one touch.
pub(crate) fn samples(log: &Path) -> Vec<Sample> {
    touches(log).remove(0).samples
}

/// Names in a folder, hidden ones too.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The command, not yet run.
pub(crate) fn palpate() -> Command {
    Command::new(env!("CARGO_BIN_EXE_palpate"))
}

/// Writes an npy file of doubles.
pub(crate) fn npy(path: &Path, shape: &[usize], numbers: &[f64]) {
    let sides: Vec<String> = shape.iter().map(|side| format!("{side},")).collect();
    let header =
        format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}), }}", sides.join(" "));
    let header = format!("{header:<117}\n"); // magic, version, length and header: 128 bytes
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

/// Writes the arrays of a touch, one of them the times.
pub(crate) fn write_touch(folder: &Path, samples: &[Sample]) {
    let (rows, joints) = (samples.len(), samples[0].q.len());
    let write = |name: &str, shape: &[usize], of: fn(&Sample) -> &[f64]| {
        npy(&folder.join(name), shape, &samples.iter().flat_map(of).copied().collect::<Vec<_>>());
    };
    fs::create_dir_all(folder).unwrap();
    write("angles.npy", &[rows, joints], |sample| &sample.q);
    write("torques.npy", &[rows, joints], |sample| &sample.tau);
    write("time.npy", &[rows], |sample| sample.time_s.as_slice());
}

/// Waits for a condition; fails after a deadline that is long enough for any machine.
#[track_caller]
pub(crate) fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(180);
    while !holds() {
        assert!(Instant::now() < deadline, "waited in vain for {what}");
        thread::sleep(Duration::from_millis(2));
    }
}

/// Presses Ctrl-C.
#[cfg(unix)]
pub(crate) fn interrupt(child: &Child) {
    signal(child, "-INT");
}

/// Sends a signal to a process.
#[cfg(unix)]
pub(crate) fn signal(child: &Child, signal: &str) {
    let id = child.id().to_string();
    assert!(Command::new("kill").args([signal, &id]).status().unwrap().success());
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Runs a command that must succeed, and returns what it wrote to stdout and stderr.
#[track_caller]
pub(crate) fn printed(command: &mut Command) -> (String, String) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}\n{}", stderr(&output));
    (stdout(&output), stderr(&output))
}

/// Runs a command that must succeed, and returns what it printed.
#[track_caller]
pub(crate) fn succeed(command: &mut Command) -> String {
    printed(command).0
}

/// Runs a command that must succeed and print JSON.
#[track_caller]
pub(crate) fn json(command: &mut Command) -> serde_json::Value {
    serde_json::from_str(&succeed(command)).unwrap()
}

/// Asserts that a text contains all of these words.
#[track_caller]
pub(crate) fn holds(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "`{word}` is not in: {text}");
    }
}

/// Runs a command that must fail with an exit code and an error that holds all of `words`, and returns what it wrote
/// to stderr.
#[track_caller]
pub(crate) fn refuse(command: &mut Command, code: i32, words: &[&str]) -> String {
    let output = command.output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{command:?}\n{said}");
    assert!(said.starts_with("error: ") || said.contains("\nerror: "), "{said}");
    assert!(!said.contains("defect"), "a panic: {said}");
    holds(&said, words);
    assert!(output.stdout.is_empty(), "{}", stdout(&output));
    said
}
