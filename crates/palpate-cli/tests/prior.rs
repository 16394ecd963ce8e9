//! `palpate map --prior`: a field starts from the stiffness of another field.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::path::Path;
use std::process::Command;

use common::{Scene, holds, json, palpate, plant, printed, refuse, succeed};
use palpate_io::field::npz::{Array, Arrays, Data, write_npz};
use palpate_io::field::{SavedField, load, save};

/// A scene with the field of its first touch, `out/first.npz`, whose cells the second touch meets
/// too.
fn scene() -> Scene {
    let scene = Scene::new();
    let first = scene.text("out/first.npz");
    succeed(&mut scene.map(&["log/seq_0"], &["-o", &first]));
    scene
}

/// `palpate map` of the second touch into `out/field.npz`, with a prior from the scene.
fn with_prior(scene: &Scene, prior: &str, more: &[&str]) -> Command {
    let prior = scene.text(prior);
    scene.map(&["log/seq_1"], &[&["--prior", &prior], more].concat())
}

fn field(scene: &Scene, name: &str) -> SavedField {
    load(&scene.path(name)).unwrap()
}

/// Changes a field on disk.
fn change(scene: &Scene, name: &str, change: impl FnOnce(&mut SavedField)) {
    let mut saved = field(scene, name);
    change(&mut saved);
    save(&scene.path(name), &saved).unwrap();
}

#[test]
fn a_field_learnt_yesterday_is_a_prior_for_today() {
    let scene = scene();
    let mapped = json(&mut with_prior(&scene, "out/first.npz", &["--json"]));
    let (first, second) = (field(&scene, "out/first.npz"), field(&scene, "out/field.npz"));
    let (was, is) = (&first.field, &second.field);
    let prior = second.prior_n_per_m.unwrap();
    let expected = was.cells.len();
    assert!(is.cells[..expected].is_sorted() && is.cells.len() > expected);
    for (row, cell) in is.cells.iter().enumerate() {
        let before = was.cells.iter().position(|other| other == cell);
        let mean = before.map_or(was.untouched_n_per_m, |row| was.stiffness_n_per_m[row]);
        assert_eq!((before.is_some(), prior[row]), (row < expected, mean), "row {row}");
        assert!(is.counts[row] > 0 || is.stiffness_n_per_m[row] == mean, "row {row}");
    }
    let touched = |counts: &[u32]| counts.iter().filter(|&&count| count > 0).count();
    assert_eq!(mapped["cells_touched"], touched(&is.counts));
    assert_eq!(mapped["cells_expected"], expected);
    let both = touched(&is.counts[..expected]);
    assert!(0 < both && both < expected, "{both} of {expected}");
    assert_eq!(mapped["cells_expected_and_touched"], both);
    let (text, said) = printed(&mut with_prior(&scene, "out/first.npz", &[]));
    holds(&text, &[&format!("{expected}, {both} of them touched")]);
    holds(&said, &[&format!("the prior means of {expected} cells are `K` of")]);
    // The other touch is predicted from it as if it had been learnt.
    let report = json(&mut scene.predict(&["log/seq_0"], &["--json"]));
    assert!(report["overall"]["avg_relative"].as_f64() < Some(0.9), "{report}");

    let mut inspect = palpate();
    let text = succeed(inspect.arg("inspect").arg(scene.path("out/field.npz")));
    let more =
        format!("{} cells more without a learnt frame", is.cells.len() - touched(&is.counts));
    assert!(text.contains(&more), "{text}");
    assert!(text.contains(&format!("{} touched", touched(&is.counts))), "{text}");
}

#[test]
fn the_prior_means_of_a_field_take_precedence_over_its_learnt_stiffness() {
    let scene = scene();
    change(&scene, "out/first.npz", |saved| {
        saved.prior_n_per_m = Some(vec![0.125; saved.field.cells.len()]);
    });
    let (_, said) = printed(&mut with_prior(&scene, "out/first.npz", &[]));
    assert!(said.contains("are `K_prior` of"), "{said}");
    let (second, expected) = (field(&scene, "out/field.npz"), field(&scene, "out/first.npz"));
    let prior = second.prior_n_per_m.unwrap();
    let (expected, others) = prior.split_at(expected.field.cells.len());
    assert!(expected.iter().all(|&k| k == 0.125) && others.iter().all(|&k| k == 0.0));
    assert!(!others.is_empty());
}

#[test]
fn a_file_that_is_no_field_of_palpate_is_refused_as_a_prior() {
    let scene = scene();
    let mut cloud = Arrays::new();
    cloud.insert("points", Array::new(vec![2, 3], Data::F64(vec![0.0; 6])));
    for name in ["K", "K_std", "touched"] {
        cloud.insert(name, Array::flat(Data::F64(vec![1.0; 2])));
    }
    write_npz(&scene.path("cloud.npz"), &cloud).unwrap();
    let openvsf = "../palpate-io/testdata/openvsf.npz";
    let openvsf = Path::new(env!("CARGO_MANIFEST_DIR")).join(openvsf);
    std::fs::copy(openvsf, scene.path("openvsf.npz")).unwrap();
    for file in ["cloud.npz", "openvsf.npz"] {
        let words = [file, "cannot be a prior", "`palpate extrapolate --field`"];
        refuse(&mut with_prior(&scene, file, &[]), 1, &words);
    }
    refuse(&mut with_prior(&scene, "none.npz", &[]), 1, &["none.npz"]);
    assert_eq!(scene.results(), ["first.npz"]);
}

#[test]
fn a_prior_in_another_lattice_is_refused_with_the_flags_that_give_it() {
    let scene = scene();
    let mut coarser = with_prior(&scene, "out/first.npz", &["--settings"]);
    std::fs::write(scene.path("s.toml"), "[lattice]\n").unwrap();
    coarser.arg(scene.path("s.toml")).args(["--box-high-m", "1.0,1.2,1.2"]);
    let words = ["[80, 80, 80] points every 0.03 m", "[73, 80, 80] points", "make the prior again"];
    let said = refuse(&mut coarser, 2, &words);
    // The flags that the error gives work.
    let advice = said.split_once("give ").unwrap().1.split_once(", or make").unwrap().0;
    let mut map = scene.command("map", &["log/seq_1"]);
    map.arg("-o").arg(scene.path("out/field.npz"));
    map.arg("--prior").arg(scene.path("out/first.npz")).args(advice.split(' '));
    succeed(&mut map);
}

#[test]
fn a_prior_beside_from_or_of_impossible_stiffness_or_replaced_by_the_result_is_refused() {
    let scene = scene();
    let first = scene.text("out/first.npz");
    let both = ["--from", &first];
    refuse(&mut with_prior(&scene, "out/first.npz", &both), 2, &["--prior and --from exclude"]);
    let over = scene.map(&["log/seq_1"], &["--prior", &first, "-o", &first]);
    refuse(&mut { over }, 2, &["the prior (--prior)"]);
    change(&scene, "out/first.npz", |saved| saved.field.stiffness_n_per_m[3] = 1e10);
    let words = ["first.npz", "cannot be a prior", "is 10000000000 N/m"];
    refuse(&mut with_prior(&scene, "out/first.npz", &[]), 1, &words);
}

#[test]
fn a_prior_learnt_with_another_contact_model_is_used_and_reported() {
    let scene = scene();
    let more = ["--friction", "0.9", "--contact-distance-m", "0.03"];
    let (_, said) = printed(&mut with_prior(&scene, "out/first.npz", &more));
    let differs = ["friction is 0.3, not 0.9", "contact_distance_m is 0.024"];
    holds(&said, &[&["another contact model"], &differs[..]].concat());
    let (_, said) = printed(&mut with_prior(&scene, "out/first.npz", &[]));
    assert!(!said.contains("contact model"));
}

#[test]
fn a_picture_shows_touched_cells_and_not_those_with_a_prior_only() {
    let scene = scene();
    let svg = |name: &str| std::fs::read_to_string(scene.path(name)).unwrap();
    let plain = scene.text("out/plain.svg");
    succeed(&mut scene.map(&["log/seq_1"], &["--picture", &plain]));
    // A prior of zero, as in the settings, changes nothing except that there are more cells.
    change(&scene, "out/first.npz", |saved| saved.field.stiffness_n_per_m.fill(0.0));
    let expecting = scene.text("out/expecting.svg");
    succeed(&mut with_prior(&scene, "out/first.npz", &["--picture", &expecting]));
    assert!(svg("out/plain.svg") == svg("out/expecting.svg"));
}

#[test]
fn half_of_the_bundled_touches_improve_the_prediction_of_the_other_half() {
    let scene = Scene::new();
    let map = |touches: [&str; 3], to: &str, more: &[&str]| {
        let mut map = palpate();
        map.arg("map").args(touches.map(|touch| plant().join(touch))).args(more);
        map.args(["--json", "--no-cache", "--bake-spacing-m", "0.01", "--spacing-m", "0.024"]);
        json(map.args(["--replays", "3", "--tune=off", "-o", &scene.text(to)]))
    };
    map(["seq_000", "seq_002", "seq_004"], "out/half.npz", &[]);
    let others = ["seq_001", "seq_003", "seq_005"];
    let error =
        |report: serde_json::Value| report["before_learning"]["avg_error"].as_f64().unwrap();
    let alone = error(map(others, "out/alone.npz", &[]));
    let half = scene.text("out/half.npz");
    let after = error(map(others, "out/after.npz", &["--prior", &half]));
    assert!(after < alone, "{after} N·m with the prior, {alone} N·m without");
}
