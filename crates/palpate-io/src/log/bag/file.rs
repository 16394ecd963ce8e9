//! The files of a bag, and access to each, independent of its storage format.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::mcap;
#[cfg(feature = "formats")]
use super::sqlite;
use super::topic::{Message, Messages, Topic};
use crate::input;
use crate::log::error::{BagError, LogError};
use crate::log::event::LogFormat;
use crate::log::folder;

/// Largest size of `metadata.yaml`, bytes.
const METADATA: u64 = 64 << 20;

/// The part of rosbag2's `metadata.yaml` that is used here.
#[derive(Debug, Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Debug, Deserialize)]
struct Information {
    relative_file_paths: Vec<PathBuf>,
    #[serde(default)]
    compression_mode: String,
}

const MCAP: &[u8] = b"\x89MCAP0";
const SQLITE: &[u8] = b"SQLite format 3\0";
const ROS_1: &[u8] = b"#ROSBAG";

/// Whether a path may be a bag: a file with a known extension or magic bytes, or a folder with
/// `metadata.yaml` or with files of such extensions.
pub(in crate::log) fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("metadata.yaml").is_file() || !by_ending(path).is_empty();
    }
    let beginning = folder::beginning(path).unwrap_or_default();
    has_ending(path) || [MCAP, SQLITE, ROS_1].iter().any(|magic| beginning.starts_with(magic))
}

/// The files of a bag in the order of recording.
pub(super) fn files(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let metadata_path = path.join("metadata.yaml");
    if !metadata_path.is_file() {
        return Ok(by_ending(path));
    }
    let text = input::read_text(&metadata_path, METADATA)
        .map_err(|source| LogError::reading(&metadata_path, source))?;
    let refused = |reason: String| BagError::Storage { path: metadata_path.clone(), reason };
    let metadata: Metadata = serde_saphyr::from_str(&text)
        .map_err(|error| refused(format!("is not what rosbag2 writes: {error}")))?;
    let information = metadata.rosbag2_bagfile_information;
    let mode = information.compression_mode.to_ascii_lowercase();
    if ["file", "message"].contains(&mode.as_str()) {
        let reason = format!(
            "says that each {mode} is compressed by itself, which is not read; rewrite the bag: \
             `ros2 bag convert` to MCAP, which compresses its chunks"
        );
        return Err(refused(reason).into());
    }
    if information.relative_file_paths.is_empty() {
        return Err(refused("names no file".to_owned()).into());
    }
    Ok(information.relative_file_paths.iter().map(|file| path.join(file)).collect())
}

/// The storage format of a file, or an error that says why it cannot be read.
pub(super) fn format(path: &Path) -> Result<LogFormat, LogError> {
    let beginning = folder::beginning(path).map_err(|source| LogError::reading(path, source))?;
    let reason = match beginning {
        bytes if bytes.starts_with(MCAP) => return Ok(LogFormat::Mcap),
        bytes if bytes.starts_with(SQLITE) => {
            if cfg!(feature = "formats") {
                return Ok(LogFormat::Rosbag2Sqlite);
            }
            &format!("is a bag in SQLite: {}", crate::not_built("SQLite"))
        }
        bytes if bytes.starts_with(ROS_1) => {
            "is a bag of ROS 1; turn it into one of ROS 2: pip install rosbags, then \
             rosbags-convert --src IN.bag --dst OUT"
        }
        bytes if bytes.is_empty() => "is empty; copy it again, or record again",
        _ => "begins neither like MCAP nor like SQLite; copy it again, or record again",
    };
    Err(BagError::Storage { path: path.to_owned(), reason: reason.to_owned() }.into())
}

/// The topics of a file in this storage format.
pub(super) fn topics(path: &Path, format: LogFormat) -> Result<Vec<Topic>, BagError> {
    let topics = match format {
        #[cfg(feature = "formats")]
        LogFormat::Rosbag2Sqlite => sqlite::topics(path).map_err(|error| sqlite::in_words(&error)),
        _ => mcap::topics(path),
    };
    topics.map_err(|reason| {
        let reason = format!("cannot be read: {reason}");
        BagError::Storage { path: path.to_owned(), reason }
    })
}

/// The messages of a file on the wanted topics; `wanted` names the topics of samples and of
/// markers.
pub(super) fn messages(path: &Path, wanted: [Option<String>; 2]) -> Result<Messages, LogError> {
    let messages = match format(path)? {
        #[cfg(feature = "formats")]
        LogFormat::Rosbag2Sqlite => {
            sqlite::messages(path, &wanted).map_err(|error| sqlite::in_words(&error))
        }
        _ => mcap::messages(path, wanted),
    };
    let messages =
        messages.map_err(|reason| BagError::Storage { path: path.to_owned(), reason })?;
    Ok(Box::new(messages.map(|message| check_size(message?))))
}

/// Divisor of [`input::largest`] that gives the largest size of one message, usually 4 MiB: many
/// are held at once.
const PART: u64 = 256;

fn check_size(message: Message) -> Result<Message, String> {
    let (found, most) = (message.data.len(), input::largest() / PART);
    match found as u64 <= most {
        true => Ok(message),
        false => Err(format!(
            "it holds a message of {found} bytes in the topic of the joints or of the markers; \
             wanted at most {most}; a larger --file-memory GIB allows larger messages"
        )),
    }
}

fn has_ending(path: &Path) -> bool {
    folder::is_file_with(path, &["mcap", "db3", "bag"])
}

/// The files in a folder with the extension of a bag.
fn by_ending(folder: &Path) -> Vec<PathBuf> {
    let mut files = folder::listed(folder).unwrap_or_default();
    files.retain(|file| has_ending(file));
    files
}
