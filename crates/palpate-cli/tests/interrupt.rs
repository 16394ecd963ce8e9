//! Ctrl-C in the middle of mapping and measuring.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

use common::{Scene, json, refuse, succeed};

/// Maps a touch that would take a minute, presses Ctrl-C once it is under way, and returns exit
/// code and stderr.
fn interrupted(scene: &Scene, more: &[&str]) -> (Option<i32>, String) {
    scene.touch("long", 3_000, 0.0);
    let mut command = scene.map(&["log/seq_1", "long"], more);
    command.args(["--replays", "20000"]);
    let (code, _, said) = press(&mut command, "note: robot");
    (code, said)
}

/// Runs a command, presses Ctrl-C when stderr holds `words`, and returns exit code, stdout and
/// stderr.
fn press(command: &mut Command, words: &str) -> (Option<i32>, String, String) {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    while !said.contains(words) {
        assert_ne!(lines.read_line(&mut said).unwrap(), 0, "{said}");
    }
    // Many signals at once: `ros2 launch` repeats the one that the terminal has sent to all
    // processes.
    let many = format!("for i in $(seq 100); do kill -INT {}; done", child.id());
    assert!(Command::new("sh").args(["-c", &many]).status().unwrap().success());
    lines.read_to_string(&mut said).unwrap();
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stdout).unwrap(), said)
}

#[test]
fn nothing_is_written_unless_asked_for() {
    let scene = Scene::new();
    let (code, said) = interrupted(&scene, &[]);
    assert_eq!(code, Some(130), "{said}");
    assert!(said.contains("error: interrupted") && said.contains("nothing was written"), "{said}");
    assert!(scene.results().is_empty(), "{:?}", scene.results());
}

#[test]
fn the_field_so_far_is_saved_whole_if_asked_for() {
    let scene = Scene::new();
    let (code, said) = interrupted(&scene, &["--save-on-interrupt"]);
    assert_eq!(code, Some(130), "{said}");
    assert!(said.contains("the field so far is in"), "{said}");
    assert_eq!(scene.results(), ["field.npz"]);

    let field = scene.text("out/field.npz");
    succeed(&mut scene.map(&["log/seq_0"], &["--from", &field]));
    let report = json(&mut scene.predict(&["log/seq_0"], &["--json"]));
    assert_eq!(report["touches"][0]["name"], "seq_0");
    refuse(&mut scene.map(&["log/seq_0"], &["--from", &field, "--seed", "9"]), 2, &["seed"]);
}

#[test]
fn an_interrupted_measurement_prints_nothing() {
    let scene = Scene::new();
    scene.touch("long", 600, 0.0);
    let mut command = scene.command("bench", &["long"]);
    command.args(["--spacing-m", "0.02", "--replays", "20000"]);
    let (code, printed, said) = press(&mut command, "note: robot");
    assert_eq!((code, printed.as_str()), (Some(130), ""), "{said}");
    assert!(said.contains("error: interrupted"), "{said}");
}
