//! Checkpoints: the field is saved to a file at regular intervals, never partially.
//!
//! The mapper only hands over a copy; another thread writes it to a temporary file, which is
//! renamed once it is complete. If a checkpoint is still being written when the next is due,
//! the next one waits.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded};
use palpate_io::field::{self, SavedField};

use crate::body::LiveElasticBody;
use crate::threads::lock;

/// File and interval of the checkpoints.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CheckpointConfig {
    /// The field's file.
    pub path: PathBuf,
    /// Time between two checkpoints.
    pub every: Duration,
}

/// The mapper's side: decides when a checkpoint is due, and hands it over.
#[derive(Debug)]
pub(crate) struct Checkpoints {
    every: Duration,
    last: Instant,
    /// Number of checkpoints handed over.
    number: u64,
    to_writer: Sender<(u64, SavedField)>,
}

/// Result of the last checkpoint: its number, and when it was written or why it was not.
#[derive(Debug, Default)]
pub(crate) struct Written {
    last: Mutex<Option<(u64, Result<Instant, String>)>>,
    /// The number of the last failure that was reported.
    reported: AtomicU64,
}

impl Checkpoints {
    /// The mapper's side, and the receiver for [`write`].
    pub(crate) fn new(config: &CheckpointConfig) -> (Self, Receiver<(u64, SavedField)>) {
        let (to_writer, from_mapper) = bounded(1);
        (Self { every: config.every, last: Instant::now(), number: 0, to_writer }, from_mapper)
    }

    /// Hands over a checkpoint if one is due and no earlier one waits for the writer.
    pub(crate) fn tick(&mut self, checkpoint: impl FnOnce() -> SavedField) {
        if self.last.elapsed() >= self.every {
            let _ = self.now(checkpoint);
        }
    }

    /// Hands over a checkpoint and returns its number; `None` if an earlier one still waits for the writer.
    pub(crate) fn now(&mut self, checkpoint: impl FnOnce() -> SavedField) -> Option<u64> {
        if !self.to_writer.is_empty() {
            return None;
        }
        self.last = Instant::now();
        self.number += 1;
        // The channel is empty, since only the mapper sends; the writer runs as long as the mapper.
        let _ = self.to_writer.try_send((self.number, checkpoint()));
        Some(self.number)
    }
}

/// Writes each checkpoint, with the elastic body if there is one, until the mapper's side is dropped.
pub(crate) fn write(
    path: &Path,
    (from_mapper, body): (Receiver<(u64, SavedField)>, Option<&LiveElasticBody>),
    written: &Written,
) {
    for (number, mut saved) in from_mapper {
        body.inspect(|body| body.put_into(&mut saved));
        let result = field::save(path, &saved).map(|()| Instant::now());
        *lock(&written.last) = Some((number, result.map_err(|error| error.to_string())));
    }
}

impl Written {
    /// Age of the last checkpoint, s; `None` if it was not written.
    pub(crate) fn age_s(&self) -> Option<f64> {
        let last = lock(&self.last);
        Some(last.as_ref()?.1.as_ref().ok()?.elapsed().as_secs_f64())
    }

    /// Result of this checkpoint or of a later one; `None` until one of them is finished.
    pub(crate) fn result(&self, number: u64) -> Option<Result<(), String>> {
        let last = lock(&self.last);
        let (written, result) = last.as_ref()?;
        (*written >= number).then(|| result.as_ref().map(|_| ()).map_err(Clone::clone))
    }

    /// Why the last checkpoint could not be written; each failure is returned once.
    pub(crate) fn failure(&self) -> Option<String> {
        let last = lock(&self.last);
        let (number, result) = last.as_ref()?;
        let why = result.as_ref().err()?;
        (self.reported.swap(*number, Ordering::Relaxed) != *number).then(|| why.clone())
    }
}
