//! What `palpate view` shows is what was computed, and no viewer sends usage statistics.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::Scene;

/// `palpate view` of some files and folders of the scene.
fn view(scene: &Scene, what: &[&str], more: &[&str]) -> std::process::Command {
    let mut command = scene.command("view", what);
    command.args(more);
    command
}

#[cfg(not(feature = "viewer"))]
#[test]
fn without_the_viewer_it_says_how_to_get_one() {
    let scene = Scene::new();
    common::refuse(
        &mut view(&scene, &["log"], &[]),
        2,
        &["cargo install", "--features full,viewer"],
    );
}

#[cfg(feature = "viewer")]
mod with_viewer {
    use std::fs;
    use std::path::Path;

    use palpate_view::contents::{rows, scalars};

    use super::common::{Scene, json, refuse, succeed};
    use super::view;

    const COARSE: [&str; 2] = ["--spacing-m", "0.03"];

    fn recorded(scene: &Scene, name: &str) -> Vec<u8> {
        fs::read(scene.path(name)).unwrap()
    }

    /// A column of a CSV, as numbers.
    fn column(csv: &str, name: &str) -> Vec<f64> {
        let mut lines = csv.lines();
        let at = lines.next().unwrap().split(',').position(|head| head == name).unwrap();
        lines.map(|line| line.split(',').nth(at).unwrap().parse().unwrap()).collect()
    }

    #[test]
    fn a_field_predicts_in_the_recording_what_predict_says() {
        let scene = Scene::new();
        succeed(&mut scene.map(&["log/seq_0"], &[]));
        let (csv, rrd) = (scene.text("out/torques.csv"), scene.text("out/touches.rrd"));
        succeed(&mut scene.predict(&["log"], &["-o", &csv]));
        let what = ["out/field.npz", "log"];
        let summary = json(&mut view(&scene, &what, &["--save", &rrd, "--json"]));
        assert_eq!(summary["recording"], rrd.as_str());
        let played = &summary["played"];
        assert_eq!((&played["touches"], &played["samples"]), (&2.into(), &80.into()));

        let bytes = recorded(&scene, "out/touches.rrd");
        let csv = fs::read_to_string(&csv).unwrap();
        for (joint, name) in ["shoulder", "elbow"].iter().enumerate() {
            for (what, columns) in [("predicted", "predicted"), ("measured", "external")] {
                let shown = scalars(&bytes, &format!("/torque/{name}/{what}")).unwrap();
                let written = column(&csv, &format!("{columns}_{}", joint + 1));
                assert_eq!(shown.len(), written.len());
                let close = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-6;
                assert!(shown.iter().zip(&written).all(close), "{name} {what}");
            }
        }
        let touched = scalars(&bytes, "/contacts").unwrap();
        assert_eq!(touched.len(), 80, "one a sample");
        let most = touched.iter().copied().fold(0.0, f64::max);
        assert!(most > 0.0 && played["contacts_largest"].as_f64() == Some(most));
        let rows = rows(&bytes).unwrap();
        assert_eq!(rows["/world/field"], 1, "the field stays as it is: {rows:?}");
        assert!(rows.contains_key("/world/arm/upper") && rows.contains_key("/world/arm/fore"));
    }

    #[test]
    fn a_touch_too_short_for_its_tare_is_named_and_not_the_next() {
        let scene = Scene::new();
        let rrd = scene.text("out/touches.rrd");
        let flags = [&COARSE[..], &["--tare-frames", "60", "--save", &rrd]].concat();
        refuse(&mut view(&scene, &["log"], &flags), 1, &["touch `seq_0`", "60"]);
    }

    #[test]
    fn logs_alone_are_learnt_from_as_they_are_played() {
        let scene = Scene::new();
        let rrd = scene.text("out/touches.rrd");
        let more = ["--save", &rrd, "--json", "--every", "3", "--field-every", "20"];
        let summary = json(view(&scene, &["log"], &more).args(COARSE));
        assert_eq!(summary["played"]["samples_shown"], 27, "0, 3, … 78: {summary}");
        let bytes = recorded(&scene, "out/touches.rrd");
        assert_eq!(scalars(&bytes, "/contacts").unwrap().len(), 27);
        // After 20, 40, 60 and 80 samples, and at the end of each touch.
        assert_eq!(rows(&bytes).unwrap()["/world/field"], 6);

        // The torque predicted before a sample is learnt is the one that `map` reports.
        let learnt = json(&mut scene.map(&["log"], &["--json"]));
        let error = |summary: &serde_json::Value| summary["avg_error"].as_f64().unwrap();
        assert_eq!(error(&learnt["before_learning"]), error(&summary["played"]["errors"]));
    }

    #[test]
    fn a_field_alone_is_shown_with_the_arm_where_it_last_was() {
        let scene = Scene::new();
        let rrd = scene.text("out/field.rrd");
        for more in [&[][..], &["--no-memory"]] {
            succeed(&mut scene.map(&["log"], more));
            let said = succeed(&mut view(&scene, &["out/field.npz"], &["--save", &rrd]));
            assert!(said.contains("field.rrd"), "{said}");
            let rows = rows(&recorded(&scene, "out/field.rrd")).unwrap();
            assert_eq!(rows["/world/field"], 1);
            assert!(!rows.contains_key("/touches"));
        }
    }

    #[test]
    fn invalid_arguments_are_refused_and_leave_no_file() {
        let scene = Scene::new();
        succeed(&mut scene.map(&["log"], &[]));
        fs::copy(scene.path("out/field.npz"), scene.path("other.npz")).unwrap();
        let rrd = scene.text("out/a.rrd");
        let save = ["--save", rrd.as_str()];
        let refuse = |what: &[&str], more: &[&str], code, words: &[&str]| {
            refuse(&mut view(&scene, what, more), code, words);
        };
        refuse(&["out/field.npz", "other.npz"], &save, 2, &["both fields"]);
        refuse(&["log"], &["--save", &scene.text("out/a.rrf")], 2, &["a.rrf", ".rrd"]);
        refuse(&["out/field.npz"], &["--save", &scene.text("out/field.npz")], 2, &["the field"]);
        refuse(&["log"], &["--save", &scene.text("nowhere/a.rrd")], 1, &["nowhere"]);
        refuse(&["log"], &["--every", "0"], 2, &["--every"]);
        refuse(&["nothing"], &save, 1, &["nothing"]);
        let learning = [&save[..], &["--replays", "3"]].concat();
        refuse(&["out/field.npz", "log"], &learning, 2, &["estimator", "field.npz"]);
        refuse(&["log"], &["--connect=elsewhere"], 2, &["elsewhere", "/proxy"]);
        let broken = [[0.0, f64::NAN]; 40];
        scene.arrays("broken", &[[0.0, 0.0]; 40], &broken);
        refuse(&["log", "broken"], &save, 1, &["broken", "NaN"]);
        assert_eq!(scene.results(), ["field.npz"]);
    }

    #[cfg(unix)]
    #[test]
    fn ctrl_c_leaves_nothing() {
        use std::io::{BufRead, BufReader, Read};
        use std::process::Stdio;
        let scene = Scene::new();
        scene.touch("long", 3_000, 0.0);
        let rrd = scene.text("out/a.rrd");
        // Each sample makes so many replays that playing would take a minute.
        let more = ["--save", &rrd, "--replays", "20000", "--tare-frames", "5"];
        let mut command = view(&scene, &["log", "long"], &more);
        let mut child = command.args(COARSE).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        while !said.contains("note: robot") {
            assert_ne!(lines.read_line(&mut said).unwrap(), 0, "{said}");
        }
        super::common::interrupt(&child);
        lines.read_to_string(&mut said).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
        assert!(said.contains("error: interrupted at touch"), "{said}");
        assert!(scene.results().is_empty(), "{:?}", scene.results());
    }

    /// A command `rerun` that notes its arguments, and runs `then`.
    #[cfg(unix)]
    fn pretend_viewer(scene: &Scene, then: &str) -> String {
        use std::os::unix::fs::PermissionsExt;
        let (folder, notes) = (scene.path("bin"), scene.text("notes"));
        fs::create_dir_all(&folder).unwrap();
        let script = folder.join("rerun");
        let text = format!("#!/bin/sh\necho \"$XDG_CONFIG_HOME $*\" >> '{notes}'\n{then}\n");
        fs::write(&script, text).unwrap();
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        folder.to_str().unwrap().to_owned()
    }

    /// Runs `palpate view log`, which starts the pretended viewer, or none; returns what the viewer
    /// noted.
    #[cfg(unix)]
    fn started(scene: &Scene, path: &str, words: &[&str]) -> Vec<String> {
        let mut command = view(scene, &["log"], &COARSE);
        command.env("PATH", path).env("PALPATE_CACHE_DIR", scene.path("cache"));
        refuse(&mut command, 1, words);
        let notes = fs::read_to_string(scene.path("notes")).unwrap_or_default();
        notes.lines().map(str::to_owned).collect()
    }

    #[cfg(unix)]
    #[test]
    fn a_viewer_is_started_with_its_usage_statistics_off() {
        let scene = Scene::new();
        let path = pretend_viewer(&scene, "");
        let notes = started(&scene, &path, &["no Rerun viewer answers", "--save"]);
        let settings = scene.text("cache/viewer");
        assert_eq!(notes[0], format!("{settings} analytics disable"), "first of all: {notes:?}");
        let viewer = notes.iter().find(|note| note.contains("--port=")).unwrap();
        assert!(viewer.starts_with(&settings), "with the same settings: {viewer}");
        assert!(Path::new(&settings).is_dir());
    }

    #[cfg(unix)]
    #[test]
    fn a_viewer_whose_statistics_cannot_be_switched_off_is_not_started() {
        let scene = Scene::new();
        let path = pretend_viewer(&scene, "echo 'no such setting' >&2; exit 2");
        let notes = started(&scene, &path, &["usage statistics", "no such setting"]);
        assert_eq!(notes.len(), 1, "{notes:?}");
    }

    #[cfg(unix)]
    #[test]
    fn without_a_viewer_it_says_how_to_get_one() {
        let scene = Scene::new();
        fs::create_dir(scene.path("empty")).unwrap();
        let words = ["no command `rerun`", "pip install 'rerun-sdk==0.36.*'", "--save"];
        assert!(started(&scene, &scene.text("empty"), &words).is_empty());
    }
}
