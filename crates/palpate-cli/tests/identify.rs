//! `palpate identify`, `torque` and `excite` on simulated logs, and their messages for unsuitable logs.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::cell::{Cell, RefCell};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use std::process::Command;

use common::{
    Scene, holds, json, npy, palpate, printed, python, refuse, root, samples, succeed, touches,
    write_touch,
};
use palpate::unstable::FrictionState;
use palpate::{Payload, Robot, Sample};
use serde_json::Value;

const RATE_HZ: f64 = 50.0;
const FRAMES: usize = 500;

/// The Gen3 with 1 kg on its last link.
fn loaded() -> Robot {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let link = robot.links()[robot.bodies().last().unwrap().index()].name.clone();
    robot.with_payload(&Payload::new(link, 1.0, [0.0, 0.02, -0.1])).unwrap()
}

/// Writes a log of free motion of the Gen3 with 1 kg on its last link, 0.4 N·m of Coulomb friction and 0.2 N·m of
/// bias, in three touches; for `pushed`, 3 N·m act on all joints in a second of the last one.
fn write_logs(folder: &Path, pushed: bool) {
    let robot = loaded();
    let n = robot.n_joints();
    for touch in 0..3 {
        let mut samples: Vec<Sample> = Vec::new();
        let mut friction = vec![FrictionState::default(); n];
        for frame in 0..FRAMES {
            let t = frame as f64 / RATE_HZ;
            let wave = |j: usize, k: usize| {
                let w = TAU * 0.07 * (k + 1) as f64;
                let phase = (1 + j * 3 + k * 5 + touch * 7) as f64;
                (0.3 / (k + 1) as f64, w, w * t + phase)
            };
            let sum = |of: fn((f64, f64, f64)) -> f64| -> Vec<f64> {
                (0..n).map(|j| (0..3).map(|k| of(wave(j, k))).sum()).collect()
            };
            let q: Vec<f64> = sum(|(a, _, x)| a * x.sin()).iter().map(|q| q + 0.4).collect();
            let speed = sum(|(a, w, x)| a * w * x.cos());
            let acceleration = sum(|(a, w, x)| -a * w * w * x.sin());
            let motor = robot.inverse_dynamics(&robot.forward(&q).unwrap(), &speed, &acceleration);
            let mut tau = Vec::new();
            for j in 0..n {
                friction[j].advance(q[j] - samples.last().map_or(q[j], |last| last.q[j]), 2e-3);
                let push =
                    if pushed && touch == 2 && (200..250).contains(&frame) { 3.0 } else { 0.0 };
                // Noise without a generator: a chaotic sequence.
                let noise = 0.03 * ((frame * 7919 + j * 104_729) as f64).sin();
                tau.push(-motor[j] - 0.4 * friction[j].middle() + 0.2 + push + noise);
            }
            samples.push(Sample::new(Some(t), q, tau));
        }
        write_touch(&folder.join(format!("seq_{touch}")), &samples);
    }
}

/// Writes the log as Universal Robots' RTDE does: separated by spaces, with motor currents in columns `name`; 1 A is
/// `n_m` N·m, with the sign of motor torques if it is below 0.
fn write_currents(folder: &Path, log: &Path, (name, n_m): (&str, f64)) {
    fs::create_dir(folder).unwrap();
    for touch in 0..3 {
        let mut text = "timestamp".to_owned();
        for what in ["actual_q", name] {
            (0..7).for_each(|j| text += &format!(" {what}_{j}"));
        }
        let samples = samples(&log.join(format!("seq_{touch}")));
        for (frame, sample) in samples.iter().enumerate() {
            text += &format!("\n{}", frame as f64 / RATE_HZ);
            let currents = sample.tau.iter().map(|tau| tau / n_m);
            sample.q.iter().copied().chain(currents).for_each(|x| text += &format!(" {x}"));
        }
        fs::write(folder.join(format!("robot_data_{touch}.csv")), text).unwrap();
    }
}

/// The flags for sign and gravity of the torques of these logs.
const MEASURED: [&str; 4] = ["--torque-sign", "plus", "--gravity", "included"];

/// Writes `free`, `pushed` and `arm.toml`, the arm identified from `free`.
fn write_identified(folder: &Path) {
    write_logs(&folder.join("free"), false);
    write_logs(&folder.join("pushed"), true);
    let mut identify = identify(&folder.join("free"));
    succeed(identify.arg("--quiet").args(MEASURED).arg("-o").arg(folder.join("arm.toml")));
}

/// Writes the first touch of a log again, with other samples.
fn write_changed(from: &Path, to: &Path, change: impl Fn(&mut Sample)) {
    let mut samples = samples(&from.join("seq_0"));
    samples.iter_mut().for_each(change);
    write_touch(to, &samples);
}

/// Writes all touches with times that are multiplied by `factor`.
fn write_in_unit(from: &Path, to: &Path, factor: f64) {
    for touch in ["seq_0", "seq_1", "seq_2"] {
        let mut samples = samples(&from.join(touch));
        let times = samples.iter_mut().filter_map(|sample| sample.time_s.as_mut());
        times.for_each(|time| *time *= factor);
        write_touch(&to.join(touch), &samples);
    }
}

fn identify(log: &Path) -> Command {
    let mut identify = palpate();
    identify.arg("identify").arg(log);
    identify
}

fn torque(log: &Path, arm: &Path) -> Command {
    let mut torque = palpate();
    torque.arg("torque").arg(log).arg("--arm").arg(arm);
    torque
}

#[test]
fn currents_of_a_ur_get_gains_and_are_refused_without_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    write_currents(&path("currents"), &path("free"), ("actual_current", -12.5));
    let mut identify = identify(&path("currents"));
    identify.args(["--json", "--payload-link", "Bracelet_Link"]);
    identify.args(["--payload-mass-kg", "1", "--payload-com-m", "0,0.02,-0.1"]);
    let found = json(identify.arg("-o").arg(path("arm.toml")));
    for joint in &found["joints"].as_array().unwrap()[1..6] {
        assert!((joint["gain"]["value"].as_f64().unwrap() * 12.5 - 1.0).abs() < 0.05, "{joint}");
    }
    assert_eq!(found["notes"].as_array().unwrap().len(), 0, "{}", found["notes"]);
    let mut torque = torque(&path("currents"), &path("arm.toml"));
    let report = json(torque.args(["--json", "--strict"]));
    assert_eq!(report["contacts"].as_array().unwrap().len(), 0, "{report}");

    for (command, output) in [("torque", "none.csv"), ("map", "none.npz")] {
        refuse(
            palpate().arg(command).arg(path("currents")).args(["-o"]).arg(path(output)),
            2,
            &["/currents`", "motor currents", "palpate identify", "--arm"],
        );
    }
    let report = json(palpate().args(["inspect", "--json"]).arg(path("currents")));
    let findings = report["paths"][0]["findings"].as_array().unwrap();
    assert_eq!((findings.len(), &findings[0]["code"]), (1, &"currents".into()));
}

#[test]
fn currents_in_arrays_are_recognised_by_the_names_of_universal_robots() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    let samples = samples(&path("free/seq_0"));
    let table = |of: fn(&Sample) -> &[f64]| -> Vec<f64> {
        samples.iter().flat_map(|sample| of(sample).to_vec()).collect()
    };
    fs::create_dir(path("currents")).unwrap();
    let shape = [samples.len(), 7];
    npy(&path("currents/actual_q.npy"), &shape, &table(|sample| &sample.q));
    npy(&path("currents/actual_current.npy"), &shape, &table(|sample| &sample.tau));
    refuse(
        palpate().arg("torque").arg(path("currents")).arg("-o").arg(path("none.csv")),
        2,
        &["/currents`", "motor currents", "palpate identify"],
    );
    let report = json(palpate().args(["inspect", "--json"]).arg(path("currents")));
    assert_eq!(report["paths"][0]["findings"][0]["code"], "currents");
}

#[test]
fn columns_of_external_torques_contain_no_gravity_and_get_their_sign_from_work() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_identified(folder.path());
    let robot = loaded();
    // Writes `factor` times the torques without a share of those of gravity.
    let write = |log: &str, factor: f64, share: f64| {
        let joint = |what: &str| (0..7).map(|j| format!(",{what}_{j}")).collect::<String>();
        let mut text = format!("time{}{}", joint("q"), joint("external_torque"));
        for sample in samples(&path("free/seq_0")) {
            text += &format!("\n{}", sample.time_s.unwrap());
            let gravity = robot.gravity_torque(&robot.forward(&sample.q).unwrap());
            let torques = sample.tau.iter().zip(&gravity);
            let external = torques.map(|(tau, gravity)| factor * (tau - share * gravity));
            sample.q.iter().copied().chain(external).for_each(|x| text += &format!(",{x}"));
        }
        fs::write(path(log), text).unwrap();
    };
    let known = "holds external torques: gravity is not subtracted";
    for (log, factor, word) in [("plus.csv", 1.0, "plus"), ("minus.csv", -1.0, "minus")] {
        write(log, factor, 1.0);
        let (_, said) = printed(palpate().args(["torque", "--json"]).arg(path(log)));
        holds(
            &said,
            &[known, &format!("the torques contain no gravity, and their sign is {word}")],
        );
        let report = json(palpate().args(["inspect", "--json"]).arg(path(log)));
        assert!(!report["paths"][0]["findings"].to_string().contains("\"gravity\""), "{report}");
        refuse(
            palpate().args(["torque", "--gravity", "included", "--json"]).arg(path(log)),
            2,
            &["external torques, from which the robot has subtracted gravity"],
        );
    }
    let renamed = fs::read_to_string(path("plus.csv")).unwrap();
    let renamed = renamed.replace("external_torque_", "tau_ext_hat_filtered_");
    fs::write(path("franka.csv"), renamed).unwrap();
    let both = || {
        let mut command = palpate();
        command.args(["torque", "--json"]).arg(path("plus.csv")).arg(path("franka.csv"));
        command
    };
    refuse(&mut both(), 2, &["whose signs may differ", "--torque-sign"]);
    succeed(both().args(["--torque-sign", "plus"]));
    let mut with_arm = torque(&path("plus.csv"), &path("arm.toml"));
    let (_, said) = printed(with_arm.arg("--json"));
    holds(
        &said,
        &["these torques contain no gravity, and --arm was identified on torques that do"],
    );
    // A payload that the robot does not know: without the names, these are taken for torques with gravity.
    write("payload.csv", 1.0, 0.5);
    let mut torque = palpate();
    torque.args(["torque", "--torque-sign", "plus", "--json"]).arg(path("payload.csv"));
    let with_gravity = "the torques contain gravity, and their sign is plus";
    let (_, said) = printed(&mut torque);
    holds(&said, &[known]);
    assert!(!said.contains(with_gravity), "{said}");
    let renamed = fs::read_to_string(path("payload.csv")).unwrap().replace("external_", "");
    fs::write(path("payload.csv"), renamed).unwrap();
    holds(&printed(&mut torque).1, &[with_gravity]);
}

#[test]
fn needs_rosbags_arms_are_identified_from_measured_torques_in_the_messages_of_makers() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    let mut write = python();
    write.arg(root().join("scripts/ros2_bags.py")).arg("states");
    succeed(write.arg(path("free")).arg(path("bags")));
    let payload = |found: &str| -> f64 {
        let found: Value = serde_json::from_str(found).unwrap();
        found["payload"]["mass_kg"]["value"].as_f64().unwrap()
    };
    let expected = payload(&succeed(identify(&path("free/seq_0")).arg("--json")));
    assert!((expected - 1.0).abs() < 0.1, "{expected}");
    for (bag, is_chosen) in [("bags/lbr", true), ("bags/kortex", false)] {
        let (found, said) =
            printed(identify(&path(bag)).arg("--json").arg("-o").arg(path("arm.toml")));
        holds(&said, &["the torques contain gravity, and their sign is plus"]);
        assert_eq!(said.contains("the measured torques are read"), is_chosen, "{said}");
        assert!((payload(&found) - expected).abs() < 0.01, "{bag}: {found}");
        let (_, said) = printed(torque(&path(bag), &path("arm.toml")).args(["--json", "--strict"]));
        assert_eq!(said.contains("the measured torques are read"), is_chosen, "{said}");
        fs::remove_file(path("arm.toml")).unwrap();
    }
    // Beside a log of measured torques.
    let (_, said) = printed(identify(&path("free/seq_1")).arg(path("bags/lbr")).arg("--json"));
    holds(&said, &["lbr`: the measured torques are read"]);
}

#[test]
fn currents_that_are_logged_as_efforts_are_recognised_by_gravity() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    write_currents(&path("efforts"), &path("free"), ("effort", 12.5));
    let mut identify = identify(&path("efforts"));
    identify.args(["--payload-link", "Bracelet_Link", "--payload-mass-kg", "1"]);
    identify.args(["--payload-com-m", "0,0.02,-0.1", "--json", "-o"]).arg(path("arm.toml"));
    let (found, said) = printed(&mut identify);
    holds(&said, &["/efforts`: the torques are ", "taken for motor currents", "and the sign plus"]);
    let found: Value = serde_json::from_str(&found).unwrap();
    for joint in &found["joints"].as_array().unwrap()[1..6] {
        assert!((joint["gain"]["value"].as_f64().unwrap() * 12.5 - 1.0).abs() < 0.05, "{joint}");
    }
    succeed(torque(&path("efforts"), &path("arm.toml")).args(["--json", "--strict"]));
    for (command, output) in [("torque", "none.csv"), ("map", "none.npz")] {
        refuse(
            palpate().arg(command).arg(path("efforts")).arg("-o").arg(path(output)),
            2,
            &["seem to be motor currents", "palpate identify"],
        );
    }
    let report = json(palpate().args(["inspect", "--json"]).arg(path("efforts")));
    let codes = report["paths"][0]["findings"].as_array().unwrap();
    assert!(codes.iter().any(|finding| finding["code"] == "currents"), "{report}");
    assert!(codes.iter().all(|finding| finding["code"] != "gravity"), "{report}");
}

#[test]
fn torques_without_gravity_are_read_with_the_sign_of_the_identified_arm() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_identified(folder.path());
    // Friction with the other sign does work on the arm, as a person does who leads it.
    let robot = loaded();
    let led = |sample: &mut Sample| {
        let gravity = robot.gravity_torque(&robot.forward(&sample.q).unwrap());
        sample.tau.iter_mut().zip(&gravity).for_each(|(tau, gravity)| *tau = gravity - *tau);
    };
    write_changed(&path("free"), &path("led"), led);
    let (_, said) = printed(torque(&path("led"), &path("arm.toml")).arg("--json"));
    holds(&said, &["from which the arm was identified (--arm): plus; gravity: removed"]);
    assert!(!said.contains("(torque_sign)"), "{said}");
    let (_, said) = printed(palpate().args(["torque", "--json"]).arg(path("led")));
    holds(&said, &["their sign is minus", "if a person or another machine moved the arm"]);
}

#[test]
fn an_arm_is_identified_and_its_torques_show_the_contact() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    write_logs(&path("pushed"), true);
    let mut identify = identify(&path("free"));
    identify.args(["--quiet", "--json", "--tool-link", "Bracelet_Link", "-o"]);
    let found = json(identify.arg(path("arm.toml")).arg("--urdf").arg(path("arm.urdf")));
    let mass = found["payload"]["mass_kg"]["value"].as_f64().unwrap();
    assert!((mass - 1.0).abs() < 0.03, "{}", found["payload"]);
    assert!(found["urscript"].as_str().unwrap().starts_with("set_target_payload("), "{found}");
    for joint in found["joints"].as_array().unwrap() {
        assert!((joint["coulomb_n_m"]["value"].as_f64().unwrap() - 0.4).abs() < 0.04, "{joint}");
    }
    // The URDF has the masses of the identified arm.
    let urdf = Robot::from_urdf(&fs::read_to_string(path("arm.urdf")).unwrap()).unwrap();
    let model: Vec<f64> = serde_json::from_value(found["model"]["inertial"].clone()).unwrap();
    let off = urdf.inertial_parameters() - nalgebra::DVector::from_vec(model);
    assert!(off.amax() < 1e-9, "{off}");

    for (file, more) in
        [("t.csv", &[][..]), ("t.parquet", &["--causal"]), ("t.mcap", &["--causal"])]
    {
        let mut torque = torque(&path("pushed"), &path("arm.toml"));
        torque.args(["--quiet", "--json", "-o"]).arg(path(file)).args(MEASURED);
        let report = json(torque.args(more));
        let contacts = report["contacts"].as_array().unwrap();
        assert_eq!(contacts.len(), 1, "{file}: {contacts:?}");
        let [from, to] = [0, 1].map(|end| contacts[0]["time_s"][end].as_f64().unwrap());
        assert!((from - 4.0).abs() < 0.3 && (to - 5.0).abs() < 0.3, "{file}: {from} to {to}");
        assert_eq!(contacts[0]["touch"], "seq_2");
    }
    // The files as other programs read them: both have as many rows as there were samples.
    let table = fs::read_to_string(path("t.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 3 * FRAMES);
    assert!(table.starts_with("touch,time,Actuator1_torque,"), "{}", &table[..60]);
    let touches = touches(&path("t.mcap"));
    assert_eq!(touches.iter().map(|touch| touch.samples.len()).sum::<usize>(), 3 * FRAMES);
}

#[test]
fn free_motion_has_no_contact_and_its_largest_torque_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let (free, arm) = (folder.path().join("free"), folder.path().join("arm.toml"));
    write_logs(&free, false);
    let robot = ["--robot", "kinova_gen3"];
    let (stdout, stderr) = printed(identify(&free).args(robot).arg("-o").arg(&arm));
    let next = format!("Next: palpate torque LOG --robot kinova_gen3 --arm {}\n", arm.display());
    assert!(stdout.ends_with(&next) && !stderr.contains("warning"), "{stdout}{stderr}");
    let (stdout, stderr) = printed(torque(&free, &arm).args(robot));
    assert!(stdout.contains("No contact was found: the largest torque is"), "{stdout}");
    assert!(!stderr.contains("warning"), "{stderr}");
    // Pushes in the logs of --free raise the threshold.
    let pushed = folder.path().join("pushed");
    write_logs(&pushed, true);
    let (_, stderr) = printed(torque(&free, &arm).args(robot).arg("--free").arg(&pushed));
    holds(&stderr, &["note: the contact threshold is", " at Actuator1, ", "of --free are short"]);
    let (_, stderr) = printed(torque(&free, &arm).args(["--bandwidth-hz", "2"]));
    assert!(stderr.contains("warning: the contact threshold was determined on"), "{stderr}");
    // The motion begins at once, which is allowed with an identified arm.
    let mut inspect = palpate();
    inspect.args(["inspect", "--json"]).arg(&free);
    assert!(common::stdout(&inspect.output().unwrap()).contains("no_start"));
    let report = json(inspect.arg("--arm").arg(&arm));
    assert!(!report.to_string().contains("no_start"), "{report}");
    let tare = ["--tare-frames", "99999"];
    refuse(torque(&free, &arm).args(tare), 1, &["the touch ends after", "99999"]);
    let wrench = ["--wrench-link", "EndEffector_Link"];
    refuse(torque(&free, &arm).args(wrench), 2, &["give --output"]);
    let removed = ["--torque-sign", "plus", "--gravity", "removed"];
    let (_, stderr) = printed(torque(&free, &arm).args(removed));
    assert!(stderr.contains("these torques contain no gravity, and --arm"), "{stderr}");
}

#[test]
fn times_in_ms_and_ns_give_what_times_in_seconds_give() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let arm = path("arm.toml");
    write_logs(&path("s"), false);
    succeed(identify(&path("s")).arg("-o").arg(&arm));
    let reports = |log: &str, flags: &[&str]| {
        let (identified, stderr) = printed(identify(&path(log)).arg("--json").args(flags));
        let (torques, _) = printed(torque(&path(log), &arm).arg("--json").args(flags));
        (identified.replace(&path(log).display().to_string(), "LOG"), torques, stderr)
    };
    let wanted = reports("s", &[]);
    for (unit, factor) in [("ms", 1e3), ("ns", 1e9)] {
        write_in_unit(&path("s"), &path(unit), factor);
        let found = reports(unit, &[]);
        let note = format!("note: times of `{}` are read as {unit}", path(unit).display());
        assert_eq!(found.2.matches(&note).count(), 1, "{}", found.2);
        let given = reports(unit, &["--time-unit", unit]);
        assert!(!given.2.contains("are read as"), "{}", given.2);
        for (found, wanted) in [(&found.0, &wanted.0), (&found.1, &wanted.1), (&given.0, &wanted.0)]
        {
            let [found, wanted] = [found, wanted].map(|text| serde_json::from_str(text).unwrap());
            assert_near(&found, &wanted);
        }
    }
}

/// Asserts that two JSON values are equal, numbers to 1e-9.
fn assert_near(found: &Value, wanted: &Value) {
    match (found, wanted) {
        (Value::Number(found), Value::Number(wanted)) => {
            let [found, wanted] = [found, wanted].map(|number| number.as_f64().unwrap());
            assert!((found - wanted).abs() <= 1e-9 * wanted.abs().max(1.0), "{found}, {wanted}");
        }
        (Value::Array(found), Value::Array(wanted)) => {
            assert_eq!(found.len(), wanted.len());
            found.iter().zip(wanted).for_each(|(found, wanted)| assert_near(found, wanted));
        }
        (Value::Object(found), Value::Object(wanted)) => {
            assert!(found.keys().eq(wanted.keys()));
            found
                .values()
                .zip(wanted.values())
                .for_each(|(found, wanted)| assert_near(found, wanted));
        }
        _ => assert_eq!(found, wanted),
    }
}

#[test]
fn what_looks_wrong_with_a_log_is_reported_before_its_torques_are_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let arm = path("arm.toml");
    write_logs(&path("free"), false);
    succeed(identify(&path("free")).arg("-o").arg(&arm));
    let swap = |sample: &mut Sample| sample.tau.swap(1, 3);
    write_changed(&path("free"), &path("torques"), swap);
    let (_, stderr) = printed(&mut torque(&path("torques"), &arm));
    assert!(stderr.contains("% of the samples the torques are larger than those of"), "{stderr}");
    // At rest for a while, so that gravity determines the order of the joints.
    let first = RefCell::new(None);
    let swap_from_rest = |sample: &mut Sample| {
        let mut first = first.borrow_mut();
        let rest: &Sample = first.get_or_insert_with(|| sample.clone());
        if sample.time_s < Some(0.4) {
            *sample = Sample::new(sample.time_s, rest.q.clone(), rest.tau.clone());
        }
        sample.q.swap(1, 3);
        sample.tau.swap(1, 3);
    };
    write_changed(&path("free"), &path("swapped"), swap_from_rest);
    let mut command = torque(&path("swapped"), &arm);
    let (_, stderr) = printed(&mut command);
    assert!(stderr.contains("(joint_order)") && stderr.contains("`Actuator4` swapped"), "{stderr}");
    refuse(command.arg("--strict"), 1, &["joint_order", "--strict"]);
    let (_, stderr) = printed(torque(&path("free"), &arm).arg(path("swapped")));
    assert!(stderr.contains("swapped` looks wrong (joint_order)"), "the log is named: {stderr}");
    write_in_unit(&path("free"), &path("ms"), 1e3);
    for command in [&mut torque(&path("ms"), &arm), &mut identify(&path("ms"))] {
        let (_, stderr) = printed(command.args(["--time-unit", "s"]));
        assert!(stderr.contains("(time_unit)"), "{stderr}");
    }
    let small = |sample: &mut Sample| sample.tau.iter_mut().for_each(|tau| *tau *= 1e3);
    write_changed(&path("free"), &path("small"), small);
    let mut command = identify(&path("small"));
    let (_, stderr) = printed(&mut command);
    holds(&stderr, &["are they in mN·m?", "warning: on held-out motion"]);
    // The log passes the checks, but no parameters of an arm explain its torques.
    let count = Cell::new(0);
    let shake = |sample: &mut Sample| {
        count.set(count.get() + 1);
        let shaken = sample.tau.iter_mut().zip(0..4);
        shaken.for_each(|(tau, j)| *tau += 6.0 * f64::from(7919 * count.get() + 31 * j).sin());
    };
    write_changed(&path("free"), &path("shaken"), shake);
    let unwritten = path("none.toml");
    let mut command = identify(&path("shaken"));
    let (stdout, stderr) = printed(command.arg("-o").arg(path("shaken.toml")));
    assert!(stderr.contains("warning: on held-out motion"), "{stderr}");
    assert!(path("shaken.toml").exists() && !stdout.contains("Next:"), "no next step: {stdout}");
    let mut command = identify(&path("shaken"));
    refuse(command.arg("--strict").arg("-o").arg(&unwritten), 1, &["held-out", "(--strict)"]);
    assert!(!unwritten.exists());
}

#[test]
fn an_arm_that_is_led_by_hand_is_named_and_its_friction_has_no_deviation() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_logs(&path("free"), false);
    // The hand drives the arm: it does the work that friction takes, and more.
    let last = RefCell::new(None);
    let lead = |sample: &mut Sample| {
        let before = last.replace(Some(sample.q.clone())).unwrap_or_else(|| sample.q.clone());
        for (tau, (q, before)) in sample.tau.iter_mut().zip(sample.q.iter().zip(before)) {
            let speed = (q - before) * RATE_HZ;
            *tau += 0.8 * (speed / 0.01).tanh() + 0.5 * speed;
        }
    };
    write_changed(&path("free"), &path("led"), lead);
    let (stdout, stderr) = printed(identify(&path("led")).args(MEASURED));
    holds(&stderr, &["friction would be negative at", "led by hand"]);
    holds(&stdout, &["0.00 ± -", "asymmetry N·m", "hysteresis N·m"]);
    let found = json(identify(&path("led")).args(MEASURED).args(["--quiet", "--json"]));
    assert_eq!(found["joints"][1]["at_zero"][0], "coulomb_n_m", "{}", found["joints"][1]);
}

#[test]
fn a_field_of_an_identified_arm_goes_on_with_it_and_not_without() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_identified(folder.path());
    // The field remembers the standard deviation of each torque, and mapping continues from it.
    let map = |from: &[&str], out: &str| {
        let mut map = palpate();
        map.args(["--quiet", "map", "--tune=off"]).arg(path("pushed/seq_2")).args(from);
        succeed(map.arg("--arm").arg(path("arm.toml")).arg("-o").arg(path(out)));
    };
    map(&[&["--spacing-m", "0.03"], &MEASURED[..]].concat(), "one.npz");
    let from = path("one.npz");
    map(&["--from", from.to_str().unwrap()], "two.npz");
    // To map without the arm is refused; to predict without it needs sign and gravity of the torques.
    let mut without = palpate();
    without.args(["--quiet", "map"]).arg(path("free/seq_0")).arg("--from").arg(&from);
    refuse(
        without.args(MEASURED).arg("-o").arg(path("three.npz")),
        2,
        &["identified arm", "--arm"],
    );
    let predict = |more: &[&str]| {
        let mut predict = palpate();
        predict.args(["--quiet", "predict"]).arg(&from).arg(path("pushed/seq_2")).args(more);
        predict
    };
    succeed(predict(&MEASURED).arg("--no-tare"));
    succeed(predict(&MEASURED).arg("--arm").arg(path("arm.toml")));
    // Touches with the same name stay separate.
    let mut torque = torque(&path("pushed"), &path("arm.toml"));
    torque.arg(path("free")).args(["--quiet", "--json"]).args(MEASURED);
    let report = json(torque.arg("-o").arg(path("both.csv")));
    assert_eq!(report["touches"][0], "pushed/seq_0");
    assert_eq!(report["contacts"].as_array().unwrap().len(), 1);
    assert_eq!(report["contacts"][0]["touch"], "pushed/seq_2");
}

#[test]
fn settings_are_chosen_from_external_torques() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_identified(folder.path());
    let mut map = palpate();
    map.args(["map", "--json", "--tune=quick", "--spacing-m", "0.05"]).arg(path("free"));
    map.args(MEASURED).arg("--arm").arg(path("arm.toml")).arg("-o").arg(path("field.npz"));
    succeed(&mut map);
    let field = palpate_io::field::load(&path("field.npz")).unwrap().field;
    assert!(field.touch.identified);
    // In free motion only noise remains, so that no cell is stiff.
    let stiffest = field.stiffness_n_per_m.iter().copied().fold(0.0, f64::max);
    assert!(stiffest < 5.0, "{stiffest} N/m");
}

fn identify_tiny(scene: &Scene, more: &[&str]) -> Command {
    let mut identify = palpate();
    identify.args(["identify", "--no-cache", "--robot"]).arg(scene.path("tiny.urdf")).args(more);
    identify
}

#[test]
fn unusable_logs_are_refused_with_what_is_missing() {
    let scene = Scene::new();
    let run = |more: &[&str]| identify_tiny(&scene, more);
    let log = scene.text("log");
    refuse(
        run(&[&log, "--gravity", "removed", "--torque-sign", "plus"]).arg("--json"),
        2,
        &["tau_J"],
    );
    refuse(&mut run(&[&log, "--arm", "arm.toml"]), 2, &["writes the file for --arm"]);
    refuse(
        run(&[&log, "--tool-link", "hand"]).args(MEASURED),
        2,
        &["no joint moves a link `hand`"],
    );
    // Joints on which gravity exerts no torque, and no clock.
    let report = json(run(&[&log, "--quiet", "--json"]).args(MEASURED));
    let notes = report["notes"].as_array().unwrap();
    let says = |words: &str| notes.iter().any(|note| note.as_str().unwrap().contains(words));
    assert!(says("no clock") && says("the payload cannot be determined"), "{notes:?}");
    assert!(report["misfit"].as_str().unwrap().contains("another robot"), "{}", report["misfit"]);

    let still = scene.path("still");
    fs::create_dir(&still).unwrap();
    npy(&still.join("angles.npy"), &[30, 2], &[0.1; 60]);
    npy(&still.join("torques.npy"), &[30, 2], &[1.0; 60]);
    refuse(run(&[still.to_str().unwrap()]).args(MEASURED), 2, &["no joint moves"]);

    fs::write(scene.path("arm.toml"), "version = 2\nrobot = \"tiny\"\ndelay_s = \"late\"\n")
        .unwrap();
    let mut torque = palpate();
    torque
        .args(["torque", "--no-cache", "--robot"])
        .arg(scene.path("tiny.urdf"))
        .arg(&log)
        .args(MEASURED);
    refuse(torque.arg("--arm").arg(scene.path("arm.toml")), 2, &["arm.toml", "delay_s"]);
}

#[test]
fn a_joint_with_another_name_in_the_log_is_renamed() {
    let scene = Scene::new();
    let run = |more: &[&str]| identify_tiny(&scene, more);
    let table = "touch,time,a_position,elbow_position,a_effort,elbow_effort\n";
    let rows = (0..60).map(|k| {
        format!(
            "x,{},{},{},1,{}\n",
            0.1 * f64::from(k),
            0.02 * f64::from(k),
            0.01 * f64::from(k),
            k % 2
        )
    });
    let text: String = rows.collect();
    fs::write(scene.path("named.csv"), format!("{table}{text}")).unwrap();
    let named = scene.text("named.csv");
    refuse(run(&[&named]).args(MEASURED), 1, &["shoulder"]);
    refuse(run(&[&named, "--rename", "a=wrist"]).args(MEASURED), 2, &["--rename", "joint `wrist`"]);
    let report = json(run(&[&named, "--quiet", "--json", "--rename", "a=shoulder"]).args(MEASURED));
    assert_eq!(report["joints"][0]["name"], "a");
    // Two names are exchanged.
    let swapped = table.replace("a_", "x_").replace("elbow", "shoulder").replace("x_", "elbow_");
    fs::write(scene.path("swapped.csv"), format!("{swapped}{text}")).unwrap();
    let both = ["--rename", "elbow=shoulder", "--rename", "shoulder=elbow"];
    let log = scene.text("swapped.csv");
    let again = json(run(&[&log, "--quiet", "--json"]).args(both).args(MEASURED));
    assert_eq!(again["joints"][0]["name"], "elbow");
    assert_eq!(again["joints"][0]["bias_n_m"], report["joints"][0]["bias_n_m"]);
}

#[test]
fn a_motion_is_written_for_a_controller() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("motion.yaml");
    let mut excite = palpate();
    excite.args(["--quiet", "excite", "--rate-hz", "10", "--json", "-o"]).arg(&path);
    let report = json(&mut excite);
    assert!(report["speed_share"].as_f64() <= Some(0.51) && report["points"] == 201, "{report}");
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.len() < 128_000, "one argument of a shell");
    assert!(text.starts_with("joint_names: [\"Actuator1\", \"Actuator2\""), "{}", &text[..80]);
    assert_eq!(text.matches("time_from_start:").count(), 201);
    assert!(text.contains("time_from_start: {sec: 20, nanosec: 0}"));

    let csv = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        let run =
            palpate().args(["excite", "--rate-hz", "10", "-o"]).arg(&path).args(more).output();
        assert!(run.unwrap().status.success());
        let rows = fs::read_to_string(&path).unwrap();
        let row = |row: &str| row.split(',').map(|number| number.parse().unwrap()).collect();
        rows.lines().skip(1).map(row).collect::<Vec<Vec<f64>>>()
    };
    // The same path, four times slower, at the same rate.
    let (fast, slow) = (csv("fast.csv", &[]), csv("slow.csv", &["--slow-down", "4"]));
    assert_eq!((fast.len(), slow.len()), (201, 801));
    for (fast, slow) in fast.iter().zip(slow.iter().step_by(4)) {
        let factors = [4.0].into_iter().chain([1.0; 7]).chain([0.25; 7]).chain([0.0625; 7]);
        for ((fast, slow), factor) in fast.iter().zip(slow).zip(factors) {
            assert!((fast * factor - slow).abs() < 1e-8, "{fast} {slow}");
        }
    }
    let low = ["excite", "--ground-m", "3", "-o"];
    refuse(palpate().args(low).arg(&path), 2, &["reaches down to"]);
    refuse(palpate().args(["excite", "-o", "motion.txt"]), 2, &["motion.txt"]);
}
