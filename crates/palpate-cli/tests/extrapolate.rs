//! `palpate extrapolate`: a cloud in its own order, a field to continue from, and bad input.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use common::{holds, json, npy, palpate, plant, printed, refuse, succeed};
use nalgebra::{Point3, Vector3};
use palpate_io::cloud::{self, Cloud};
use palpate_io::field::load;
use palpate_io::field::npz::read_npz;
use tempfile::TempDir;

/// A folder with fields of two bundled touches, with memory and without, learnt once for all tests.
fn scene() -> &'static TempDir {
    static SCENE: OnceLock<TempDir> = OnceLock::new();
    SCENE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        for (name, more) in [("field.npz", &[][..]), ("forgetful.npz", &["--no-memory"])] {
            let mut map = palpate();
            map.arg("map").args(["seq_002", "seq_008"].map(|touch| plant().join(touch)));
            map.args(["--replays", "2", "-o"]).arg(folder.path().join(name)).args(more);
            succeed(&mut map);
        }
        folder
    })
}

/// `palpate extrapolate` of one of the fields.
fn extrapolate(field: &str, cloud: &Path, output: &Path) -> Command {
    let mut command = palpate();
    command.args(["--quiet", "extrapolate"]).arg(scene().path().join(field)).arg(cloud);
    command.arg("-o").arg(output);
    command
}

fn object() -> Cloud {
    cloud::read(&plant().join("object.ply")).unwrap().cloud
}

/// Every n-th point of the object, moved and with or without its colours, as PLY.
fn written(path: &Path, every: usize, by: Vector3<f64>, coloured: bool) -> PathBuf {
    let object = object();
    let points: Vec<Point3<f64>> = object.points().iter().step_by(every).map(|p| p + by).collect();
    let colours = object.colours().unwrap().iter().step_by(every).copied().collect();
    let cloud = Cloud::new(points, coloured.then_some(colours));
    cloud::write_ply(path, &cloud, &[]).unwrap();
    path.to_owned()
}

#[test]
fn every_point_gets_a_stiffness_in_the_clouds_own_order() {
    let out = tempfile::tempdir().unwrap();
    let (npz, ply) = (out.path().join("seen.npz"), out.path().join("seen.ply"));
    let summary = json(extrapolate("field.npz", &plant().join("object.ply"), &npz).arg("--json"));
    assert_eq!((&summary["method"], &summary["features"]), (&"torque".into(), &"chroma".into()));
    assert_eq!(summary["points"], 29_000);
    let arrays = read_npz(&npz).unwrap();
    let n = Some(29_000);
    let points = arrays.floats("points", &[n, Some(3)]).unwrap();
    let object = object();
    let in_order = points.chunks(3).zip(object.points()).all(|(a, b)| a == b.coords.as_slice());
    assert!(in_order, "the cloud's own order");
    let k = arrays.floats("K", &[n]).unwrap();
    let std = arrays.floats("K_std", &[n]).unwrap();
    assert!(k.iter().chain(&std).all(|value| *value >= 0.0));
    let touched = arrays.counts("touched", &[n]).unwrap();
    assert_eq!(touched.iter().sum::<u64>(), summary["touched"].as_u64().unwrap());

    succeed(&mut extrapolate("field.npz", &plant().join("object.ply"), &ply));
    let read = cloud::read(&ply).unwrap().cloud;
    assert_eq!((read.points(), read.colours()), (object.points(), object.colours()));
    assert!(fs::read_to_string(&ply).is_err(), "binary");
}

#[test]
fn a_picture_with_depth_serves_as_a_cloud_and_truth_is_read_only_when_asked() {
    let out = tempfile::tempdir().unwrap();
    let npz = out.path().join("seen.npz");
    // The folder of the data set, whose rgbd/ is used; the box excludes floor and walls.
    let mut command = extrapolate("field.npz", &plant(), &npz);
    command.args(["--crop-low-m=0.2,-0.4,0.02", "--crop-high-m=1.0,0.4,1.0", "--json"]);
    let summary = json(&mut command);
    assert!(summary["points"].as_u64().unwrap() > 20_000, "{summary}");
    assert!(summary["truth"].is_null());
    let mut command = extrapolate("field.npz", &plant().join("object.ply"), &npz);
    let summary = json(command.arg("--json").arg("--truth").arg(plant().join("truth")));
    assert!(summary["truth"]["untouched"]["auc"].is_f64(), "{summary}");
}

#[test]
fn untouched_cells_get_a_prior_mean_from_which_mapping_continues() {
    let out = tempfile::tempdir().unwrap();
    let [npz, filled, more] = ["seen.npz", "filled.npz", "more.npz"].map(|n| out.path().join(n));
    let mut command = extrapolate("field.npz", &plant().join("object.ply"), &npz);
    let summary = json(command.arg("--json").arg("--field").arg(&filled));
    let (before, after) =
        (load(&scene().path().join("field.npz")).unwrap(), load(&filled).unwrap());
    let touched = before.field.cells.len();
    assert_eq!(after.field.cells[..touched], before.field.cells[..]);
    assert_eq!(after.field.stiffness_n_per_m[..touched], before.field.stiffness_n_per_m[..]);
    let expected = after.field.counts[touched..].iter().filter(|count| **count == 0).count();
    assert_eq!(expected as u64, summary["cells_expected"].as_u64().unwrap());
    assert!(expected > 1000, "{expected}");
    let prior = after.prior_n_per_m.unwrap();
    assert_eq!(prior[touched..], after.field.stiffness_n_per_m[touched..]);

    let go_on = |flag: &str| {
        let mut map = palpate();
        map.arg("map").arg(plant().join("seq_005")).arg(flag).arg(&filled);
        json(map.arg("-o").arg(&more).arg("--json"))
    };
    let from = go_on("--from");
    assert_eq!(from["cells_expected"], expected as u64 + touched as u64, "{from}");
    let mut map = palpate();
    map.arg("map").arg(plant().join("seq_005")).arg("--prior").arg(&filled);
    json(map.args(["--replays", "2", "--json", "-o"]).arg(&more));
}

#[test]
fn without_a_method_touches_held_out_choose_it() {
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name);
    let touches = ["seq_001", "seq_002", "seq_005", "seq_008"];
    let mut map = palpate();
    map.arg("map").args(touches.map(|touch| plant().join(touch)));
    succeed(map.args(["--replays", "2", "--tune=off", "-o"]).arg(path("four.npz")));
    let of_four = |more: &[&str]| {
        let mut command = palpate();
        command.arg("extrapolate").arg(path("four.npz")).arg(plant().join("object.ply"));
        command.arg("-o").arg(path("seen.npz")).args(["--json", "--compare"]).args(more);
        json(command.arg("--field").arg(path("filled.npz")))
    };
    let chosen = of_four(&[]);
    let [with, without] = ["with", "without"].map(|key| chosen["held_out"][key].as_f64().unwrap());
    let mean = |row: usize| chosen["compare"][row]["avg_relative"]["mean"].as_f64().unwrap();
    assert_eq!([without, with], [mean(1), mean(3)], "the comparison begins with the chosen method");
    let cells = chosen["cells_expected"].as_u64().unwrap();
    assert_eq!(cells > 0, with <= 1.01 * without, "{chosen}");

    let given = of_four(&["--method", "torque"]);
    assert!(given["held_out"].is_null() && given["cells_expected"].as_u64() > Some(0), "{given}");
}

#[test]
fn a_second_cloud_keeps_the_prior_means_of_the_first() {
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name);
    let object = object();
    let of = |name: &str, keep: &dyn Fn(&Point3<f64>) -> bool| {
        let both = object.points().iter().zip(object.colours().unwrap());
        let (points, colours) =
            both.filter(|(point, _)| keep(point)).map(|(p, c)| (*p, *c)).unzip();
        let cloud = Cloud::new(points, Some(colours));
        cloud::write_ply(&path(name), &cloud, &[]).unwrap();
        path(name)
    };
    // No cell is within reach of both.
    let (left, right) = (of("left.ply", &|p| p.y > 0.1), of("right.ply", &|p| p.y <= 0.0));
    let (first, second) = (path("first.npz"), path("second.npz"));
    let seen = path("seen.npz");
    succeed(extrapolate("field.npz", &left, &seen).arg("--field").arg(&first));
    let mut command = palpate();
    command.args(["--quiet", "extrapolate"]).arg(&first).arg(&right).arg("-o").arg(&seen);
    succeed(command.arg("--field").arg(&second));
    let (first, second) = (load(&first).unwrap(), load(&second).unwrap());
    let n = first.field.cells.len();
    assert!(second.field.cells.len() > n + 1000);
    let [before, after] = [&first, &second].map(|saved| saved.prior_n_per_m.as_ref().unwrap());
    let kept = |row: &usize| {
        first.field.counts[*row] == 0
            && after[*row] == before[*row]
            && second.field.stiffness_n_per_m[*row] == before[*row]
    };
    let expected = (0..n).filter(|row| first.field.counts[*row] == 0).count();
    let kept = (0..n).filter(kept).count();
    assert_eq!(kept, expected);
}

#[test]
fn pictures_and_page_are_written_and_a_comparison_lists_all_methods() {
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name);
    let cloud = written(&path("thin.ply"), 10, Vector3::zeros(), true);
    let mut command = extrapolate("field.npz", &cloud, &path("seen.pcd"));
    command.args(["--compare", "--halves", "1", "--simulated", "--picture"]).arg(path("fig4.png"));
    let text = succeed(command.arg("--report").arg(path("seen.html")));
    let again = "torque chroma, learnt again";
    holds(&text, &["predicting zero", "no prior", again, "knn rgb, where"]);
    assert!(fs::read(path("fig4.png")).unwrap().starts_with(b"\x89PNG"));
    let page = fs::read_to_string(path("seen.html")).unwrap();
    assert!(page.contains("The touches are simulated") && page.contains("cells chroma"));
    assert_eq!(cloud::read(&path("seen.pcd")).unwrap().cloud.len(), 2900);
}

#[test]
fn a_field_without_memory_falls_back_on_its_cells() {
    let out = tempfile::tempdir().unwrap();
    let cloud = plant().join("object.ply");
    let npz = out.path().join("seen.npz");
    let summary = json(extrapolate("forgetful.npz", &cloud, &npz).arg("--json"));
    assert_eq!((&summary["method"], &summary["features"]), (&"knn".into(), &"rgb".into()));
    for method in ["cells", "knn"] {
        let mut command = extrapolate("forgetful.npz", &cloud, &npz);
        succeed(command.args(["--method", method, "--features", "oklab+height+shape"]));
    }
    let mut command = extrapolate("forgetful.npz", &cloud, &npz);
    refuse(command.args(["--method", "torque"]), 1, &["forgetful.npz", "knn", "memory"]);
    let mut command = extrapolate("forgetful.npz", &cloud, &npz);
    refuse(command.arg("--compare"), 1, &["remembers no touch", "--no-memory"]);
}

#[test]
fn useless_clouds_are_refused_and_nothing_is_written() {
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name);
    let npz = path("seen.npz");
    let grey = written(&path("grey.ply"), 100, Vector3::zeros(), false);
    refuse(&mut extrapolate("field.npz", &grey, &npz), 1, &["grey.ply", "no colours"]);
    let away = written(&path("away.ply"), 100, Vector3::new(0.0, 4.0, 0.0), true);
    refuse(&mut extrapolate("field.npz", &away, &npz), 1, &["away.ply", "touched cells are 3."]);
    let cloud = Cloud::new(vec![Point3::new(0.55, -0.07, 0.18)], Some(vec![[1, 2, 3]]));
    cloud::write_ply(&path("base.ply"), &cloud, &[]).unwrap();
    let words = ["base.ply", "no touched cell lies at a point of the cloud"];
    refuse(&mut extrapolate("field.npz", &path("base.ply"), &npz), 1, &words);
    let bytes = fs::read(plant().join("object.ply")).unwrap();
    fs::write(path("cut.ply"), &bytes[..bytes.len() / 2]).unwrap();
    refuse(&mut extrapolate("field.npz", &path("cut.ply"), &npz), 1, &["cut.ply", "truncated"]);
    refuse(&mut extrapolate("field.npz", &path("none.ply"), &npz), 1, &["none.ply"]);
    refuse(&mut extrapolate("field.npz", out.path(), &npz), 1, &["no colour image", "color.png"]);
    assert!(!npz.exists());
}

#[test]
fn a_cloud_that_is_mostly_background_is_warned_of() {
    let out = tempfile::tempdir().unwrap();
    let said = |cloud: &Path| {
        printed(&mut extrapolate("field.npz", cloud, &out.path().join("seen.npz"))).1
    };
    let alone = written(&out.path().join("alone.ply"), 20, Vector3::zeros(), true);
    assert_eq!(said(&alone), "");
    let object = cloud::read(&alone).unwrap().cloud;
    let behind = object.points().iter().map(|point| point + Vector3::new(0.0, 3.0, 0.0));
    let points = object.points().iter().copied().chain(behind.clone()).chain(behind).collect();
    let colours = object.colours().unwrap().repeat(3);
    let room = out.path().join("room.ply");
    cloud::write_ply(&room, &Cloud::new(points, Some(colours)), &[]).unwrap();
    let said = said(&room);
    assert!(said.contains("--crop-low-m"), "{said}");
}

#[test]
fn pictures_that_do_not_fit_are_refused() {
    let out = tempfile::tempdir().unwrap();
    let npz = out.path().join("seen.npz");
    let rgbd = out.path().join("rgbd");
    fs::create_dir(&rgbd).unwrap();
    for name in ["color.png", "depth.png", "camera.json"] {
        fs::copy(plant().join("rgbd").join(name), rgbd.join(name)).unwrap();
    }
    npy(&rgbd.join("depth.npy"), &[4, 5], &[1.0; 20]);
    fs::remove_file(rgbd.join("depth.png")).unwrap();
    refuse(&mut extrapolate("field.npz", &rgbd, &npz), 1, &["640", "5"]);
    fs::copy(plant().join("rgbd/depth.png"), rgbd.join("depth.png")).unwrap();
    let range = |range: &str| {
        let mut command = extrapolate("field.npz", &rgbd, &npz);
        command.args(["--depth-range-m", range]);
        command
    };
    refuse(&mut range("0.1"), 2, &["two numbers with a comma between"]);
    refuse(&mut range("2,1"), 2, &["0 ≤ near < far"]);
    refuse(&mut range("8,9"), 1, &["depth"]);
    let camera = fs::read_to_string(rgbd.join("camera.json")).unwrap();
    fs::write(rgbd.join("camera.json"), camera.replace("\"fx\": 5", "\"fx\": -5")).unwrap();
    refuse(&mut extrapolate("field.npz", &rgbd, &npz), 1, &["camera.json"]);
    fs::write(rgbd.join("camera.json"), camera).unwrap();
    let mut metres = extrapolate("field.npz", &rgbd, &npz);
    refuse(metres.args(["--depth-unit-m", "1"]), 1, &["depth"]);
    let mut pose = extrapolate("field.npz", &rgbd, &npz);
    // The camera looks away from all that was touched.
    refuse(pose.args(["--camera-pose", "0 0 0 0 0 0 1"]), 1, &["touched cells are"]);
}

#[test]
fn flags_that_cannot_be_followed_are_refused() {
    let out = tempfile::tempdir().unwrap();
    let (cloud, npz) = (plant().join("object.ply"), out.path().join("seen.npz"));
    let of = |more: &[&str]| {
        let mut command = extrapolate("field.npz", &cloud, &npz);
        command.args(more);
        command
    };
    refuse(&mut of(&["--features", "hue"]), 2, &["hue", "chroma"]);
    refuse(&mut of(&["--method", "guess"]), 2, &["torque, cells or knn"]);
    refuse(&mut of(&["--length-scale", "0"]), 2, &["length_scale", "0"]);
    refuse(&mut of(&["--crop-low-m=1,1,1", "--crop-high-m=0,0,0"]), 2, &["inside out"]);
    refuse(&mut extrapolate("field.npz", &cloud, &out.path().join("seen")), 2, &[".npz, .ply or"]);
    let field = scene().path().join("field.npz");
    let mut over = extrapolate("field.npz", &cloud, &npz);
    refuse(over.arg("--field").arg(&field), 2, &["which is the field"]);
    refuse(&mut of(&["--reach-cells", "100"]), 2, &["reach_cells", "from 0.5 to 4"]);
    refuse(&mut of(&["--picture", "fig4.png", "--threshold", "nan"]), 2, &["from 0 on"]);
}
