//! `palpate bench`: its figures are complete and consistent, and it times what was chosen.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::process::Command;

use common::{Scene, holds, json, palpate, refuse, succeed};
use serde_json::Value;

/// `palpate bench` of some logs, with settings that make it fast.
fn bench(scene: &Scene, logs: &[&str], more: &[&str]) -> Command {
    let mut command = scene.command("bench", logs);
    command.args(["--spacing-m", "0.03"]).args(more);
    command
}

fn number(figures: &Value, key: &str) -> f64 {
    let value = figures.pointer(&format!("/{}", key.replace('.', "/")));
    value.and_then(Value::as_f64).unwrap_or_else(|| panic!("{key} in {figures}"))
}

/// The keys of a measurement that are numbers above zero.
const NUMBERS: [&str; 20] = [
    "touches",
    "passes",
    "steps",
    "steps_per_second",
    "step_ms.median",
    "step_ms.p99",
    "simulator_ms",
    "update_ms",
    "contacts",
    "ns_per_visit",
    "cells_declared",
    "cells_touched",
    "spacing_m",
    "frames_remembered",
    "memory_mib",
    "start_ms",
    "threads",
    "shape.0",
    "shape.1",
    "shape.2",
];

/// Checks everything that is true of any measurement.
#[track_caller]
fn check(figures: &Value) {
    for key in NUMBERS {
        let value = number(figures, key);
        assert!(value > 0.0 && value.is_finite(), "{key} is {value}");
    }
    assert!(number(figures, "step_ms.p99") >= number(figures, "step_ms.median"));
    assert!(number(figures, "cells_touched") <= number(figures, "cells_declared"));
    assert!(figures["pace"].is_null());

    if cfg!(target_os = "linux") {
        let peak = number(figures, "peak_memory_mib");
        assert!(peak > number(figures, "memory_mib") && peak < 200.0, "{peak} MiB");
    }
}

#[test]
fn all_figures_are_printed_and_agree_with_each_other() {
    let scene = Scene::new();
    for estimator in ["map", "ekf"] {
        let figures = json(&mut bench(&scene, &["log"], &["--json", "--estimator", estimator]));
        check(&figures);
        assert_eq!(figures["estimator"], estimator);
        assert_eq!(figures["robot"], "tiny");
        assert_eq!(figures["simulated"], false);
        assert_eq!(figures["shape"], serde_json::json!([80, 80, 80]));
        assert_eq!((number(&figures, "touches"), number(&figures, "warm_passes")), (2.0, 1.0));
    }
}

#[test]
fn passes_and_touches_choose_what_is_learnt_and_timed() {
    let scene = Scene::new();
    let of = |more: &[&str]| json(bench(&scene, &["log"], &["--json"]).args(more));
    let plain = of(&[]);
    let thrice = of(&["--passes", "3"]);
    assert_eq!(number(&thrice, "steps"), 3.0 * number(&plain, "steps"));
    let cold = of(&["--warm-passes", "0"]);
    assert_eq!(number(&cold, "steps"), number(&plain, "steps"));
    assert_eq!(2.0 * number(&cold, "frames_remembered"), number(&plain, "frames_remembered"));
    let first = of(&["--touches", "1"]);
    assert_eq!(number(&first, "touches"), 1.0);
    assert!(number(&first, "steps") < number(&plain, "steps"));
    let all = of(&["--touches", "99"]);
    assert_eq!(number(&all, "steps"), number(&plain, "steps"));
}

#[test]
fn answers_about_paths_are_timed_and_compared_with_exact_ones() {
    let scene = Scene::new();
    assert!(json(&mut bench(&scene, &["log"], &["--json"]))["answers"].is_null());
    let log = scene.path("log");
    let mut asked = bench(&scene, &["log"], &["--touches", "1"]);
    asked.arg("--answers").arg(&log);
    let text = succeed(&mut asked);
    let words = ["paths of 200 points: 2 whole", "their 2 pushes", "prediction of a push", "std"];
    holds(&text, &words);
    let answers = &json(asked.arg("--json"))["answers"];
    for kind in ["whole", "push"] {
        let asked = &answers[kind];
        assert_eq!(number(asked, "paths"), 2.0);
        for key in ["coarse_ms", "exact_ms", "torque_off", "std_off", "rss_off"] {
            let of = |name: &str| number(asked, &format!("{key}.{name}"));
            assert!(0.0 < of("least") && of("least") <= of("median"), "{kind}, {key}: {answers}");
            assert!(
                of("median") <= of("most") && of("most").is_finite(),
                "{kind}, {key}: {answers}"
            );
        }
        assert!(number(asked, "torque_off.most") < 0.5, "{answers}");
    }
    assert!(number(answers, "handover_ms.least") > 0.0, "{answers}");
    let nowhere = scene.path("nowhere");
    refuse(bench(&scene, &["log"], &[]).arg("--answers").arg(nowhere), 1, &["nowhere"]);
}

#[test]
fn without_a_log_the_bundled_touches_are_learnt_and_called_simulated() {
    let bundled = |more: &[&str]| {
        let mut command = palpate();
        command.env("PALPATE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"));
        command.args(["bench", "--touches", "1", "--spacing-m", "0.03"]).args(more);
        command
    };
    let figures = json(&mut bundled(&["--json"]));
    check(&figures);
    assert_eq!((&figures["simulated"], number(&figures, "touches")), (&Value::Bool(true), 1.0));
    let of_step = ["steps a second", "a visit of one contact", "peak memory", "tare is known"];
    holds(&succeed(&mut bundled(&[])), &[&["simulated"], &of_step[..]].concat());
}

#[test]
fn what_cannot_be_measured_is_refused_with_a_remedy() {
    let scene = Scene::new();
    let far = ["--box-low-m", "5,5,5", "--box-high-m", "6,6,6"];
    let words = ["nothing to time", "2 touches", "log`", "--box-low-m", "palpate inspect"];
    refuse(&mut bench(&scene, &["log"], &far), 1, &words);
    refuse(&mut bench(&scene, &["out"], &[]), 1, &["out"]);
    refuse(&mut bench(&scene, &["nowhere"], &[]), 1, &["nowhere"]);
    refuse(&mut bench(&scene, &["log"], &["--passes", "0"]), 2, &["--passes", "'0'"]);
    refuse(&mut bench(&scene, &["log"], &["--touches", "0"]), 2, &["--touches", "'0'"]);
    scene.arrays("bad", &[[0.0, f64::NAN]; 9], &[[0.0; 2]; 9]);
    refuse(&mut bench(&scene, &["bad"], &[]), 1, &["bad"]);
}
