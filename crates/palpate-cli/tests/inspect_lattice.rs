//! `inspect`, `map` and `evaluate` agree about what a log touches of a lattice that is not the
//! default.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

mod common;
mod recording;

use std::fs;
use std::process::Command;

use common::{Scene, holds, json, printed, refuse};
use recording::{codes, first, run};
use serde_json::Value;

/// A lattice in a part of what the arm sweeps, coarser than the default, with another contact
/// model.
const LATTICE: [&str; 8] = [
    "--spacing-m",
    "0.025",
    "--box-low-m",
    "0.3,-0.2,-0.1",
    "--box-high-m",
    "0.7,0.4,0.1",
    "--contact-distance-m",
    "0.03",
];
/// A box that the arm never reaches.
const ELSEWHERE: [&str; 4] = ["--box-low-m", "2,2,2", "--box-high-m", "2.5,2.5,2.5"];

/// A subcommand on the log of a scene.
fn command(scene: &Scene, name: &str, flags: &[&str]) -> Command {
    let mut command = scene.command(name, &["log"]);
    command.args(flags);
    match name {
        "map" => command.arg("-o").arg(scene.path("out/field.npz")).arg("--json"),
        "evaluate" => {
            command.arg("-o").arg(scene.path("out/e")).args(["--methods", "map", "--json"])
        }
        _ => &mut command,
    };
    command
}

/// The report of an inspection of the log.
#[track_caller]
fn inspect(scene: &Scene, flags: &[&str]) -> Value {
    let (exit, report) = run(&mut command(scene, "inspect", flags));
    assert_eq!(exit, Some(0), "{report}");
    report
}

fn frames_in_contact(report: &Value) -> Vec<u64> {
    let touches = report["touches"].as_array().unwrap();
    touches.iter().map(|touch| touch["frames_in_contact"].as_u64().unwrap()).collect()
}

#[test]
fn inspect_map_and_evaluate_agree_about_what_is_touched() {
    let scene = Scene::new();
    let report = inspect(&scene, &LATTICE);
    let (log, mapped) = (&report["paths"][0], json(&mut command(&scene, "map", &LATTICE)));
    for key in ["frames", "frames_in_contact", "contacts_median", "cells_touched"] {
        assert_eq!(log["touched"][key], mapped[key], "{key}");
    }
    assert_eq!(log["lattice"]["cells_declared"], mapped["cells_declared"]);
    let frames = frames_in_contact(log);
    assert!(frames.iter().all(|frames| (1..40).contains(frames)), "{frames:?}");
    assert_eq!(frames, frames_in_contact(&mapped));
    let evaluated = json(&mut command(&scene, "evaluate", &LATTICE));
    assert_eq!(frames, frames_in_contact(&evaluated));

    let default = inspect(&scene, &["--spacing-m", "0.025"]);
    assert_ne!(default["paths"][0]["touched"], log["touched"], "the box must matter");
}

#[test]
fn the_lattice_may_come_from_a_settings_file_or_a_field() {
    let scene = Scene::new();
    let by_flags = inspect(&scene, &LATTICE);
    json(&mut command(&scene, "map", &LATTICE));
    let file = scene.text("lattice.toml");
    let text = "[lattice]\nspacing_m = 0.025\nbox_low_m = [0.3, -0.2, -0.1]\n\
                box_high_m = [0.7, 0.4, 0.1]\n[contact]\ncontact_distance_m = 0.03\n";
    fs::write(&file, text).unwrap();
    assert_eq!(inspect(&scene, &["--settings", &file]), by_flags);
    let field = scene.text("out/field.npz");
    assert_eq!(inspect(&scene, &["--from", &field]), by_flags);
    let contradiction = ["--from", &field, "--friction", "0.9"];
    refuse(&mut command(&scene, "inspect", &contradiction), 2, &["contradict", "friction"]);
}

#[test]
fn a_box_without_contacts_is_reported_and_nothing_is_learnt() {
    let scene = Scene::new();
    let report = inspect(&scene, &ELSEWHERE);
    assert_eq!(codes(&report), ["no_contact"], "{}", report["paths"][0]["findings"]);
    let words = ["0 of 80 frames touch the lattice", "--box-low-m", "`fore` moves within"];
    holds(&first(&report).to_string(), &words);
    assert_eq!(report["paths"][0]["touched"]["cells_touched"], 0);

    let (mapped, said) = printed(&mut command(&scene, "map", &ELSEWHERE));
    holds(&said, &["0 of 80 frames touch the lattice"]);
    let mapped: Value = serde_json::from_str(&mapped).unwrap();
    assert_eq!((&mapped["frames_in_contact"], &mapped["cells_touched"]), (&0.into(), &0.into()));
}

#[test]
fn a_touch_beside_the_box_is_reported_among_others() {
    let scene = Scene::new();
    let swing: Vec<[f64; 2]> =
        (0..40_u32).map(|frame| [2.0 + 0.01 * f64::from(frame.saturating_sub(8)), 0.0]).collect();
    scene.arrays("log/seq_2", &swing, &vec![[0.3, 0.1]; 40]);
    let report = inspect(&scene, &LATTICE);
    let findings = report["paths"][0]["findings"].as_array().unwrap();
    let beside = findings.iter().find(|finding| finding["code"] == "no_contact").unwrap();
    assert_eq!(beside["touches"], serde_json::json!(["seq_2"]));
    assert!(!codes(&report).contains(&"never_moves"), "{:?}", codes(&report));
}
