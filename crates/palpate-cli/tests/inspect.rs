//! `palpate inspect` of logs: each defect gives one finding, and a log without defects gives none.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

mod common;
mod recording;

use std::fs;
use std::path::Path;

use common::{holds, palpate, plant, printed, refuse, stdout, succeed};
use palpate::Payload;
use recording::{Maker, STILL, Touch, clean, codes, first, found, inspect, run, write, write_csv};
use serde_json::Value;

/// Inspects touches with some flags.
fn look(touches: &[Touch], flags: &[&str]) -> (Option<i32>, Value) {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), touches);
    run(inspect().arg(folder.path()).args(flags))
}

/// Asserts that there is exactly one finding, a warning, and returns it.
#[track_caller]
fn only(touches: &[Touch], flags: &[&str], code: &str) -> Value {
    only_at("warning", touches, flags, code)
}

/// The same for a finding of this level.
#[track_caller]
fn only_at(level: &str, touches: &[Touch], flags: &[&str], code: &str) -> Value {
    let report = found(look(touches, flags), 0, &[code]);
    assert_eq!(first(&report)["level"], level);
    first(&report).clone()
}

/// Asserts that nothing looks wrong.
#[track_caller]
fn nothing(touches: &[Touch], flags: &[&str]) {
    found(look(touches, flags), 0, &[]);
}

/// Asserts which sign and gravity of the torques were found.
#[track_caller]
fn read(report: &Value, sign: &str, gravity: &str) {
    let reading = &report["paths"][0]["reading"];
    let read = [&reading["torque_sign"], &reading["gravity"]];
    assert_eq!(read, [sign, gravity], "{reading}");
}

/// Asserts that, without flags, this sign and gravity are found and nothing looks wrong.
#[track_caller]
fn read_without_flags(touches: &[Touch], sign: &str, gravity: &str) {
    nothing(touches, &[]);
    read(&look(touches, &[]).1, sign, gravity);
}

#[track_caller]
fn says(finding: &Value, words: &[&str]) {
    holds(&finding.to_string(), words);
}

fn flags(finding: &Value) -> Vec<&str> {
    finding["flags"].as_array().unwrap().iter().map(|flag| flag.as_str().unwrap()).collect()
}

#[test]
fn nothing_is_wrong_with_a_clean_log_and_its_figures_are_right() {
    nothing(&clean(), &["--strict"]);
    let (_, report) = look(&clean(), &[]);
    let log = &report["paths"][0];
    assert_eq!((&log["kind"], &log["frames"]), (&"log".into(), &300.into()));
    assert!((log["clock"]["period_s"].as_f64().unwrap() - 0.05).abs() < 1e-9, "{log}");
    let slope = log["reading"]["fits"]["set"]["slope"].as_f64().unwrap();
    assert!((slope - 1.0).abs() < 0.05, "{slope}");
    for touch in log["touches"].as_array().unwrap() {
        let start = touch["start_frames"].as_u64().unwrap();
        assert!((20..28).contains(&start), "{touch}");
        for noise in touch["noise_std"].as_array().unwrap() {
            let noise = noise.as_f64().unwrap(); // uniform from -0.1 to 0.1: 0.058
            assert!((0.03..0.09).contains(&noise), "{noise}");
        }
        let peak = touch["peak_external"].as_f64().unwrap(); // 10 x (0.4 - 0.05), and noise
        assert!((3.2..3.9).contains(&peak), "{peak}");
    }
}

#[test]
fn nothing_is_wrong_with_the_bundled_touches() {
    found(run(inspect().arg(plant()).arg("--strict")), 0, &[]);
}

#[test]
fn the_text_holds_the_facts_and_marks_the_findings() {
    let folder = tempfile::tempdir().unwrap();
    let mut touches = clean();
    touches.iter_mut().for_each(Touch::negate_torques);
    write(folder.path(), &touches);
    let text = succeed(inspect().arg(folder.path()).args(["--torque-sign", "plus"]));
    let words = ["20.0 Hz", "Actuator7", "seq_2", "Tare", "WARNING", "-> use --torque-sign minus"];
    holds(&text, &words);
}

#[test]
fn torques_of_the_other_sign_are_recognised_by_gravity() {
    let mut touches = clean();
    touches.iter_mut().for_each(Touch::negate_torques);
    let plus = ["--torque-sign", "plus"];
    assert_eq!(flags(&only(&touches, &plus, "torque_sign")), ["--torque-sign", "minus"]);
    read_without_flags(&touches, "minus", "included");
}

#[test]
fn torques_without_gravity_are_recognised() {
    let touches = Maker { gravity: 0.0, ..Maker::new() }.touches();
    let included = ["--gravity", "included", "--torque-sign", "plus"];
    assert_eq!(flags(&only(&touches, &included, "gravity")), ["--gravity", "removed"]);
    read_without_flags(&touches, "plus", "removed");
    let back = only(&clean(), &["--gravity", "removed"], "gravity");
    assert_eq!(flags(&back), ["--gravity", "included"]);
}

#[test]
fn the_sign_of_torques_without_gravity_shows_in_the_work() {
    let touches = Maker { gravity: 0.0, contact: -1.0, ..Maker::new() }.touches();
    let plus = ["--gravity", "removed", "--torque-sign", "plus"];
    assert_eq!(flags(&only(&touches, &plus, "torque_sign")), ["--torque-sign", "minus"]);
    read_without_flags(&touches, "minus", "removed");
}

#[test]
fn gravity_determines_the_convention_even_if_no_touch_begins_still() {
    let moving = Maker { still: 0, ..Maker::new() };
    let touches = Maker { gravity: -1.0, contact: -1.0, ..moving.clone() }.touches();
    let plus = ["--no-tare", "--torque-sign", "plus", "--gravity", "included"];
    let (_, report) = look(&touches, &plus);
    assert_eq!(flags(first(&report)), ["--torque-sign", "minus"], "{}", first(&report));
    read(&look(&touches, &["--no-tare"]).1, "minus", "included");
    let touches = Maker { gravity: 0.0, ..moving }.touches();
    let (_, report) = look(&touches, &plus);
    assert_eq!(flags(first(&report)), ["--gravity", "removed"], "{}", first(&report));
    read(&look(&touches, &["--no-tare"]).1, "plus", "removed");
}

#[test]
fn torques_that_gravity_does_not_explain_are_reported() {
    let mut touches = clean();
    for tau in touches.iter_mut().flat_map(|touch| &mut touch.tau) {
        let odd = [9.0, -7.0, 8.0, 9.0, -5.0, 6.0, 4.0];
        tau.iter_mut().zip(odd).for_each(|(tau, odd)| *tau = odd + 0.01 * *tau);
    }
    says(&only(&touches, &[], "gravity_misfit"), &["--robot", "--payload-link", "--angle-unit"]);
}

#[test]
fn a_negated_column_is_named() {
    let mut touches = clean();
    touches.iter_mut().flat_map(|touch| &mut touch.tau).for_each(|tau| tau[1] *= -1.0);
    let (_, report) = look(&touches, &[]);
    assert_eq!(first(&report)["code"], "joint_sign", "{}", report["paths"][0]["findings"]);
    says(first(&report), &["minus for Actuator2", "negate the columns"]);
}

#[test]
fn an_arm_on_a_ceiling_with_an_upright_urdf_is_reported() {
    let with_friction = |gravity: f64| {
        let mut touches = Maker { gravity, ..Maker::new() }.touches();
        for Touch { q, tau, .. } in &mut touches {
            for (pair, tau) in q.windows(2).zip(&mut tau[1..]) {
                let way = pair[1][0] - pair[0][0];
                tau[0] -= if way.abs() < 1e-4 { 0.0 } else { 2.0 * way.signum() };
            }
        }
        touches
    };
    says(&only(&with_friction(-1.0), &[], "mounting"), &["3 of 3 touches", "<origin rpy>"]);
    nothing(&with_friction(1.0), &[]);
}

#[test]
fn a_forgotten_payload_is_weighed() {
    let mut maker = Maker::new();
    let com_link_m = [0.02, 0.0, -0.08];
    let payload = Payload::new("Bracelet_Link", 1.5, com_link_m);
    maker.robot = maker.robot.with_payload(&payload).unwrap();
    let touches = maker.touches();
    let found = only(&touches, &[], "payload");
    let flags = flags(&found);
    assert_eq!(flags[..2], ["--payload-link", "Bracelet_Link"]);
    let mass_kg: f64 = flags[3].parse().unwrap();
    assert!((mass_kg - 1.5).abs() < 0.15, "{mass_kg}");
    nothing(&touches, &flags);
}

#[test]
fn another_order_of_the_joints_is_recognised_by_gravity() {
    let mut touches = clean();
    touches.iter_mut().for_each(|touch| touch.each_row(|row| row.reverse()));
    says(&only(&touches, &[], "joint_order"), &["in reverse", "Actuator7, Actuator6"]);
    let mut touches = clean();
    touches.iter_mut().for_each(|touch| touch.each_row(|row| row.swap(1, 3)));
    says(&only(&touches, &[], "joint_order"), &["`Actuator2` and `Actuator4` swapped"]);
}

#[test]
fn named_joints_are_matched_and_unknown_names_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("touch.csv");
    let mut touch = clean().remove(0);
    touch.each_row(|row| row.rotate_left(2));
    let joints = [3, 4, 5, 6, 7, 1, 2].map(|joint| format!("Actuator{joint}"));
    let mut names: Vec<&str> = joints.iter().map(String::as_str).collect();
    write_csv(&path, &touch, &names);
    let report = found(run(inspect().arg(&path)), 0, &[]);
    assert_eq!(report["paths"][0]["matching"], "reordered");
    let read = &report["paths"][0]["columns"];
    assert_eq!(read["joints"][0], "Actuator3");
    assert_eq!(read["joints"][5], "Actuator1");
    assert_eq!(read["q"].as_array().map(Vec::len), Some(7));

    names[5] = "Shoulder";
    write_csv(&path, &touch, &names);
    let report = found(run(inspect().arg(&path)), 1, &["joint_names"]);
    says(first(&report), &["`Actuator1` is not in the log", "Shoulder", "--columns", "error"]);
}

#[test]
fn fingers_that_are_not_in_a_log_stand_still_and_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let arm = Path::new(env!("CARGO_MANIFEST_DIR")).join("../palpate/src/robot/kinova_gen3.urdf");
    let finger = r#"<link name="left_finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.01"/>
        <inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial></link>
        <joint name="finger_joint" type="prismatic"><parent link="EndEffector_Link"/>
        <child link="left_finger"/><axis xyz="1 0 0"/>
        <limit lower="0" upper="0.08" effort="20" velocity="1"/></joint></robot>"#;
    let with_finger = fs::read_to_string(arm).unwrap().replace("</robot>", finger);
    fs::write(path("gripper.urdf"), with_finger).unwrap();
    let look = |log: &Path, more: &[&str]| {
        let mut command = inspect();
        command.arg(log).arg("--robot").arg(path("gripper.urdf")).args(more);
        command
    };
    write(&path("arrays"), &clean());
    let touch = &clean()[0];
    let joints = [1, 2, 3, 4, 5, 6, 7].map(|joint| format!("gen3_Actuator{joint}"));
    write_csv(&path("named.csv"), touch, &joints.each_ref().map(String::as_str));
    for log in ["arrays", "named.csv"] {
        let (_, note) = printed(&mut look(&path(log), &["--strict"]));
        holds(&note, &["--hold finger_joint=0.04", "7 joints"]);
        let hold = ["--strict", "--hold", "finger_joint=0.01"];
        let (_, note) = printed(&mut look(&path(log), &hold));
        assert!(!note.contains("finger_joint"), "{note}");
        let matched = note.contains("`gen3_Actuator1` is `Actuator1`");
        assert_eq!(matched, log == "named.csv", "{note}");
    }
    // A bag has the names of the joints that are in the log; a motion moves the arm only.
    let with_robot = |command: &str, output: &Path| {
        let mut run = palpate();
        run.args([command, "--robot"]).arg(path("gripper.urdf")).arg("-o").arg(output);
        run
    };
    let bag = path("arrays.mcap");
    succeed(with_robot("convert", &bag).arg(path("arrays")));
    succeed(&mut look(&bag, &["--strict"]));
    let motion = path("motion.csv");
    succeed(with_robot("excite", &motion).args(["--rate-hz", "10"]));
    let motion = fs::read_to_string(motion).unwrap();
    assert!(motion.starts_with("time,Actuator1_position,") && !motion.contains("finger"));
    refuse(&mut look(&path("arrays"), &["--hold", "nose=1"]), 2, &["`nose`"]);

    // A wrist with another name is not a finger.
    let mut joints = joints;
    joints[6] = "gen3_wrist".to_owned();
    write_csv(&path("named.csv"), touch, &joints.each_ref().map(String::as_str));
    let output = look(&path("named.csv"), &["--hold", "finger_joint=0.01", "--json"]).output();
    assert!(stdout(&output.unwrap()).contains("`Actuator7` is not in the log"));
}

#[test]
fn another_number_of_joints_is_an_error() {
    let mut touches = clean();
    touches.iter_mut().for_each(|touch| touch.each_row(|row| row.truncate(6)));
    let report = found(look(&touches, &[]), 1, &["joint_count"]);
    says(first(&report), &["6 joints", "has 7", "--robot"]);
}

#[test]
fn degrees_and_radians_are_distinguished() {
    let mut touches = clean();
    touches.iter_mut().for_each(Touch::turn_to_degrees);
    let report = found(look(&touches, &[]), 0, &["angle_unit"]);
    says(first(&report), &["degrees", "gravity fits", "read as degrees"]);
    assert_eq!(
        flags(&only(&touches, &["--angle-unit", "rad"], "angle_unit")),
        ["--angle-unit", "deg"]
    );
    nothing(&touches, &["--angle-unit", "deg"]);
    let found = only(&clean(), &["--angle-unit", "deg"], "angle_unit");
    assert_eq!(flags(&found), ["--angle-unit", "rad"]);
}

#[test]
fn positions_beyond_the_limits_are_reported() {
    let mut touches = clean();
    let robot = Maker::new().robot;
    let Touch { q, tau, .. } = &mut touches[1];
    for (q, tau) in q.iter_mut().zip(tau) {
        let gravity = |q: &[f64]| robot.gravity_torque(&robot.forward(q).unwrap());
        let before = gravity(q);
        q[5] += 1.3;
        let change = gravity(q) - before;
        tau.iter_mut().zip(&change).for_each(|(tau, change)| *tau += change);
    }
    says(&only(&touches, &[], "joint_limits"), &["Actuator6", "-2.230 .. 2.230", "100 frames"]);
}

#[test]
fn repeated_frames_are_counted_and_placed() {
    let mut touches = clean();
    for row in [40, 50] {
        (touches[1].q[row], touches[1].tau[row]) =
            (touches[1].q[row - 1].clone(), touches[1].tau[row - 1].clone());
    }
    let found = only(&touches, &[], "duplicate_frames");
    says(&found, &["2 frames of 300", "seq_1 row 40, seq_1 row 50"]);
    assert_eq!(found["touches"], serde_json::json!(["seq_1"]));
}

#[test]
fn touches_that_are_copies_are_reported() {
    let mut touches = clean();
    touches[2] = touches[0].clone();
    let found = only(&touches, &[], "duplicate_touches");
    says(&found, &["a touch is an exact copy of another", "`seq_2` of `seq_0`"]);
    assert_eq!(found["touches"], serde_json::json!(["seq_2"]));
}

#[test]
fn gaps_and_clocks_that_go_wrong_are_reported() {
    let mut touches = clean();
    touches[2].time_s[60..].iter_mut().for_each(|time_s| *time_s += 0.4);
    says(&only(&touches, &[], "gaps"), &["1 gap", "0.450 s", "seq_2 row 60"]);
    let mut touches = clean();
    touches[0].time_s[30] = touches[0].time_s[29];
    says(&only(&touches, &[], "clock"), &["once", "seq_0 row 30"]);
}

#[test]
fn times_in_another_unit_are_recognised_and_noted() {
    let in_unit = |factor: f64| {
        let mut touches = clean();
        touches.iter_mut().flat_map(|touch| &mut touch.time_s).for_each(|time| *time *= factor);
        touches
    };
    for (unit, factor) in [("ms", 1e3), ("us", 1e6), ("ns", 1e9)] {
        let touches = in_unit(factor);
        let found = only_at("note", &touches, &[], "time_unit");
        says(&found, &["were read as", unit, "--time-unit"]);
        let (_, report) = look(&touches, &[]);
        let period_s = report["paths"][0]["clock"]["period_s"].as_f64().unwrap();
        assert!((period_s - 0.05).abs() < 1e-9, "{period_s}");
        nothing(&touches, &["--time-unit", unit]);
    }
    let as_s = ["--time-unit", "s"];
    says(&only(&in_unit(1e9), &as_s, "time_unit"), &["nanoseconds", "--time-unit"]);
    // A period of 2 s is plausible, but the speeds are not: for example a log in ms.
    let slow = in_unit(40.0);
    says(&only(&slow, &as_s, "time_unit"), &["2.000 s", "hardly moves", "milliseconds"]);
    // No smaller unit gives the rate of a robot's log.
    let report = found(look(&in_unit(1e-4), &[]), 0, &["time_unit", "jumps"]);
    assert_eq!(first(&report)["level"], "warning");
}

#[test]
fn time_stamps_that_differ_from_the_reading_times_are_noted() {
    // The robot reports every 34 ms, and a node publishes its last report every 33.3 ms.
    let stamps = (0..300).map(|k| f64::from(k) / 30.0).collect::<Vec<_>>();
    let robot = Maker::new().robot;
    let swinging = |touch: &Touch, read_s: &dyn Fn(f64) -> f64| {
        let (mut swinging, mut random) = (touch.clone(), 0.0_f64);
        let still_s = STILL as f64 / 30.0;
        let swing = |joint: usize, time_s: f64| {
            0.15 * (1.0 - ((1.5 + 0.3 * joint as f64) * (time_s - still_s).max(0.0)).cos())
        };
        let q = stamps.iter().map(|stamp| -> Vec<f64> {
            let start = touch.q[0].iter().enumerate();
            start.map(|(joint, q)| q + swing(joint, read_s(*stamp))).collect()
        });
        swinging.q = q.collect();
        let tau = swinging.q.iter().map(|q| -> Vec<f64> {
            let gravity = robot.gravity_torque(&robot.forward(q).unwrap());
            let springs = q.iter().zip(&touch.q[0]).map(|(q, start)| 8.0 * (start - q));
            let noisy = gravity.iter().zip(springs).map(|(gravity, spring)| {
                random = (random + 0.618).fract();
                gravity + spring + 0.1 * (random - 0.5)
            });
            noisy.collect()
        });
        swinging.tau = tau.collect();
        swinging.time_s.clone_from(&stamps);
        swinging
    };
    let touches = clean();
    let relayed = swinging(&touches[0], &|stamp| (stamp / 0.034).floor() * 0.034);
    let driver = swinging(&touches[1], &|stamp| stamp);
    let found = only_at("note", &[relayed, driver, touches[2].clone()], &[], "stamps");
    says(&found, &["in 1 touch", "seq_0", "ms", "driver"]);
    assert_eq!(found["touches"], serde_json::json!(["seq_0"]));
}

#[test]
fn a_frozen_sensor_is_reported_and_is_an_error_if_strict() {
    let mut touches = clean();
    touches[1].tau.iter_mut().for_each(|tau| tau[6] = 0.05);
    let found = only(&touches, &[], "frozen_torque");
    says(&found, &["`Actuator7`", "1 of 3 touches: seq_1"]);
    assert_eq!(look(&touches, &["--strict"]).0, Some(1));
    touches.iter_mut().flat_map(|touch| &mut touch.tau).for_each(|tau| tau.fill(0.0));
    let found = first(&look(&touches, &[]).1).clone();
    says(&found, &["frozen_torque", "of no joint", "Actuator1", "Actuator7"]);
}

#[test]
fn a_stuck_sensor_is_reported_and_a_coarse_one_is_not() {
    let mut touches = clean();
    let held = touches[2].tau[40][3];
    touches[2].tau[40..70].iter_mut().for_each(|tau| tau[3] = held);
    let found = only(&touches, &[], "stuck_torque");
    says(&found, &["`Actuator4`", "seq_2 rows 40 to 69", "1 stretch:"]);
    let mut touches = clean();
    let torques = touches.iter_mut().flat_map(|touch| touch.tau.iter_mut().flatten());
    torques.for_each(|tau| *tau = (*tau / 0.2).round() * 0.2);
    let (_, report) = look(&touches, &[]);
    assert!(!codes(&report).contains(&"stuck_torque"), "{:?}", codes(&report));
}

#[test]
fn torques_that_are_cut_off_are_reported_once() {
    let mut touches = clean();
    let most = touches.iter().flat_map(|touch| &touch.tau).map(|tau| tau[0]).fold(0.0, f64::min);
    touches.iter_mut().flat_map(|touch| &mut touch.tau).for_each(|tau| {
        tau[0] = tau[0].max(0.6 * most);
    });
    let found = only(&touches, &[], "clipped_torque");
    says(&found, &["`Actuator1`", "is cut off at", "seq_0"]);
}

#[test]
fn torques_that_come_late_are_reported_with_their_delay() {
    let mut touches = clean();
    for touch in &mut touches {
        let on_time = touch.tau.clone();
        for (row, tau) in touch.tau.iter_mut().enumerate() {
            tau.clone_from(&on_time[row.saturating_sub(8)]);
        }
        // Samples from before the start of the log have their own noise.
        for row in 0..8 {
            touch.tau[row].clone_from(&on_time[STILL - 8 + row]);
        }
    }
    let found = only(&touches, &[], "delay");
    says(&found, &[" s: in 3 touches, the arm starts to move"]);
    let what = found["what"].as_str().unwrap();
    let frames: i32 = what.split(' ').find_map(|word| word.parse().ok()).unwrap();
    assert!((7..=11).contains(&frames), "{what}");
}

#[test]
fn a_jump_is_reported_and_a_wrapped_angle_is_not() {
    let mut touches = clean();
    touches[0].q[50..].iter_mut().for_each(|q| q[0] += 0.3);
    says(&only(&touches, &[], "jumps"), &["once", "seq_0 row 50 (`Actuator1` by 0.3"]);
    let mut touches = clean();
    touches[0].q[50..].iter_mut().for_each(|q| q[0] -= std::f64::consts::TAU);
    nothing(&touches, &[]);
}

#[test]
fn wrapped_angles_look_as_others_do() {
    let ways = |touches: &[Touch], flags: &[&str]| -> Vec<f64> {
        nothing(touches, flags);
        let report = look(touches, flags).1;
        let range = report["paths"][0]["touches"][0]["range"].as_array().unwrap().clone();
        range.iter().map(|ends| ends[1].as_f64().unwrap() - ends[0].as_f64().unwrap()).collect()
    };
    let moved = ways(&clean(), &[]);
    let mut touches = clean();
    let angles = |touches: &mut Vec<Touch>, change: &dyn Fn(f64) -> f64| {
        touches.iter_mut().flat_map(|touch| &mut touch.q).flatten().for_each(|q| *q = change(*q));
    };
    // The angles wrap within the motion of Actuator2, and at the rest position of Actuator6.
    angles(&mut touches, &|q| (q - 0.8).rem_euclid(std::f64::consts::TAU) + 0.8);
    assert!(touches[0].q[0][1] > 6.9 && touches[0].q[50][1] < 1.0);
    for (factor, flags) in [(1.0, [].as_slice()), (1_f64.to_degrees(), &["--angle-unit", "deg"])] {
        angles(&mut touches, &|q| q * factor);
        for (way, moved) in ways(&touches, flags).iter().zip(&moved) {
            assert!((way - moved).abs() < 1e-9, "{way} for {moved}");
        }
    }
}

#[test]
fn a_log_that_breaks_off_is_reported_and_the_next_path_inspected() {
    let folder = tempfile::tempdir().unwrap();
    let mut touches = clean();
    touches[1].tau[70][2] = f64::NAN;
    write(&folder.path().join("bad"), &touches);
    write(&folder.path().join("good"), &clean());
    let paths = ["bad", "good"].map(|name| folder.path().join(name));
    let report = found(run(inspect().args(&paths)), 1, &["unreadable"]);
    says(first(&report), &["NaN in row 70, column 2"]);
    assert_eq!(report["paths"][0]["frames"], 170);
    assert_eq!(report["paths"][1]["frames"], 300);
    assert_eq!((&report["errors"], &report["warnings"]), (&1.into(), &0.into()));
}

#[test]
fn a_touch_that_begins_under_load_is_reported() {
    let mut touches = clean();
    touches[1].tau.iter_mut().for_each(|tau| tau[1] += 2.0);
    let found = only(&touches, &[], "bias");
    says(&found, &["`Actuator2` is off by up to", "seq_1", "touching something"]);
    touches.iter_mut().flat_map(|touch| &mut touch.tau).for_each(|tau| tau[1] += 1.5);
    says(&only(&touches, &[], "bias"), &["all 3 touches", "--payload-link"]);
}

#[test]
fn no_noise_and_too_much_of_it_are_reported() {
    let silent = Maker { noise: 0.0, ..Maker::new() }.touches();
    let found = only_at("note", &silent, &["--strict"], "no_noise");
    says(&found, &["simulated", "Actuator1, Actuator2"]);
    let mut held = silent.clone();
    for touch in &mut held {
        for row in 1..recording::STILL {
            (touch.q[row], touch.tau[row]) = (touch.q[0].clone(), touch.tau[0].clone());
        }
    }
    only_at("note", &held, &[], "no_noise");
    let loud = Maker { noise: 15.0, ..Maker::new() }.touches();
    let (_, report) = look(&loud, &[]);
    assert!(codes(&report).contains(&"noise"), "{:?}", codes(&report));
}

#[test]
fn saturated_torques_are_reported() {
    let mut touches = clean();
    touches[2].tau[50..54].iter_mut().for_each(|tau| tau[4] = -9.0);
    says(&only(&touches, &[], "saturation"), &["`Actuator5`", "9.000 N·m", "4 frames", "seq_2"]);
    // A column in mN·m is not cut off.
    let mut touches = clean();
    touches.iter_mut().flat_map(|touch| &mut touch.tau).for_each(|tau| tau[1] *= 1000.0);
    let codes = codes(&look(&touches, &[]).1).join(" ");
    assert!(codes.contains("torque_unit") && !codes.contains("saturation"), "{codes}");
}

#[test]
fn a_touch_without_a_still_start_is_an_error_unless_the_tare_is_given() {
    let touches = Maker { still: 0, ..Maker::new() }.touches();
    let report = found(look(&touches, &[]), 1, &["no_start"]);
    says(first(&report), &["--tare-frames N", "--no-tare"]);
    only(&touches, &["--tare-frames", "15"], "moving_tare");
    nothing(&touches, &["--no-tare"]);
    let (exit, report) = look(&clean(), &["--tare-frames", "400"]);
    assert_eq!((exit, codes(&report)[0]), (Some(1), "tare_too_long"));
}

#[test]
fn touches_that_teach_nothing_are_reported() {
    let weak = Maker { contact: 0.1, ..Maker::new() }.touches();
    says(&only_at("note", &weak, &[], "weak_touch"), &["1 N·m", "all 3 touches"]);
    let mut touches = clean();
    let still = touches[1].q[0].clone();
    for q in &mut touches[1].q[1..] {
        q.iter_mut().zip(&still).for_each(|(q, still)| *q = still + 1e-4);
    }
    let (_, report) = look(&touches, &[]);
    assert!(codes(&report).contains(&"never_moves"), "{:?}", codes(&report));
}

#[test]
fn drift_is_reported() {
    let mut touches = clean();
    for (row, tau) in touches[2].tau.iter_mut().enumerate().skip(40) {
        tau[2] += 0.02 * (row - 40) as f64;
    }
    says(&only(&touches, &[], "drift"), &["seq_2: Actuator3 by", "1 of 3 touches"]);
}

#[test]
fn paths_of_an_unknown_kind_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("notes.md"), "not a log").unwrap();
    fs::create_dir(path("void")).unwrap();
    write(folder.path(), &clean());
    let cases = [
        ("nowhere", "does not exist"),
        ("notes.md", "has an unknown format"),
        ("void", "it is empty"),
        ("seq_0/angles.npy", "give the folder"),
    ];
    for (name, wanted) in cases {
        let (exit, report) = run(inspect().arg(path(name)));
        assert_eq!(exit, Some(1), "{name}");
        says(first(&report), &[wanted]);
    }
}
