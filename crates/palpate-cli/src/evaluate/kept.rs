//! The finished pieces of an evaluation, kept until all of it is finished.
//!
//! Every piece lies in a file of its own, which appears whole or not at all, under the *key* of what
//! made it: robot, settings, touches, folds and version. What has another key is not taken.

use std::path::{Path, PathBuf};

use serde::de::{DeserializeOwned, IgnoredAny};
use serde::{Deserialize, Serialize};

use palpate_io::input;
use palpate_learn::evaluate::Part;
use palpate_learn::tune::Tuned;
use palpate_work::evaluate::{Keep, Work};

use crate::error::CliError;
use crate::place;

/// The folder of the pieces.
pub(super) struct Kept {
    results: PathBuf,
    folder: PathBuf,
    key: String,
}

/// What a file holds.
#[derive(Serialize, Deserialize)]
struct Sealed<P> {
    key: String,
    piece: P,
}

impl Kept {
    /// The pieces kept in a folder of results.
    pub(super) fn open(results: &Path, work: &Work<'_>) -> Result<Self, CliError> {
        let folder = results.join("parts");
        let what = format!("the folder `{}`", folder.display());
        std::fs::create_dir_all(&folder).map_err(|source| CliError::Write { what, source })?;
        Ok(Self { results: results.to_owned(), folder, key: key(work) })
    }

    /// All pieces whose name begins so, if they are whole.
    fn read<P: DeserializeOwned>(&self, begins: &str) -> Vec<P> {
        let Ok(entries) = self.folder.read_dir() else { return Vec::new() };
        let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
        let mut names: Vec<String> = names.filter(|name| name.starts_with(begins)).collect();
        names.sort();
        names.iter().filter_map(|name| self.one(name.strip_suffix(".json")?)).collect()
    }

    /// A piece by its name, if it is there and whole.
    fn one<P: DeserializeOwned>(&self, name: &str) -> Option<P> {
        let text =
            input::read_text(&self.folder.join(format!("{name}.json")), input::LARGEST).ok()?;
        let sealed: Sealed<P> = serde_json::from_str(&text).ok()?;
        (sealed.key == self.key).then_some(sealed.piece)
    }

    /// Keeps a piece under a name.
    fn keep<P: Serialize>(&self, name: &str, piece: &P) -> Result<(), CliError> {
        let sealed = Sealed { key: self.key.clone(), piece };
        let text = serde_json::to_string(&sealed).map_err(CliError::file)?;
        place::write(&self.folder.join(format!("{name}.json")), &text)
    }

    /// Removes all pieces, and nothing else that lies there.
    pub(super) fn remove(&self) {
        let Ok(entries) = self.folder.read_dir() else { return };
        for path in entries.flatten().map(|entry| entry.path()) {
            let Ok(text) = input::read_text(&path, input::LARGEST) else { continue };
            if serde_json::from_str::<Sealed<IgnoredAny>>(&text).is_ok() {
                let _ = std::fs::remove_file(&path); // What stays is found, or has another key.
            }
        }
    }
}

impl Keep for Kept {
    fn parts(&self) -> Vec<Part> {
        self.read("part-")
    }

    fn tuned(&self, name: &str) -> Option<Tuned> {
        self.one(name)
    }

    fn keep_part(&self, part: &Part) -> Result<(), CliError> {
        self.keep(&format!("part-{}-{}", part.method.name(), part.fold), part)
    }

    fn keep_tuned(&self, name: &str, tuned: &Tuned) -> Result<(), CliError> {
        self.keep(name, tuned)
    }

    fn told(&self) -> String {
        format!(
            "; what is done is kept in `{}`, and the same command goes on from there",
            self.results.display()
        )
    }
}

impl Drop for Kept {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.folder); // Refused unless it is empty.
    }
}

/// A hash of everything that a piece depends on.
fn key(work: &Work<'_>) -> String {
    let names: Vec<&str> = work.touches.iter().map(|touch| touch.name.as_str()).collect();
    let (version, arm) = (env!("CARGO_PKG_VERSION"), work.arm.fingerprint());
    let settings = (version, &work.estimators, &work.folds, work.tune, work.truth, arm, names);
    let mut hasher = blake3::Hasher::new();
    hasher.update(format!("{settings:?}").as_bytes());
    for touch in work.touches {
        hasher.update(&(touch.samples.len() as u64).to_le_bytes());
        let numbers = touch.samples.iter().flat_map(|sample| sample.q.iter().chain(&sample.tau));
        numbers.for_each(|number| {
            hasher.update(&number.to_bits().to_le_bytes());
        });
    }
    hasher.finalize().to_hex().to_string()
}
