//! The finished pieces of an evaluation, kept on disk until all of it is finished.
//!
//! Every piece is a file, written whole or not at all. It contains a *key*, a hash of everything that the
//! piece depends on: robot, settings, touches with their truth, folds and program. A piece with another key
//! is ignored. A piece whose *seal*, a hash of key and content, is wrong was changed since: it is reported
//! and computed again.

use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use palpate_io::input;
use palpate_learn::evaluate::FoldPrediction;
use palpate_learn::tune::Tuned;
use palpate_work::Progress;
use palpate_work::evaluate::{EvaluationJob, ResultStore};

use crate::error::CliError;
use crate::output::Output;
use crate::{file_paths, program};

/// The folder of the pieces.
pub(super) struct Kept {
    results: PathBuf,
    folder: PathBuf,
    key: String,
    output: Output,
    /// Whether keeping a piece has failed already: only the first failure is reported.
    fails: AtomicBool,
}

/// Content of a file.
#[derive(Serialize, Deserialize)]
struct Sealed {
    key: String,
    /// A hash of key and piece.
    seal: String,
    /// The piece as JSON.
    piece: String,
}

impl Sealed {
    fn new(key: &str, piece: String) -> Self {
        Self { key: key.to_owned(), seal: seal(key, &piece), piece }
    }
}

fn seal(key: &str, piece: &str) -> String {
    blake3::Hasher::new().update(key.as_bytes()).update(piece.as_bytes()).finalize().to_string()
}

impl Kept {
    /// Opens the pieces in a folder of results, and makes their folder.
    pub(super) fn open(
        results: &Path,
        work: &EvaluationJob<'_>,
        output: Output,
    ) -> Result<Self, CliError> {
        let folder = results.join("parts");
        let what = format!("the folder `{}`", folder.display());
        std::fs::create_dir_all(&folder).map_err(|source| CliError::Write { what, source })?;
        let (results, fails) = (results.to_owned(), AtomicBool::new(false));
        Ok(Self { results, folder, key: key(work), output, fails })
    }

    /// All valid pieces whose names begin with `begins`.
    fn read<P: DeserializeOwned>(&self, begins: &str) -> Vec<P> {
        let Ok(entries) = self.folder.read_dir() else { return Vec::new() };
        let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
        let mut names: Vec<String> = names.filter(|name| name.starts_with(begins)).collect();
        names.sort();
        names.iter().filter_map(|name| self.one(name.strip_suffix(".json")?)).collect()
    }

    /// A piece by its name, if it exists and is valid; warns if it was changed.
    fn one<P: DeserializeOwned>(&self, name: &str) -> Option<P> {
        let path = self.folder.join(format!("{name}.json"));
        let Sealed { key, seal: found, piece } =
            serde_json::from_str(&input::read_text(&path, u64::MAX).ok()?).ok()?;
        if key != self.key {
            return None;
        }
        if found == seal(&key, &piece)
            && let Ok(piece) = serde_json::from_str(&piece)
        {
            return Some(piece);
        }
        self.output.warn(&format!(
            "`{}` was changed after it was saved: its results are computed again",
            path.display()
        ));
        None
    }

    /// Keeps a piece under a name. A failure is only a warning: the evaluation continues without it.
    fn keep<P: Serialize>(&self, name: &str, piece: &P) {
        if let Err(error) = self.write(name, piece)
            && !self.fails.swap(true, Ordering::Relaxed)
        {
            self.output.warn(&format!(
                "{error}; if this evaluation is interrupted, it must start from the beginning"
            ));
        }
    }

    fn write<P: Serialize>(&self, name: &str, piece: &P) -> Result<(), CliError> {
        let piece = serde_json::to_string(piece).map_err(CliError::file)?;
        let sealed = Sealed::new(&self.key, piece);
        let text = serde_json::to_string(&sealed).map_err(CliError::file)?;
        file_paths::write(&self.folder.join(format!("{name}.json")), &text)
    }

    /// Removes all pieces, and no other file of the folder.
    pub(super) fn remove(&self) {
        let Ok(entries) = self.folder.read_dir() else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let Ok(text) = input::read_text(&path, u64::MAX) else { continue };
            if serde_json::from_str::<Sealed>(&text).is_ok() {
                let _ = std::fs::remove_file(&path); // A piece that stays is reused, or ignored for its key.
            }
        }
    }
}

impl ResultStore for Kept {
    fn stored_predictions(&self) -> Vec<FoldPrediction> {
        self.read("part-")
    }

    fn tuned(&self, name: &str) -> Option<Tuned> {
        self.one(name)
    }

    fn keep_part(&self, part: &FoldPrediction) {
        self.keep(&format!("part-{}-{}", part.method.name(), part.fold), part);
    }

    fn keep_tuned(&self, name: &str, tuned: &Tuned) {
        self.keep(name, tuned);
    }

    fn kept_message(&self) -> String {
        format!(
            "; finished parts are in `{}`, and the same command continues from them",
            self.results.display()
        )
    }
}

impl Drop for Kept {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.folder); // Fails unless it is empty.
    }
}

/// A hash of everything that a piece depends on.
fn key(work: &EvaluationJob<'_>) -> String {
    let names: Vec<&str> = work.touches.iter().map(|touch| touch.name.as_str()).collect();
    let (program, arm) = (program(), work.arm.fingerprint());
    let tune = (work.tune, work.given);
    let settings =
        (program, &work.estimators, &work.folds, tune, work.truth, arm, names, &work.bodies);
    let mut hasher = blake3::Hasher::new();
    hasher.update(format!("{settings:?}").as_bytes());
    for touch in work.touches {
        hasher.update(&(touch.samples.len() as u64).to_le_bytes());
        let numbers = touch.samples.iter().flat_map(|sample| {
            sample.q.iter().chain(&sample.tau).chain(sample.tau_std.iter().flatten())
        });
        let truth = touch.truth.iter().flatten().flatten();
        let times = touch.samples.iter().filter_map(|sample| sample.time_s.as_ref());
        numbers.chain(truth).chain(times).for_each(|number| {
            hasher.update(&number.to_bits().to_le_bytes());
        });
    }
    hasher.finalize().to_hex().to_string()
}

/// Identifies the program: its version, and size and time of its file, which differ between builds.
fn program() -> impl Debug {
    let file = program::file().and_then(|path| std::fs::metadata(path).ok());
    let built = file.map(|file| (file.len(), file.modified().ok()));
    (env!("CARGO_PKG_VERSION"), built)
}
