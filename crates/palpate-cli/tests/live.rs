//! `palpate live` beside a robot that CycloneDDS plays, on loopback. The robot runs in the Python
//! environment that ./setup makes. Latencies depend on the load of the machine: they are not
//! tested here but measured by `scripts/dds_robot.py`; BENCHMARKS.md has the figures.
#![cfg(unix)]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;
mod dds;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use common::{
    interrupt, json, names, palpate, plant, refuse, samples, signal, succeed, wait_until,
};
use dds::{Domain, Live, Playing, robot};
use palpate::{ExternalTorqueConfig, Robot, TorqueModel};
use palpate_io::field::load;
use palpate_work::arm_file;
use serde_json::Value;

#[test]
fn needs_cyclonedds_the_robot_is_the_one_that_is_described_on_the_network() {
    let domain = Domain::take();
    let urdf = palpate::Robot::built_in_urdf("kinova_gen3").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("described.urdf");
    fs::write(&path, urdf.replace("Actuator", "published_")).unwrap();
    let renamed: Vec<String> =
        (1..=7).map(|joint| format!("Actuator{joint}=published_{joint}")).collect();
    let mut flags = vec!["--robot", "/robot_description"];
    renamed.iter().for_each(|name| flags.extend(["--rename", name]));
    let live = Live::start(&domain, &flags);
    let played = ["--rate", "100", "--seconds", "inf", "--description", path.to_str().unwrap()];
    let _robot = Playing::start(robot(&domain, &played));
    live.wait_for_figures("samples of the robot that was described", |figures| {
        figures["mapped"].as_u64() > Some(100)
    });
}

#[test]
fn a_missing_robot_description_is_an_error_that_names_the_topic() {
    let domain = Domain::take();
    let mut live = palpate();
    live.args(["live", "--localhost", "--domain", &domain.number.to_string()]);
    live.args(["--robot", "/nobody/robot_description", "--duration", "1"]);
    refuse(&mut live, 1, &["/nobody/robot_description", "robot_state_publisher"]);
}

#[test]
fn needs_cyclonedds_every_topic_is_received_and_no_sample_is_lost() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--guard", "1", "--checkpoint", "1"]);
    let arguments = ["--rate", "100", "--seconds", "9", "--until-received", "--guard", "1"];
    let robot = json(&mut robot(&domain, &arguments));
    live.wait_for_figures("all samples", |figures| figures["mapped"] == robot["sent"]);
    let figures = &live.end()["figures"];
    assert_eq!(figures["received"], robot["sent"]);
    assert_eq!((&figures["dropped"], &figures["lost"]), (&0.into(), &0.into()), "{figures}");
    assert!(figures["avg_error"].as_f64() < figures["zero_avg_error"].as_f64(), "{figures}");
    for (topic, count) in robot["received"].as_object().unwrap() {
        assert!(count.as_u64() > Some(0), "{topic}: {robot}");
    }
    let torques =
        |name: &str| robot["received"][format!("rt/palpate/torque_{name}")].as_u64().unwrap();
    let unpaired = torques("predicted").abs_diff(torques("external"));
    assert!(unpaired <= figures["unsent"].as_u64().unwrap(), "{robot}, {figures}");
    assert_eq!(robot["stops"].as_array().unwrap()[..3], [true, false, true], "{robot}");
    assert_eq!(robot["diagnostics"]["samples dropped"], "0");
    assert!(robot["points"]["rt/palpate/field"].as_u64() > Some(0), "{robot}");
    let report = succeed(palpate().arg("inspect").arg(live.path("field.npz")).arg("--json"));
    assert!(report.contains("kinova_gen3"), "{report}");
}

#[test]
fn needs_cyclonedds_an_identified_arm_publishes_how_sure_its_torques_are_with_a_map_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let (path, robot_of_file) = (folder.path().join("arm.toml"), "kinova_gen3");
    let model = TorqueModel::of_urdf(&Robot::built_in(robot_of_file).unwrap());
    let text = arm_file::text(
        &Robot::built_in(robot_of_file).unwrap(),
        &model,
        &ExternalTorqueConfig::default(),
        "",
    );
    fs::write(&path, text).unwrap();
    let arm = ["--arm", path.to_str().unwrap()];
    let wrench = ["--no-map", "--wrench-link", "Bracelet_Link"];
    for (more, is_mapped) in [(&[][..], true), (&wrench, false)] {
        let domain = Domain::take();
        let mut live = Live::start(&domain, &[&arm, more].concat());
        let arguments = ["--rate", "100", "--seconds", "6", "--until-received", "--identified"];
        let robot = json(&mut robot(&domain, &arguments));
        live.wait_for_figures("all samples", |figures| figures["mapped"] == robot["sent"]);
        let received = |topic: &str| robot["received"][format!("rt/palpate/{topic}")].as_u64();
        assert!(received("torque_std") > Some(0), "{robot}");
        assert_eq!(received("torque_std"), received("touched"), "{robot}");
        if !is_mapped {
            let force: Vec<f64> = serde_json::from_value(robot["wrench"][1].clone()).unwrap();
            assert_eq!(robot["wrench"][0], "Bracelet_Link");
            assert!(force.iter().any(|force| *force != 0.0), "{robot}");
        }
        live.end();
        let lines = live.lines();
        let mut lines = lines.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let touches = lines.any(|line| line["contacts"].as_u64() > Some(0));
        assert_eq!(touches, is_mapped, "{}", live.lines());
    }
    refuse(palpate().args(["live", "--localhost", "--no-map"]), 2, &["--torque-sign", "--gravity"]);
    refuse(palpate().args(["live", "--wrench-link", "hand"]), 2, &["--no-map"]);
    let arguments = ["live", "--localhost", "--arm", arm[1], "--no-map", "--wrench-link", "hand"];
    refuse(palpate().args(arguments), 2, &["no link `hand`", "Bracelet_Link"]);
    let arguments = ["live", "--guard", "5", "--localhost", "--arm", arm[1]];
    refuse(palpate().args(arguments), 2, &["leave out --guard"]);
}

#[test]
fn needs_cyclonedds_settings_are_chosen_during_the_session_except_for_given_ones() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--friction", "0.05", "--replays", "2"]);
    let robot = Playing::start(robot(&domain, &["--rate", "200", "--seconds", "inf"]));
    live.wait_for("chosen by cross-validation on 3 touches");
    live.wait_for("the field was learned again with these settings");
    drop(robot);
    live.end();
    let field = load(&live.path("field.npz")).unwrap();
    let config = field.snapshot.unwrap().config;
    let lines = live.lines();
    let note = lines.lines().rfind(|line| line.contains("was learned again")).unwrap();
    let distance = format!("contact distance {:.0} mm", 1e3 * config.contact.contact_distance_m);
    assert!(note.contains(&distance) && note.contains("friction 0.05"), "{note}");
    assert_eq!(config.contact.friction, 0.05);
    for flags in [&["--no-map"][..], &["--estimator", "ekf"]] {
        let mut command = palpate();
        command.args(["live", "--localhost", "--duration", "0.1", "--tune"]).args(flags);
        refuse(&mut command, 2, &["--estimator ekf", "leave out --tune"]);
    }
}

#[test]
fn needs_cyclonedds_broken_samples_are_refused_with_a_reason_and_the_others_mapped() {
    for (broken, reason, words) in [
        ("nan", "not finite", "the effort of joint `Actuator1` is NaN"),
        ("effort", "length", "0 efforts for 7 joints"),
        ("names", "joints", "the robot's joint `Actuator1` is not in the log"),
        ("still", "duplicate", "each time stamp is used only once"),
        ("clock", "", "the clock was set back; waiting for the arm to pause"),
    ] {
        let domain = Domain::take();
        let live = Live::start(&domain, &[]);
        let arguments = ["--rate", "100", "--seconds", "inf", "--break", broken, "--best-effort"];
        let _robot = Playing::start(robot(&domain, &arguments));
        live.wait_for(words);
        live.wait_for_figures(&format!("refused for {broken}, and others mapped"), |figures| {
            let refused = broken == "clock" || figures["refused"][reason].as_u64() > Some(1);
            refused && figures["mapped"].as_u64() > Some(100)
        });
    }
}

#[test]
fn needs_cyclonedds_a_log_that_looks_wrong_is_reported_and_ends_a_strict_session_with_its_field() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--torque-sign", "minus", "--strict"]);
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "inf"]));
    live.wait_for("looks wrong (torque_sign)");
    assert_eq!(live.child.wait().unwrap().code(), Some(1), "{}", live.lines());
    assert!(names(live.folder.path()).contains(&"field.npz".to_owned()));
}

#[test]
fn needs_cyclonedds_a_topic_that_is_not_there_is_named_beside_those_that_are() {
    let domain = Domain::take();
    let live = Live::start(&domain, &["--joint-states", "/joints"]);
    let _robot = Playing::start(robot(&domain, &["--rate", "20", "--seconds", "inf"]));
    live.wait_for("nobody publishes `/joints`");
    live.wait_for("there are /joint_states (sensor_msgs/msg/JointState)");
}

#[test]
fn needs_cyclonedds_a_network_process_that_ends_is_replaced_and_the_robot_heard_again() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--guard", "50"]);
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "inf"]));
    live.wait_for_figures("a flag that is down", |figures| figures["stopped"] == false);
    let threads = format!("/proc/{}/task", live.child.id());
    let children =
        |id: String| fs::read_to_string(format!("{threads}/{id}/children")).unwrap_or_default();
    let network = || {
        let found: String = names(Path::new(&threads)).into_iter().map(children).collect();
        found.trim().to_owned()
    };
    let first = network();
    assert!(Command::new("kill").args(["-KILL", &first]).status().unwrap().success());
    live.wait_for("another one is started");
    live.wait_for("STOP: no joint state comes");
    let heard = live.lines().len();
    wait_until("joint states from another process", || {
        let lines = live.lines();
        let rates = lines[heard..].lines().filter_map(|line| serde_json::from_str(line).ok());
        rates.skip(1).any(|figures: Value| figures["rate_hz"].as_f64() > Some(50.0))
    });
    assert_ne!(network(), first);
    assert_eq!(live.end()["figures"]["stopped"], true, "nobody has reset the guard");
}

#[test]
#[cfg(target_os = "linux")]
fn a_session_that_waits_for_a_robot_leaves_the_processor_alone() {
    let cpu_s = |live: &Live| {
        let stat = fs::read_to_string(format!("/proc/{}/stat", live.child.id())).unwrap();
        let after_name = stat.rsplit_once(") ").unwrap().1;
        // User and system time, in hundredths of a second (man 5 proc).
        let ticks = after_name.split(' ').skip(11).take(2).map(|ticks| ticks.parse::<f64>());
        ticks.sum::<Result<f64, _>>().unwrap() / 100.0
    };
    for guard in [&[][..], &["--guard", "1"]] {
        let domain = Domain::take();
        let live = Live::start(&domain, guard);
        live.wait_for("waiting: ");
        let (before_s, start) = (cpu_s(&live), Instant::now());
        thread::sleep(Duration::from_secs(2));
        let share = (cpu_s(&live) - before_s) / start.elapsed().as_secs_f64();
        assert!(share < 0.3, "{share} of a core");
    }
}

#[test]
fn sigterm_saves_the_field_and_leaves_nothing_and_a_second_session_is_refused() {
    let (domain, folder) = (Domain::take(), tempfile::tempdir().unwrap());
    let socket = folder.path().join("ask");
    let mut live = Live::start(&domain, &["--ask", socket.to_str().unwrap()]);
    wait_until("the socket", || socket.exists());
    let mut second = palpate();
    second.args(["live", "--localhost", "-o"]).arg(live.path("field.npz"));
    refuse(&mut second, 1, &["field.npz", "being written by another palpate"]);
    signal(&live.child, "-TERM");
    assert!(live.child.wait().unwrap().success(), "{}", live.lines());
    assert_eq!(names(live.folder.path()), ["field.npz", "lines.json"]);
    assert!(names(folder.path()).is_empty(), "the socket is gone");
}

#[test]
fn a_field_whose_folder_is_gone_at_the_end_is_saved_elsewhere() {
    let (domain, folder) = (Domain::take(), tempfile::tempdir().unwrap());
    let (gone, elsewhere) = (folder.path().join("gone"), folder.path().join("elsewhere"));
    fs::create_dir(&gone).unwrap();
    fs::create_dir(&elsewhere).unwrap();
    let mut live = palpate();
    live.args(["live", "--localhost", "--domain", &domain.number.to_string(), "-o"]);
    let socket = folder.path().join("ask");
    live.arg(gone.join("field.npz")).arg("--ask").arg(&socket);
    let live = live.env("TMPDIR", &elsewhere).stderr(Stdio::piped()).spawn().unwrap();
    wait_until("the session", || socket.exists());
    fs::remove_dir_all(&gone).unwrap();
    interrupt(&live);
    let output = live.wait_with_output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    let kept = elsewhere.join(&names(&elsewhere)[0]);
    assert!(
        message.contains(&format!("the field is in `{}` instead", kept.display())),
        "{message}"
    );
    succeed(palpate().arg("inspect").arg(&kept));
}

#[test]
fn an_existing_field_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let field = folder.path().join("field.npz");
    fs::write(&field, "precious").unwrap();
    let mut live = palpate();
    live.args(["live", "--localhost", "-o"]).arg(&field);
    refuse(&mut live, 2, &["is there already", "--resume"]);
    refuse(live.arg("--resume"), 1, &["field.npz"]);
    assert_eq!(fs::read_to_string(&field).unwrap(), "precious");
}

#[test]
fn needs_cyclonedds_another_type_on_the_topic_is_named_and_the_robot_is_mapped_beside_it() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--joint-states", "/joint_states"]);
    let _other = Playing::start(robot(&domain, &["--another-type"]));
    live.wait_for("`/joint_states` is published as std_msgs/msg/Bool; wanted sensor_msgs");
    let robot = json(&mut robot(&domain, &["--rate", "100", "--seconds", "2"]));
    live.wait_for_figures("all samples", |figures| figures["mapped"] == robot["sent"]);
    live.end();
}

#[test]
fn needs_cyclonedds_a_client_of_the_service_gets_its_answer_and_the_tare() {
    let domain = Domain::take();
    let mut live = Live::start(&domain, &["--services", "cyclone"]);
    let robot = json(&mut robot(&domain, &["--rate", "100", "--seconds", "1", "--tare"]));
    let answers = robot["tare"].as_array().unwrap();
    for (answer, number) in answers.iter().zip([1, 2]) {
        let [client, sequence, taring, words] = answer.as_array().unwrap().as_slice() else {
            panic!("{robot}")
        };
        assert_eq!((client.as_i64(), sequence.as_i64()), (Some(4711), Some(number)), "{robot}");
        assert_eq!(taring.as_bool(), Some(true), "{robot}");
        assert!(words.as_str().unwrap().contains("hold the arm still"), "{robot}");
    }
    assert_eq!(answers.len(), 2, "{robot}");
    live.wait_for("a tare at the next pause");
    live.end();
}

#[test]
fn needs_cyclonedds_every_service_answers_and_the_node_is_one_of_ros() {
    let domain = Domain::take();
    let flags = ["--services", "cyclone", "--guard", "30", "--checkpoint", "3600"];
    let live = Live::resume(&domain, &flags);
    let before = fs::read(live.path("field.npz")).unwrap();
    let played = ["--rate", "100", "--seconds", "2", "--call", "palpate", "--until-received"];
    let robot = json(&mut robot(&domain, &played));
    let called = &robot["called"];
    assert_eq!(robot["failed"], Value::Null, "{robot}");
    assert_eq!(called["save"], serde_json::json!([true, "the field is saved"]), "{called}");
    assert!(load(&live.path("field.npz")).is_ok());
    let now = fs::read(live.path("field.npz")).unwrap();
    assert!(now != before, "saved long before a checkpoint is due");
    assert_eq!(called["tare"][0], true, "{called}");
    assert!(called["reset"][1].as_str().is_some_and(|words| !words.is_empty()), "{called}");

    let ask = &called["ask"];
    assert_eq!((&ask["success"], &ask["message"]), (&true.into(), &"".into()), "{ask}");
    let joints: Vec<String> = (1..=7).map(|joint| format!("Actuator{joint}")).collect();
    assert_eq!(ask["joint_names"], serde_json::json!(joints), "in the robot's order");
    let rows = |name: &str| -> Vec<Vec<f64>> { serde_json::from_value(ask[name].clone()).unwrap() };
    let torques = rows("torque");
    assert_eq!((torques.len(), rows("positions").len()), (12, 12));
    assert_eq!(ask["times"], serde_json::json!((0..12).collect::<Vec<_>>()));
    let peak = torques.concat().into_iter().map(f64::abs).fold(0.0, f64::max);
    let found = |name: &str| ask[name].as_f64().unwrap();
    assert!((found("peak") - peak).abs() < 1e-12, "{ask}");
    // The band for the largest torque is at least as wide as the bands of the single torques.
    let with_band = torques.concat().into_iter().zip(rows("half_width").concat());
    let outer = with_band.map(|(torque, width)| torque.abs() + width).fold(0.0, f64::max);
    assert!(found("level") == 0.9 && outer > peak && found("peak_with_band") >= outer, "{ask}");
    assert_eq!(called["refused"][0], false);
    assert!(called["refused"][1].as_str().unwrap().contains("Actuator7"), "{}", called["refused"]);
    let uneven = called["uneven"][1].as_str().unwrap();
    assert!(uneven.contains("point 0 (from 0) has 7 positions for 6 joint names"), "{uneven}");

    let names: Vec<String> = serde_json::from_value(called["names"].clone()).unwrap();
    let place = |name: &str| names.iter().position(|other| other == name).unwrap();
    assert_eq!(called["values"][place("use_sim_time")][1], false);
    assert_eq!(called["values"][place("guard")][2], 30.0);
    assert_eq!(called["values"][place("robot")][3], "kinova_gen3");
    let types = called["types"].as_array().unwrap();
    assert_eq!(
        (types.len(), types.last().unwrap().as_u64()),
        (names.len() + 1, Some(0)),
        "not set"
    );
    for (described, name) in called["described"].as_array().unwrap().iter().zip(&names) {
        assert_eq!((&described[0], &described[3]), (&Value::from(&**name), &true.into()));
        assert_eq!(described[1], types[place(name)]);
        assert!(!described[2].as_str().unwrap().is_empty(), "{name}");
    }
    let set = called["set"].as_array().unwrap();
    assert!(set[..names.len()].iter().all(|result| result[0] == true), "as they are: {set:?}");
    let refused = set.last().unwrap();
    assert!(refused[0] == false && refused[1].as_str().unwrap().contains("flag of `palpate live`"));
    assert_eq!(called["set_all"], serde_json::json!([true, false]));

    let node = &robot["nodes"]["/palpate"];
    assert!(node[0].as_u64() >= Some(11) && node[1].as_u64() >= Some(19), "{}", robot["nodes"]);
}

#[test]
fn needs_cyclonedds_a_simulations_time_and_other_names_are_those_of_ros() {
    let domain = Domain::take();
    let names = ["--remap", "__node:=hand", "--remap", "/palpate/contacts:=/left/touched"];
    let mut flags = vec!["--sim-time", "--services", "cyclone"];
    flags.extend(names);
    let live = Live::start(&domain, &flags);
    let played = ["--rate", "50", "--seconds", "6", "--simulation", "--call", "hand"];
    let robot = json(&mut robot(&domain, &played));
    assert_eq!(robot["failed"], Value::Null, "{robot}");
    // Samples without a stamp get the simulation's time, which runs at half the speed.
    let stamp = robot["stamp"].as_f64().unwrap();
    assert!((1001.0..1100.0).contains(&stamp), "{stamp}");
    let counts = &robot["received"];
    assert!(counts["rt/palpate/torque_predicted"].as_u64() > Some(0), "{counts}");
    assert_eq!(counts["rt/palpate/contacts"], 0, "it has another name: {counts}");
    assert!(robot["nodes"].get("/hand").is_some(), "{}", robot["nodes"]);
    assert_eq!(robot["called"]["values"][0][1], true, "use_sim_time");
    live.wait_for_figures("samples", |figures| figures["mapped"].as_u64() > Some(50));
}

#[test]
fn needs_cyclonedds_joint_states_of_ros2_control_are_mapped() {
    let domain = Domain::take();
    let live = Live::start(&domain, &[]);
    let robot = json(&mut robot(&domain, &["--rate", "100", "--seconds", "2", "--dynamic"]));
    live.wait_for("listening to `/dynamic_joint_states`");
    live.wait_for_figures("all samples", |figures| figures["mapped"] == robot["sent"]);
}

/// Writes a line to a socket, and returns the line that answers it.
fn ask(stream: &mut BufReader<UnixStream>, line: &Value) -> Value {
    stream.get_mut().write_all(format!("{line}\n").as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_line(&mut answer).unwrap();
    serde_json::from_str(&answer).unwrap()
}

#[test]
fn needs_cyclonedds_questions_are_answered_while_it_maps() {
    let domain = Domain::take();
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("ask");
    let live = Live::resume(&domain, &["--ask", socket.to_str().unwrap()]);
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "inf"]));
    live.wait_for("\"state\":\"mapping\"");
    let mut stream = BufReader::new(UnixStream::connect(&socket).unwrap());
    let mut ask = |line: &Value| ask(&mut stream, line);
    let start = [1.362, -0.5258, 2.1044, -2.0491, 0.5411, 0.1605, 0.2473];
    let path: Vec<Vec<f64>> =
        (0..50).map(|i| start.map(|q| q + 0.004 * f64::from(i)).to_vec()).collect();
    let answer = ask(&serde_json::json!({ "path": path }));
    let rows = answer["torque"].as_array().unwrap_or_else(|| panic!("{answer}"));
    assert_eq!((rows.len(), rows[0].as_array().unwrap().len()), (50, 7));
    let stds: Vec<f64> =
        answer["torque_std"][49].as_array().unwrap().iter().map(|s| s.as_f64().unwrap()).collect();
    assert!(stds.iter().all(|&std| std >= 0.0) && stds.iter().any(|&std| std > 0.0), "{stds:?}");
    let widths =
        |name: &str| -> Vec<Vec<f64>> { serde_json::from_value(answer[name].clone()).unwrap() };
    let widths = widths("half_width").concat().into_iter().zip(widths("peak_half_width").concat());
    assert!(widths.clone().count() == 350 && widths.into_iter().all(|(own, peak)| own <= peak));
    let bytes: Vec<u8> = path.concat().iter().flat_map(|q| q.to_le_bytes()).collect();
    let path_f64 = BASE64_STANDARD.encode(bytes);
    let answer = ask(&serde_json::json!({ "path_f64": path_f64 }));
    let bytes = BASE64_STANDARD.decode(answer["torque_f64"].as_str().unwrap()).unwrap();
    assert_eq!((bytes.len(), answer["contacts"].as_array().unwrap().len()), (50 * 7 * 8, 50));
    let answer = ask(&serde_json::json!({ "path": [[1, 2]] }));
    assert!(answer["error"].as_str().unwrap().contains("point 0"));
    assert_eq!(ask(&serde_json::json!({ "tare": true }))["taring"], true);
    live.wait_for("a tare at the next pause");
}

#[test]
fn needs_cyclonedds_a_body_learns_touch_by_touch_answers_questions_and_goes_on() {
    let (domain, folder) = (Domain::take(), tempfile::tempdir().unwrap());
    let socket = folder.path().join("ask");
    let cloud = plant().join("object.ply");
    let arguments = ["--ask", socket.to_str().unwrap(), "--cloud", cloud.to_str().unwrap()];
    let mut live = Live::start(&domain, &[&arguments[..], &["--replays", "2"]].concat());
    let playing = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "inf"]));
    let answer = |path: &[Vec<f64>]| -> Value {
        let mut stream = BufReader::new(UnixStream::connect(&socket).unwrap());
        ask(&mut stream, &serde_json::json!({ "path": path }))
    };
    live.wait_for("\"state\":\"mapping\"");
    // A push that comes later: only the body is known there.
    let q = samples(&plant().join("seq_003")).into_iter().map(|sample| sample.q);
    let answer = answer(&q.step_by(10).collect::<Vec<_>>());
    let torques = answer["torque"].as_array().unwrap_or_else(|| panic!("{answer}"));
    let largest = torques.iter().flat_map(|row| row.as_array().unwrap());
    let largest = largest.map(|torque| torque.as_f64().unwrap().abs()).fold(0.0, f64::max);
    assert!(largest > 1.0, "{answer}");
    live.wait_for("touches that the elastic body has learnt: 1");
    drop(playing);
    live.end();
    let field = live.path("field.npz");
    let saved = load(&field).unwrap();
    let (model, touches) = (saved.field.elastic.unwrap(), saved.elastic_touches.len());
    assert!(model.share > 0.1 && !model.residual_cells.is_empty(), "{}", model.share);
    assert!(model.calibration.as_ref().is_some_and(|bands| bands.of_other_objects));
    assert!(model.speed_m_per_s > 0.01 && model.speed_m_per_s < 1.0, "{}", model.speed_m_per_s);

    let folder = tempfile::tempdir().unwrap();
    let again = folder.path().join("field.npz");
    let mut map = palpate();
    succeed(map.args(["map", "--from"]).arg(&field).arg("-o").arg(&again));
    let learnt = load(&again).unwrap();
    assert_eq!(learnt.elastic_touches.len(), touches);
    assert_eq!(learnt.field.stiffness_n_per_m, saved.field.stiffness_n_per_m);
    let mut on = Live::start_in(folder, &domain, &["--resume"]);
    on.wait_for("waiting: ");
    on.end();
    let resumed = load(&on.path("field.npz")).unwrap();
    assert_eq!(
        (resumed.field.elastic, resumed.elastic_touches.len()),
        (learnt.field.elastic, touches)
    );
}

#[test]
fn needs_cyclonedds_whenever_it_is_killed_it_continues_from_a_whole_checkpoint() {
    let domain = Domain::take();
    let mut folder = tempfile::tempdir().unwrap();
    let _robot = Playing::start(robot(&domain, &["--rate", "100", "--seconds", "inf"]));
    let mut cells = 0;
    for round in 0..9 {
        let arguments = ["--resume", "--checkpoint", "0.05", "--replays", "2"];
        let mut live = Live::start_in(folder, &domain, &arguments);
        if round % 3 == 0 {
            let more = |figures: &Value| figures["cells"].as_u64() > Some(cells);
            live.wait_for_figures("more cells", more);
        }
        live.wait_for_checkpoint(live.written());
        if round % 3 > 0 {
            live.wait_for_writing();
        }
        live.kill();
        let field = live.path("field.npz");
        let report = succeed(palpate().arg("inspect").arg(&field).arg("--json"));
        let report: Value = serde_json::from_str(&report).unwrap();
        let now = report["paths"][0]["cells"].as_u64().unwrap_or_else(|| panic!("{report}"));
        assert!(now >= cells && now > 0, "round {round}: {now} cells after {cells}");
        cells = now;
        let files = names(live.folder.path());
        let what = "the field, what holds it, the lines, one that was being written";
        assert!(files.len() <= 4, "{what}: {files:?}");
        folder = tempfile::tempdir().unwrap();
        fs::copy(&field, folder.path().join("field.npz")).unwrap();
    }
}
