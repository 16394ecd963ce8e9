//! Checkpoints: the field as it is, on disk every so often, whole or not at all.
//!
//! The mapper only hands over a copy; a thread of its own writes it, under a temporary name that is
//! renamed once the file is complete. If a checkpoint is still being written when the next is due,
//! the next one waits.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded};
use palpate_io::field::{self, Saved};

use crate::body::LiveBody;

/// Where checkpoints go, and how often.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CheckpointConfig {
    /// The field's file.
    pub path: PathBuf,
    /// Time between two.
    pub every: Duration,
}

/// The mapper's side.
#[derive(Debug)]
pub(crate) struct Checkpoints {
    every: Duration,
    last: Instant,
    to_writer: Sender<Saved>,
}

/// What came of the last one: when it was written, or why not.
#[derive(Debug, Default)]
pub(crate) struct Written {
    last: Mutex<Option<Result<Instant, String>>>,
}

impl Checkpoints {
    /// The mapper's side, and what it hands over to [`write`].
    pub(crate) fn new(config: &CheckpointConfig) -> (Self, Receiver<Saved>) {
        let (to_writer, from_mapper) = bounded(1);
        (Self { every: config.every, last: Instant::now(), to_writer }, from_mapper)
    }

    /// Hands a checkpoint over if one is due and the last one is written.
    pub(crate) fn tick(&mut self, checkpoint: impl FnOnce() -> Saved) {
        if self.last.elapsed() < self.every || !self.to_writer.is_empty() {
            return;
        }
        self.last = Instant::now();
        // There is room, since nobody else sends, and the writer stays for as long as the mapper.
        let _ = self.to_writer.try_send(checkpoint());
    }
}

/// Writes what is handed over, with the elastic body if there is one, until nobody is left to do so.
pub(crate) fn write(
    path: &Path,
    (from_mapper, body): (Receiver<Saved>, Option<&LiveBody>),
    written: &Written,
) {
    for mut saved in from_mapper {
        body.inspect(|body| body.put_into(&mut saved));
        let result = field::save(path, &saved).map(|()| Instant::now());
        *written.lock() = Some(result.map_err(|error| error.to_string()));
    }
}

impl Written {
    /// Age of the last one, s.
    pub(crate) fn age_s(&self) -> Option<f64> {
        let last = self.lock();
        Some(last.as_ref()?.as_ref().ok()?.elapsed().as_secs_f64())
    }

    /// Why the last one could not be written, once.
    pub(crate) fn failure(&self) -> Option<String> {
        self.lock().take_if(|last| last.is_err())?.err()
    }

    fn lock(&self) -> MutexGuard<'_, Option<Result<Instant, String>>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
