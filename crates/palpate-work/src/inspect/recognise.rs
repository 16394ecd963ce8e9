//! Which of log, robot and field a path is, by its name and, where that is not enough, by its
//! first bytes.

use std::io::Read;
use std::path::Path;

use palpate::Robot;
use palpate_io::input;
use serde::Serialize;

use super::finding::Finding;

/// Kind of a path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Touches.
    Log,
    /// A URDF, or the name of a built-in robot.
    Robot,
    /// A field, as learnt by `palpate map`.
    Field,
    /// None of these.
    Unknown,
}

/// First bytes of formats that can be recognised by them.
const FIRST_BYTES: [(&[u8], Kind); 5] = [
    (b"PK\x03\x04", Kind::Field),
    (b"\x89MCAP", Kind::Log),
    (b"SQLite format 3", Kind::Log),
    (b"#ROSBAG", Kind::Log),
    (b"PAR1", Kind::Log),
];

const WANTED: &str = "wanted a log (a folder with angles.npy and torques.npy, a folder of such \
                      folders, a .csv file or a folder of them, a bag of ROS 2, Parquet), a URDF, \
                      the name of a built-in robot, or a field (.npz)";

/// Recognises the kind of a path; the error is a finding that says why it is not recognised.
pub(super) fn recognise(path: &Path) -> Result<Kind, Box<Finding>> {
    if path.is_dir() {
        return Ok(Kind::Log);
    }
    let built_in: Vec<&str> = Robot::built_in_names().collect();
    if path.to_str().is_some_and(|name| built_in.contains(&name)) {
        return Ok(Kind::Robot);
    }
    let wrong = |code, is: &str, remedy| {
        Err(Box::new(Finding::error(code, format!("`{}` {is}", path.display()), remedy)))
    };
    if !path.exists() {
        let known = built_in.join(", ");
        let is = format!("does not exist, and no built-in robot has this name ({known})");
        return wrong("missing", &is, "check the spelling and the current folder");
    }
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("csv" | "tsv" | "mcap" | "db3" | "parquet") => return Ok(Kind::Log),
        Some("urdf" | "xacro" | "xml") => return Ok(Kind::Robot),
        Some("npz") => return Ok(Kind::Field),
        _ => {}
    }
    let mut bytes = Vec::new();
    let read = input::open(path).and_then(|file| file.take(4096).read_to_end(&mut bytes));
    if let Err(error) = read {
        return wrong("unreadable", &format!("cannot be read: {error}"), "check its permissions");
    }
    if let Some((_, kind)) = FIRST_BYTES.iter().find(|(first, _)| bytes.starts_with(first)) {
        return Ok(*kind);
    }
    if String::from_utf8_lossy(&bytes).contains("<robot") {
        return Ok(Kind::Robot);
    }
    if bytes.starts_with(b"\x93NUMPY") {
        let remedy = "give the folder that holds angles.npy and torques.npy";
        return wrong("unknown_format", "is a single npy array", remedy);
    }
    if let Some("txt" | "log" | "dat") = ending.as_deref() {
        return Ok(Kind::Log);
    }
    wrong("unknown_format", "has an unknown format", WANTED)
}
