//! Outputs never overwrite inputs, nor each other.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;

use common::{Scene, refuse, succeed};

#[test]
fn map_refuses_to_write_over_its_inputs() {
    let scene = Scene::new();
    let at = |name: &str| scene.text(name);
    let same = at("out/same.npz");
    let both = ["-o", &same, "--picture", &same];
    refuse(&mut scene.map(&["log"], &both), 2, &["--output", "--picture", "same.npz"]);

    let arrays = scene.path("log/seq_0/angles.npy");
    let before = fs::read(&arrays).unwrap();
    for log in ["log", "log/seq_0"] {
        for name in ["angles.npy", "torques.npy", "time.npy"] {
            let over = at(&format!("log/seq_0/../seq_0/{name}"));
            refuse(&mut scene.map(&[log], &["-o", &over]), 2, &["--output", "a file of the log"]);
        }
    }
    refuse(&mut scene.map(&["log"], &["-o", &at("tiny.urdf")]), 2, &["--output", "the robot"]);
    fs::write(scene.path("s.toml"), "").unwrap();
    let settings = ["-o", &at("s.toml"), "--settings", &at("s.toml")];
    refuse(&mut scene.map(&["log"], &settings), 2, &["--output", "the settings file"]);
    assert_eq!(fs::read(&arrays).unwrap(), before);
    assert!(scene.results().is_empty());
}

#[test]
fn a_field_may_be_replaced_by_what_goes_on_from_it_but_not_by_a_picture() {
    let scene = Scene::new();
    let field = scene.text("out/field.npz");
    succeed(&mut scene.map(&["log/seq_0"], &[]));
    succeed(&mut scene.map(&["log/seq_1"], &["--from", &field]));
    let other = scene.text("out/other.npz");
    let over = ["--from", &field, "-o", &other, "--picture", &field];
    refuse(&mut scene.map(&["log/seq_1"], &over), 2, &["--picture", "--from"]);
}

#[test]
fn predict_refuses_to_write_over_its_inputs() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    let at = |name: &str| scene.text(name);
    let before = fs::read(scene.path("out/field.npz")).unwrap();
    refuse(
        &mut scene.predict(&["log"], &["-o", &at("out/field.npz")]),
        2,
        &["--output", "the field"],
    );
    let same = at("out/same.csv");
    let both = ["-o", &same, "--picture", &same];
    refuse(&mut scene.predict(&["log"], &both), 2, &["--output", "--picture"]);
    assert_eq!(fs::read(scene.path("out/field.npz")).unwrap(), before);

    fs::create_dir(scene.path("tables")).unwrap();
    let table = at("tables/a.csv");
    fs::write(&table, "q1,q2,tau1,tau2\n0,0,0,0\n").unwrap();
    for log in ["tables", "tables/a.csv"] {
        refuse(&mut scene.predict(&[log], &["-o", &table]), 2, &["a file of the log"]);
    }
    // A table beside touches as arrays is not read, and may be replaced.
    for _ in 0..2 {
        succeed(&mut scene.predict(&["log"], &["-o", &at("log/torques.csv")]));
    }
}
