//! Settings compared over several objects.

use std::sync::Arc;

use palpate::{Arm, MapperConfig};
use palpate_learn::study::{self, ObjectScores};
use palpate_learn::tracked::TouchSamples;

use crate::error::WorkError;
use crate::evaluate::fault;
use crate::inspect::counted;
use crate::progress::Progress;
use crate::touches::RecordedTouch;

/// An object of a study, with its touches.
#[derive(Clone, Copy)]
pub struct StudiedObject<'a> {
    /// Name of the object in errors.
    pub name: &'a str,
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// The touches as read, for errors that name the log.
    pub recorded: &'a [RecordedTouch],
    /// The touches as they are predicted.
    pub touches: &'a [TouchSamples],
}

impl StudiedObject<'_> {
    /// Predicts each touch from the others under each of `settings`; `of` is `(every, curve)` of
    /// [`study::study`].
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, a sample cannot be used, or on being stopped.
    ///
    /// # Panics
    ///
    /// If there are no settings or no touches; see [`at_least_two`].
    pub fn study(
        &self,
        settings: &[MapperConfig],
        of: (usize, bool),
        progress: &dyn Progress,
    ) -> Result<ObjectScores, WorkError> {
        let mut models: Vec<_> = Vec::new();
        for config in settings {
            if !models.contains(&&config.contact) {
                models.push(&config.contact);
            }
        }
        let bar = progress.begin(Some(models.len() as u64), "contact models", self.name);
        study::study(
            (self.arm, self.touches),
            settings,
            of,
            (&|| progress.stopped(), &|| bar.step()),
        )
        .map_err(|error| fault(self.recorded, error, "; nothing was written".to_owned()))
    }
}

/// Refuses an object with too few touches.
///
/// # Errors
///
/// If there are fewer than two.
pub fn at_least_two(name: &str, touches: &[TouchSamples]) -> Result<(), WorkError> {
    if touches.len() >= 2 {
        return Ok(());
    }
    Err(WorkError::from(format!(
        "`{name}` holds {}; a study needs at least two of each object, one to learn from and one to predict",
        counted(touches.len(), "touch")
    )))
}
