//! Settings for a robot and an object, chosen by cross-validation on their touches.

use std::sync::Arc;

use palpate::{Arm, Calibration, EstimatorKind, MapperConfig, Sample};
use palpate_learn::choose::{self, MIN_TUNING_TOUCHES};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::tune::{FixedSettings, Search, SearchBudget, Trial, Tuned, Tuner};
use serde_json::json;

use crate::error::WorkError;
use crate::evaluate::{fault, touch_samples};
use crate::progress::Progress;
use crate::settings::{Settings, SettingsError};
use crate::touches::{RecordedTouch, TouchEvent, Touches};

/// Most touches, and most samples, that are read to pick those from which settings are chosen.
const MAX_TOUCHES: usize = 200;
const MAX_SAMPLES: usize = 500_000;

/// How settings are chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Tune {
    /// Not at all.
    Off,
    /// Settings of `map` that are not given, among few candidates, in seconds.
    #[default]
    Quick,
    /// Settings of `map` and of `ekf`, among many candidates around the given ones, in minutes.
    Thorough,
}

impl Tune {
    /// Parses `off`, `quick` or `thorough`.
    ///
    /// # Errors
    ///
    /// If it is none of them.
    pub fn named(name: &str) -> Result<Self, String> {
        match name {
            "off" => Ok(Self::Off),
            "quick" => Ok(Self::Quick),
            "thorough" => Ok(Self::Thorough),
            _ => Err("wanted off, quick or thorough".to_owned()),
        }
    }
}

/// Keys of the settings in [`FixedSettings`].
pub(crate) const CHOSEN: [&str; 7] = [
    "contact_distance_m",
    "friction",
    "coulomb_friction",
    "prior_mean",
    "prior_std",
    "torque_std",
    "stiffness_scale",
];

/// Which settings a file or a flag gives; a quick search chooses the others.
pub fn given(settings: &Settings) -> FixedSettings {
    let (contact, estimator) = (&settings.contact, &settings.estimator);
    FixedSettings {
        contact_distance: contact.contact_distance_m.is_some(),
        friction: contact.friction.is_some(),
        coulomb_friction: contact.coulomb_friction.is_some(),
        prior_mean: estimator.prior_mean.is_some(),
        prior_std: estimator.prior_std.is_some(),
        torque_std: estimator.torque_std.is_some(),
        stiffness_scale: estimator.stiffness_scale.is_some(),
    }
}

/// Touches for which settings are chosen.
#[derive(Clone, Copy)]
pub struct Tuning<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// The touches as read, for errors that name the log.
    pub recorded: &'a [RecordedTouch],
    /// The touches as they are evaluated.
    pub touches: &'a [TouchSamples],
    /// The initial settings, which are a candidate themselves.
    pub config: &'a MapperConfig,
}

impl Tuning<'_> {
    /// Chooses the settings of `map` that are not given, among few candidates.
    ///
    /// # Errors
    ///
    /// If the estimator is not `map`, there are fewer than three touches, a sample cannot be used, or on being stopped.
    pub fn quick(&self, given: FixedSettings, progress: &dyn Progress) -> Result<Tuned, WorkError> {
        Ok(self.quickly(given, progress)?.1)
    }

    /// The touches, tracked under the initial settings, and the result of a quick search.
    fn quickly(
        &self,
        given: FixedSettings,
        progress: &dyn Progress,
    ) -> Result<(TrackedTouches, Tuned), WorkError> {
        if self.config.method != EstimatorKind::Map {
            return Err(WorkError::Usage(format!(
                "quick tuning is for the estimator `map`, not for `{}`; `palpate tune` without --quick is for both",
                self.config.method.name()
            )));
        }
        self.searched(Search::quick(self.config, given), progress)
    }

    /// Chooses among `candidates` candidates; if not given, among as many as a few minutes allow.
    ///
    /// # Errors
    ///
    /// If there are fewer than three touches, a sample cannot be used, or on being stopped.
    pub fn thorough(
        &self,
        candidates: Option<u32>,
        progress: &dyn Progress,
    ) -> Result<Tuned, WorkError> {
        let mut effort = SearchBudget::of(self.config.method);
        effort.candidates = candidates.map_or(effort.candidates, |n| n as usize);
        effort.seed = self.config.estimator.seed;
        Ok(self.searched(Search::thorough(self.config, effort), progress)?.1)
    }

    /// Bands around predictions under `config`, calibrated on all touches; `tracked` are these under the initial
    /// settings.
    fn calibrated(
        &self,
        tracked: &TrackedTouches,
        config: &MapperConfig,
        progress: &dyn Progress,
    ) -> Result<Option<Calibration>, WorkError> {
        let stop = || progress.stopped();
        let fault = |error| fault(self.recorded, error, "; nothing was written".to_owned());
        progress.note("calibrating bands");
        let touches = (self.arm, self.touches, tracked);
        choose::bands(touches, (self.config, config), &stop).map_err(fault)
    }

    /// The touches, tracked under the initial settings, and the result of a search.
    fn searched(
        &self,
        search: Search,
        progress: &dyn Progress,
    ) -> Result<(TrackedTouches, Tuned), WorkError> {
        if self.touches.len() < MIN_TUNING_TOUCHES {
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
        let track = if search.is_quick() { TrackedTouches::sparse } else { TrackedTouches::new };
        let tracked = track(self.arm, self.config, self.touches, &stop).map_err(fault)?;
        let base = (self.arm, self.touches, &tracked);
        let tuner = Tuner::new(base, self.config, search, &stop, &|| bar.step()).map_err(fault)?;
        drop(bar);
        progress.note("comparing the candidates");
        let everything: Vec<usize> = (0..self.touches.len()).collect();
        let tuned = tuner.tune(&everything, &stop).map_err(fault)?;
        if let Some(text) = doubt(&tuned) {
            progress.warn(&text);
        }
        Ok((tracked, tuned))
    }
}

/// A warning, if the torques seem not to be those of contacts.
pub(crate) fn doubt(tuned: &Tuned) -> Option<String> {
    let (finding, remedy) = choose::doubt(tuned)?;
    let noise = if tuned.is_all_noise {
        "all of the torque counts as noise, and the field hardly differs from its prior"
    } else {
        "it is learned as stiffness, since the estimator or its torque noise or stiffness scale is given"
    };
    Some(format!("{finding}. So {noise}. {remedy}"))
}

/// Chosen settings, and bands around predictions under them if there were enough touches.
#[derive(Debug, Clone)]
pub struct TunedSettings {
    /// The settings.
    pub config: MapperConfig,
    /// The bands.
    pub calibration: Option<Calibration>,
}

/// Chooses the settings that are not given, by cross-validation on some of the touches, and notes them in one line.
/// With fewer than three touches in contact, `config` is returned as it is.
///
/// # Errors
///
/// If `config` is not of `map`, a log is broken, a sample cannot be used, or on being stopped.
pub fn quickly_tuned(
    touches: Touches,
    (arm, settings, config): (&Arc<Arm>, &Settings, &MapperConfig),
    progress: &dyn Progress,
) -> Result<TunedSettings, WorkError> {
    config.estimator(arm.robot.n_joints()).map_err(SettingsError::value)?;
    let place = (config.lattice.clone(), config.contact.clone());
    let mut touches = touches.for_arm(arm, &settings.log, config.lattice.clone())?;
    let (mut recorded, mut found, mut is_all) = (Vec::new(), 0, true);
    let tuned = first_of(&mut touches, &mut recorded).and_then(|all| {
        found = recorded.len();
        is_all = pick(&mut recorded, (arm, config), progress)? && all;
        if recorded.len() < MIN_TUNING_TOUCHES {
            return Ok(None);
        }
        let touches = touch_samples(&recorded, false)?;
        let tuning = Tuning { arm, recorded: &recorded, touches: &touches, config };
        let (tracked, tuned) = tuning.quickly(given(settings), progress)?;
        let calibration = tuning.calibrated(&tracked, &tuned.config, progress)?;
        Ok(Some((tuned, calibration)))
    });
    match tuned {
        Ok(Some((tuned, calibration))) => {
            progress.note(&choose::summary(&tuned, (recorded.len(), found)));
            Ok(TunedSettings { config: tuned.config, calibration })
        }
        Ok(None) => {
            let n = recorded.len();
            progress.note(&format!(
                "the default settings are used, since choosing settings needs {MIN_TUNING_TOUCHES} touches in which \
                 the arm touches something, and there are {n}{}",
                if is_all { "" } else { " among the samples that are used for it" }
            ));
            Ok(TunedSettings { config: config.clone(), calibration: None })
        }
        Err(error) => {
            if !matches!(error, WorkError::Interrupted { .. }) {
                touches.check(arm, place, &config.touch).of(&recorded).explain(progress);
            }
            Err(error)
        }
    }
}

/// Reads the first touches, up to [`MAX_TOUCHES`] and [`MAX_SAMPLES`]; true if these are all.
fn first_of(touches: &mut Touches, recorded: &mut Vec<RecordedTouch>) -> Result<bool, WorkError> {
    let mut samples = 0;
    while let Some(event) = touches.advance()? {
        match event {
            TouchEvent::Touch(name) if recorded.len() < MAX_TOUCHES => {
                recorded.push(touches.begun(&name));
            }
            TouchEvent::Sample(sample) if samples < MAX_SAMPLES => {
                samples += 1;
                recorded.last_mut().expect("a touch was begun").samples.push(sample);
            }
            TouchEvent::Touch(_) => return Ok(false),
            TouchEvent::Sample(_) => {
                recorded.pop(); // It is incomplete.
                return Ok(false);
            }
        }
    }
    Ok(true)
}

/// Keeps the touches from which settings are chosen ([`choose::pick`]). False if touches were left out because of their
/// number of samples.
fn pick(
    recorded: &mut Vec<RecordedTouch>,
    (arm, config): (&Arc<Arm>, &MapperConfig),
    progress: &dyn Progress,
) -> Result<bool, WorkError> {
    if recorded.len() < MIN_TUNING_TOUCHES {
        return Ok(true);
    }
    let samples: Vec<&[Sample]> = recorded.iter().map(|touch| &touch.samples[..]).collect();
    let (kept, are_all) = choose::pick((arm, config), &samples, &|| progress.stopped())
        .map_err(|error| fault(recorded, error, "; nothing was written".to_owned()))?;
    let mut place = 0..;
    recorded.retain(|_| place.next().is_some_and(|place| kept.contains(&place)));
    Ok(are_all)
}

/// The candidates with their scores, for programs.
pub fn trials(tuned: &Tuned) -> Vec<serde_json::Value> {
    let trial = |trial: &Trial| json!({ "settings": trial.config, "scores": trial.scores });
    tuned.trials.iter().map(trial).collect()
}

/// The given settings, with the chosen values.
pub fn tuned_settings(tuned: &Tuned, given: &Settings) -> Settings {
    let (mut settings, config) = (given.clone(), &tuned.config);
    settings.contact.contact_distance_m = Some(config.contact.contact_distance_m);
    settings.contact.friction = Some(config.contact.friction);
    settings.contact.coulomb_friction = Some(config.contact.coulomb_friction);
    let estimator = &mut settings.estimator;
    estimator.estimator = Some(config.method);
    estimator.prior_mean = Some(config.estimator.prior.mean_n_per_m);
    estimator.prior_std = Some(config.estimator.prior.std_n_per_m);
    estimator.torque_std = Some(config.estimator.torque_std.clone());
    estimator.replays = Some(config.estimator.replays);
    estimator.stiffness_scale = Some(config.estimator.stiffness_scale);
    settings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_is_reported_with_its_share_what_becomes_of_it_and_a_remedy() {
        let tuned = |is_all_noise, own_motion, identified| {
            let mut config = MapperConfig::of(EstimatorKind::Map);
            config.touch.identified = identified;
            Tuned { config, trials: Vec::new(), is_all_noise, own_motion }
        };
        assert_eq!(doubt(&tuned(false, None, false)), None);
        let text = doubt(&tuned(true, Some(0.871), false)).unwrap();
        let parts =
            ["explain 87 % of the torque", "counts as noise", "identify", "--arm subtracts"];
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        let text = doubt(&tuned(false, Some(0.871), true)).unwrap();
        let parts = ["learned as stiffness", "new free motion"];
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    }
}
