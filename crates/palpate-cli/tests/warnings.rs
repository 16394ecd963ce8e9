//! Every command that reads a log warns in one line of what `inspect` would report, and `--strict`
//! makes that an error.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

mod common;
mod recording;

use std::path::Path;
use std::process::Command;

use common::{holds, names, palpate, printed, refuse, stderr};
use recording::{Maker, Touch, clean, write};
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

fn warnings(said: &str) -> Vec<&str> {
    said.lines().filter(|line| line.contains("looks wrong (")).collect()
}

#[test]
fn each_command_warns_in_one_line_for_each_kind_of_defect_and_of_a_clean_log_not_at_all() {
    let [good, bad] = [scene(|_| ()), scene(Touch::negate_torques)];
    for (mut good, mut bad) in commands(good.path()).into_iter().zip(commands(bad.path())) {
        let (_, said) = printed(&mut good);
        assert!(warnings(&said).is_empty(), "{said}");
        let said = stderr(&bad.output().unwrap());
        let lines = warnings(&said);
        assert_eq!(lines.len(), 1, "{lines:?}");
        let words = ["warning: `", "log` looks wrong (torque_sign): ", "try --torque-sign minus"];
        holds(lines[0], &words);
    }
}

#[test]
fn strict_makes_it_an_error_that_leaves_no_result() {
    let folder = scene(Touch::negate_torques);
    for mut command in commands(folder.path()) {
        let message = refuse(command.args(["--strict", "--quiet"]), 1, &[]);
        // Touches with the wrong sign hardly predict each other: a warning of that may come first.
        let error = message.lines().find(|line| line.starts_with("error: `"));
        assert!(error.is_some_and(|error| error.contains("(torque_sign)")), "{message}");
        assert!(names(&folder.path().join("out")).is_empty());
    }
}

#[test]
fn logs_of_two_conventions_and_negated_columns_are_refused() {
    let folder = scene(|touch| touch.tau.iter_mut().for_each(|tau| tau[1] *= -0.9));
    write(&folder.path().join("without"), &Maker { gravity: 0.0, ..Maker::new() }.touches());
    write(&folder.path().join("with"), &clean());
    let map = |logs: &[&str]| {
        let mut map = palpate();
        map.arg("map").args(logs.iter().map(|log| folder.path().join(log)));
        map.arg("-o").arg(folder.path().join("out/field.npz"));
        map
    };
    let said = refuse(&mut map(&["with", "without"]), 2, &["with`", "without`"]);
    holds(&said, &["contain gravity", "contain no gravity", "separate commands"]);
    refuse(&mut map(&["log"]), 2, &["opposite sign of the others", "--torque-sign"]);
}

#[test]
fn predict_warns_of_the_log_that_it_predicts() {
    let folder = scene(|_| ());
    assert!(commands(folder.path())[0].status().unwrap().success());
    let bad = scene(Touch::negate_torques);
    let mut predict = palpate();
    predict.arg("predict").arg(folder.path().join("out/field.npz")).arg(bad.path().join("log"));
    let (_, said) = printed(&mut predict);
    assert!(warnings(&said).is_empty(), "{said}");
    let said = stderr(&predict.args(["--torque-sign", "plus"]).output().unwrap());
    assert_eq!(warnings(&said).len(), 1, "{said}");
    refuse(predict.arg("--strict"), 1, &[]);
}

#[test]
fn a_log_in_degrees_gives_the_field_of_the_same_in_radians() {
    let cells = |folder: &TempDir| {
        let (_, said) = printed(&mut commands(folder.path())[0]);
        assert!(warnings(&said).is_empty(), "{said}");
        let field = palpate_io::field::load(&folder.path().join("out/field.npz")).unwrap().field;
        (field.stiffness_n_per_m.to_vec(), said.contains("the angles look like degrees"))
    };
    let ((wanted, note_on_radians), (found, note_on_degrees)) =
        (cells(&scene(|_| ())), cells(&scene(Touch::turn_to_degrees)));
    assert_eq!((note_on_radians, note_on_degrees), (false, true));
    let stiffest = wanted.iter().copied().fold(0.0, f64::max);
    assert!(stiffest > 0.0);
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-3 * stiffest;
    assert!(wanted.len() == found.len() && wanted.iter().zip(&found).all(near));
}

#[test]
fn logs_in_degrees_beside_others_in_radians_are_refused_by_name() {
    let radians = scene(|_| ());
    let degrees = scene(Touch::turn_to_degrees);
    let (radians, degrees) = (radians.path().join("log"), degrees.path().join("log"));
    for order in [[&radians, &degrees], [&degrees, &radians]] {
        let out = degrees.with_file_name("out");
        let mut map = palpate();
        map.arg("map").args(order).arg("-o").arg(out.join("field.npz"));
        let said = refuse(&mut map, 2, &["convert all to one unit"]);
        let names_one = order.iter().any(|log| said.contains(&format!("`{}`: the", log.display())));
        assert!(names_one && !out.join("field.npz").exists(), "{said}");
    }
}

#[test]
fn a_log_of_another_robot_is_recognised_by_its_number_of_joints() {
    let folder = scene(|touch| touch.each_row(|row| row.truncate(6)));
    for mut command in commands(folder.path()) {
        refuse(&mut command, 1, &["6 joint", "has 7"]);
    }
}

#[test]
fn the_error_of_a_bad_log_names_its_finding() {
    let folder = scene(|touch| touch.tau[90][2] = 2e6);
    refuse(&mut commands(folder.path())[0], 1, &["looks wrong (saturation)"]);
}

#[test]
fn converting_probable_degrees_to_a_bag_in_radians_warns() {
    let scene = scene(Touch::turn_to_degrees);
    let convert = |more: &[&str]| {
        let mut convert = palpate();
        convert.arg("convert").arg(scene.path().join("log")).args(more);
        let (_, said) = printed(convert.arg("-o").arg(scene.path().join("out/bag.mcap")));
        said.contains("and are written as radians: if they are degrees")
    };
    assert!(convert(&[]) && !convert(&["--angle-unit", "deg"]));
}
