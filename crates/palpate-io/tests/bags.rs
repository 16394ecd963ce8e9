//! Bags of ROS 2: samples that are read back, and errors and warnings for defective bags.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use palpate::TorqueSign;
use palpate_io::log::bag_write::{BagWriter, Compression};
use palpate_io::log::write::TouchWriter;
use palpate_io::log::{
    self, AngleUnit, LogEvent, LogFormat, LogOptions, LogWarning, LoggedTorques, Sample,
};
use re_cdr::{CdrWriter, LittleEndian};
use tempfile::TempDir;

use common::refused;

const JOINT_STATE: &str = "std_msgs/Header header\nstring[] name\nfloat64[] position\n\
    float64[] velocity\nfloat64[] effort\n===\nMSG: std_msgs/Header\n\
    builtin_interfaces/Time stamp\nstring frame_id\n===\nMSG: builtin_interfaces/Time\n\
    int32 sec\nuint32 nanosec\n";

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn sample(i: usize) -> Sample {
    let x = i as f64;
    Sample::new(Some(x / 64.0), vec![x.sin(), -x], vec![1.0 / (x + 1.0), 1e-300 * x])
}

/// Writes two touches with `samples` samples each.
fn write(path: &Path, samples: usize, compression: Compression) {
    let joints = names(&["a", "b"]);
    let mut bag = BagWriter::new(File::create(path).unwrap(), joints, compression).unwrap();
    for touch in ["first push", "second"] {
        bag.touch(touch).unwrap();
        (0..samples).for_each(|i| bag.sample(&sample(i)).unwrap());
    }
    bag.finish().unwrap();
}

/// A bag of any messages, without chunks, with a topic of joint states.
struct Raw {
    folder: TempDir,
    bag: mcap::Writer<File>,
    states: u16,
}

/// A joint state as bytes.
fn state(time_ns: i64, joints: &[&str], position: &[f64], effort: &[f64]) -> Vec<u8> {
    let mut body = Vec::new();
    let mut out = CdrWriter::<LittleEndian>::new(&mut body);
    out.write_i32((time_ns / 1_000_000_000) as i32);
    out.write_u32((time_ns % 1_000_000_000) as u32);
    out.write_string("base");
    out.write_u32(joints.len() as u32);
    joints.iter().for_each(|joint| out.write_string(joint));
    for values in [position, &[], effort] {
        out.write_u32(values.len() as u32);
        values.iter().for_each(|&value| out.write_f64(value));
    }
    [vec![0, 1, 0, 0], body].concat()
}

impl Raw {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = File::create(folder.path().join("bag.mcap")).unwrap();
        let mut bag = mcap::WriteOptions::new().use_chunks(false).create(file).unwrap();
        let kind = "sensor_msgs/msg/JointState";
        let schema = bag.add_schema(kind, "ros2msg", JOINT_STATE.as_bytes()).unwrap();
        let states = bag.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new()).unwrap();
        Self { folder, bag, states }
    }

    fn channel(&mut self, topic: &str, kind: &str, definition: &str) -> u16 {
        let schema = self.bag.add_schema(kind, "ros2msg", definition.as_bytes()).unwrap();
        self.bag.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
    }

    fn put(&mut self, channel_id: u16, log_time: u64, data: &[u8]) {
        let header = MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
        self.bag.write_to_known_channel(&header, data).unwrap();
    }

    fn state(&mut self, time_ns: i64, joints: &[&str], position: &[f64], effort: &[f64]) {
        let data = state(time_ns, joints, position, effort);
        self.put(self.states, 5_000_000_000 + time_ns.unsigned_abs(), &data);
    }

    fn done(mut self) -> (TempDir, PathBuf) {
        self.bag.finish().unwrap();
        let path = self.folder.path().join("bag.mcap");
        (self.folder, path)
    }
}

/// All events of a log, its warnings, or the error.
fn read(path: &Path, options: &LogOptions) -> Result<(Vec<LogEvent>, Vec<LogWarning>), String> {
    let mut log = log::open(path, options).map_err(|error| error.to_string())?;
    let events: Result<Vec<_>, _> = log.by_ref().collect();
    let events = events.map_err(|error| error.to_string())?;
    Ok((events, log.warnings().to_vec()))
}

fn samples(events: &[LogEvent]) -> Vec<Sample> {
    let only = |event: &LogEvent| match event {
        LogEvent::Sample(sample) => Some(sample.clone()),
        LogEvent::TouchStarts { .. } => None,
    };
    events.iter().filter_map(only).collect()
}

#[test]
fn written_bags_read_back_exactly_with_every_compression() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let path = folder.path().join("bag.mcap");
        write(&path, 700, compression);
        let description = log::open(&path, &LogOptions::default()).unwrap().describe();
        assert_eq!(description.format, LogFormat::Mcap);
        assert_eq!((description.touches, description.samples), (Some(2), Some(1400)));
        let (events, warnings) = read(&path, &LogOptions::default()).unwrap();
        assert_eq!(warnings, []);
        let start = |name: &str| LogEvent::TouchStarts {
            name: name.to_owned(),
            joint_names: Some(names(&["a", "b"])),
        };
        let mut expected = Vec::new();
        for touch in ["first push", "second"] {
            expected.push(start(touch));
            expected.extend((0..700).map(|i| LogEvent::Sample(sample(i))));
        }
        assert_eq!(events, expected);
    }
}

#[test]
fn a_bag_that_breaks_off_says_how_far_it_went_and_can_be_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut raw = Raw::new();
    (0..1000).for_each(|i| raw.state(i * 10_000_000 + 1, &["a"], &[i as f64], &[0.5]));
    let (_kept, whole) = raw.done();
    let bytes = fs::read(whole).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    refused(&path, &LogOptions::default(), &["breaks off after", "cut short", "--until-break"]);

    let options = LogOptions { until_break: true, ..LogOptions::default() };
    let (events, warnings) = read(&path, &options).unwrap();
    let [LogWarning::BrokenOff { messages, seconds, .. }] = &warnings[..] else {
        panic!("{warnings:?}")
    };
    assert!(*messages > 300 && (*seconds - (*messages - 1) as f64 * 0.01).abs() < 1e-9);
    assert_eq!(samples(&events).len() as u64, *messages);
}

#[test]
fn topics_are_chosen_if_there_is_a_choice_and_named_if_not() {
    let mut raw = Raw::new();
    raw.state(1, &["a"], &[0.0], &[0.5]);
    let text = raw.channel("/notes", "std_msgs/msg/String", "string data\n");
    raw.put(text, 0, &[0, 1, 0, 0, 1, 0, 0, 0, 0]);
    let (_kept, path) = raw.done();
    let on = |topic: &str| LogOptions { topic: Some(topic.to_owned()), ..LogOptions::default() };
    assert_eq!(samples(&read(&path, &LogOptions::default()).unwrap().0).len(), 1);
    assert_eq!(samples(&read(&path, &on("joint_states")).unwrap().0).len(), 1);
    let topics = ["`/joint_states` (sensor_msgs/msg/JointState, 1 messages)", "`/notes`"];
    refused(&path, &on("/elsewhere"), &[&["`/elsewhere`"][..], &topics].concat());
    refused(&path, &on("/notes"), &[&["std_msgs/msg/String"][..], &topics].concat());

    let mut raw = Raw::new();
    raw.state(1, &["a"], &[0.0], &[0.5]);
    let second = raw.channel("/other", "sensor_msgs/msg/JointState", JOINT_STATE);
    raw.put(second, 0, &state(1, &["b"], &[0.0], &[0.5]));
    let (_kept, path) = raw.done();
    refused(&path, &LogOptions::default(), &["more than one", "--topic", "/joint_states, /other"]);
}

/// A message of a maker: the numbers of its fields, in their order.
enum Number {
    U32(u32),
    F32(f32),
    F64(f64),
}

fn message(numbers: &[Number]) -> Vec<u8> {
    let mut body = Vec::new();
    let mut out = CdrWriter::<LittleEndian>::new(&mut body);
    for number in numbers {
        match *number {
            Number::U32(number) => out.write_u32(number),
            Number::F32(number) => out.write_f32(number),
            Number::F64(number) => out.write_f64(number),
        }
    }
    [vec![0, 1, 0, 0], body].concat()
}

#[test]
fn states_of_kuka_hold_external_torques_and_measured_ones_on_request() {
    let mut raw = Raw::new();
    // Releases differ in their fields.
    let definition = "float64 sample_time\nuint32 time_stamp_sec\nuint32 time_stamp_nano_sec\n\
        float64[2] measured_joint_position\nfloat64[2] commanded_joint_position\n\
        float64[2] measured_torque\nfloat64[2] external_torque\n";
    let topic = raw.channel("/lbr/state", "lbr_fri_idl/msg/LBRState", definition);
    let mut numbers = vec![Number::F64(0.005), Number::U32(7), Number::U32(500_000_000)];
    let values = [[0.1, 0.2], [9.0, 9.0], [3.0, 4.0], [0.5, 0.6]];
    numbers.extend(values.into_iter().flatten().map(Number::F64));
    raw.put(topic, 1, &message(&numbers));
    let (_kept, path) = raw.done();
    let external = LoggedTorques::External(Some(TorqueSign::Plus));
    for (measured_torques, kind, tau) in
        [(false, external, [0.5, 0.6]), (true, LoggedTorques::Unknown, [3.0, 4.0])]
    {
        let options = LogOptions { measured_torques, ..LogOptions::default() };
        let description = log::open(&path, &options).unwrap().describe();
        assert_eq!((description.torques, description.joints), (kind, Some(2)));
        let (events, _) = read(&path, &options).unwrap();
        let LogEvent::TouchStarts { joint_names: None, .. } = &events[0] else {
            panic!("{events:?}")
        };
        let expected = Sample::new(Some(7.5), vec![0.1, 0.2], tau.to_vec());
        assert_eq!(samples(&events), [expected]);
    }
}

#[test]
fn feedback_of_kinova_is_in_degrees_unless_a_unit_is_given() {
    let mut raw = Raw::new();
    let definition = "uint32 frame_id\nActuatorFeedback[] actuators\nuint32 last\n\
        ===\nMSG: kortex_driver/ActuatorFeedback\nuint32 id\nfloat32 position\nfloat32 torque\n";
    for (kind, name) in [("kortex_driver/msg/BaseCyclic_Feedback", "/a"), ("other/Feedback", "/b")]
    {
        let topic = raw.channel(name, kind, definition);
        let mut numbers = vec![Number::U32(1), Number::U32(2)];
        for (position, torque) in [(180.0, -2.0), (350.0, 4.0)] {
            numbers.extend([Number::U32(3), Number::F32(position), Number::F32(torque)]);
        }
        numbers.push(Number::U32(9));
        raw.put(topic, 2_500_000_000, &message(&numbers));
    }
    let (_kept, path) = raw.done();
    let half = std::f64::consts::PI;
    for (angle_unit, q) in [
        (None, [half, 350_f64.to_radians()]),
        (Some(AngleUnit::Deg), [half, 350_f64.to_radians()]),
        (Some(AngleUnit::Rad), [180.0, 350.0]),
    ] {
        let options = LogOptions { angle_unit, ..LogOptions::default() };
        let description = log::open(&path, &options).unwrap().describe();
        assert_eq!(description.angle_unit, Some(AngleUnit::Deg));
        let (events, _) = read(&path, &options).unwrap();
        assert_eq!(samples(&events), [Sample::new(Some(2.5), q.to_vec(), vec![-2.0, 4.0])]);
    }
    let other = LogOptions { topic: Some("/b".to_owned()), ..LogOptions::default() };
    refused(&path, &other, &["other/Feedback", "not joint states"]);
}

#[test]
fn the_only_topic_of_joint_states_is_read_before_those_of_makers() {
    let mut raw = Raw::new();
    raw.state(1, &["a"], &[0.25], &[0.5]);
    let definition = "float64[1] q\nfloat64[1] tau_ext_hat_filtered\nstd_msgs/Header header\n";
    let definition = format!("{definition}{}", &JOINT_STATE[JOINT_STATE.find("===").unwrap()..]);
    let topic = raw.channel("/franka", "franka_msgs/msg/FrankaRobotState", &definition);
    let stamp = [Number::U32(1), Number::U32(0), Number::U32(0)];
    let numbers: Vec<Number> = [0.75, 2.0].map(Number::F64).into_iter().chain(stamp).collect();
    raw.put(topic, 1, &message(&numbers));
    let (_kept, path) = raw.done();
    let on = |topic: Option<&str>| LogOptions {
        topic: topic.map(str::to_owned),
        ..LogOptions::default()
    };
    for (topic, q) in [(None, 0.25), (Some("/franka"), 0.75)] {
        assert_eq!(samples(&read(&path, &on(topic)).unwrap().0)[0].q, [q]);
    }
}

#[test]
fn joint_states_with_fewer_torques_than_a_topic_of_the_maker_are_not_read() {
    let definition = "float64 sample_time\nuint32 time_stamp_sec\nuint32 time_stamp_nano_sec\n\
        float64[2] measured_joint_position\nfloat64[2] measured_torque\nfloat64[2] external_torque\n";
    for (joints, effort) in [(&["a", "b"][..], &[][..]), (&["grip"], &[0.5])] {
        let mut raw = Raw::new();
        raw.state(1, joints, &[0.25, 0.35][..joints.len()], effort);
        let topic = raw.channel("/lbr/state", "lbr_fri_idl/msg/LBRState", definition);
        let numbers = [0.1, 0.2, 3.0, 4.0, 0.5, 0.6].map(Number::F64);
        let stamp = [Number::F64(0.005), Number::U32(7), Number::U32(0)];
        let numbers: Vec<Number> = stamp.into_iter().chain(numbers).collect();
        raw.put(topic, 1, &message(&numbers));
        let (_kept, path) = raw.done();
        assert_eq!(samples(&read(&path, &LogOptions::default()).unwrap().0)[0].q, [0.1, 0.2]);
    }
}

#[test]
fn joints_are_matched_by_name_in_any_order_and_others_are_left_out() {
    let mut raw = Raw::new();
    raw.state(1, &["grip"], &[9.0], &[f64::NAN]);
    raw.state(2, &["a", "b", "grip"], &[1.0, 2.0, 3.0], &[0.1, 0.2, 0.3]);
    raw.state(3, &["grip", "b", "a"], &[3.0, 2.0, 1.0], &[0.3, 0.2, 0.1]);
    let (_kept, path) = raw.done();
    let (events, warnings) = read(&path, &LogOptions::default()).unwrap();
    let rows: Vec<Vec<f64>> = samples(&events).into_iter().map(|sample| sample.q).collect();
    assert_eq!(rows, [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]);
    assert_eq!(warnings, [LogWarning::LeftOut { other_joints: 1, before_touch: 0 }]);

    let joints = |list: &[&str]| LogOptions { joints: Some(names(list)), ..LogOptions::default() };
    let (events, _) = read(&path, &joints(&["b", "a"])).unwrap();
    assert_eq!(samples(&events)[1].tau, [0.2, 0.1]);
    refused(&path, &joints(&["c"]), &["none of them of the joints c"]);

    // A gripper's joint without torques in the arm's messages is left out; a single NaN of an arm's joint is an error.
    let mut raw = Raw::new();
    let arm_and_grip = |raw: &mut Raw, time_ns, tau: f64| {
        raw.state(time_ns, &["a", "grip", "b"], &[1.0, 3.0, 2.0], &[0.1, f64::NAN, tau]);
    };
    arm_and_grip(&mut raw, 1, 0.2);
    arm_and_grip(&mut raw, 2, 0.2);
    let (_kept, path) = raw.done();
    let (events, _) = read(&path, &LogOptions::default()).unwrap();
    assert_eq!(
        (&samples(&events)[1].q[..], &samples(&events)[1].tau[..]),
        (&[1.0, 2.0][..], &[0.1, 0.2][..])
    );
    let mut raw = Raw::new();
    arm_and_grip(&mut raw, 1, f64::NAN);
    arm_and_grip(&mut raw, 2, 0.2);
    let (_kept, path) = raw.done();
    refused(&path, &LogOptions::default(), &["the torque of joint `b` is NaN", "--joints"]);
}

#[test]
fn messages_that_cannot_be_used_are_named_with_their_number() {
    let bad: [(&[f64], &[f64], &str); 4] = [
        (&[0.0], &[], "no effort"),
        (&[0.0], &[1.0, 2.0], "1 joints, 1 positions and 2 torques"),
        (&[f64::NAN], &[1.0], "the position of joint `a` is NaN"),
        (&[0.0], &[f64::INFINITY], "the torque of joint `a` is inf"),
    ];
    for (position, effort, words) in bad {
        let mut raw = Raw::new();
        raw.state(1, &["a"], &[0.0], &[1.0]);
        raw.state(2, &["a"], position, effort);
        let (_kept, path) = raw.done();
        refused(&path, &LogOptions::default(), &["message 1 (from 0)", "`/joint_states`", words]);
    }
    let mut raw = Raw::new();
    raw.put(raw.states, 0, &state(1, &["a"], &[0.0], &[1.0])[..30]);
    let (_kept, path) = raw.done();
    refused(&path, &LogOptions::default(), &["message 0", "do not fit its definition"]);
    let (_kept, path) = Raw::new().done();
    refused(&path, &LogOptions::default(), &["no topic holds joint states"]);
}

#[test]
fn a_clock_that_stands_or_goes_back_is_reported_and_one_that_is_missing_is_that_of_recording() {
    let mut raw = Raw::new();
    for second in [5, 6, 6, 4] {
        raw.state(second * 1_000_000_000, &["a"], &[0.0], &[1.0]);
    }
    let (_kept, path) = raw.done();
    let (_, warnings) = read(&path, &LogOptions::default()).unwrap();
    let [LogWarning::TimeNotIncreasing { row: 2, count: 2, .. }] = warnings[..] else {
        panic!("{warnings:?}")
    };

    let mut raw = Raw::new();
    for second in [3, 4] {
        raw.put(raw.states, second * 1_000_000_000, &state(0, &["a"], &[0.0], &[1.0]));
    }
    let (_kept, path) = raw.done();
    let (events, _) = read(&path, &LogOptions::default()).unwrap();
    let times: Vec<Option<f64>> = samples(&events).iter().map(|sample| sample.time_s).collect();
    assert_eq!(times, [Some(3.0), Some(4.0)]);
}

#[test]
fn markers_of_any_type_start_touches_and_what_comes_before_is_counted() {
    let kinds: [(&str, &str, &[u8], &str); 3] = [
        ("std_msgs/msg/Empty", "", &[0], "touch_000"),
        ("std_msgs/msg/Int32", "int32 data\n", &[7, 0, 0, 0], "7"),
        ("std_msgs/msg/String", "string data\n", &[3, 0, 0, 0, b'u', b'p', 0], "up"),
    ];
    for (kind, definition, body, expected) in kinds {
        let mut raw = Raw::new();
        let marks = raw.channel("/mark", kind, definition);
        raw.state(1, &["a"], &[0.0], &[1.0]);
        raw.put(marks, 2, &[&[0, 1, 0, 0], body].concat());
        raw.state(3, &["a"], &[0.0], &[1.0]);
        let (_kept, path) = raw.done();
        let touch_topic = Some("/mark".to_owned());
        let (events, warnings) =
            read(&path, &LogOptions { touch_topic, ..LogOptions::default() }).unwrap();
        let LogEvent::TouchStarts { name, .. } = &events[0] else { panic!("{events:?}") };
        assert_eq!((name.as_str(), events.len()), (expected, 2));
        assert_eq!(warnings, [LogWarning::LeftOut { other_joints: 0, before_touch: 1 }]);
    }
}

#[test]
fn touches_get_different_names_whatever_the_markers_say() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let file = File::create(&path).unwrap();
    let mut bag = BagWriter::new(file, names(&["a", "b"]), Compression::None).unwrap();
    for touch in ["push_2", "push", "push"] {
        bag.touch(touch).unwrap();
        bag.sample(&sample(1)).unwrap();
    }
    bag.finish().unwrap();
    let read: Vec<String> = common::touches(&path).into_iter().map(|(name, _)| name).collect();
    assert_eq!(read, ["push_2", "push", "push_3"]);
}

#[test]
fn gaps_split_touches_of_any_format() {
    let mut raw = Raw::new();
    for ms in [0, 10, 20, 520, 530, 1031] {
        raw.state(1 + ms * 1_000_000, &["a"], &[0.0], &[1.0]);
    }
    let (_kept, path) = raw.done();
    let options = LogOptions { split_gap_s: Some(0.4), ..LogOptions::default() };
    let (events, _) = read(&path, &options).unwrap();
    let starts = events.iter().filter_map(|event| match event {
        LogEvent::TouchStarts { name, joint_names } => Some((name.as_str(), joint_names.is_some())),
        LogEvent::Sample(_) => None,
    });
    assert_eq!(starts.collect::<Vec<_>>(), [("bag", true), ("bag_2", true), ("bag_3", true)]);
    assert_eq!(samples(&events).len(), 6);

    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("push.csv");
    fs::write(&table, "q1,tau1\n0,1\n").unwrap();
    refused(&table, &options, &["push.csv", "has no time", "--split-gap-s"]);
}

#[test]
fn files_that_are_no_bag_of_ros_2_get_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let options = LogOptions::default();
    refused(&at("old.bag", b"#ROSBAG V2.0\n"), &options, &["ROS 1", "rosbags-convert"]);
    refused(&at("empty.mcap", b""), &options, &["is empty"]);
    refused(&at("text.mcap", b"hello, this is text"), &options, &["neither like MCAP"]);
    refused(&at("cut.db3", b"SQLite format 3\0 and no more"), &options, &["cut.db3"]);
    refused(&at("cut.mcap", b"\x89MCAP0\r\n and no more"), &options, &["cut.mcap"]);

    let bag = folder.path().join("recorded");
    fs::create_dir(&bag).unwrap();
    fs::write(
        bag.join("metadata.yaml"),
        "rosbag2_bagfile_information:\n  relative_file_paths: [gone.mcap]\n",
    )
    .unwrap();
    refused(&bag, &options, &["gone.mcap", "does not exist"]);
}

#[test]
fn a_text_that_claims_gigabytes_is_refused_before_memory_is_allocated() {
    let mut raw = Raw::new();
    (0..5).for_each(|i| raw.state(i * 10_000_000 + 1, &["a"], &[i as f64], &[0.5]));
    let (_kept, path) = raw.done();
    let whole = fs::read(&path).unwrap();
    let text = |text: &[u8]| whole.windows(text.len()).position(|bytes| bytes == text).unwrap();
    for text in [text(b"/joint_states"), text(b"sensor_msgs/msg/JointState"), text(b"cdr")] {
        let mut bytes = whole.clone();
        bytes[text - 4..text].copy_from_slice(&u32::MAX.to_le_bytes());
        fs::write(&path, &bytes).unwrap();
        refused(
            &path,
            &LogOptions::default(),
            &["claims to be longer than the record that contains it"],
        );
    }
}
