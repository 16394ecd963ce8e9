//! Every command that reads a log warns in one line of what `inspect` would report, and `--strict`
//! makes that an error.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

mod common;
mod recording;

use std::path::Path;
use std::process::{Command, Output};

use common::{names, palpate, stderr};
use recording::{Touch, clean, write};
use tempfile::TempDir;

/// A coarse lattice, so that every command is fast, and a sign that may be wrong.
const FLAGS: [&str; 4] = ["--spacing-m", "0.04", "--torque-sign", "plus"];

/// A log, clean or spoilt, and room for results.
fn scene(spoil: impl Fn(&mut Touch)) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut touches = clean();
    touches.iter_mut().for_each(spoil);
    write(&folder.path().join("log"), &touches);
    std::fs::create_dir(folder.path().join("out")).unwrap();
    folder
}

fn other_sign(touch: &mut Touch) {
    touch.tau.iter_mut().flatten().for_each(|tau| *tau = -*tau);
}

/// Every command that learns from a log or predicts it, its results in `out`.
fn commands(folder: &Path) -> Vec<Command> {
    let [log, out] = ["log", "out"].map(|name| folder.join(name));
    let of = |args: &[&str], result: &str| {
        let mut command = palpate();
        command.arg(args[0]).arg(&log).arg("-o").arg(out.join(result));
        command.args(&args[1..]).args(FLAGS);
        command
    };
    vec![
        of(&["map"], "field.npz"),
        of(&["evaluate", "--methods", "zero"], "evaluation"),
        of(&["tune", "--candidates", "2"], "settings.toml"),
    ]
}

fn warnings(output: &Output) -> Vec<String> {
    let lines = stderr(output);
    lines.lines().filter(|line| line.contains("looks wrong (")).map(str::to_owned).collect()
}

#[test]
fn each_command_warns_in_one_line_for_each_kind_of_defect_and_of_a_clean_log_not_at_all() {
    let [good, bad] = [scene(|_| ()), scene(other_sign)];
    for (mut good, mut bad) in commands(good.path()).into_iter().zip(commands(bad.path())) {
        let good = good.output().unwrap();
        assert!(good.status.success() && warnings(&good).is_empty(), "{}", stderr(&good));
        let lines = warnings(&bad.output().unwrap());
        assert_eq!(lines.len(), 1, "{lines:?}");
        let words = ["warning: `", "log` looks wrong (torque_sign): ", "try --torque-sign minus"];
        words.iter().for_each(|word| assert!(lines[0].contains(word), "{lines:?}"));
    }
}

#[test]
fn strict_makes_it_an_error_that_leaves_no_result() {
    let folder = scene(other_sign);
    for mut command in commands(folder.path()) {
        let output = command.args(["--strict", "--quiet"]).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        let message = stderr(&output);
        // Touches with the wrong sign hardly predict each other: a warning of that may come first.
        let error = message.lines().find(|line| line.starts_with("error: `"));
        assert!(error.is_some_and(|error| error.contains("(torque_sign)")), "{message}");
        assert!(names(&folder.path().join("out")).is_empty());
    }
}

#[test]
fn predict_warns_of_the_log_that_it_predicts() {
    let folder = scene(|_| ());
    assert!(commands(folder.path())[0].status().unwrap().success());
    let bad = scene(other_sign);
    let mut predict = palpate();
    predict.arg("predict").arg(folder.path().join("out/field.npz")).arg(bad.path().join("log"));
    let found = predict.output().unwrap();
    assert!(found.status.success() && warnings(&found).is_empty(), "{}", stderr(&found));
    predict.args(["--torque-sign", "plus"]);
    let lines = warnings(&predict.output().unwrap());
    assert_eq!(lines.len(), 1, "{lines:?}");
    let strict = predict.arg("--strict").output().unwrap();
    assert_eq!(strict.status.code(), Some(1), "{}", stderr(&strict));
}

#[test]
fn a_log_in_degrees_gives_the_field_of_the_same_in_radians() {
    let degrees =
        |touch: &mut Touch| touch.q.iter_mut().flatten().for_each(|q| *q = q.to_degrees());
    let cells = |folder: &TempDir| {
        let output = commands(folder.path())[0].output().unwrap();
        assert!(output.status.success() && warnings(&output).is_empty(), "{}", stderr(&output));
        let field = palpate_io::field::load(&folder.path().join("out/field.npz")).unwrap().field;
        (field.stiffness_n_per_m.to_vec(), stderr(&output).contains("the angles look like degrees"))
    };
    let ((wanted, note_on_radians), (found, note_on_degrees)) =
        (cells(&scene(|_| ())), cells(&scene(degrees)));
    assert_eq!((note_on_radians, note_on_degrees), (false, true));
    let stiffest = wanted.iter().copied().fold(0.0, f64::max);
    assert!(stiffest > 0.0);
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-3 * stiffest;
    assert!(wanted.len() == found.len() && wanted.iter().zip(&found).all(near));
}

#[test]
fn logs_in_degrees_beside_others_in_radians_are_refused_by_name() {
    let radians = scene(|_| ());
    let degrees = scene(|touch| touch.q.iter_mut().flatten().for_each(|q| *q = q.to_degrees()));
    let (radians, degrees) = (radians.path().join("log"), degrees.path().join("log"));
    for order in [[&radians, &degrees], [&degrees, &radians]] {
        let out = degrees.with_file_name("out");
        let mut map = palpate();
        map.arg("map").args(order).arg("-o").arg(out.join("field.npz"));
        let output = map.output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains("convert all to one unit"), "{said}");
        let names_one = order.iter().any(|log| said.contains(&format!("`{}`: the", log.display())));
        assert!(names_one && !out.join("field.npz").exists(), "{said}");
    }
}

#[test]
fn a_log_of_another_robot_is_recognised_by_its_number_of_joints() {
    let folder = scene(|touch| touch.each_row(|row| row.truncate(6)));
    for mut command in commands(folder.path()) {
        let output = command.output().unwrap();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains("joint") && !message.contains("defect"), "{message}");
        assert!(message.contains("6 joint") && message.contains("has 7"), "{message}");
    }
}

#[test]
fn the_error_of_a_bad_log_names_its_finding() {
    let folder = scene(|touch| touch.tau[90][2] = 2e6);
    let output = commands(folder.path())[0].output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("looks wrong (saturation)"), "{message}");
}

#[test]
fn converting_probable_degrees_to_a_bag_in_radians_warns() {
    let scene = scene(|touch| touch.q.iter_mut().flatten().for_each(|q| *q = q.to_degrees()));
    let convert = |more: &[&str]| {
        let mut convert = palpate();
        convert.arg("convert").arg(scene.path().join("log")).args(more);
        let done = convert.arg("-o").arg(scene.path().join("out/bag.mcap")).output().unwrap();
        assert!(done.status.success(), "{}", stderr(&done));
        stderr(&done).contains("and are written as radians: if they are degrees")
    };
    assert!(convert(&[]) && !convert(&["--angle-unit", "deg"]));
}
