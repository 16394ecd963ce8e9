//! Checkpoints: the field as it is, on disk every so often, whole or not at all.
//!
//! The mapper only hands over a copy; a thread of its own writes it, under a temporary name that is
//! renamed once the file is complete. If a checkpoint is still being written when the next is due,
//! the next one waits.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
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
    /// Checkpoints handed over.
    number: u64,
    to_writer: Sender<(u64, Saved)>,
}

/// What came of the last one: its number, and when it was written or why not.
#[derive(Debug, Default)]
pub(crate) struct Written {
    last: Mutex<Option<(u64, Result<Instant, String>)>>,
    /// The number of the last failure that was reported.
    reported: AtomicU64,
}

impl Checkpoints {
    /// The mapper's side, and what it hands over to [`write`].
    pub(crate) fn new(config: &CheckpointConfig) -> (Self, Receiver<(u64, Saved)>) {
        let (to_writer, from_mapper) = bounded(1);
        (Self { every: config.every, last: Instant::now(), number: 0, to_writer }, from_mapper)
    }

    /// Hands a checkpoint over if one is due and the last one is written.
    pub(crate) fn tick(&mut self, checkpoint: impl FnOnce() -> Saved) {
        if self.last.elapsed() >= self.every {
            let _ = self.now(checkpoint);
        }
    }

    /// Hands a checkpoint over if the last one is taken, and says under which number it will be written.
    pub(crate) fn now(&mut self, checkpoint: impl FnOnce() -> Saved) -> Option<u64> {
        if !self.to_writer.is_empty() {
            return None;
        }
        self.last = Instant::now();
        self.number += 1;
        // There is room, since nobody else sends, and the writer stays for as long as the mapper.
        let _ = self.to_writer.try_send((self.number, checkpoint()));
        Some(self.number)
    }
}

/// Writes what is handed over, with the elastic body if there is one, until nobody is left to do so.
pub(crate) fn write(
    path: &Path,
    (from_mapper, body): (Receiver<(u64, Saved)>, Option<&LiveBody>),
    written: &Written,
) {
    for (number, mut saved) in from_mapper {
        body.inspect(|body| body.put_into(&mut saved));
        let result = field::save(path, &saved).map(|()| Instant::now());
        *written.lock() = Some((number, result.map_err(|error| error.to_string())));
    }
}

impl Written {
    /// Age of the last one, s.
    pub(crate) fn age_s(&self) -> Option<f64> {
        let last = self.lock();
        Some(last.as_ref()?.1.as_ref().ok()?.elapsed().as_secs_f64())
    }

    /// What came of a checkpoint, or of a later one, once it is known.
    pub(crate) fn result(&self, number: u64) -> Option<Result<(), String>> {
        let last = self.lock();
        let (written, result) = last.as_ref()?;
        (*written >= number).then(|| result.as_ref().map(|_| ()).map_err(Clone::clone))
    }

    /// Why the last one could not be written, once.
    pub(crate) fn failure(&self) -> Option<String> {
        let last = self.lock();
        let (number, result) = last.as_ref()?;
        let why = result.as_ref().err()?;
        (self.reported.swap(*number, Ordering::Relaxed) != *number).then(|| why.clone())
    }

    fn lock(&self) -> MutexGuard<'_, Option<(u64, Result<Instant, String>)>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
