//! Bags exchanged with other programs: bags that these write give the same field, and they can read
//! the bags that are written here. They run in the Python environment that ./setup makes.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs;
use std::path::Path;
use std::process::Command;

use common::{Scene, json, palpate, plant, python, refuse, root, samples, succeed, write_touch};
use nalgebra::Vector3;
use palpate::{Robot, Sample};
use palpate_io::field::{load, to_bytes};
use serde_json::Value;
use tempfile::TempDir;

/// The script that writes and reads bags.
fn script(arguments: &[&Path]) -> Command {
    let mut command = python();
    command.arg(root().join("scripts/ros2_bags.py")).args(arguments);
    command
}

/// Bags of the bundled touches, as other programs write them.
fn bags(of: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    succeed(&mut script(&[Path::new(of), &plant(), folder.path()]));
    folder
}

/// The field that is learnt from a log, whatever its touches are called.
fn field(log: &Path, more: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    // Two replays distinguish logs as well as twenty.
    succeed(
        palpate()
            .arg("map")
            .arg(log)
            .arg("-o")
            .arg(&path)
            .args(["--tune=off", "--replays", "2"])
            .args(more),
    );
    let mut saved = load(&path).unwrap();
    let snapshot = saved.snapshot.as_mut().unwrap();
    snapshot.sample_log.iter_mut().for_each(|touch| touch.name.clear());
    to_bytes(&saved)
}

/// The messages that another program's reader finds, one per line.
fn lines(reader: &str, bag: &Path) -> Vec<Value> {
    let text = succeed(&mut script(&[Path::new(reader), bag]));
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn needs_rosbags_touches_written_by_rosbags_give_the_field_of_the_arrays_bit_for_bit() {
    let bags = bags("write");
    let arrays = field(&plant(), &[]);
    for bag in ["mcap_zstd", "mcap_plain", "sqlite"] {
        let found = field(&bags.path().join(bag), &["--touch-topic", "/marker"]);
        assert!(found == arrays, "{bag} gives another field");
    }
    // Without marks, touches are separated by the pauses between them.
    let found = field(&bags.path().join("mcap_zstd/mcap_zstd.mcap"), &["--split-gap-s", "5"]);
    assert!(found == arrays, "gaps give another field");
    for packed in ["message_zstd", "file_zstd"] {
        let mut map = palpate();
        map.arg("map").arg(bags.path().join(packed)).arg("-o").arg(bags.path().join("field.npz"));
        refuse(&mut map, 1, &["metadata.yaml", "compressed by itself", "ros2 bag convert"]);
    }
}

#[test]
fn needs_rosbags_robot_states_of_franka_are_followed_by_their_definition_and_hold_no_gravity() {
    let bags = bags("states");
    let removed = ["--gravity", "removed", "--torque-sign", "minus"];
    let arrays = field(&plant().join("seq_000"), &removed);
    for layout in ["franka_new", "franka_old"] {
        assert!(field(&bags.path().join(layout), &[]) == arrays, "{layout}");
        let mut map = palpate();
        map.arg("map").arg(bags.path().join(layout)).arg("-o").arg(bags.path().join("field.npz"));
        refuse(map.args(["--gravity", "included"]), 2, &["external torques", "--gravity removed"]);
        let report = json(palpate().arg("inspect").arg(bags.path().join(layout)).arg("--json"));
        assert_eq!(report["paths"][0]["format"], "mcap", "{report}");
    }
}

#[test]
fn needs_rosbags_external_torques_of_kuka_have_the_sign_plus() {
    let (bags, folder) = (bags("states"), tempfile::tempdir().unwrap());
    let negated = samples(&plant().join("seq_000")).into_iter().map(|sample| {
        let tau = sample.tau.iter().map(|tau| -tau).collect();
        Sample::new(sample.time_s, sample.q, tau)
    });
    write_touch(folder.path(), &negated.collect::<Vec<_>>());
    let arrays = field(folder.path(), &["--gravity", "removed", "--torque-sign", "plus"]);
    assert!(field(&bags.path().join("lbr"), &[]) == arrays);
    let mut map = palpate();
    map.arg("map").arg(bags.path().join("lbr")).arg("-o").arg(bags.path().join("field.npz"));
    refuse(map.args(["--gravity", "included"]), 2, &["external torques", "--gravity removed"]);
    // Another number of joints than the robot has.
    let scene = Scene::new();
    let mut map = palpate();
    map.arg("map").arg(bags.path().join("lbr")).arg("-o").arg(bags.path().join("field.npz"));
    let wanted = "the log has 7 joints, the robot `tiny` has";
    refuse(map.args(scene.settings()).arg("--strict"), 1, &["joint_count", wanted]);
}

#[test]
fn needs_rosbags_states_of_kinova_are_in_degrees_and_contain_gravity() {
    let bags = bags("states");
    let (bag, arrays) = (bags.path().join("kortex"), plant().join("seq_000"));
    let robot = Robot::built_in("kinova_gen3").unwrap();
    for (found, expected) in samples(&bag).iter().zip(samples(&arrays)) {
        let off = robot.difference(&expected.q, &found.q);
        assert!(off.iter().all(|off| off.abs() < 1e-5), "{off:?}");
        assert!(found.tau.iter().zip(&expected.tau).all(|(a, b)| (a - b).abs() < 1e-5));
    }
    let of = |log: &Path| json(palpate().arg("inspect").arg(log).arg("--json"));
    let (found, expected) = (of(&bag), of(&arrays));
    assert_eq!(found["paths"][0]["findings"], expected["paths"][0]["findings"]);
    let reading = &found["paths"][0]["reading"];
    assert_eq!(reading["torque_sign"], "plus", "{reading}");
    assert_eq!(reading["gravity"], "included", "{reading}");
}

#[test]
fn needs_rosbags_bags_written_here_are_read_by_rosbags_and_by_mcap_ros2() {
    let folder = tempfile::tempdir().unwrap();
    let touch = plant().join("seq_003");
    for packed in ["zstd", "lz4", "none"] {
        let bag = folder.path().join(format!("{packed}.mcap"));
        let mut convert = palpate();
        convert.arg("convert").arg(&touch).arg("-o").arg(&bag).args(["--compression", packed]);
        succeed(&mut convert);
        let by_mcap = lines("read-mcap", &bag);
        assert_eq!(lines("read", &bag), by_mcap, "the two readers differ: {packed}");
        assert_eq!(by_mcap[0]["topic"], "/palpate/touch");
        assert_eq!(by_mcap[0]["data"], "seq_003");
        let (states, samples) = (&by_mcap[1..], samples(&touch));
        assert_eq!((states.len(), samples.len()), (400, 400));
        assert_eq!(states[0]["name"][6], "Actuator7");
        for (state, sample) in states.iter().zip(samples) {
            assert_eq!(state["position"], serde_json::json!(sample.q), "{packed}");
            assert_eq!(state["effort"], serde_json::json!(sample.tau), "{packed}");
        }
    }
}

#[test]
fn needs_rosbags_a_wrench_in_a_bag_is_that_of_the_table_in_the_frame_of_its_link() {
    let folder = tempfile::tempdir().unwrap();
    let write = |file: &str| {
        let mut torque = palpate();
        torque.arg("torque").arg(plant().join("seq_003")).arg("-o").arg(folder.path().join(file));
        succeed(torque.args(["--json", "--wrench-link", "Bracelet_Link"]));
        folder.path().join(file)
    };
    let bag = write("torques.mcap");
    let all = lines("read", &bag);
    assert_eq!(lines("read-mcap", &bag), all, "the two readers differ");
    let wrenches = all.iter().filter(|line| line["topic"] == "/palpate/wrench");
    let table = fs::read_to_string(write("torques.csv")).unwrap();
    let mut rows = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = rows.next().unwrap();
    let columns = ["fx", "fy", "fz", "mx", "my", "mz"]
        .map(|name| names.iter().position(|own| *own == name).unwrap());
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let link = robot.link_id("Bracelet_Link").unwrap();
    let (rows, samples) = (rows.collect::<Vec<_>>(), samples(&plant().join("seq_003")));
    assert_eq!([rows.len(), samples.len(), wrenches.clone().count()], [400; 3]);
    for ((wrench, row), sample) in wrenches.zip(rows).zip(samples) {
        assert_eq!(wrench["link"], "Bracelet_Link");
        let found: Vec<f64> = serde_json::from_value(wrench["wrench"].clone()).unwrap();
        let wanted = columns.map(|column| row[column].parse::<f64>().unwrap());
        let rotation = robot.forward(&sample.q).unwrap().world_from_link[link.index()].rotation;
        for of in [0, 3] {
            let [found, wanted] =
                [&found[of..], &wanted[of..]].map(|own| Vector3::new(own[0], own[1], own[2]));
            assert!((rotation * found - wanted).norm() < 1e-9, "{found} in the link, {wanted}");
        }
    }
}

#[test]
fn a_log_turned_into_every_format_and_back_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let convert = |from: &Path, to: &Path| {
        succeed(palpate().arg("convert").arg(from).arg("-o").arg(to));
    };
    let touches = plant();
    convert(&touches, &at("a.mcap"));
    convert(&at("a.mcap"), &at("b.csv"));
    convert(&at("b.csv"), &at("c.mcap"));
    assert!(fs::read(at("a.mcap")).unwrap() == fs::read(at("c.mcap")).unwrap(), "a bag is another");
    convert(&at("c.mcap"), &at("arrays"));
    assert_eq!(
        common::names(&at("arrays")),
        (0..11).map(|i| format!("seq_{i:03}")).collect::<Vec<_>>()
    );
    for touch in common::names(&at("arrays")) {
        for array in ["angles.npy", "torques.npy"] {
            let read =
                |folder: &Path| fs::read(folder.join(&touch).join(array)).unwrap().split_off(128);
            assert!(read(&at("arrays")) == read(&touches), "{touch}/{array}");
        }
    }
    refuse(
        palpate().arg("convert").arg(at("b.csv")).arg("-o").arg(at("arrays")),
        1,
        &["arrays", "exists already"],
    );
    refuse(
        palpate().arg("convert").arg(at("b.csv")).arg("-o").arg(at("x.txt")),
        2,
        &[".mcap, .csv"],
    );
}

#[test]
fn arrays_that_convert_writes_are_in_the_robots_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let joints: Vec<u32> = (1..=7).rev().collect();
    let names = |what: &str| joints.iter().map(|j| format!("joint_{j}_{what}")).collect::<Vec<_>>();
    let header = [names("position"), names("effort")].concat().join(",");
    let numbers: Vec<String> = joints
        .iter()
        .flat_map(|j| [format!("0.{j}")])
        .chain(joints.iter().map(|j| format!("{j}")))
        .collect();
    let row = numbers.join(",");
    fs::write(path("log.csv"), format!("{header}\n{row}\n{row}\n")).unwrap();
    let convert = |from: &str, to: &str, more: &[&str]| {
        let mut command = palpate();
        command.arg("convert").arg(path(from)).arg("-o").arg(path(to)).args(more);
        common::stderr(&command.output().unwrap())
    };
    convert("log.csv", "robot", &["--robot", "kinova_gen3"]);
    convert("robot", "robot.csv", &[]);
    let text = fs::read_to_string(path("robot.csv")).unwrap();
    let first = text.lines().nth(1).unwrap();
    assert!(first.ends_with("0.1,0.2,0.3,0.4,0.5,0.6,0.7,1,2,3,4,5,6,7"), "{first}");
    // Without --robot.
    let message = convert("log.csv", "log", &[]);
    assert!(message.contains("joint_7, joint_6") && message.contains("--robot"), "{message}");
    let (_, seven) = (convert("log", "log.out.csv", &[]), fs::read_to_string(path("log.out.csv")));
    assert!(seven.unwrap().lines().nth(1).unwrap().contains("0.7,0.6"));
}
