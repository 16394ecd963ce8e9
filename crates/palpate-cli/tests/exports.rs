//! The files that `palpate convert` makes of a field for other programs, as these read them. They run in the Python
//! environment that ./setup makes.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use common::{palpate, printed, python, refuse, root, succeed};

fn convert(input: &Path, output: &Path, more: &[&str]) -> Command {
    let mut convert = palpate();
    convert.arg("convert").arg(input).arg("-o").arg(output).args(more);
    convert
}

/// A field of bundled touches.
fn mapped(folder: &Path, touches: &str) -> PathBuf {
    let field = folder.join("field.npz");
    let flags = ["--tune=off", "--replays", "2"];
    succeed(palpate().arg("map").arg(root().join(touches)).args(flags).arg("-o").arg(&field));
    field
}

#[test]
fn needs_mujoco_pyvista_trimesh_a_field_is_read_by_others_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let field = mapped(folder.path(), "data/plant_a");
    for name in ["field.vti", "field.glb"] {
        succeed(&mut convert(&field, &folder.path().join(name), &[]));
    }
    for name in ["boxes.urdf", "springs.xml", "stiff.ply", "stiff.npz"] {
        succeed(&mut convert(&field, &folder.path().join(name), &["--above", "1"]));
    }
    let script = root().join("scripts/exports.py");
    let text = succeed(python().arg(script).arg(&field).arg(folder.path()));
    assert_eq!(text.lines().count(), 5, "{text}");
}

#[test]
fn the_flag_above_is_refused_for_a_log_and_if_no_cell_is_stiffer() {
    let folder = tempfile::tempdir().unwrap();
    let field = mapped(folder.path(), "data/plant_a/seq_000");
    let touch = root().join("data/plant_a/seq_000");
    let out = folder.path().join("boxes.urdf");
    refuse(
        &mut convert(&field, &out, &["--above", "1e9"]),
        1,
        &["no cell stiffer than 1000000000 N/m"],
    );
    refuse(
        &mut convert(&touch, &folder.path().join("log"), &["--above", "1"]),
        2,
        &["--above", "log"],
    );
    refuse(&mut convert(&field, &folder.path().join("field.obj"), &[]), 2, &[".glb", ".urdf"]);
    assert_eq!(common::names(folder.path()), ["field.npz"]);
}

#[test]
fn points_alone_are_no_field_and_a_note_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let field = mapped(folder.path(), "data/plant_a/seq_000");
    let points = folder.path().join("points.npz");
    let (_, said) = printed(&mut convert(&field, &points, &[]));
    assert!(said.contains("bands and elastic body are left out"), "{said}");
    let predict = ["predict", points.to_str().unwrap(), "data/plant_a/seq_001"];
    refuse(palpate().args(predict).current_dir(root()), 1, &["points.npz"]);
}
