//! The bundled data set, and logs as events or as touches.
#![allow(dead_code, clippy::unwrap_used)] // every test file takes what it needs; helpers of tests are tests

use std::path::{Path, PathBuf};

use palpate_io::log::{LogEvent, LogOptions, Sample, open};

/// Folder of the bundled data set.
pub(crate) fn plant() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/plant_a")
}

/// The bundled data set, and those in the folder `PALPATE_DATA`, if that is given, that contain this file.
pub(crate) fn sets(file: &str) -> Vec<PathBuf> {
    let mut sets = vec![plant()];
    if let Some(folder) = std::env::var_os("PALPATE_DATA") {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        sets.extend(entries.filter(|path| path.join(file).is_file()));
    }
    sets
}

/// All events of a log, or its error message.
pub(crate) fn events(path: &Path, options: &LogOptions) -> Result<Vec<LogEvent>, String> {
    let log = open(path, options).map_err(|error| error.to_string())?;
    log.collect::<Result<_, _>>().map_err(|error| error.to_string())
}

/// The touches of a log with their names.
pub(crate) fn touches(path: &Path) -> Vec<(String, Vec<Sample>)> {
    let mut touches: Vec<(String, Vec<Sample>)> = Vec::new();
    for event in events(path, &LogOptions::default()).unwrap() {
        match event {
            LogEvent::TouchStarts { name, .. } => touches.push((name, Vec::new())),
            LogEvent::Sample(sample) => touches.last_mut().unwrap().1.push(sample),
        }
    }
    touches
}

/// Reads a log that must be refused with an error that holds all of `words`.
#[track_caller]
pub(crate) fn refused(path: &Path, options: &LogOptions, words: &[&str]) {
    let error = events(path, options).expect_err("it must be refused");
    for word in words {
        assert!(error.contains(word), "`{word}` is not in: {error}");
    }
}
