//! Logs as tables: supported variants, and errors for defects.
#![allow(missing_docs, clippy::unwrap_used)]

mod common;

use common::events as read_as;
use palpate_io::log::{
    AngleUnit, CsvColumns, LogEvent, LogOptions, LogWarning, Sample, TimeUnit, open,
};
use std::fs;
use tempfile::TempDir;

fn folder_with(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

/// Events of one table, or its error message.
fn read(text: &str) -> Result<Vec<LogEvent>, String> {
    let folder = folder_with(&[("push.csv", text)]);
    read_as(&folder.path().join("push.csv"), &LogOptions::default())
}

fn start(name: &str, joints: Option<&[&str]>) -> LogEvent {
    let joint_names = joints.map(|names| names.iter().map(|&name| name.to_owned()).collect());
    LogEvent::TouchStarts { name: name.to_owned(), joint_names }
}

fn sample(time_s: Option<f64>, q: &[f64], tau: &[f64]) -> LogEvent {
    LogEvent::Sample(Sample::new(time_s, q.to_vec(), tau.to_vec()))
}

#[test]
fn every_dialect_gives_the_same_samples() {
    let wanted = vec![
        start("push", None),
        sample(Some(0.0), &[0.1, -0.2], &[1.0, 2e-3]),
        sample(Some(0.05), &[0.1, -0.3], &[1.5, 2.0]),
    ];
    for text in [
        "t,q1,q2,tau1,tau2\n0,0.1,-0.2,1,2e-3\n0.05,0.1,-0.3,1.5,2\n",
        "\u{feff}t;q1;q2;tau1;tau2\r\n0;0.1;-0.2;1;2e-3\r\n0.05;0.1;-0.3;1.5;2",
        "# by hand\n\"t\"\t\"q1\"\tq2\ttau1\ttau2\n0\t0.1\t-0.2\t1\t2e-3\n# a pause\n\n0.05\t0.1\t\
         -0.3\t1.5\t2\n",
        "# t q1 q2 tau1 tau2\n0 0.1 -0.2 1 2e-3\n0.05 0.1 -0.3 1.5 2\n",
        "timestamp actual_q_0 actual_q_1 actual_current_0 actual_current_1\r\n0 0.1 -0.2 1 2e-3\r\n0.05 \
         0.1 -0.3 1.5 2\r\n",
        "# t, q1, q2, tau1, tau2\n0, 0.1, -0.2, 1, 2e-3\n0.05, 0.1, -0.3, 1.5, 2\n",
        "q1,tau1,q2,tau2,timestamp\n0.1,1,-0.2,2e-3,1970-01-01 00:00:00\n0.1,1.5,-0.3,2,1970-01-01 \
         00:00:00.050\n",
        ",q1,tau1,q2,tau2\n1970-01-01T00:00:00Z,0.1,1,-0.2,2e-3\n1970-01-01T00:00:00.05Z,0.1,1.5,-0.3,2\n",
        "tau2,note,tau1,q2,q1,time\n2e-3,\"a, b\",1,-0.2,0.1,0\n2,,1.5,-0.3,0.1,0.05\n",
    ] {
        assert_eq!(read(text).as_ref(), Ok(&wanted), "{text:?}");
    }
}

#[test]
fn a_touch_column_parts_touches_and_joints_are_named() {
    let text = "seq,elbow_position,elbow_effort\n7,0.1,1\n7,0.2,2\n8,0.3,3\n";
    let joints = Some(&["elbow"][..]);
    assert_eq!(
        read(text).unwrap(),
        [
            start("7", joints),
            sample(None, &[0.1], &[1.0]),
            sample(None, &[0.2], &[2.0]),
            start("8", joints),
            sample(None, &[0.3], &[3.0]),
        ]
    );
    // Rows with an empty touch column are between touches.
    let named = [start("7", None), sample(None, &[0.1], &[1.0]), start("8", None)];
    let between = read("seq,q1,tau1\n,0,0\n7,0.1,1\n,0,0\n8,0,0\n,0,0\n").unwrap();
    assert_eq!(between[..3], named);
    assert_eq!(between.len(), 4);
    let error = read("seq,q1,tau1\n,0,0\n,0,0\n").unwrap_err();
    assert!(error.contains("push.csv` has a touch column that is empty in all rows"), "{error}");
    let error = read("seq,q1,tau1\n7,0,0\n8,0,0\n7,0,0\n").unwrap_err();
    assert!(error.contains("touch `7` in line 4"), "{error}");
}

#[test]
fn tables_of_messages_name_the_joints_in_their_rows() {
    let rostopic = "%time,field.header.frame_id,field.name0,field.name1,field.position0,\
                    field.position1,field.velocity0,field.velocity1,field.effort0,field.effort1\n\
                    1700000000500000000,,elbow,shoulder,0.1,0.2,9,9,1,2\n\
                    1700000001000000000,,elbow,shoulder,0.3,0.4,9,9,3,4\n";
    let joints = Some(&["elbow", "shoulder"][..]);
    let wanted = [
        start("push", joints),
        sample(Some(1_700_000_000.5), &[0.1, 0.2], &[1.0, 2.0]),
        sample(Some(1_700_000_001.0), &[0.3, 0.4], &[3.0, 4.0]),
    ];
    assert_eq!(read(rostopic).unwrap(), wanted);
    let foxglove = "header.stamp.sec,header.stamp.nanosec,name[0],name[1],position[0],position[1],\
                    effort[0],effort[1]\n1700000000,500000000,elbow,shoulder,0.1,0.2,1,2\n\
                    1700000001,0,elbow,shoulder,0.3,0.4,3,4\n";
    assert_eq!(read(foxglove).unwrap(), wanted);
    let bagpy = "Time,header.stamp.secs,header.stamp.nsecs,name,position_0,position_1,effort_0,effort_1\n\
                 9,1700000000,500000000,\"['elbow', 'shoulder']\",0.1,0.2,1,2\n\
                 9,1700000001,0,\"['elbow', 'shoulder']\",0.3,0.4,3,4\n";
    assert_eq!(read(bagpy).unwrap(), wanted);
    let two_robots = bagpy.replace("001,0,\"['elbow'", "001,0,\"['knee'");
    let error = read(&two_robots).unwrap_err();
    assert!(error.contains("the joints knee, shoulder in line 3"), "{error}");
    let of_trials = read("name,q1,tau1\nfirst,0.1,1\nsecond,0.2,2\n").unwrap();
    assert_eq!(of_trials[0], start("push", None));
    let short = foxglove.replace(",1,2\n", ",1\n");
    assert!(read(&short).unwrap_err().contains("has 7 cells in line 2; wanted 8"));
}

#[test]
fn a_file_of_kukas_recorder_is_read_as_it_is() {
    let log = "%   ZeitInSec ZeitInNanoSec axisQMsr_LBR_iiwa_7_R800_1[0] axisTauMsr_LBR_iiwa_7_R800_1[0]\n  \
               1400000000   500000000   0.5   -12.25  \n\
               1400000001           0   0.25  -12\n";
    let folder = folder_with(&[("DataRecorder0.log", log)]);
    let events = read_as(&folder.path().join("DataRecorder0.log"), &LogOptions::default());
    let wanted = [
        start("DataRecorder0", None),
        sample(Some(1_400_000_000.5), &[0.5], &[-12.25]),
        sample(Some(1_400_000_001.0), &[0.25], &[-12.0]),
    ];
    assert_eq!(events.unwrap(), wanted);
    assert!(read_as(folder.path(), &LogOptions::default()).is_err(), "not if it is not named");
}

#[test]
fn a_folder_is_read_in_natural_order_with_a_touch_per_file() {
    let table = "q1,tau1\n0,1\n";
    let folder =
        folder_with(&[("r10.csv", table), ("r9.CSV", table), (".r0.csv", "?"), ("a.md", "")]);
    let log = open(folder.path(), &LogOptions::default()).unwrap();
    assert_eq!((log.describe().touches, log.describe().joints), (Some(2), Some(1)));
    let events: Vec<_> = log.map(Result::unwrap).collect();
    assert_eq!((&events[0], &events[2]), (&start("r9", None), &start("r10", None)));

    fs::write(folder.path().join("r11.csv"), "q1,q2,tau1,tau2\n0,0,0,0\n").unwrap();
    let error = read_as(folder.path(), &LogOptions::default()).unwrap_err();
    assert!(error.contains("r11.csv") && error.contains("has 1 joints"), "{error}");
}

#[test]
fn a_map_names_the_columns_and_degrees_are_turned() {
    let folder = folder_with(&[("push.csv", "when,b [deg],a [deg],B,A,run\n3,90,180,1,2,x\n")]);
    let strings = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
    let columns = CsvColumns {
        q: strings(&["a [deg]", "b [deg]"]),
        tau: strings(&["A", "B"]),
        joints: Some(strings(&["a", "b"])),
        time: Some("when".to_owned()),
        touch: Some("run".to_owned()),
    };
    let json = serde_json::json!({"angle_unit": "deg", "columns": columns});
    let options: LogOptions = serde_json::from_value(json).unwrap();
    let events = read_as(&folder.path().join("push.csv"), &options).unwrap();
    let pi = std::f64::consts::PI;
    let wanted = [start("x", Some(&["a", "b"])), sample(Some(3.0), &[pi, pi / 2.0], &[2.0, 1.0])];
    assert_eq!(events, wanted);

    // A time in two columns is given by the name that the description of the log reports.
    let table = folder.path().join("two.csv");
    fs::write(&table, "sec,nanosec,q1,tau1\n3,500000000,0,0\n").unwrap();
    let found = open(&table, &LogOptions::default()).unwrap().describe().columns;
    assert_eq!(found.as_ref().unwrap().time.as_deref(), Some("sec and nanosec"));
    let named = read_as(&table, &LogOptions { columns: found, ..LogOptions::default() }).unwrap();
    assert_eq!(named[1], sample(Some(3.5), &[0.0], &[0.0]));

    let by_name = LogOptions { angle_unit: None, ..options.clone() };
    assert_eq!(read_as(&folder.path().join("push.csv"), &by_name).unwrap(), wanted);
    let rad = LogOptions { angle_unit: Some(AngleUnit::Rad), ..options };
    let error = read_as(&folder.path().join("push.csv"), &rad).unwrap_err();
    assert!(error.contains("`a [deg]` contradicts"), "{error}");
}

#[test]
fn a_table_without_a_header_is_read_by_the_numbers_of_its_columns() {
    let folder = folder_with(&[("push.csv", "0.5,1,2,3\n0.6,4,5,6\n")]);
    let table = folder.path().join("push.csv");
    let numbers = |numbers: &[&str]| numbers.iter().map(|&number| number.to_owned()).collect();
    let columns = |q: &[&str], tau: &[&str]| CsvColumns {
        q: numbers(q),
        tau: numbers(tau),
        time: Some("1".to_owned()),
        ..CsvColumns::default()
    };
    let named = |columns| LogOptions { columns: Some(columns), ..LogOptions::default() };
    let events = read_as(&table, &named(columns(&["3"], &["2"]))).unwrap();
    let wanted =
        [start("push", None), sample(Some(0.5), &[2.0], &[1.0]), sample(Some(0.6), &[5.0], &[4.0])];
    assert_eq!(events, wanted);
    let error = read_as(&table, &named(columns(&["3"], &["5"]))).unwrap_err();
    assert!(error.contains("no column `5`"), "{error}");

    fs::write(&table, "1970-01-01 00:00:00.5,1,2,3\n").unwrap();
    let events = read_as(&table, &named(columns(&["3"], &["2"]))).unwrap();
    assert_eq!(events[1], sample(Some(0.5), &[2.0], &[1.0]));

    // pandas names the columns of an array by their numbers, from 0.
    fs::write(&table, "0,1,2,3\n0.5,1,2,3\n").unwrap();
    let events = read_as(&table, &named(columns(&["2"], &["3"]))).unwrap();
    assert_eq!(events[1], sample(Some(1.0), &[2.0], &[3.0]));
}

#[test]
fn every_defect_is_located() {
    for (text, wanted) in [
        ("", "holds no header"),
        ("a,b\n1,2\n", "Its columns are `a`, `b`"),
        ("a,b\n1,2\n", "columns = { q = [\"a\", \"b\"]"),
        ("1,2\n3,4\n", "numbers instead of names"),
        ("q1,tau1\n", "is empty"),
        ("q1,tau1\n0,1\n\n0,\n", "holds nothing in line 4, column `tau1`"),
        ("# c\r\nq1,tau1\r\n\r\n0,1\r\n# c\r\n0,x", "holds `x` in line 6, column `tau1`"),
        ("q1,tau1\n0,nan\n", "holds `nan` in line 2"),
        ("q1,tau1\n0,-inf\n", "holds `-inf` in line 2"),
        ("q1;tau1\n0;1,5\n", "holds `1,5` in line 2"),
        ("q1,tau1\n0,1\n0,1,2\n", "has 3 cells in line 3; wanted 2"),
        ("q1,tau1\n0\n", "has 1 cells in line 2"),
    ] {
        let error = read(text).unwrap_err();
        assert!(error.contains(wanted) && error.contains("push.csv"), "{text:?}: {error}");
    }
    let open_quote = format!("q1,tau1\n0,\"1\n{}", "0,1\n".repeat(400_000));
    let error = read(&open_quote).unwrap_err();
    assert!(error.contains("longer than 1 MiB"), "{error}");
}

#[test]
fn a_clock_that_stands_still_or_runs_backwards_is_one_warning_a_touch() {
    let text = "touch,t,q1,tau1\na,0,0,0\na,1,0,0\nb,0,0,0\nb,0,0,0\nb,-1,0,0\n";
    let folder = folder_with(&[("push.csv", text)]);
    let mut log = open(&folder.path().join("push.csv"), &LogOptions::default()).unwrap();
    assert!(log.by_ref().all(|event| event.is_ok()));
    let [LogWarning::TimeNotIncreasing { touch, row, count, .. }] = log.warnings() else {
        panic!("a new touch may start a new clock: {:?}", log.warnings())
    };
    assert_eq!((touch.as_str(), *row, *count), ("b", 1, 2));
}

/// A table of 40 rows, 20 per s, in each of which the joint moves by 0.01 rad; its clock has `per_s` ticks per second
/// and starts at `start`.
fn ticking(header: &str, per_s: f64, start: f64) -> String {
    let row = |row: u32| {
        format!("{},{},1\n", start + 0.05 * per_s * f64::from(row), 0.01 * f64::from(row))
    };
    format!("{header},q1,tau1\n{}", (0..40).map(row).collect::<String>())
}

/// Time from the first to the last sample, s, of the touches of a log, and the unit that was found.
fn seconds_of(files: &[(&str, &str)], options: &LogOptions) -> (Vec<f64>, Option<TimeUnit>) {
    let folder = folder_with(files);
    let mut log = open(folder.path(), options).unwrap();
    let mut spans: Vec<[f64; 2]> = Vec::new();
    let mut starts = false;
    for event in log.by_ref() {
        match event.unwrap() {
            LogEvent::TouchStarts { .. } => starts = true,
            LogEvent::Sample(Sample { time_s, .. }) => {
                let time_s = time_s.unwrap();
                if std::mem::take(&mut starts) {
                    spans.push([time_s; 2]);
                }
                spans.last_mut().unwrap()[1] = time_s;
            }
        }
    }
    (spans.iter().map(|[first, last]| last - first).collect(), log.found_time_unit())
}

#[test]
fn a_unit_of_times_that_no_name_says_is_found_before_touches_are_split_at_gaps() {
    let split = LogOptions { split_gap_s: Some(1.0), ..LogOptions::default() };
    let near = |found: Vec<f64>, wanted: &[f64]| {
        assert_eq!(found.len(), wanted.len(), "{found:?}");
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
    };
    // The last one, nanoseconds after half an hour, could be milliseconds since 1970 by its size.
    for (per_s, start, unit) in [
        (1.0, 0.0, None),
        (1e3, 0.0, Some(TimeUnit::Ms)),
        (1e6, 1.9e9, Some(TimeUnit::Us)),
        (1e9, 0.0, Some(TimeUnit::Ns)),
        (1e3, 1.7e12, None),
        (1e9, 1.8e12, Some(TimeUnit::Ns)),
    ] {
        let (spans, found) = seconds_of(&[("a.csv", &ticking("time", per_s, start))], &split);
        assert_eq!(found, unit, "{per_s}, {start}");
        near(spans, &[1.95]);
    }
    // A name, or the setting, is not doubted; a file that names its unit has it.
    let ms = ticking("time", 1e3, 0.0);
    let seconds = LogOptions { time_unit: Some(TimeUnit::S), ..LogOptions::default() };
    near(seconds_of(&[("a.csv", &ms)], &seconds).0, &[1950.0]);
    let named = ticking("time [s]", 1e3, 0.0);
    near(seconds_of(&[("a.csv", &named)], &LogOptions::default()).0, &[1950.0]);
    let given = LogOptions { time_unit: Some(TimeUnit::Ms), ..LogOptions::default() };
    near(seconds_of(&[("a.csv", &named)], &given).0, &[1.95]);
}
