//! A field with a body that bends: `map`, `predict` and `evaluate` agree, and mapping can continue.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::{Scene, json, palpate, plant, refuse, samples, succeed, write_touch};
use palpate_io::field::load;
use serde_json::Value;

fn bundled(file: &str) -> String {
    plant().join(file).to_str().unwrap().to_owned()
}

/// The first samples of a bundled touch: its still start and the approach.
fn beginning(scene: &Scene, touch: &str, count: usize) -> String {
    let name = format!("log/{touch}");
    write_touch(&scene.path(&name), &samples(&plant().join(touch))[..count]);
    scene.text(&name)
}

#[test]
fn a_field_with_a_body_predicts_as_evaluate_does_and_continues_as_if_learnt_at_once() {
    let scene = Scene::new();
    let [a, b, c] = ["seq_000", "seq_001", "seq_002"].map(|name| beginning(&scene, name, 220));
    let cloud = bundled("object.ply");
    let map = |logs: &[&str], more: &[&str], to: &str| {
        let mut command = palpate();
        command.arg("map").args(logs).args(["--replays", "3", "-o", &scene.text(to)]).args(more);
        command
    };
    let with = ["--estimator", "elastic", "--cloud", &cloud];
    succeed(&mut map(&[&a, &b], &with, "once.npz"));
    succeed(&mut map(&[&a], &with[2..], "half.npz"));
    let mut on = palpate();
    on.args(["map", &b, "--from", &scene.text("half.npz"), "-o", &scene.text("both.npz")]);
    let summary = json(on.arg("--json"));
    assert_eq!(summary["estimator"], "elastic");
    assert!(summary["elastic"]["share"].as_f64().unwrap() > 0.1, "{summary}");
    assert_eq!(summary["bands"]["of_other_objects"], true, "{summary}");
    let [once, both] = ["once.npz", "both.npz"].map(|name| load(&scene.path(name)).unwrap());
    assert!(once.field.elastic.is_some());
    assert_eq!(once.field, both.field, "the two must agree to the bit");
    assert_eq!(once.elastic_touches, both.elastic_touches);

    let mut command = palpate();
    command.args(["evaluate", &a, &b, &c, "--methods", "elastic,map,zero", "--cloud", &cloud]);
    command.args(["--test", "seq_002", "--replays", "3", "--json", "-o", &scene.text("e")]);
    let evaluated = json(&mut command);
    let error = |method: usize, figure: &str| {
        evaluated["methods"][method][figure]["mean"].as_f64().unwrap()
    };
    let [elastic, zero] = [0, 2].map(|method| error(method, "avg_relative"));
    assert!(elastic < 0.95 * zero, "{elastic} beside zero's {zero}");
    let mut command = palpate();
    let predicted = json(command.args(["predict", &scene.text("once.npz"), &c, "--json"]));
    let predicted = predicted["overall"]["avg_error"].as_f64().unwrap();
    let wanted = error(0, "avg_error");
    assert!((predicted / wanted - 1.0).abs() < 1e-6, "{predicted}, evaluate says {wanted}");

    // `next` judges a motion by the torques of the body too.
    let next = |limit: &str| {
        let mut command = palpate();
        command.args(["next", &scene.text("once.npz"), "--candidates", &c, "--limit", limit]);
        json(command.arg("--json"))
    };
    let allowed = next("1000")["proposals"][0].clone();
    let of = |name: &str| allowed[name].as_f64().unwrap();
    let torques = scene.text("torques.csv");
    succeed(palpate().args(["predict", &scene.text("once.npz"), &c, "-o", &torques]));
    let most = largest_prediction(&torques);
    assert!((of("torque_n_m") / most - 1.0).abs() < 1e-5, "{allowed}, predicted {most}");
    assert!(of("with_band_n_m") > of("torque_n_m"), "{allowed}");
    let refused = next(&format!("{}", 0.99 * of("with_band_n_m")));
    assert_eq!(refused["proposals"].as_array().unwrap().len(), 0, "{refused}");
    let wanted = of("with_band_n_m");
    assert_eq!(refused["beyond_limit"][0]["with_band_n_m"].as_f64().unwrap(), wanted);

    // Extrapolated stiffness is not what the bands were calibrated with.
    let (filled, on) = (scene.text("filled.npz"), scene.text("on.npz"));
    let (mut extrapolate, mut map) = (palpate(), palpate());
    extrapolate.args(["extrapolate", &scene.text("once.npz"), &cloud, "--method", "cells"]);
    succeed(extrapolate.args(["-o", &scene.text("cloud.ply"), "--field", &filled]));
    let summary = json(map.args(["map", "--from", &filled, "-o", &on, "--json"]));
    assert!(summary["bands"].is_null(), "{summary}");
    assert!(load(&scene.path("on.npz")).unwrap().field.bands().is_none());
}

/// The largest predicted torque of a joint in a table of `palpate predict`, N·m.
fn largest_prediction(path: &str) -> f64 {
    let table = std::fs::read_to_string(path).unwrap();
    let mut rows = table.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let header = rows.next().unwrap();
    let is_predicted = |column: &usize| header[*column].starts_with("predicted_");
    let columns: Vec<usize> = (0..header.len()).filter(is_predicted).collect();
    assert_eq!(columns.len(), 7, "{header:?}");
    let torques = rows.flat_map(|row| {
        columns.iter().map(|column| row[*column].parse::<f64>().unwrap().abs()).collect::<Vec<_>>()
    });
    torques.fold(0.0, f64::max)
}

#[test]
fn without_a_touch_a_body_has_a_typical_stiffness_and_predicts_better_than_zero() {
    let scene = Scene::new();
    let field = scene.text("field.npz");
    let mut command = palpate();
    succeed(command.args(["map", "--cloud", &bundled("object.ply"), "-o", &field]));
    assert!(load(&scene.path("field.npz")).unwrap().field.elastic.unwrap().share == 1.0);
    let touch = beginning(&scene, "seq_001", 220);
    // Without a touch there are no bands, and no way to keep to a limit.
    let mut next = palpate();
    next.args(["next", &field, "--candidates", &touch, "--limit", "5"]);
    refuse(&mut next, 2, &["elastic body", "no bands"]);
    let mut command = palpate();
    let report = json(command.args(["predict", &field, &touch, "--json"]));
    let [error, zero] = [&report["overall"], &report["overall"]["zero"]]
        .map(|f| f["avg_relative"].as_f64().unwrap());
    assert!(error < 0.95 * zero, "{error} beside zero's {zero}");
}

#[test]
fn a_plant_of_several_pictures_is_held_at_its_root() {
    let scene = Scene::new();
    let (field, body) = (scene.text("field.npz"), scene.text("body.json"));
    let (cloud, root) = (bundled("object.ply"), [0.55, 0.0, 0.1]);
    let mut map = palpate();
    map.args(["map", "--cloud", &cloud, "--cloud", &bundled("rgbd"), "--root", "0.55,0,0.1"]);
    map.args(["--crop-low-m=0.2,-0.4,0.02", "--crop-high-m=1,0.4,1"]);
    succeed(map.args(["-o", &field]));
    succeed(palpate().args(["convert", &field, "-o", &body]));
    let body: Value = serde_json::from_slice(&std::fs::read(&body).unwrap()).unwrap();
    let rooted = body["segments"].as_array().unwrap().iter().filter(|s| s["parent"].is_null());
    let starts: Vec<&Value> = rooted.map(|segment| &segment["start_m"]).collect();
    assert_eq!(starts, [&serde_json::json!(root)]);

    let usage = |with: &[&str], words: &[&str]| {
        refuse(palpate().args(["map", "-o", &field]).args(with), 2, words);
    };
    usage(&["--root", "0,0,0"], &["--cloud"]);
    usage(&["--cloud", &cloud, "--root", "0,0,nan"], &["--root", "finite"]);
    usage(&["--cloud", &cloud, "--root", "550,0,100"], &["root 550,0,100", "m from the nearest"]);
    let of_cushion = ["--cloud", &cloud, "--object-kind", "cushion", "--root", "0.55,0,0.1"];
    usage(&of_cushion, &["root", "cushion"]);
    let two_cameras = ["--cloud", &cloud, "--cloud", &cloud, "--camera-pose", "0 0 0 0 0 0 1"];
    usage(&two_cameras, &["--camera", "several"]);
}

#[test]
fn elastic_without_a_body_and_a_cloud_that_is_not_used_are_refused() {
    let scene = Scene::new();
    let cloud = bundled("object.ply");
    let words = ["elastic", "--cloud"];
    let mut evaluate = palpate();
    let (log, out) = (scene.text("log"), scene.text("out/e"));
    refuse(evaluate.args(["evaluate", &log, "--methods", "elastic,zero", "-o", &out]), 2, &words);
    assert!(scene.results().is_empty(), "{:?}", scene.results());
    refuse(&mut scene.map(&["log"], &["--estimator", "elastic"]), 2, &words);
    let with_ekf = ["--estimator", "ekf", "--cloud", &cloud];
    refuse(&mut scene.map(&["log"], &with_ekf), 2, &["--cloud", "--estimator is ekf"]);
    refuse(&mut scene.map(&["log"], &["--camera-pose", "0 0 0 0 0 0 1"]), 2, &["--cloud"]);
    let mut tune = palpate();
    let tuned = scene.text("out/t.toml");
    let args = ["tune", &log, "--estimator", "elastic", "-o", &tuned];
    refuse(tune.args(args), 2, &words);
}
