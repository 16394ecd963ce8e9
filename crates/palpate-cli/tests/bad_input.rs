//! Bad input: a clear error, a non-zero exit, and nothing left behind.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;

use common::{Scene, holds, npy, palpate, refuse, stderr, stdout, succeed};

/// Maps a log that must be refused.
#[track_caller]
fn refuse_log(scene: &Scene, log: &str, words: &[&str]) {
    refuse(&mut scene.map(&[log], &[]), 1, words);
    assert!(scene.results().is_empty(), "{:?}", scene.results());
}

/// Maps with settings that must be refused.
#[track_caller]
fn refuse_settings(settings: &[&str], code: i32, words: &[&str]) {
    let scene = Scene::new();
    refuse(&mut scene.map(&["log"], settings), code, words);
    assert!(scene.results().is_empty(), "{:?}", scene.results());
}

/// Maps with a URDF that must be refused.
#[track_caller]
fn refuse_robot(from: &str, to: &str, words: &[&str]) {
    let scene = Scene::new();
    let urdf = common::URDF.replacen(from, to, 1);
    assert_ne!(urdf, common::URDF, "the change must take");
    fs::write(scene.path("tiny.urdf"), urdf).unwrap();
    refuse_log(&scene, "log", words);
}

#[test]
fn a_missing_log_is_named() {
    refuse_log(&Scene::new(), "nowhere", &["nowhere` does not exist"]);
}

#[test]
fn an_empty_log_is_named() {
    let scene = Scene::new();
    fs::create_dir(scene.path("void")).unwrap();
    refuse_log(&scene, "void", &["void", "holds no touch"]);
    scene.arrays::<2>("none", &[], &[]);
    refuse_log(&scene, "none", &["angles.npy", "is empty"]);
}

#[test]
fn arrays_of_the_wrong_shape_are_named() {
    let scene = Scene::new();
    npy(&scene.path("log/seq_1/angles.npy"), &[80], &[0.0; 80]);
    refuse_log(&scene, "log", &["seq_1/angles.npy", "shape [80]"]);
    scene.arrays("short", &[[0.0; 2]; 40], &[[0.0; 2]; 39]);
    refuse_log(&scene, "short", &["torques.npy", "[39, 2]"]);
}

#[test]
fn a_log_of_another_robot_is_refused() {
    let scene = Scene::new();
    scene.arrays("three", &[[0.0; 3]; 40], &[[0.0; 3]; 40]);
    refuse_log(&scene, "three", &["three", "got 3 joint angles, the robot has 2 moving joints"]);
}

#[test]
fn a_torque_that_is_no_number_is_reported_with_its_place() {
    for bad in [f64::NAN, f64::INFINITY] {
        let scene = Scene::new();
        let mut torques = [[0.0; 2]; 40];
        torques[20][1] = bad;
        scene.arrays("bad", &[[0.0; 2]; 40], &torques);
        refuse_log(&scene, "bad", &["torques.npy", "row 20, column 1", "finite"]);
    }
}

#[test]
fn a_truncated_array_is_named_before_any_work() {
    let scene = Scene::new();
    let path = scene.path("log/seq_1/torques.npy");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() - 100]).unwrap();
    refuse_log(&scene, "log", &["seq_1/torques.npy", "truncated"]);
}

#[test]
fn a_file_that_is_no_robot_is_named() {
    refuse_robot(
        r#"<parent link="base"/><child link="upper"/>"#,
        r#"<parent link="fore"/><child link="upper"/>"#,
        &["tiny.urdf", "loop"],
    );
    refuse_robot(r#"<mass value="1"/>"#, r#"<mass value="-1"/>"#, &["tiny.urdf", "mass", "-1"]);
    refuse_robot(
        r#"<box size="0.4 0.06 0.06"/>"#,
        r#"<mesh filename="meshes/upper.stl"/>"#,
        &["link `upper`", "meshes/upper.stl", "not found"],
    );
    let scene = Scene::new();
    let mut command = scene.map(&["log"], &[]);
    refuse(command.args(["--robot", "kinova_gen4"]), 2, &["--robot"]); // given twice
    let mut command = palpate();
    command.arg("map").arg(scene.path("log")).arg("-o").arg(scene.path("out/f.npz"));
    refuse(command.args(["--robot", "kinova_gen4"]), 1, &["kinova_gen4", "kinova_gen3"]);
}

#[test]
fn settings_out_of_range_are_refused() {
    let scene = Scene::new();
    let mut command = scene.command("map", &["log"]);
    command.arg("-o").arg(scene.path("out/field.npz"));
    refuse(command.args(["--spacing-m", "0"]), 2, &["spacing is 0 m", "positive"]);
    assert!(scene.results().is_empty());

    refuse_settings(&["--box-low-m=-90,-90,-90", "--box-high-m=90,90,90"], 2, &["indexed"]);
    refuse_settings(&["--box-low-m=1,1,1", "--box-high-m=0,2,2"], 2, &["inside out"]);
    refuse_settings(&["--estimator", "ekf", "--prior-mean", "0"], 2, &["never learns"]);
    refuse_settings(&["--friction", "-0.1"], 2, &["friction is -0.1"]);
    refuse_settings(&["--torque-std", "0.1,0.2,0.3"], 2, &["3 values", "each of 2"]);
    refuse_settings(&["--payload-mass-kg", "1"], 2, &["--payload-link"]);
    refuse_settings(&["--payload-link", "hand", "--payload-mass-kg", "1"], 2, &["hand"]);
    refuse_settings(&["--tare-frames", "400"], 1, &["seq_0", "400", "tare"]);
}

#[test]
fn a_misspelt_key_of_a_settings_file_is_reported_with_its_line() {
    let scene = Scene::new();
    fs::write(scene.path("p.toml"), "[contact]\nfrictoin = 0.2\n").unwrap();
    let mut command = scene.map(&["log"], &["--settings", &scene.text("p.toml")]);
    refuse(&mut command, 2, &["p.toml", "line 2", "did you mean `friction`?"]);
}

#[test]
fn an_output_that_cannot_be_written_is_refused_before_any_work() {
    let scene = Scene::new();
    let file = scene.text("tiny.urdf/field.npz");
    refuse(&mut scene.map(&["log"], &["-o", &file]), 1, &["tiny.urdf"]);
    refuse(&mut scene.map(&["log"], &["-o", &scene.text("out")]), 1, &["folder"]);
    refuse(&mut scene.map(&["log"], &["-o", &scene.text("no/f.npz")]), 1, &["no folder"]);
    refuse(&mut scene.map(&["log"], &["-o", &scene.text("f.ply")]), 2, &["f.ply", ".npz"]);
    if cfg!(target_os = "linux") {
        refuse(&mut scene.map(&["log"], &["-o", "/proc/field.npz"]), 1, &["/proc/field.npz"]);
        refuse(&mut scene.map(&["log"], &["-o", "/dev/full"]), 1, &["/dev/full"]);
    }
    assert!(scene.results().is_empty());
}

#[cfg(unix)]
#[test]
fn a_full_disk_leaves_the_older_field_as_it_was() {
    let scene = Scene::new();
    fs::write(scene.path("out/field.npz"), "older").unwrap();
    // Files are limited to 512 bytes, and the signal that is sent at the limit is ignored.
    let limited = r#"trap "" XFSZ; ulimit -f 1; exec "$0" "$@""#;
    let map = scene.map(&["log"], &[]);
    let mut command = std::process::Command::new("sh");
    command.args(["-c", limited]).arg(map.get_program()).args(map.get_args());
    refuse(&mut command, 1, &["field.npz` cannot be written"]);
    assert_eq!(scene.results(), ["field.npz"]);
    assert_eq!(fs::read(scene.path("out/field.npz")).unwrap(), b"older");
}

#[test]
fn a_file_that_is_no_field_is_refused() {
    let scene = Scene::new();
    refuse(&mut scene.predict(&["log"], &[]), 1, &["field.npz"]);
    fs::write(scene.path("out/field.npz"), "no archive").unwrap();
    refuse(&mut scene.predict(&["log"], &[]), 1, &["field.npz", "not an npz"]);
    succeed(&mut scene.map(&["log"], &[]));
    let bytes = fs::read(scene.path("out/field.npz")).unwrap();
    fs::write(scene.path("out/field.npz"), &bytes[..bytes.len() / 2]).unwrap();
    refuse(&mut scene.predict(&["log"], &[]), 1, &["field.npz", "truncated"]);
}

#[test]
fn a_missing_truth_is_refused_with_the_name_of_the_touch() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    refuse(&mut scene.predict(&["log"], &["--truth"]), 1, &["seq_0", "--truth"]);
    refuse(&mut scene.predict(&["log"], &["-o", "torques.txt"]), 2, &[".csv", ".npz"]);
}

#[test]
fn a_closed_pipe_is_no_error_and_a_full_device_is() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = palpate().arg("settings").stdout(writer).output().unwrap();
    assert_eq!((output.status.code(), stderr(&output)), (Some(0), String::new()));
    if cfg!(target_os = "linux") {
        let full = fs::File::create("/dev/full").unwrap();
        let output = palpate().arg("settings").stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains("standard output cannot be written"));
    }
}

#[test]
fn coordinates_beyond_a_kilometre_are_refused_as_a_wrong_unit() {
    let far = ["--box-low-m", "1500,0,0", "--box-high-m", "1500.2,0.2,0.2"];
    refuse_settings(&far, 2, &["1500", "1000 m", "millimetres"]);
    refuse_robot(r#"xyz="0.4 0 0""#, r#"xyz="4000 0 0""#, &["elbow", "4000", "millimetres"]);
    refuse_robot(
        r#"size="0.4 0.06 0.06""#,
        r#"size="4000 60 60""#,
        &["upper", "4000", "millimetres"],
    );
}

#[test]
fn a_file_beyond_the_memory_limit_is_refused_and_read_with_a_larger_limit() {
    let scene = Scene::new();
    scene.touch("log/long", 60_000, 0.0);
    succeed(&mut scene.map(&["log/long"], &["--replays", "0"]));
    let bounded = |gib: &str, command: &str, file: &str| {
        let mut command = scene.command(command, &[file]);
        command.args(["--file-memory", gib, "--json"]);
        command
    };
    for file in ["log", "out/field.npz"] {
        let output = bounded("0.001", "inspect", file).output().unwrap();
        let report = stdout(&output);
        assert_eq!(output.status.code(), Some(1), "{report}");
        holds(&report, &[file, "0.001 GiB", "--file-memory GIB"]);
        succeed(&mut bounded("0.1", "inspect", file));
    }
}
