//! `--split-idle`: one long recording, split where the arm pauses in the air.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;

use common::{Scene, json, names, succeed};

/// Rows of `q1,q2,tau1,tau2,time`: still, swing out and hold there, swing back, and once more.
fn recording(pushes: usize) -> String {
    let mut text = "time,q1,q2,tau1,tau2\n".to_owned();
    let mut row = 0;
    let mut put = |q: f64| {
        text += &format!("{},{q},0,{},{}\n", f64::from(row) * 0.02, 0.3 - 12.0 * q, 0.1 - 4.0 * q);
        row += 1;
    };
    for _ in 0..pushes {
        (0..40).for_each(|_| put(0.0));
        (1..=40).for_each(|i| put(0.01 * f64::from(i)));
        (0..60).for_each(|_| put(0.4)); // still, but pushing
        (1..=40).for_each(|i| put(0.4 - 0.01 * f64::from(i)));
    }
    text
}

#[test]
fn a_recording_is_split_at_pauses_in_the_air_and_nowhere_else() {
    let scene = Scene::new();
    fs::write(scene.path("day.csv"), recording(3)).unwrap();
    let whole = json(&mut scene.map(&["day.csv"], &["--json"]));
    assert_eq!(whole["touches"].as_array().unwrap().len(), 1);

    let parted = json(&mut scene.map(&["day.csv"], &["--json", "--split-idle"]));
    let touches = parted["touches"].as_array().unwrap();
    let touch_names: Vec<_> = touches.iter().map(|touch| touch["name"].as_str().unwrap()).collect();
    assert_eq!(touch_names, ["day", "day_2", "day_3"]);
    let frames: u64 = touches.iter().map(|touch| touch["frames"].as_u64().unwrap()).sum();
    assert_eq!(frames, 3 * 180, "every sample is in one touch");
    for touch in touches {
        assert!(touch["tare_frames"].as_u64().unwrap() >= 20, "{touch}");
        assert!(touch["frames_in_contact"].as_u64().unwrap() >= 60, "{touch}");
    }
    let predicted = json(&mut scene.predict(&["day.csv"], &["--json", "--split-idle"]));
    assert_eq!(predicted["touches"].as_array().unwrap().len(), 3);
    let mut inspect = scene.command("inspect", &["day.csv"]);
    let output = inspect.args(["--json", "--split-idle"]).output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["paths"][0]["touches"].as_array().unwrap().len(), 3, "{report}");
}

#[test]
fn a_recording_is_also_split_at_a_pause_after_a_motion_through_the_box() {
    let scene = Scene::new();
    let mut text = "time,q1,q2,tau1,tau2\n".to_owned();
    let mut row = 0;
    let mut put = |q: [f64; 2], push: f64| {
        let time = f64::from(row) * 0.02;
        text += &format!("{time},{},{},{},{}\n", q[0], q[1], 0.3 - 12.0 * push, 0.1 - 4.0 * push);
        row += 1;
    };
    for elbow in [0.0, 0.6, 1.2] {
        (0..40).for_each(|_| put([0.0, elbow], 0.0));
        (1..=40).for_each(|i| put([0.01 * f64::from(i), elbow], 0.01 * f64::from(i)));
        (0..60).for_each(|_| put([0.4, elbow], 0.4));
        (1..=40).for_each(|i| put([0.4 - 0.01 * f64::from(i), elbow], 0.4 - 0.01 * f64::from(i)));
        (0..40).for_each(|_| put([0.0, elbow], 0.0));
        (1..=40).for_each(|i| put([0.0, elbow + 0.015 * f64::from(i)], 0.0));
    }
    fs::write(scene.path("day.csv"), text).unwrap();
    let parted = json(&mut scene.map(&["day.csv"], &["--json", "--split-idle"]));
    let touches = parted["touches"].as_array().unwrap();
    // Three times a push, each with a motion to the next one.
    assert_eq!(touches.len(), 6, "{touches:?}");
    let frames: Vec<u64> = touches.iter().map(|touch| touch["frames"].as_u64().unwrap()).collect();
    assert!(frames.iter().step_by(2).all(|frames| (165..=185).contains(frames)), "{frames:?}");
}

#[test]
fn touches_split_by_convert_are_those_split_while_mapping() {
    let scene = Scene::new();
    fs::write(scene.path("day.csv"), recording(2)).unwrap();
    let mut convert = scene.command("convert", &["day.csv"]);
    succeed(convert.arg("--split-idle").arg("-o").arg(scene.path("arrays")));
    assert_eq!(names(&scene.path("arrays")), ["day", "day_2"]);

    succeed(&mut scene.map(&["day.csv"], &["--split-idle"]));
    let on_the_way = fs::read(scene.path("out/field.npz")).unwrap();
    succeed(&mut scene.map(&["arrays"], &[]));
    assert!(fs::read(scene.path("out/field.npz")).unwrap() == on_the_way);
}
