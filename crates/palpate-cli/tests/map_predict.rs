//! `palpate map` and `predict`: their results for programs, and mapping in several runs.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;

use common::{Scene, holds, json, npy, palpate, printed, refuse, succeed};
use palpate_io::field::{SavedField, load};
use serde_json::Value;

fn field(scene: &Scene, name: &str) -> SavedField {
    load(&scene.path(name)).unwrap()
}

/// The four figures are there, as numbers or null.
#[track_caller]
fn assert_figures(figures: &Value) {
    for key in ["avg_error", "max_error", "avg_relative", "max_relative"] {
        let figure = figures.get(key).unwrap_or_else(|| panic!("no {key} in {figures}"));
        assert!(figure.is_f64() || figure.is_null(), "{key}: {figure}");
    }
}

#[test]
fn predict_prints_the_keys_that_programs_rely_on() {
    let scene = Scene::new();
    let summary = json(&mut scene.map(&["log/seq_0"], &["--json"]));
    assert_eq!((&summary["frames"], &summary["touches"][0]["name"]), (&40.into(), &"seq_0".into()));
    assert!(summary["cells_touched"].as_u64().unwrap() > 10, "{summary}");

    let report = json(&mut scene.predict(&["log"], &["--json"]));
    let touches = report["touches"].as_array().unwrap();
    assert_eq!(touches.len(), 2);
    for row in touches.iter().chain([&report["overall"]]) {
        assert_figures(row);
        assert_figures(&row["zero"]);
        let frames = |key: &str| row[key].as_u64().unwrap();
        assert_eq!(frames("frames") + frames("tare_frames"), frames("frames_in_log"));
    }
    assert_eq!(report["against"], "measured");
    let sum: u64 = touches.iter().map(|row| row["frames"].as_u64().unwrap()).sum();
    assert_eq!(report["overall"]["frames"], sum);
    let learnt = &touches[0];
    assert!(learnt["avg_error"].as_f64() < learnt["zero"]["avg_error"].as_f64(), "{learnt}");
    let are_learnt = |row: &Value| row["learnt"].as_bool();
    assert_eq!(
        [&touches[0], &touches[1], &report["overall"]].map(are_learnt),
        [true, false, true].map(Some)
    );
}

#[test]
fn predicting_a_learnt_touch_warns() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log/seq_0"], &[]));
    let said = |log: &str| printed(&mut scene.predict(&[log], &[])).1;
    holds(&said("log"), &["warning: ", "has learned these touches", ": `seq_0` (#0 seq_0)"]);
    assert!(!said("log/seq_1").contains("has learned"));
}

#[test]
fn a_relative_error_is_null_where_no_frame_reaches_a_newton_metre() {
    let scene = Scene::new();
    let angles: Vec<[f64; 2]> = (0..40).map(|t| [0.01 * f64::from((t - 8).max(0)), 0.0]).collect();
    scene.arrays("weak", &angles, &[[0.0; 2]; 40]);
    succeed(&mut scene.map(&["weak"], &[]));
    let report = json(&mut scene.predict(&["weak"], &["--json"]));
    assert!(report["overall"]["avg_error"].is_f64() && report["overall"]["avg_relative"].is_null());
}

#[test]
fn mapping_in_two_halves_equals_mapping_at_once_with_a_prior_too() {
    let scene = Scene::new();
    let [prior, once, half, both] =
        ["prior", "once", "half", "both"].map(|name| scene.text(&format!("{name}.npz")));
    succeed(&mut scene.map(&["log/seq_1"], &["-o", &prior]));
    let expected = field(&scene, "prior.npz").field.cells.len();
    let priors = [(&[][..], 0), (&["--prior", &prior][..], expected)];
    for (estimator, (prior, expected)) in
        ["map", "ekf"].into_iter().flat_map(|estimator| priors.map(|prior| (estimator, prior)))
    {
        let with = [&["--estimator", estimator][..], prior].concat();
        succeed(&mut scene.map(&["log"], &[&with[..], &["-o", &once]].concat()));
        succeed(&mut scene.map(&["log/seq_0"], &[&with[..], &["-o", &half]].concat()));
        let go_on = ["--from", &half, "-o", &both, "--json"];
        let mapped = json(&mut scene.map(&["log/seq_1"], &go_on));
        assert_eq!(mapped["cells_expected"], expected, "{estimator}");
        let (once, both) = (field(&scene, "once.npz"), field(&scene, "both.npz"));
        let bits = |saved: &SavedField| -> Vec<u64> {
            saved.field.stiffness_n_per_m.iter().map(|k| k.to_bits()).collect()
        };
        assert_eq!(bits(&once), bits(&both), "{estimator}");
        assert_eq!((&once.field, &once.prior_n_per_m), (&both.field, &both.prior_n_per_m));
    }
}

#[test]
fn going_on_under_other_settings_or_without_memory_is_refused() {
    let scene = Scene::new();
    let saved = scene.text("out/field.npz");
    succeed(&mut scene.map(&["log/seq_0"], &[]));
    let contradictions: [(&[&str], &str); 4] = [
        (&["--friction", "0.9"], "friction is 0.3, not 0.9"),
        (&["--estimator", "ekf"], "estimator is map, not ekf"),
        (&["--box-high-m", "1,1,1"], "lattice"),
        (&["--replays", "3"], "replays"),
    ];
    for (setting, words) in contradictions {
        let mut command = scene.map(&["log/seq_1"], &["--from", &saved]);
        refuse(command.args(setting), 2, &["contradict", words]);
    }
    succeed(&mut scene.map(&["log/seq_0"], &["--no-memory"]));
    refuse(&mut scene.map(&["log/seq_1"], &["--from", &saved]), 1, &["--no-memory"]);
    succeed(&mut scene.predict(&["log"], &[]));
}

#[test]
fn going_on_with_another_robot_is_refused() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log/seq_0"], &[]));
    let heavier = common::URDF.replacen(r#"<mass value="1"/>"#, r#"<mass value="2"/>"#, 1);
    fs::write(scene.path("tiny.urdf"), heavier).unwrap();
    let saved = scene.text("out/field.npz");
    refuse(&mut scene.map(&["log/seq_1"], &["--from", &saved]), 1, &["same robot"]);
}

#[test]
fn truth_is_scored_against_only_when_asked_for() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    fs::create_dir(scene.path("log/truth")).unwrap();
    for touch in ["seq_0", "seq_1"] {
        let path = scene.path(&format!("log/truth/{touch}_external.npy"));
        npy(&path, &[40, 2], &[5.0; 80]);
    }
    let largest = |more: &[&str]| {
        let report = json(&mut scene.predict(&["log"], &[&["--json"], more].concat()));
        report["overall"]["zero"]["max_error"].as_f64().unwrap()
    };
    assert!((largest(&["--truth"]) - 50_f64.sqrt()).abs() < 1e-12);
    assert!((largest(&[]) - 50_f64.sqrt()).abs() > 0.1);
}

#[test]
fn torques_and_pictures_are_written_where_asked() {
    let scene = Scene::new();
    let [field, torques] = ["out/field.svg", "out/torques.svg"].map(|name| scene.text(name));
    succeed(&mut scene.map(&["log"], &["--picture", &field]));
    let csv = scene.text("out/torques.csv");
    succeed(&mut scene.predict(&["log"], &["-o", &csv, "--picture", &torques]));
    let npz = scene.text("out/torques.npz");
    succeed(&mut scene.predict(&["log", "log/seq_1"], &["-o", &npz]));

    let text = fs::read_to_string(csv).unwrap();
    assert!(text.starts_with("log,touch,frame,time_s,contacts,predicted_1,predicted_2,external_1"));
    let arrays = palpate_io::field::npz::read_npz(npz.as_ref()).unwrap();
    let rows = arrays.floats("seq_0/predicted", &[None, Some(2)]).unwrap().len() / 2;
    assert_eq!(text.lines().filter(|line| line.contains(",seq_0,")).count(), rows);
    assert!(arrays.get("seq_1#2/external").is_some(), "a second touch of the same name");
    for picture in [&field, &torques] {
        assert!(fs::read_to_string(picture).unwrap().starts_with("<svg"));
    }
    // The band of each of the two joints, in each of the two touches.
    let drawn = fs::read_to_string(torques).unwrap();
    assert!(drawn.contains("90 % band of a joint"));
    assert_eq!(drawn.matches("<polygon opacity=\"0.2\"").count(), 4);
}

#[test]
fn with_few_touches_bands_are_those_of_other_objects_and_misfits_are_kept() {
    let scene = Scene::new();
    scene.touch("log/seq_2", 50, 0.3);
    scene.touch("log/seq_3", 50, 0.2);
    succeed(&mut scene.map(&["log/seq_0"], &["-o", &scene.text("out/few.npz")]));
    let few = field(&scene, "out/few.npz").field;
    let few = few.calibration.unwrap();
    assert_eq!((few.touches, few.of_other_objects, few.misfits.len()), (1, true, 0));

    let text = succeed(&mut scene.map(&["log"], &[]));
    assert!(text.contains("up to 95 %, calibrated on other objects"), "{text}");
    let own = field(&scene, "out/field.npz").field.calibration.unwrap();
    assert_eq!((own.touches, own.of_other_objects, own.misfits.len()), (4, true, 4));

    let torques = scene.text("out/torques.csv");
    let report = json(&mut scene.predict(&["log/seq_3"], &["--json", "-o", &torques]));
    let bands = &report["bands"];
    assert_eq!(bands["level"], 0.9);
    let share = |key: &str| bands[key].as_f64().unwrap();
    // High, since the touch was also learnt.
    assert!(share("torque_share") > 0.8 && share("half_width_n_m") > 0.0, "{bands}");
    let table = fs::read_to_string(&torques).unwrap();
    assert!(table.lines().next().unwrap().ends_with(",half_width_1,half_width_2"), "{table}");
    let width: f64 = table.lines().last().unwrap().rsplit(',').next().unwrap().parse().unwrap();
    assert!(width >= own.at(0.9).unwrap().frame * own.floor_n_m[1] - 1e-6, "{width}");

    let saved = scene.text("out/field.npz");
    succeed(&mut scene.map(&["log/seq_1"], &["--from", &saved]));
    let again = field(&scene, "out/field.npz").field.calibration.unwrap();
    assert_eq!((again.touches, &again.misfits), (5, &own.misfits));
}

#[test]
fn the_ending_of_a_picture_decides_its_format() {
    let scene = Scene::new();
    let [field, torques] = ["out/field.png", "out/torques.PNG"].map(|name| scene.text(name));
    refuse(&mut scene.map(&["log"], &["--picture", "field.jpg"]), 2, &["jpg", ".svg", ".png"]);
    assert!(common::names(&scene.path("out")).is_empty(), "refused before any work");
    succeed(&mut scene.map(&["log"], &["--picture", &field]));
    succeed(&mut scene.predict(&["log"], &["--picture", &torques]));
    for picture in [field, torques] {
        assert!(fs::read(picture).unwrap().starts_with(b"\x89PNG"));
    }
    refuse(&mut scene.predict(&["log"], &["--picture", "torques"]), 2, &[".svg", ".png"]);
}

#[test]
fn a_touch_that_meets_no_known_point_is_noted() {
    let scene = Scene::new();
    let away = ["--box-low-m", "5,5,5", "--box-high-m", "6,6,6"];
    let (_, said) = printed(&mut scene.map(&["log"], &away));
    assert!(said.contains("0 of 80 frames touch the lattice"), "{said}");
    let (_, said) = printed(&mut scene.predict(&["log"], &[]));
    assert!(said.contains("no touch reaches a cell that is in the field"), "{said}");
}

#[test]
fn the_demo_beats_predicting_zero_and_leaves_its_results() {
    let quick =
        ["errors.csv", "evaluation.json", "field.npz", "field.svg", "figures", "report.html"];
    demo_is_better(&[], &["uniform", "knn", "zero"], &[&quick[..], &["torques.svg"]].concat());
}

#[test]
#[ignore = "takes two and a half minutes; `.ci/run --all` runs it"]
fn the_full_demo_compares_all_methods_and_extrapolates() {
    let mut results = vec!["errors.csv", "evaluation.json", "field.npz", "field.svg", "fig4.svg"];
    results.extend(["figures", "report.html", "seen.html", "seen.ply", "torques.svg"]);
    // The default prior as flags, so that only a sixth of the candidate settings remains.
    let flags = ["--full", "--prior-mean", "0", "--prior-std", "0.76"];
    demo_is_better(&flags, &["uniform", "gp", "zero"], &results);
}

fn demo_is_better(flags: &[&str], others: &[&str], results: &[&str]) {
    let scene = Scene::new();
    let folder = scene.text("demo");
    let mut demo = palpate();
    demo.args(["demo", "--json", "--replays", "2", "-o", &folder]).args(flags);
    let report = json(&mut demo);
    assert_eq!(report["simulated"], true);
    assert_eq!(report["held_out"][0], "seq_010");
    let overall = &report["overall"];
    assert!(overall["avg_error"].as_f64() < overall["zero"]["avg_error"].as_f64(), "{overall}");
    let evaluation = report["evaluation"]["methods"].as_array().unwrap();
    let error = |name: &str| {
        let method = evaluation.iter().find(|method| method["name"] == name).unwrap();
        method["avg_error"]["mean"].as_f64().unwrap()
    };
    for other in others {
        assert!(error("map") < error(other), "{other}: {evaluation:?}");
    }
    assert_eq!(common::names(&scene.path("demo")), results);
}

#[test]
fn the_demo_without_its_report_is_a_field_and_two_pictures() {
    let scene = Scene::new();
    let folder = scene.text("demo");
    let more = ["demo", "--json", "--replays", "2", "--no-report", "-o", &folder];
    let report = json(palpate().args(more));
    assert!(report.get("evaluation").is_none());
    assert_eq!(common::names(&scene.path("demo")), ["field.npz", "field.svg", "torques.svg"]);
}

#[test]
fn going_on_with_the_settings_that_made_the_field_works_for_any_box() {
    let scene = Scene::new();
    let out = scene.text("out/s.npz");
    let file = scene.text("s.toml");
    let map = |log: &str, more: &[&str]| {
        let mut map = scene.command("map", &[log]);
        map.args(["-o", &out, "--settings", &file]).args(more);
        map
    };
    let boxes = [
        "spacing_m = 0.034",
        "spacing_m = 0.034\nbox_low_m = [-1.0, -1.0, -1.0]",
        "spacing_m = 0.034\nbox_high_m = [1.0, 1.0, 1.0]",
        "spacing_m = 0.034\nbox_low_m = [-1.0, -1.0, -1.0]\nbox_high_m = [0.9, 0.8, 0.77]",
        "spacing_m = 0.034\norigin_m = [-1.0, -1.0, -1.0]\nshape = [60, 60, 60]",
    ];
    for lattice in boxes {
        fs::write(&file, format!("[lattice]\n{lattice}\n")).unwrap();
        succeed(&mut map("log/seq_0", &[]));
        let made = field(&scene, "out/s.npz").field.lattice;
        succeed(&mut map("log/seq_1", &["--from", &out]));
        assert_eq!(field(&scene, "out/s.npz").field.lattice, made, "{lattice}");
    }
    fs::write(&file, "[lattice]\nbox_low_m = [-1.0, -1.0, -1.1]\n").unwrap();
    refuse(&mut map("log/seq_1", &["--from", &out]), 2, &["contradict", "lattice"]);
}

#[test]
fn a_fine_field_goes_on_without_its_box() {
    let scene = Scene::new();
    let out = scene.text("out/fine.npz");
    let map = |log: &str, more: &[&str]| {
        let mut map = scene.command("map", &[log]);
        map.args(["-o", &out, "--spacing-m", "0.001"]).args(more);
        map
    };
    // Above the arm, where nothing is touched, so that many points cost nothing.
    let small = ["--box-low-m", "0.6,0.1,0.3", "--box-high-m", "0.8,0.3,0.5"];
    succeed(&mut map("log/seq_0", &small));
    succeed(&mut map("log/seq_1", &["--from", &out]));
}

#[test]
fn degrees_are_refused_for_a_robot_that_slides() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    let slide = r#"name="elbow" type="prismatic""#;
    let urdf = common::URDF.replace(r#"name="elbow" type="continuous""#, slide).replace(
        "<origin xyz=\"0.4 0 0\"/>",
        "<origin xyz=\"0.4 0 0\"/><limit lower=\"-1\" upper=\"1\" effort=\"9\" velocity=\"1\"/>",
    );
    fs::write(scene.path("tiny.urdf"), urdf).unwrap();
    let degrees = ["--angle-unit", "deg"];
    let words = ["elbow", "prismatic", "radians"];
    refuse(&mut scene.map(&["log"], &degrees), 2, &words);
    refuse(&mut scene.predict(&["log"], &degrees), 2, &words);
    let mut inspect = scene.command("inspect", &["log"]);
    let text = common::stdout(&inspect.args(degrees).output().unwrap());
    assert!(text.contains("prismatic"), "{text}");
}
