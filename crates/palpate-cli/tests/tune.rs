//! `palpate tune`, seen from outside.

mod common;

use common::{Scene, printed, refuse, succeed};
use std::process::Command;

fn tune(scene: &Scene, logs: &[&str], more: &[&str]) -> Command {
    let mut command = scene.command("tune", logs);
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

    // The file can be read back, and used for mapping.
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
fn a_map_learns_with_quickly_tuned_settings_and_prints_them() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    let field = |logs: &[&str], flags: &[&str], expected: &str| {
        let (_, said) = printed(&mut scene.map(logs, flags));
        assert!(said.contains(expected), "{said}");
        std::fs::read(scene.path("out/field.npz")).unwrap()
    };
    let chosen = "chosen by cross-validation on 3 touches";
    let by_itself = field(&["log"], &[], chosen);
    field(&["log"], &[], " N/m, torque noise 0.");
    assert!(by_itself != field(&["log"], &["--tune=off"], ""), "nothing was chosen");

    let mut quick = scene.command("tune", &["log"]);
    succeed(quick.args(["--spacing-m", "0.03", "--quick", "-o"]).arg(scene.path("out/tuned.toml")));
    succeed(&mut scene.map(&["log"], &["--settings", &scene.text("out/tuned.toml")]));
    let again = std::fs::read(scene.path("out/field.npz")).unwrap();
    let calibration =
        |bytes: &[u8]| palpate_io::field::from_bytes(bytes, "field").unwrap().field.calibration;
    assert_eq!(calibration(&by_itself), calibration(&again));
    assert!(by_itself == again, "the two fields differ");

    // Two touches are too few to choose settings.
    let two = ["log/seq_0", "log/seq_1"];
    let defaults = field(&two, &[], "in which the arm touches something, and there are 2");
    assert!(defaults == field(&two, &["--tune=off"], ""), "something was chosen");
    let ekf = ["--tune=quick", "--estimator", "ekf"];
    refuse(&mut scene.map(&["log"], &ekf), 2, &["for the estimator `map`, not for `ekf`"]);
    refuse(&mut scene.map(&["log"], &["--tune=thorough"]), 2, &["wanted quick or off"]);
}

#[test]
fn given_settings_are_not_tuned() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 40, -0.2);
    let flags = [
        ["--contact-distance-m", "0.033"],
        ["--friction", "0.25"],
        ["--coulomb-friction", "0.1"],
        ["--prior-mean", "3"],
        ["--prior-std", "300"],
        ["--torque-std", "0.3"],
        ["--stiffness-scale", "0.75"],
    ];
    let of = |scene: &Scene| {
        palpate_io::field::load(&scene.path("out/field.npz")).unwrap().snapshot.unwrap().config
    };
    let given = |flag: usize| {
        succeed(&mut scene.map(&["log"], &flags[flag]));
        of(&scene)
    };
    assert_eq!(given(0).contact.contact_distance_m, 0.033);
    assert_eq!(given(1).contact.friction, 0.25);
    assert_eq!(given(2).contact.coulomb_friction, 0.1);
    assert_eq!(given(3).estimator.prior.mean_n_per_m, 3.0);
    assert_eq!(given(4).estimator.prior.std_n_per_m, 300.0);
    assert_eq!(given(5).estimator.torque_std, [0.3]);
    assert_eq!(given(6).estimator.stiffness_scale, 0.75);
    // With so small a scale no touch is predicted, but that is no reason to take its torque for noise.
    let (_, said) = printed(&mut scene.map(&["log"], &["--stiffness-scale", "0.01"]));
    let score = |score: &str| said.contains(&format!("(score {score})"));
    assert!(score("0.99") || score("1.00"), "{said}");
    assert!(!said.contains("counts as noise"), "{said}");
    let config = of(&scene);
    assert!(config.estimator.torque_std.iter().all(|std| *std < 1.0), "{config:?}");
    // With all given, the map is as if none were chosen.
    let all = flags.concat();
    succeed(&mut scene.map(&["log"], &all));
    let config = of(&scene);
    succeed(&mut scene.map(&["log"], &[&all[..], &["--tune=off"]].concat()));
    assert_eq!(config, of(&scene));
}
