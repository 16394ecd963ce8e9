//! `palpate tune`, seen from outside.

mod common;

use common::{Scene, palpate, refuse, succeed};
use std::process::Command;

fn tune(scene: &Scene, logs: &[&str], more: &[&str]) -> Command {
    let mut command = palpate();
    command.arg("tune").args(logs.iter().map(|log| scene.path(log))).args(scene.settings());
    command.args(["--spacing-m", "0.03", "--candidates", "4", "-o"]);
    command.arg(scene.path("out/tuned.toml")).args(more);
    command
}

#[test]
fn tuned_settings_are_a_settings_file_with_its_evidence() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    let text = succeed(&mut tune(&scene, &["log"], &[]));
    assert!(text.contains("given") && text.contains("round 3"), "{text}");

    let file = std::fs::read_to_string(scene.path("out/tuned.toml")).unwrap();
    assert!(file.contains("# Chosen by cross-validation"), "{file}");
    let settings: toml::Table = toml::from_str(&file).unwrap();
    let number = |section: &str, key: &str| settings[section][key].as_float().unwrap();
    assert!(number("contact", "contact_distance_m") > 0.0);
    assert!(number("estimator", "prior_std") > 0.0);

    // It is read back, and maps.
    let tuned = scene.text("out/tuned.toml");
    succeed(&mut scene.map(&["log"], &["--settings", &tuned]));
}

#[test]
fn the_same_touches_give_the_same_settings() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    let first = succeed(&mut tune(&scene, &["log"], &["--json"]));
    let second = succeed(&mut tune(&scene, &["log"], &["--json"]));
    assert_eq!(first, second);
    let evidence: serde_json::Value = serde_json::from_str(&first).unwrap();
    let trials = evidence["trials"].as_array().unwrap();
    let last: Vec<f64> = trials
        .iter()
        .filter(|trial| trial["scores"].as_array().unwrap().len() == 3)
        .map(|trial| trial["scores"][2].as_f64().unwrap())
        .collect();
    assert!(last.is_sorted() && !last.is_empty(), "{last:?}");
}

#[test]
fn too_few_touches_are_refused_and_nothing_is_written() {
    let scene = Scene::new();
    refuse(&mut tune(&scene, &["log"], &[]), 1, &["at least three touches", "hold 2"]);
    refuse(&mut tune(&scene, &["nowhere"], &[]), 1, &["nowhere"]);
    assert!(scene.results().is_empty());
}

#[test]
fn a_map_that_tunes_learns_what_a_quick_search_found_and_says_so() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    let chosen = scene.map(&["log"], &["--tune"]).output().unwrap();
    let told = String::from_utf8_lossy(&chosen.stderr).into_owned();
    assert!(
        chosen.status.success() && told.contains("tuned by cross-validation on 3 touches"),
        "{told}"
    );
    let field = || std::fs::read(scene.path("out/field.npz")).unwrap();
    let by_itself = field();

    let mut quick = palpate();
    quick.arg("tune").arg(scene.path("log")).args(scene.settings()).args(["--spacing-m", "0.03"]);
    succeed(quick.args(["--quick", "-o"]).arg(scene.path("out/tuned.toml")));
    succeed(&mut scene.map(&["log"], &["--settings", &scene.text("out/tuned.toml")]));
    assert!(by_itself == field(), "the two fields differ");

    let ekf = ["--tune", "--estimator", "ekf"];
    refuse(&mut scene.map(&["log"], &ekf), 2, &["for the estimator `map`, not for `ekf`"]);
    refuse(
        &mut scene.map(&["log/seq_0", "log/seq_1"], &["--tune"]),
        1,
        &["at least three touches"],
    );
}
