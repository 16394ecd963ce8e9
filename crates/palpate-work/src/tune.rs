//! Settings for one's own robot and object, chosen on one's own touches.

use std::sync::Arc;

use palpate::{Arm, MapperConfig};
use palpate_learn::tracked::{Touch, Tracked};
use palpate_learn::tune::{Effort, Trial, Tuned, Tuner};
use serde_json::json;

use crate::error::WorkError;
use crate::evaluate::fault;
use crate::progress::Progress;
use crate::settings::Settings;
use crate::touches::RecordedTouch;

/// What settings are chosen for.
#[derive(Clone, Copy)]
pub struct Tuning<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// As read, for errors that name the log.
    pub recorded: &'a [RecordedTouch],
    /// As they are evaluated.
    pub touches: &'a [Touch],
    /// The settings to start from, which are a candidate themselves.
    pub config: &'a MapperConfig,
}

impl Tuning<'_> {
    /// Chooses among so many candidates, or as many as a few minutes allow.
    ///
    /// # Errors
    ///
    /// If there are fewer than three touches, a sample cannot be used, or on being stopped.
    pub fn run(
        &self,
        candidates: Option<u32>,
        progress: &dyn Progress,
    ) -> Result<Tuned, WorkError> {
        if self.touches.len() < 3 {
            return Err(WorkError::from(format!(
                "tuning needs at least three touches to learn from some and predict others, and \
                 the logs hold {}",
                self.touches.len()
            )));
        }
        let stop = || progress.stopped();
        let fault = |error| fault(self.recorded, error, "; nothing was written".to_owned());
        let mut effort = Effort::of(self.config.method);
        effort.candidates = candidates.map_or(effort.candidates, |n| n as usize);
        effort.seed = self.config.estimator.seed;
        let bar = progress.begin(Some(effort.candidates as u64), "contact models", "simulating");
        let tracked = Tracked::new(self.arm, self.config, self.touches, &stop).map_err(fault)?;
        let base = (self.arm, self.touches, &tracked);
        let tuner = Tuner::new(base, self.config, effort, &stop, &|| bar.step()).map_err(fault)?;
        drop(bar);
        progress.note("comparing the candidates");
        let everything: Vec<usize> = (0..self.touches.len()).collect();
        tuner.tune(&everything, &stop).map_err(fault)
    }
}

/// The candidates with their scores, for programs.
pub fn trials(tuned: &Tuned) -> Vec<serde_json::Value> {
    let trial = |trial: &Trial| json!({ "settings": trial.config, "scores": trial.scores });
    tuned.trials.iter().map(trial).collect()
}

/// The given settings with what was chosen.
pub fn tuned_settings(tuned: &Tuned, given: &Settings) -> Settings {
    let (mut settings, config) = (given.clone(), &tuned.config);
    settings.contact.contact_distance_m = Some(config.contact.contact_distance_m);
    settings.contact.friction = Some(config.contact.friction);
    let estimator = &mut settings.estimator;
    estimator.estimator = Some(config.method);
    estimator.prior_mean = Some(config.estimator.prior.mean_n_per_m);
    estimator.prior_std = Some(config.estimator.prior.std_n_per_m);
    estimator.torque_std = Some(config.estimator.torque_std.clone());
    estimator.replays = Some(config.estimator.replays);
    settings
}
