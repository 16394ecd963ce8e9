//! Settings compared over several objects.

use std::sync::Arc;

use palpate::{Arm, MapperConfig};
use palpate_learn::choose::MIN_TUNING_TOUCHES;
use palpate_learn::study::{self, ObjectScores, StudyPlan};
use palpate_learn::tracked::TouchSamples;
use palpate_learn::tune::Search;

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
    /// Predicts each touch from the others under each of `settings`, as [`study::study`].
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
        plan: StudyPlan,
        progress: &dyn Progress,
    ) -> Result<ObjectScores, WorkError> {
        let chooses = plan.choose.filter(|_| self.touches.len() > MIN_TUNING_TOUCHES);
        let candidates = chooses.map(|given| Search::quick(&settings[0], given).candidates());
        let rows = settings.len() + usize::from(candidates.is_some());
        let steps = (rows * self.touches.len() + candidates.unwrap_or(0)) as u64;
        let bar = progress.begin(Some(steps), "parts", self.name);
        let touches = (self.arm, self.touches);
        study::study(touches, settings, plan, (&|| progress.stopped(), &|| bar.step()))
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
