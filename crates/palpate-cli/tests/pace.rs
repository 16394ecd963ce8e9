//! `--rate`: replays fill the time that steps leave.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::process::Command;

use common::{Scene, json, palpate, refuse, succeed};
use serde_json::Value;

/// How the pace was kept in a measurement of one touch.
fn pace(scene: &Scene, more: &[&str]) -> Value {
    let mut command = scene.command("bench", &["log/seq_0"]);
    let figures = json(command.args(["--spacing-m", "0.02", "--json"]).args(more));
    figures["pace"].clone()
}

#[test]
fn at_a_low_rate_there_are_more_replays_than_the_setting_asks_for() {
    let scene = Scene::new();
    let pace = pace(&scene, &["--rate", "20", "--replays", "1"]);
    assert_eq!(pace["rate_hz"], 20.0);
    let replays = pace["replays_median"].as_f64().unwrap();
    assert!(replays > 1.0, "{pace}"); // of the thousands for which there is time
}

#[test]
fn at_an_absurd_rate_deadlines_are_missed_and_counted() {
    let scene = Scene::new();
    let pace = pace(&scene, &["--rate", "100000"]);
    assert!(pace["missed"].as_u64().unwrap() > 0, "{pace}");
    assert!(pace["worst_overrun_ms"].as_f64().unwrap() > 0.0, "{pace}");
}

#[test]
fn ekf_never_replays_more_than_its_setting_allows() {
    let scene = Scene::new();
    let pace = pace(&scene, &["--rate", "20", "--estimator", "ekf", "--replays", "7"]);
    assert!(pace["replays_median"].as_f64().unwrap() <= 7.0, "{pace}");
}

#[test]
fn a_field_mapped_at_a_pace_says_so_and_keeps_its_setting_of_replays() {
    let scene = Scene::new();
    let text = succeed(&mut scene.map(&["log/seq_0"], &["--rate", "50", "--replays", "9"]));
    assert!(text.contains("50 Hz") && text.contains("depends on the speed"), "{text}");
    let replays = || {
        let saved = palpate_io::field::load(&scene.path("out/field.npz")).unwrap();
        saved.snapshot.unwrap().config.estimator.replays
    };
    assert_eq!(replays(), 9);

    let field = scene.text("out/field.npz");
    let on = |more: &[&str]| -> Command {
        let mut command = scene.map(&["log/seq_1"], &["--from", &field, "--json"]);
        command.args(more);
        command
    };
    let report = json(&mut on(&["--rate", "100"]));
    assert_eq!(report["pace"]["rate_hz"], 100.0);
    assert_eq!(replays(), 9);
    assert!(json(&mut on(&[]))["pace"].is_null());
    refuse(&mut on(&["--replays", "20", "--rate", "50"]), 2, &["replays is 9, not 20"]);
}

#[test]
fn a_rate_out_of_range_is_refused_with_what_was_found_and_wanted() {
    let scene = Scene::new();
    for rate in ["0", "-5", "0.09", "100001", "inf", "nan", "often", ""] {
        let words = ["--rate", rate, "from 0.1 to 100000 Hz"];
        refuse(&mut scene.map(&["log"], &["--rate", rate]), 2, &words);
        refuse(palpate().args(["bench", "--rate", rate]), 2, &words);
    }
    for rate in ["0.1", "1e5"] {
        refuse(palpate().args(["bench", "nowhere", "--rate", rate]), 1, &["nowhere"]);
    }
    assert!(scene.results().is_empty());
}
