//! Parquet: lists as in LeRobot, and one column per joint.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs::{self, File};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use palpate_io::log::{self, LogEvent, LogFormat, LogOptions, Sample};
use parquet::basic::{Compression, GzipLevel, ZstdLevel};
use parquet::data_type::{DoubleType, FloatType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;

const LISTS: &str = "message schema {
    optional group observation.state (LIST) { repeated group list { optional float element; } }
    optional group observation.effort (LIST) { repeated group list { optional float element; } }
    required int64 frame_index;
    required float timestamp;
    required int64 episode_index;
}";

/// Writes frames of two joints in row groups of four; `episodes` has the episode of each frame.
fn write_lists(path: &Path, episodes: &[i64]) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let schema = Arc::new(parse_message_type(LISTS).unwrap());
    let properties = Arc::new(WriterProperties::builder().build());
    let file = File::create(path).unwrap();
    let mut writer = SerializedFileWriter::new(file, schema, properties).unwrap();
    for (group, episodes) in episodes.chunks(4).enumerate() {
        let mut rows = writer.next_row_group().unwrap();
        let n = episodes.len();
        let frames: Vec<i64> = (0..n as i64).map(|i| 4 * group as i64 + i).collect();
        for scale in [1.0, 10.0] {
            let values: Vec<f32> =
                frames.iter().flat_map(|&i| [scale * i as f32, -scale]).collect();
            let repeats: Vec<i16> = (0..2 * n).map(|i| (i % 2) as i16).collect();
            let mut column = rows.next_column().unwrap().unwrap();
            let typed = column.typed::<FloatType>();
            typed.write_batch(&values, Some(&vec![3; 2 * n]), Some(&repeats)).unwrap();
            column.close().unwrap();
        }
        let times: Vec<f32> = frames.iter().map(|&i| i as f32 / 4.0).collect();
        for (place, numbers) in [&frames[..], &[], episodes].iter().enumerate() {
            let mut column = rows.next_column().unwrap().unwrap();
            if place == 1 {
                column.typed::<FloatType>().write_batch(&times, None, None).unwrap();
            } else {
                column.typed::<Int64Type>().write_batch(numbers, None, None).unwrap();
            }
            column.close().unwrap();
        }
        rows.close().unwrap();
    }
    writer.close().unwrap();
}

/// A table of doubles.
fn write_columns(path: &Path, columns: &[(&str, &[f64])]) {
    write_compressed(path, columns, Compression::UNCOMPRESSED);
}

fn write_compressed(path: &Path, columns: &[(&str, &[f64])], compression: Compression) {
    let fields: String =
        columns.iter().map(|(name, _)| format!("optional double {name};")).collect();
    let schema = parse_message_type(&format!("message schema {{ {fields} }}")).unwrap();
    let properties = WriterProperties::builder().set_compression(compression).build();
    let file = File::create(path).unwrap();
    let mut writer =
        SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties)).unwrap();
    let mut rows = writer.next_row_group().unwrap();
    for (_, values) in columns {
        let mut column = rows.next_column().unwrap().unwrap();
        let all_there = vec![1; values.len()];
        column.typed::<DoubleType>().write_batch(values, Some(&all_there), None).unwrap();
        column.close().unwrap();
    }
    rows.close().unwrap();
    writer.close().unwrap();
}

/// Byte range of the footer.
fn footer_of(bytes: &[u8]) -> Range<usize> {
    let end = bytes.len() - 8;
    let length = u32::from_le_bytes(bytes[end..end + 4].try_into().unwrap());
    end - length as usize..end
}

fn read(path: &Path) -> Result<Vec<LogEvent>, String> {
    common::events(path, &LogOptions::default())
}

#[track_caller]
fn refused(path: &Path, words: &[&str]) {
    common::refused(path, &LogOptions::default(), words);
}

#[test]
fn each_episode_of_a_lerobot_data_set_is_a_touch() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    write_lists(&data.join("chunk-000/file-000.parquet"), &[0, 0, 0, 1, 1, 1, 1, 1, 1]);
    write_lists(&data.join("chunk-000/file-001.parquet"), &[2, 2]);
    let description = log::open(folder.path(), &LogOptions::default()).unwrap().describe();
    assert_eq!((description.format, description.samples), (LogFormat::Parquet, Some(11)));

    let events = read(folder.path()).unwrap();
    let mut expected = Vec::new();
    for (episode, frames) in [(0, 0..3), (1, 3..9), (2, 0..2)] {
        let name = format!("episode_{episode}");
        expected.push(LogEvent::TouchStarts { name, joint_names: None });
        expected.extend(frames.map(|i| {
            let x = f64::from(i);
            let (q, tau) = (vec![x, -1.0], vec![10.0 * x, -10.0]);
            LogEvent::Sample(Sample::new(Some(x / 4.0), q, tau))
        }));
    }
    assert_eq!(events, expected);
}

#[test]
fn columns_are_recognised_as_in_a_table_and_a_file_is_a_touch() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("push.parquet");
    let time = [0.0, 0.5];
    let columns: [(&str, &[f64]); 4] = [
        ("elbow_effort", &[3.0, 4.0]),
        ("extra", &time),
        ("elbow_position", &[1.0, 2.0]),
        ("t", &time),
    ];
    write_columns(&path, &columns);
    let events = read(&path).unwrap();
    let joint_names = Some(vec!["elbow".to_owned()]);
    let name = "push".to_owned();
    assert_eq!(events[0], LogEvent::TouchStarts { name, joint_names });
    let last = Sample::new(Some(0.5), vec![2.0], vec![4.0]);
    assert_eq!((&events[2], events.len()), (&LogEvent::Sample(last), 3));
}

#[test]
fn compressed_columns_are_read_as_others_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("push.parquet");
    let numbers: Vec<f64> = (0..500).map(|i| f64::from(i % 7)).collect();
    let columns: [(&str, &[f64]); 2] = [("q1", &numbers), ("tau1", &numbers)];
    write_columns(&path, &columns);
    let (plain, size) = (read(&path).unwrap(), fs::metadata(&path).unwrap().len());
    let gzip = Compression::GZIP(GzipLevel::default());
    let zstd = Compression::ZSTD(ZstdLevel::default());
    for codec in [Compression::SNAPPY, gzip, Compression::LZ4, Compression::LZ4_RAW, zstd] {
        write_compressed(&path, &columns, codec);
        assert_eq!(read(&path).unwrap(), plain, "{codec}");
        assert_ne!(fs::metadata(&path).unwrap().len(), size, "{codec} did something");
    }
}

#[test]
fn what_cannot_be_used_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_columns(&at("a.parquet"), &[("q1", &[0.0]), ("speed", &[0.0])]);
    refused(&at("a.parquet"), &["a.parquet", "known name of joint torques", "`q1`, `speed`"]);
    write_columns(&at("b.parquet"), &[("q1", &[0.0, f64::NAN]), ("tau1", &[0.0, 0.0])]);
    refused(&at("b.parquet"), &["row 1", "`q1`", "finite"]);
    write_columns(&at("c.parquet"), &[("observation.state", &[0.0])]);
    refused(&at("c.parquet"), &["no column holds torques", "observation.effort"]);
    write_lists(&at("d.parquet"), &[0, 1, 0]);
    refused(&at("d.parquet"), &["goes back to touch `episode_0`"]);

    // A hundred rows, changed in the footer to 8191.
    let numbers = [0.5; 100];
    write_columns(&at("f.parquet"), &[("q1", &numbers), ("tau1", &numbers)]);
    let mut bytes = fs::read(at("f.parquet")).unwrap();
    let (footer, end) = (footer_of(&bytes), bytes.len());
    let rows = (footer.start..end).find(|&at| bytes[at..].starts_with(&[0xC8, 0x01])).unwrap();
    bytes[rows..rows + 2].copy_from_slice(&[0xFE, 0x7F]);
    fs::write(at("f.parquet"), &bytes).unwrap();
    refused(&at("f.parquet"), &["f.parquet", "8091 of its 8191 rows are missing"]);

    let bytes = fs::read(at("d.parquet")).unwrap();
    fs::write(at("e.parquet"), &bytes[..bytes.len() - 20]).unwrap();
    refused(&at("e.parquet"), &["e.parquet", "damaged"]);
}

#[test]
fn no_changed_byte_of_the_footer_makes_the_reader_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.parquet");
    write_lists(&path, &[0, 0, 1]);
    let bytes = fs::read(&path).unwrap();
    for at in footer_of(&bytes) {
        for flipped in [0x01, 0x80, 0xFF] {
            let mut bytes = bytes.clone();
            bytes[at] ^= flipped;
            fs::write(&path, &bytes).unwrap();
            let _ = read(&path);
        }
    }
}
