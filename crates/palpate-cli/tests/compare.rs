//! `palpate compare`, `next` and `forget`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::path::Path;

use common::{Scene, json, palpate, plant, refuse, samples, succeed, write_touch};
use palpate_io::field::load;
use palpate_io::log::external_truth;

#[test]
fn a_softer_object_is_distinguished_from_an_unchanged_one() {
    let scene = Scene::new();
    let field = scene.text("field.npz");
    let learned = [0, 1, 2, 3, 4, 5, 8].map(|k| plant().join(format!("seq_{k:03}")));
    succeed(palpate().arg("map").args(&learned).args(["-o", &field]));
    // The same touch of a much softer object: most of the external torque is subtracted.
    let mut softer = samples(&plant().join("seq_003"));
    let external = external_truth(&plant(), "seq_003").unwrap().unwrap();
    for (sample, external) in softer.iter_mut().zip(&external) {
        sample.tau.iter_mut().zip(external).for_each(|(tau, external)| *tau -= 0.9 * external);
    }
    let soft = scene.path("soft");
    write_touch(&soft, &softer);

    let compared = |log: &Path| {
        json(palpate().args(["compare", &field, "--json"]).arg(log))["together"].clone()
    };
    let same = compared(&plant().join("seq_003"));
    assert_eq!(same["change"], "unchanged", "{same}");
    let changed = compared(&soft);
    assert_eq!(changed["change"], "softer", "{changed}");
    assert!(changed["factor"].as_f64().unwrap() < 0.25, "{changed}");
    let text = succeed(palpate().args(["compare", &field]).arg(&soft));
    assert!(text.contains("softer, 0."), "{text}");
}

#[test]
fn a_field_without_bands_compares_nothing() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log"], &[]));
    let mut command = scene.predict(&["log"], &[]);
    let arguments: Vec<_> = command.get_args().skip(1).map(ToOwned::to_owned).collect();
    command = palpate();
    refuse(
        command.arg("compare").args(arguments),
        1,
        &["no touches were held out", "three touches"],
    );
}

#[test]
fn the_motion_that_is_most_like_the_task_is_proposed_and_written() {
    let scene = Scene::new();
    succeed(&mut scene.map(&["log/seq_0"], &[]));
    // Planned motions: tables without torques.
    let swing = |name: &str, elbow: f64| {
        let rows = (0..40_i32).map(|t| {
            format!(
                "{:.2},{:.4},{elbow}\n",
                0.05 * f64::from(t),
                0.0125 * f64::from((t - 8).max(0))
            )
        });
        let table = format!("time,shoulder_position,elbow_position\n{}", rows.collect::<String>());
        fs::write(scene.path(name), table).unwrap();
    };
    for (name, elbow) in [("near.csv", -0.41), ("far.csv", 2.0), ("task.csv", -0.4)] {
        swing(name, elbow);
    }
    let [near, far, task, best] =
        ["near.csv", "far.csv", "task.csv", "best.csv"].map(|n| scene.text(n));
    let next = |more: &[&str]| {
        let mut command = palpate();
        command.args(["next", &scene.text("out/field.npz"), "--candidates", &far, &near]);
        command.args(scene.settings()).args(more);
        command
    };
    let found = json(&mut next(&["--task", &task, "-o", &best, "--json"]));
    let proposals = found["proposals"].as_array().unwrap();
    assert_eq!((&proposals[0]["name"], proposals.len()), (&"near".into(), 2), "{found}");
    let left = |k: usize| proposals[k]["variance_left"].as_f64().unwrap();
    assert!(left(0) < 0.5 && left(1) <= left(0), "{found}");
    // The written motion can be a candidate, and is the same motion.
    let again = json(
        palpate()
            .args(["next", &scene.text("out/field.npz"), "--candidates", &best])
            .args(["--task", &task, "--json"])
            .args(scene.settings()),
    );
    let same = again["proposals"][0]["variance_left"].as_f64().unwrap();
    assert!((same - left(0)).abs() < 1e-6, "{again}");
    let text = succeed(&mut next(&["--limit", "0.001"]));
    assert!(
        text.contains("Torque with its band above --limit: far")
            || text.contains("Torque with its band above --limit: near"),
        "{text}"
    );
    refuse(&mut next(&["--task", &scene.text("nothing")]), 1, &["nothing"]);
    let nan = ["--box", "nan", "0", "0", "1", "1", "1"];
    refuse(&mut next(&nan), 2, &["a finite coordinate, m"]);
    // An elbow with smaller joint limits.
    let urdf = fs::read_to_string(scene.path("tiny.urdf")).unwrap();
    let (before, elbow) = urdf.split_at(urdf.find("<joint name=\"elbow\"").unwrap());
    let limit = "\"revolute\"><limit lower=\"-1\" upper=\"1.5\" effort=\"9\" velocity=\"2\"/>";
    let elbow = elbow.replacen("\"continuous\">", limit, 1);
    fs::write(scene.path("tiny.urdf"), format!("{before}{elbow}")).unwrap();
    let found = json(&mut next(&["--task", &task, "--json"]));
    assert_eq!(found["proposals"].as_array().unwrap().len(), 1, "{found}");
    let out = &found["beyond_joint_limits"][0];
    assert_eq!((&out["name"], &out["joint"]), (&"far".into(), &"elbow".into()), "{found}");
    let text = succeed(&mut next(&["--task", &task]));
    assert!(
        text.contains("Beyond joint limits: far (elbow at 2.000, limits -1.000 .. 1.500)."),
        "{text}"
    );
}

#[test]
fn a_forgotten_touch_leaves_the_field_of_the_others() {
    let scene = Scene::new();
    let (both, one, rest) = (scene.text("both.npz"), scene.text("one.npz"), scene.text("rest.npz"));
    succeed(&mut scene.map(&["log"], &["-o", &both]));
    succeed(&mut scene.map(&["log/seq_1"], &["-o", &one]));
    let forget = |more: &[&str]| {
        let mut command = palpate();
        command.args(["forget", &both, "-o", &rest]).args(scene.settings()).args(more);
        command
    };
    let report = json(&mut forget(&["--touch", "seq_0", "--json"]));
    assert_eq!(
        (&report["forgotten"][0], &report["touches"]),
        (&"#0 seq_0".into(), &1.into()),
        "{report}"
    );
    assert_eq!(load(rest.as_ref()).unwrap().field, load(one.as_ref()).unwrap().field);
    let text = succeed(&mut forget(&["--older-than", "1"]));
    assert!(text.contains("forgotten") && text.contains("seq_0"), "{text}");
    assert_eq!(load(rest.as_ref()).unwrap().field, load(one.as_ref()).unwrap().field);
    // A box around everything: both touches are forgotten.
    let all = json(&mut forget(&["--box", "-9", "-9", "-9", "9", "9", "9", "--json"]));
    assert_eq!((&all["touches"], &all["cells_touched"]), (&0.into(), &0.into()), "{all}");

    refuse(&mut forget(&["--touch", "seq_7"]), 2, &["no touch `seq_7`", "#0 seq_0, #1 seq_1"]);
    refuse(&mut forget(&["--box", "8", "8", "8", "9", "9", "9"]), 2, &["no such touch"]);
    refuse(&mut forget(&[]), 2, &["--touch"]);
    succeed(&mut scene.map(&["log"], &["-o", &both, "--no-memory"]));
    refuse(&mut forget(&["--touch", "seq_0"]), 2, &["without its memory"]);
}
