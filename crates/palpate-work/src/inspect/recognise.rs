//! Which of log, robot and field a path is, by its name and, where that does not tell, by its
//! first bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use palpate::Robot;
use serde::Serialize;

use super::finding::Finding;

/// What a path is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Touches.
    Log,
    /// A URDF, or the name of a built-in robot.
    Robot,
    /// What `map` has learnt.
    Field,
    /// Nothing that is known.
    Unknown,
}

impl Kind {
    /// Its name.
    pub fn word(self) -> &'static str {
        match self {
            Self::Log => "log",
            Self::Robot => "robot",
            Self::Field => "field",
            Self::Unknown => "unknown",
        }
    }
}

const WANTED: &str = "wanted a log (a folder with angles.npy and torques.npy, a folder of such \
                      folders, a .csv file or a folder of them, a bag of ROS 2, Parquet), a URDF, the name of a built-in \
                      robot, or a field (.npz)";

/// Says what a path is, or why that cannot be said.
pub(super) fn recognise(path: &Path) -> Result<Kind, Box<Finding>> {
    if path.is_dir() {
        return Ok(Kind::Log);
    }
    if path.to_str().is_some_and(|name| Robot::built_in_names().any(|known| known == name)) {
        return Ok(Kind::Robot);
    }
    if !path.exists() {
        let known = Robot::built_in_names().collect::<Vec<_>>().join(", ");
        let what = format!(
            "`{}` does not exist, and no built-in robot is called so ({known})",
            path.display()
        );
        let remedy = "check the spelling and where you are";
        return Err(Box::new(Finding::error("missing", what, remedy)));
    }
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("csv" | "tsv" | "mcap" | "db3" | "parquet") => Ok(Kind::Log),
        Some("urdf" | "xacro" | "xml") => Ok(Kind::Robot),
        Some("npz") => Ok(Kind::Field),
        _ => by_first_bytes(path),
    }
}

fn by_first_bytes(path: &Path) -> Result<Kind, Box<Finding>> {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(4096).read_to_end(&mut bytes));
    if let Err(error) = read {
        let what = format!("`{}` cannot be read: {error}", path.display());
        return Err(Box::new(Finding::error("unreadable", what, "check its permissions")));
    }
    let unknown = |is: &str, remedy: &str| {
        let what = format!("`{}` is {is}", path.display());
        Err(Box::new(Finding::error("unknown_format", what, remedy)))
    };
    if bytes.starts_with(b"PK\x03\x04") {
        return Ok(Kind::Field);
    }
    if String::from_utf8_lossy(&bytes).contains("<robot") {
        return Ok(Kind::Robot);
    }
    if bytes.starts_with(b"\x93NUMPY") {
        return unknown(
            "a single npy array",
            "give the folder that holds angles.npy and torques.npy",
        );
    }
    let magics = [&b"\x89MCAP"[..], b"SQLite format 3", b"#ROSBAG", b"PAR1"];
    if magics.iter().any(|magic| bytes.starts_with(magic)) {
        return Ok(Kind::Log);
    }
    unknown("of no format that is known", WANTED)
}
