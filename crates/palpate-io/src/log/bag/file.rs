//! Which files make up a bag, and one of them at a time, whichever way it is stored.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::topic::Topic;
use super::{BagError, Message, mcap, sqlite};
use crate::log::{Format, LogError, natural};

/// What rosbag2 says of a folder, as far as it matters.
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

/// How a file is stored, by its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Storage {
    Mcap,
    Sqlite,
}

impl Storage {
    pub(super) fn format(self) -> Format {
        match self {
            Self::Mcap => Format::Mcap,
            Self::Sqlite => Format::Rosbag2Sqlite,
        }
    }
}

/// Whether a path may be a bag: a file of a known beginning, or a folder with such files in it.
pub(in crate::log) fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("metadata.yaml").is_file() || !by_ending(path).is_empty();
    }
    let beginning = beginning(path).unwrap_or_default();
    has_ending(path)
        || [&b"\x89MCAP0"[..], b"SQLite format 3\0", b"#ROSBAG"]
            .iter()
            .any(|magic| beginning.starts_with(magic))
}

/// The files of a bag in the order of recording.
pub(super) fn files(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let told = path.join("metadata.yaml");
    if !told.is_file() {
        return Ok(by_ending(path));
    }
    let text = std::fs::read_to_string(&told).map_err(|source| LogError::reading(&told, source))?;
    let refused = |reason: String| BagError::Storage { path: told.clone(), reason };
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

/// How a file is stored, or why it cannot be read.
pub(super) fn storage(path: &Path) -> Result<Storage, LogError> {
    let beginning = beginning(path).map_err(|source| LogError::reading(path, source))?;
    let reason = match beginning {
        bytes if bytes.starts_with(b"\x89MCAP0") => return Ok(Storage::Mcap),
        bytes if bytes.starts_with(b"SQLite format 3\0") => return Ok(Storage::Sqlite),
        bytes if bytes.starts_with(b"#ROSBAG") => {
            "is a bag of ROS 1; turn it into one of ROS 2: pip install rosbags, then \
             rosbags-convert --src IN.bag --dst OUT"
        }
        bytes if bytes.is_empty() => "is empty; copy it again, or record again",
        _ => "begins neither like MCAP nor like SQLite; copy it again, or record again",
    };
    Err(BagError::Storage { path: path.to_owned(), reason: reason.to_owned() }.into())
}

/// The topics of a file.
pub(super) fn topics(path: &Path, storage: Storage) -> Result<Vec<Topic>, BagError> {
    let topics = match storage {
        Storage::Mcap => mcap::topics(path).map_err(|error| mcap::in_words(&error)),
        Storage::Sqlite => sqlite::topics(path).map_err(|error| error.to_string()),
    };
    topics.map_err(|reason| {
        let reason = format!("cannot be read: {reason}");
        BagError::Storage { path: path.to_owned(), reason }
    })
}

/// The messages of the wanted topics in a file.
pub(super) enum Messages {
    Mcap(Box<mcap::Messages>),
    Sqlite(sqlite::Messages),
}

impl Messages {
    /// Stands before the first message. An error is half a sentence.
    pub(super) fn open(path: &Path, wanted: &[Option<String>; 2]) -> Result<Self, LogError> {
        let failed = |reason: String| BagError::Storage { path: path.to_owned(), reason };
        Ok(match storage(path)? {
            Storage::Mcap => {
                let messages = mcap::Messages::open(path, wanted.clone());
                Self::Mcap(Box::new(messages.map_err(|error| failed(mcap::in_words(&error)))?))
            }
            Storage::Sqlite => {
                let messages = sqlite::Messages::open(path, wanted);
                Self::Sqlite(messages.map_err(|error| failed(error.to_string()))?)
            }
        })
    }
}

impl Iterator for Messages {
    type Item = Result<Message, String>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::Mcap(messages) => messages.next(),
            Self::Sqlite(messages) => {
                messages.next().map(|message| message.map_err(|error| error.to_string()))
            }
        }
    }
}

fn beginning(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(16).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn has_ending(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    matches!(ending.as_deref(), Some("mcap" | "db3" | "bag"))
}

/// The files in a folder that are called like parts of a bag.
fn by_ending(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().into_iter().flatten().filter_map(Result::ok);
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    files.retain(|file| file.is_file() && has_ending(file));
    files.sort_by(|a, b| natural::compare(&a.to_string_lossy(), &b.to_string_lossy()));
    files
}
