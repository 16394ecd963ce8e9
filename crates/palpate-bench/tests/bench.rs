//! The tool measures every lattice with the command `palpate`, which the tests of the workspace
//! build beside it.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

/// One link that swings about a vertical axis, so that gravity does not reach its joint.
const URDF: &str = r#"<robot name="tiny">
  <link name="base"/>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  </joint>
  <link name="arm">
    <collision><origin xyz="0.3 0 0"/><geometry><box size="0.6 0.06 0.06"/></geometry></collision>
  </link>
</robot>"#;

/// A folder with the arm and one touch of it: still, then into something springy.
fn scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("tiny.urdf"), URDF).unwrap();
    let mut table = "time,shoulder_position,shoulder_effort\n".to_owned();
    for frame in 0..40 {
        let q = 0.0125 * f64::from((frame - 8).max(0));
        table += &format!("{},{q},{}\n", 0.1 * f64::from(frame), 0.3 - 12.0 * (q - 0.05).max(0.0));
    }
    fs::write(folder.path().join("touch.csv"), table).unwrap();
    folder
}

fn run(folder: &Path, more: &[&str]) -> Output {
    let palpate = Path::new(env!("CARGO_BIN_EXE_palpate-bench")).with_file_name("palpate");
    assert!(palpate.is_file(), "the command is not built: run `cargo test --workspace`");
    let mut command = Command::new(env!("CARGO_BIN_EXE_palpate-bench"));
    command.arg(folder.join("touch.csv")).arg("--robot").arg(folder.join("tiny.urdf"));
    command.args(["--no-cache", "--bake-spacing-m", "0.01", "--spacing-m", "0.03"]);
    command.args(["--replays", "2"]).args(more).output().unwrap()
}

#[track_caller]
fn succeed(folder: &Path, more: &[&str]) -> String {
    let output = run(folder, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn number(figures: &Value, pointer: &str) -> f64 {
    figures.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer}"))
}

fn sides(figures: &Value, rows: &str) -> Vec<f64> {
    figures[rows].as_array().unwrap().iter().map(|row| number(row, "/shape/0")).collect()
}

#[test]
fn a_step_is_compared_with_the_lower_bound_of_the_machine() {
    let scene = scene();
    let figures: Value = serde_json::from_str(&succeed(scene.path(), &["--json"])).unwrap();
    let bound = number(&figures, "/lower_bound/ns_per_visit");
    let ratio = number(&figures, "/update_ns_per_visit") / bound;
    assert!((number(&figures, "/lower_bound_ratio") / ratio - 1.0).abs() < 1e-9);
    assert!(figures.get("worlds").is_none() && figures.get("cells").is_none());
    let text = succeed(scene.path(), &[]);
    assert!(text.contains("56 bytes") && text.contains("23 operations"), "{text}");
}

#[test]
fn a_sweep_measures_every_lattice_in_every_round() {
    let scene = scene();
    let more = ["--sweep", "worlds,cells", "--warm-passes", "0", "--rounds", "3", "--json"];
    let figures: Value = serde_json::from_str(&succeed(scene.path(), &more)).unwrap();
    assert_eq!(sides(&figures, "worlds"), [50.0, 100.0, 200.0, 400.0, 1000.0]);
    // All of them contain the touched cells, at the rest points of the base.
    for world in figures["worlds"].as_array().unwrap() {
        assert_eq!(world["cells_touched"], figures["cells_touched"]);
        assert_eq!(world["contacts"], figures["contacts"]);
        let apart = (number(world, "/origin_m/0") - number(&figures, "/origin_m/0")) / 0.03;
        assert!((apart - apart.round()).abs() < 1e-6, "{apart}");
        let rounds = world["rounds"].as_array().unwrap().iter().map(|ms| ms.as_f64().unwrap());
        let mut rounds: Vec<f64> = rounds.collect();
        rounds.sort_by(f64::total_cmp);
        assert_eq!((rounds.len(), rounds[1]), (3, number(world, "/step_ms/median")));
    }
    assert_eq!(sides(&figures, "cells"), [100.0, 200.0, 300.0, 480.0]);
}

#[test]
fn the_ratios_of_a_table_have_the_mean_one() {
    let scene = scene();
    let text = succeed(scene.path(), &["--sweep", "worlds", "--warm-passes", "0", "--rounds", "1"]);
    let rows: Vec<&str> = text.lines().filter(|line| line.contains("³ |")).collect();
    assert!(rows.len() == 5 && rows[0].starts_with("| 50³ |"), "{text}");
    let ratio = |row: &&str| row.split('|').nth(7).unwrap().trim().parse::<f64>().unwrap();
    let sum: f64 = rows.iter().map(ratio).sum();
    assert!((sum - 5.0).abs() < 0.05, "{text}"); // two digits each
}

#[test]
fn what_cannot_be_measured_is_an_error() {
    let scene = scene();
    let refused = |more: &[&str], words: &str| {
        let output = run(scene.path(), more);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && error.contains(words), "{error}");
    };
    refused(&["--box-low-m", "5,5,5", "--box-high-m", "6,6,6"], "nothing to time");
    refused(&["--palpate", "nowhere"], "cargo build --release");
    refused(&["--rounds", "2"], "--sweep");
    refused(&["--sweep", "time"], "worlds");
    refused(&["--sweep", "cells", "--rounds", "0"], "--rounds");
}
