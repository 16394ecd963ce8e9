//! Synthetic logs of the built-in robot, as its sensors would measure them, without defects.
#![allow(dead_code)] // every test file takes what it needs
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

use std::fs;
use std::path::Path;
use std::process::Command;

use palpate::Robot;
use serde_json::Value;

use super::common::{npy, palpate};

pub(crate) const STILL: usize = 20;
pub(crate) const FRAMES: usize = 100;
pub(crate) const PERIOD_S: f64 = 0.05;

/// The content of the files of one touch.
#[derive(Clone)]
pub(crate) struct Touch {
    pub(crate) time_s: Vec<f64>,
    pub(crate) q: Vec<Vec<f64>>,
    pub(crate) tau: Vec<Vec<f64>>,
}

/// How a recording is made.
#[derive(Clone)]
pub(crate) struct Maker {
    pub(crate) robot: Robot,
    /// Factors of gravity, contact and noise.
    pub(crate) gravity: f64,
    pub(crate) contact: f64,
    pub(crate) noise: f64,
    pub(crate) still: usize,
    pub(crate) random: u64,
}

impl Maker {
    pub(crate) fn new() -> Self {
        let robot = Robot::built_in("kinova_gen3").unwrap();
        Self { robot, gravity: 1.0, contact: 1.0, noise: 1.0, still: STILL, random: 1 }
    }

    /// A number from -1 to 1, always the same sequence.
    fn random(&mut self) -> f64 {
        self.random = self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.random >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Three touches: still, then into something springy and out again.
    pub(crate) fn touches(mut self) -> Vec<Touch> {
        let starts = [
            [0.3, 0.7, 0.2, 1.2, 0.1, 0.8, 0.5],
            [-0.6, 1.0, -0.4, 0.9, 0.6, 1.1, -0.3],
            [1.1, 0.5, 0.6, 1.5, -0.5, 0.6, 0.9],
        ];
        starts.map(|start| self.touch(&start)).to_vec()
    }

    fn touch(&mut self, start: &[f64; 7]) -> Touch {
        let bias: Vec<f64> = (0..7).map(|_| 0.1 * self.random()).collect();
        let mut touch = Touch { time_s: vec![], q: vec![], tau: vec![] };
        for frame in 0..FRAMES {
            let moving = (FRAMES - STILL - self.still) as f64;
            let part = (frame as f64 - self.still as f64).clamp(0.0, moving) / moving;
            let depth = 0.2 * (1.0 - (std::f64::consts::TAU * part).cos());
            let mut q = start.to_vec();
            (q[0], q[1], q[3]) = (q[0] + depth, q[1] + 0.5 * depth, q[3] - 0.5 * depth);
            let jitter: Vec<f64> = (0..7).map(|_| 1e-5 * self.random()).collect();
            let poses = self.robot.forward(&q).unwrap();
            let gravity = self.robot.gravity_torque(&poses);
            let push = [-8.0, -4.0, -2.0, 4.0, 0.0, 0.0, 0.0];
            let tau = (0..7).map(|joint| {
                let noise = self.noise * 0.1 * self.random();
                let contact = self.contact * push[joint] * (depth - 0.05).max(0.0);
                self.gravity * gravity[joint] + contact + bias[joint] + noise
            });
            touch.tau.push(tau.collect());
            touch.q.push(q.iter().zip(jitter).map(|(q, jitter)| q + jitter).collect());
            touch.time_s.push(frame as f64 * PERIOD_S);
        }
        touch
    }
}

impl Touch {
    /// Changes every row of both arrays.
    pub(crate) fn each_row(&mut self, change: impl Fn(&mut Vec<f64>)) {
        self.q.iter_mut().chain(&mut self.tau).for_each(change);
    }

    pub(crate) fn negate_torques(&mut self) {
        self.tau.iter_mut().flatten().for_each(|tau| *tau = -*tau);
    }

    pub(crate) fn turn_to_degrees(&mut self) {
        self.q.iter_mut().flatten().for_each(|angle| *angle = angle.to_degrees());
    }
}

/// Touches with nothing wrong in them.
pub(crate) fn clean() -> Vec<Touch> {
    Maker::new().touches()
}

/// Writes `seq_0`, `seq_1` and so on.
pub(crate) fn write(folder: &Path, touches: &[Touch]) {
    for (number, touch) in touches.iter().enumerate() {
        let path = folder.join(format!("seq_{number}"));
        fs::create_dir_all(&path).unwrap();
        let n = touch.q[0].len();
        npy(&path.join("angles.npy"), &[touch.q.len(), n], &touch.q.concat());
        npy(&path.join("torques.npy"), &[touch.tau.len(), n], &touch.tau.concat());
        npy(&path.join("time.npy"), &[touch.time_s.len()], &touch.time_s);
    }
}

/// Writes one touch as a table with columns of these names.
pub(crate) fn write_csv(path: &Path, touch: &Touch, joints: &[&str]) {
    let heads =
        |kind: &str| joints.iter().map(|joint| format!("{joint}_{kind}")).collect::<Vec<_>>();
    let mut text = format!("time,{},{}\n", heads("position").join(","), heads("effort").join(","));
    for ((time_s, q), tau) in touch.time_s.iter().zip(&touch.q).zip(&touch.tau) {
        let cells: Vec<String> = q.iter().chain(tau).map(ToString::to_string).collect();
        text += &format!("{time_s},{}\n", cells.join(","));
    }
    fs::write(path, text).unwrap();
}

/// `palpate inspect`, with links baked once for all tests.
pub(crate) fn inspect() -> Command {
    let mut command = palpate();
    command.arg("inspect").env("PALPATE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"));
    command
}

/// Exit code and JSON of an inspection.
#[track_caller]
pub(crate) fn run(command: &mut Command) -> (Option<i32>, Value) {
    let output = command.arg("--json").output().unwrap();
    let report = serde_json::from_slice(&output.stdout);
    let report = report.unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    (output.status.code(), report)
}

/// Asserts an exit code and the codes of the findings of the first path, and returns the report.
#[track_caller]
pub(crate) fn found((exit, report): (Option<i32>, Value), wanted: i32, codes: &[&str]) -> Value {
    let found = (exit, self::codes(&report));
    assert_eq!(found, (Some(wanted), codes.to_vec()), "{}", report["paths"][0]["findings"]);
    report
}

/// The findings of the first path, by their codes.
pub(crate) fn codes(report: &Value) -> Vec<&str> {
    let findings = report["paths"][0]["findings"].as_array().unwrap();
    findings.iter().map(|finding| finding["code"].as_str().unwrap()).collect()
}

/// The first finding of the first path.
pub(crate) fn first(report: &Value) -> &Value {
    &report["paths"][0]["findings"][0]
}
