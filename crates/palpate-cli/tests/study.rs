//! `palpate study`, seen from outside.

mod common;

use common::{Scene, json, refuse, succeed};
use std::process::Command;

fn study(scene: &Scene, objects: &[&str], more: &[&str]) -> Command {
    let mut command = scene.command("study", objects);
    command.args(["--spacing-m", "0.03"]).args(more);
    command
}

fn two_objects() -> Scene {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    scene.touch("other/seq_0", 40, 0.3);
    scene.touch("other/seq_1", 50, 0.1);
    scene
}

#[test]
fn a_study_finds_what_an_evaluation_of_each_object_finds() {
    let scene = two_objects();
    let grid = ["--frictions", "0.1,0.3,0.1", "--distances-m", "0.02", "--curve", "--json"];
    let found = json(&mut study(&scene, &["log", "other"], &grid));
    let settings = found["settings"].as_array().unwrap();
    assert_eq!(settings.len(), 3, "the given ones and two more: {settings:?}");
    for (name, object) in ["log", "other"].iter().zip(found["objects"].as_array().unwrap()) {
        assert_eq!(object["name"], *name);
        for (number, of_study) in object["avg_relative"].as_array().unwrap().iter().enumerate() {
            let contact = &settings[number]["contact"];
            let [friction, distance] = ["friction", "contact_distance_m"]
                .map(|key| contact[key].as_f64().unwrap().to_string());
            let mut evaluate = scene.command("evaluate", &[name]);
            evaluate.args(["--spacing-m", "0.03", "--methods", "map", "--json"]);
            evaluate.args(["--friction", &friction, "--contact-distance-m", &distance, "-o"]);
            let evaluation = json(evaluate.arg(scene.path(&format!("out/{name}{number}"))));
            let relative = evaluation["methods"][0]["avg_relative"]["mean"].as_f64().unwrap();
            assert!(
                (of_study.as_f64().unwrap() / relative - 1.0).abs() < 1e-12,
                "{of_study} {relative}"
            );
        }
    }
    // With two touches, one learnt is leave-one-touch-out.
    let other = &found["objects"][1];
    let curve = &other["by_touches_learnt"];
    assert_eq!(curve[0][0], 1);
    assert_eq!(curve[0][1], other["avg_relative"][0]);
}

#[test]
fn the_table_has_a_row_for_what_was_chosen_on_the_others() {
    let scene = two_objects();
    let text =
        succeed(&mut study(&scene, &["log", "other"], &["--frictions", "0.1", "--every", "2"]));
    let rows = ["log", "other", "best of each", "chosen on the others", "worst touch"];
    assert!(rows.iter().all(|row| text.contains(row)), "{text}");
    assert!(!text.contains("touches learnt"), "{text}");
    let by_joint = ["--torque-std", "0.2,0.1"];
    let text = succeed(&mut study(&scene, &["log"], &by_joint));
    assert!(text.contains("noise 0.150 N·m") && !text.contains("best of each"), "{text}");
}

#[test]
fn settings_that_map_chooses_are_studied_as_evaluated() {
    let scene = Scene::new();
    for (number, turn) in [-0.2, -0.1, 0.0, 0.1].into_iter().enumerate() {
        scene.touch(&format!("four/seq_{number}"), 60, turn);
    }
    let mut evaluate = scene.command("evaluate", &["four"]);
    evaluate.args(["--spacing-m", "0.03", "--methods", "map", "--json", "-o"]);
    let evaluation = json(evaluate.arg(scene.path("out/evaluation")));
    let relative = &evaluation["methods"][0]["avg_relative"]["mean"];
    let found = json(&mut study(&scene, &["four"], &["--json"]));
    let object = &found["objects"][0];
    assert_eq!(&object["chosen_by_map"]["avg_relative"], relative);
    assert_ne!(object["avg_relative"][0], *relative, "the given settings were chosen");
    // Every touch pushes the same object the same way.
    let touch = &object["chosen_by_map"]["touches"][1];
    assert!(touch["same_direction"].is_f64() && touch["other_direction"].is_null(), "{touch}");
    let text = succeed(&mut study(&scene, &["four"], &[]));
    let parts = ["chosen by map", "By frames, under the settings that map chooses", "same way"];
    assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    let text = succeed(&mut study(&scene, &["four"], &["--tune=off"]));
    assert!(!text.contains("chosen by map"), "{text}");
    let text = succeed(&mut study(&scene, &["four"], &["--estimator", "ekf"]));
    assert!(!text.contains("chosen by map"), "{text}");
    let both = ["--tune", "--estimator", "ekf"];
    refuse(&mut study(&scene, &["four"], &both), 2, &["for the estimator `map`", "--tune"]);
}

#[test]
fn what_cannot_be_studied_is_refused() {
    let scene = two_objects();
    scene.touch("single/seq_0", 40, 0.0);
    refuse(&mut study(&scene, &["log", "single"], &[]), 1, &["single", "1 touch", "at least two"]);
    refuse(
        &mut study(&scene, &["log"], &["--distances-m", "0.02,0.5"]),
        2,
        &["contact_distance_m", "0.5"],
    );
    refuse(&mut study(&scene, &["log"], &["--prior-stds=-1"]), 2, &["prior", "-1"]);
    refuse(&mut study(&scene, &["log", "nowhere"], &[]), 1, &["nowhere"]);
    refuse(&mut study(&scene, &["log", "other", "log"], &[]), 2, &["log", "twice"]);
    refuse(&mut study(&scene, &["log"], &["--truth"]), 1, &["truth"]);
}
