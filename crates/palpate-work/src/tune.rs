//! Settings for one's own robot and object, chosen on one's own touches.

use std::sync::Arc;

use palpate::{Arm, EstimatorKind, MapperConfig};
use palpate_learn::tracked::{Touch, Tracked};
use palpate_learn::tune::{Effort, Search, Trial, Tuned, Tuner};
use serde_json::json;

use crate::error::WorkError;
use crate::evaluate::{as_touches, fault};
use crate::progress::Progress;
use crate::settings::Settings;
use crate::touches::{RecordedTouch, TouchEvent, Touches};

/// Touches that settings are chosen from where nobody asked for more, and samples of them: the first ones.
const QUICK_TOUCHES: usize = 16;
const QUICK_SAMPLES: usize = 20_000;

/// Fewest touches that settings are chosen from.
pub(crate) const FEWEST: usize = 3;

/// How the settings of `map` are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// As given.
    Given,
    /// Chosen among few, in seconds.
    Quick,
    /// Chosen among many, those of `ekf` too.
    Thorough,
}

impl Choice {
    /// What the settings ask for; `tune` asks for the thorough one.
    pub fn of(settings: &Settings, tune: bool) -> Self {
        let estimator = &settings.estimator;
        let is_map = estimator.estimator != Some(EstimatorKind::Ekf);
        match (tune, estimator.choose) {
            (true, _) => Self::Thorough,
            (false, Some(true)) if is_map => Self::Quick,
            (false, _) => Self::Given,
        }
    }
}

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
    /// Chooses among few candidates.
    ///
    /// # Errors
    ///
    /// If there are fewer than three touches, a sample cannot be used, or on being stopped.
    pub fn quick(&self, progress: &dyn Progress) -> Result<Tuned, WorkError> {
        self.search(Search::quick(self.config), progress)
    }

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
        let mut effort = Effort::of(self.config.method);
        effort.candidates = candidates.map_or(effort.candidates, |n| n as usize);
        effort.seed = self.config.estimator.seed;
        self.search(Search::thorough(self.config, effort), progress)
    }

    fn search(&self, search: Search, progress: &dyn Progress) -> Result<Tuned, WorkError> {
        if self.touches.len() < FEWEST {
            return Err(WorkError::from(format!(
                "tuning needs at least three touches to learn from some and predict others, and \
                 the logs hold {}",
                self.touches.len()
            )));
        }
        let stop = || progress.stopped();
        let fault = |error| fault(self.recorded, error, "; nothing was written".to_owned());
        let steps = Some(search.candidates() as u64);
        let bar = progress.begin(steps, "contact models", "simulating");
        let tracked = Tracked::new(self.arm, self.config, self.touches, &stop).map_err(fault)?;
        let base = (self.arm, self.touches, &tracked);
        let tuner = Tuner::new(base, self.config, search, &stop, &|| bar.step()).map_err(fault)?;
        drop(bar);
        progress.note("comparing the candidates");
        let everything: Vec<usize> = (0..self.touches.len()).collect();
        tuner.tune(&everything, &stop).map_err(fault)
    }
}

/// The configuration to learn `touches` with: `config` with what its first touches speak for, or as given if they
/// are fewer than three, or cannot be read: learning them tells what is wrong.
///
/// # Errors
///
/// On being stopped.
pub fn chosen(
    touches: Result<Touches, WorkError>,
    (arm, settings, config): (&Arc<Arm>, &Settings, &MapperConfig),
    progress: &dyn Progress,
) -> Result<MapperConfig, WorkError> {
    let read = || {
        let place = (config.lattice.clone(), config.contact.clone());
        let recorded = first_of(touches?.for_arm(arm, &settings.log, place)?)?;
        let touches = as_touches(&recorded, false)?;
        if touches.len() < FEWEST {
            return Ok(None);
        }
        let tuning = Tuning { arm, recorded: &recorded, touches: &touches, config };
        tuning.quick(progress).map(Some)
    };
    match read() {
        Ok(Some(tuned)) => {
            progress.note(&told(&tuned));
            Ok(tuned.config)
        }
        Err(stopped @ WorkError::Interrupted { .. }) => Err(stopped),
        Ok(None) | Err(_) => Ok(config.clone()),
    }
}

/// The first touches, as far as settings are chosen from them.
fn first_of(mut touches: Touches) -> Result<Vec<RecordedTouch>, WorkError> {
    let (mut recorded, mut samples): (Vec<RecordedTouch>, usize) = (Vec::new(), 0);
    while let Some(event) = touches.advance()? {
        match event {
            TouchEvent::Touch(name) if recorded.len() < QUICK_TOUCHES => {
                recorded.push(touches.begun(&name));
            }
            TouchEvent::Sample(sample) if samples < QUICK_SAMPLES => {
                samples += 1;
                recorded.last_mut().expect("a touch was begun").samples.push(sample);
            }
            TouchEvent::Touch(_) => break,
            TouchEvent::Sample(_) => {
                recorded.pop(); // Its end is not there.
                break;
            }
        }
    }
    Ok(recorded)
}

/// What was chosen and why, in a line.
fn told(tuned: &Tuned) -> String {
    let (contact, estimator) = (&tuned.config.contact, &tuned.config.estimator);
    let score = tuned.trials[0].scores.last().copied().unwrap_or(f64::NAN);
    format!(
        "chosen by touches that were not learnt (relative error {score:.2}): contact distance {:.0} mm, \
         friction {:.2}, prior mean {:.3} N/m, trust {:.2}",
        1e3 * contact.contact_distance_m,
        contact.friction,
        estimator.prior.mean_n_per_m,
        estimator.trust,
    )
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
    estimator.trust = Some(config.estimator.trust);
    estimator.choose = Some(false);
    settings
}
