//! `palpate inspect` of robots and fields.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

mod common;
mod recording;

use std::fs;
use std::path::Path;
use std::process::Command;

use common::{Scene, URDF, holds, succeed};
use palpate_io::field::{SavedField, load, save};
use recording::{codes, first, found, inspect, run};
use serde_json::Value;

/// Inspects the tiny arm after a change to its text.
fn look(from: &str, to: &str) -> (Option<i32>, Value) {
    let folder = tempfile::tempdir().unwrap();
    let urdf = URDF.replacen(from, to, 1);
    assert!(from == to || urdf != URDF, "the change must take");
    let path = folder.path().join("tiny.urdf");
    fs::write(&path, urdf).unwrap();
    fs::write(folder.path().join("cup.stl"), cup()).unwrap();
    run(inspect().arg(&path).arg("--no-cache"))
}

/// An open box of 10 cm without its lid, as an STL in text.
fn cup() -> String {
    let corner = |n: usize| [n & 1, n >> 1 & 1, n >> 2 & 1].map(|bit| 0.1 * bit as f64);
    let sides = [[0, 2, 3, 1], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let mut text = "solid cup\n".to_owned();
    for [a, b, c, d] in sides {
        for triangle in [[a, b, c], [a, c, d]] {
            text += "facet normal 0 0 0\nouter loop\n";
            for [x, y, z] in triangle.map(corner) {
                text += &format!("vertex {x} {y} {z}\n");
            }
            text += "endloop\nendfacet\n";
        }
    }
    text + "endsolid cup\n"
}

const UPPER_SHAPE: &str = r#"<box size="0.4 0.06 0.06"/>"#;

#[test]
fn nothing_is_wrong_with_the_built_in_robot() {
    let report = found(run(inspect().args(["kinova_gen3", "--strict"])), 0, &[]);
    let robot = &report["paths"][0];
    assert_eq!(robot["joints"].as_array().unwrap().len(), 7);
    assert!((robot["mass_kg"].as_f64().unwrap() - 8.188).abs() < 0.01, "{}", robot["mass_kg"]);
    let reach_m = robot["reach_m"].as_f64().unwrap();
    assert!((1.1..1.4).contains(&reach_m), "{reach_m}"); // 0.9 m from its shoulder, at 0.285 m
    let text = succeed(inspect().arg("kinova_gen3"));
    assert!(text.contains("Actuator4") && text.contains("Nothing looks wrong"), "{text}");
}

#[test]
fn links_without_mass_or_shape_are_reported() {
    assert_eq!(look("", "").1["paths"][0]["findings"], Value::Array(vec![]));
    let without_mass = look(r#"<mass value="1"/>"#, r#"<mass value="0"/>"#);
    let report = found(without_mass, 0, &["link_without_mass"]);
    assert_eq!(first(&report)["parts"], serde_json::json!(["upper"]));
    let shape = format!(
        "<collision><origin xyz=\"0.2 0 0\"/><geometry>{UPPER_SHAPE}</geometry></collision>"
    );
    assert_eq!(codes(&look(&shape, "").1), ["link_without_shape"]);
}

#[test]
fn millimetres_taken_for_metres_are_reported() {
    let (_, report) = look(UPPER_SHAPE, r#"<box size="0.004 0.0006 0.0006"/>"#);
    assert_eq!(codes(&report), ["link_size"]);
    assert!(first(&report)["what"].as_str().unwrap().contains("millimetres"), "{report}");
}

#[test]
fn an_open_mesh_is_reported() {
    let report = found(look(UPPER_SHAPE, r#"<mesh filename="cup.stl"/>"#), 0, &["open_shell"]);
    assert_eq!(first(&report)["parts"], serde_json::json!(["upper"]));
}

#[test]
fn a_robot_that_cannot_be_used_is_an_error_and_its_tree_is_reported() {
    let report = found(look(UPPER_SHAPE, r#"<mesh filename="nowhere.stl"/>"#), 1, &["robot"]);
    assert!(first(&report)["what"].as_str().unwrap().contains("nowhere.stl"));
    assert_eq!(report["paths"][0]["joints"][1]["name"], "elbow");
    found(look(r#"<child link="upper"/>"#, r#"<child link="fore"/>"#), 1, &["robot"]);
}

/// A field of the tiny arm, after a change.
fn look_at_field(change: impl FnOnce(&mut SavedField)) -> (Option<i32>, Value) {
    look_at_field_with(change, |_, command| command)
}

/// The same, with other flags.
fn look_at_field_with(
    change: impl FnOnce(&mut SavedField),
    flags: impl Fn(&Scene, Command) -> Command,
) -> (Option<i32>, Value) {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    let path = scene.path("out/field.npz");
    let mut saved = load(&path).unwrap();
    change(&mut saved);
    save(&path, &saved).unwrap();
    let mut command = inspect();
    command.arg(&path);
    run(&mut flags(&scene, command))
}

#[test]
fn what_a_field_holds_is_reported() {
    let report = found(look_at_field(|_| {}), 0, &[]);
    let field = &report["paths"][0];
    assert_eq!((&field["kind"], &field["own"]["robot"]), (&"field".into(), &"tiny".into()));
    assert_eq!(field["own"]["lattice"]["spacing_m"], 0.03);
    assert_eq!(field["own"]["memory"]["method"], "map");
    assert!(field["cells"].as_u64().unwrap() > 10 && field["total_n_per_m"].as_f64() > Some(0.0));
    let (_, report) = look_at_field(|saved| saved.snapshot = None);
    assert!(report["paths"][0]["own"]["memory"].is_null(), "{report}");
}

#[test]
fn a_field_of_another_robot_than_the_given_one_is_reported() {
    let with = |robot: &'static str| {
        move |scene: &Scene, mut command: Command| {
            match robot {
                "tiny" => command.args(scene.settings()),
                other => command.args(["--robot", other]),
            };
            command
        }
    };
    found(look_at_field_with(|_| {}, with("tiny")), 0, &[]);
    let report = found(look_at_field_with(|_| {}, with("kinova_gen3")), 0, &["other_robot"]);
    holds(&first(&report).to_string(), &["`tiny`", "`kinova_gen3`"]);
}

#[test]
fn fields_that_learnt_nothing_are_reported() {
    let zero = look_at_field(|saved| saved.field.stiffness_n_per_m.fill(0.0));
    found(zero, 0, &["all_zero"]);
    let (_, report) = look_at_field(|saved| {
        let config = &saved.snapshot.as_ref().unwrap().config;
        let prior = config.estimator.prior.at_spacing(config.lattice.spacing_m()).1;
        saved.field.std_n_per_m.fill(prior);
    });
    assert_eq!(codes(&report), ["std_never_reduced"]);
}

#[test]
fn a_field_of_another_program_and_a_broken_one_are_reported() {
    let testdata = Path::new(env!("CARGO_MANIFEST_DIR")).join("../palpate-io/testdata");
    let report = found(run(inspect().arg(testdata.join("openvsf.npz"))), 0, &["foreign_field"]);
    assert_eq!(report["paths"][0]["cells"], 3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.npz");
    fs::write(&path, "no archive").unwrap();
    found(run(inspect().arg(&path)), 1, &["field"]);
}
