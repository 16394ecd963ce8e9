//! The work of an evaluation: track, tune if asked to, and do part after part.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use palpate::arm::Arm;
use palpate::contact;
use palpate::field::Field;
use palpate::mapper::Config;
use palpate_learn::contender::{self, Contender, ContenderError};
use palpate_learn::evaluate::{Part, Plan};
use palpate_learn::evaluation::Evaluation;
use palpate_learn::folds::Fold;
use palpate_learn::tracked::{Touch, TrackError, Tracked};
use palpate_learn::tune::{Effort, Tuned, Tuner};

use super::Origin;
use super::kept::Kept;
use super::told::Told;
use crate::error::CliError;
use crate::interrupt;
use crate::output::Output;
use crate::settings::Settings;
use crate::touches::Recorded;

/// What is evaluated.
pub(crate) struct Work<'a> {
    pub(crate) arm: &'a Arc<Arm>,
    /// As read, for errors that name the log.
    pub(crate) recorded: &'a [Recorded],
    pub(crate) touches: &'a [Touch],
    pub(crate) contenders: Vec<Contender>,
    pub(crate) folds: Vec<Fold>,
    /// Settings of `map` and of `ekf`.
    pub(crate) estimators: [Config; 2],
    /// Whether these are tuned in every fold.
    pub(crate) tune: bool,
    /// Whether true torques are to be predicted.
    pub(crate) truth: bool,
}

/// What came out.
pub(crate) struct Evaluated {
    pub(crate) evaluation: Evaluation,
    /// Learnt by `map` from all touches, for the picture of it.
    pub(crate) field: Field,
    /// The estimators' settings in every fold, if they were tuned.
    tuned: Option<Vec<[Config; 2]>>,
}

impl Evaluated {
    /// The settings as a file, with those of each fold as remarks.
    pub(crate) fn settings_toml(&self, settings: &Settings) -> Result<String, CliError> {
        let mut text = settings.template()?;
        for (fold, [map, ekf]) in self.tuned.iter().flatten().enumerate() {
            for (name, config) in [("map", map), ("ekf", ekf)] {
                text += &format!("\n# fold {fold}, {name}: {}", tuned_line(config));
            }
        }
        Ok(text)
    }
}

/// What tuning chooses, in a line.
fn tuned_line(config: &Config) -> String {
    let (contact, estimator) = (&config.contact, &config.estimator);
    let stds: Vec<String> = estimator.torque_std.iter().map(|std| format!("{std:.3}")).collect();
    format!(
        "contact_distance_m = {:.4}, friction = {:.3}, prior_mean = {:.4}, prior_std = {:.3}, \
         torque_std = [{}], replays = {}",
        contact.contact_distance_m,
        contact.friction,
        estimator.prior.mean_n_per_m,
        estimator.prior.std_n_per_m,
        stds.join(", "),
        estimator.replays
    )
}

/// Asked by all that works for long.
const STOP: &(dyn Fn() -> bool + Sync) = &interrupt::pressed;

impl Work<'_> {
    /// What there is to tell of what came out.
    pub(crate) fn told<'a>(
        &self,
        evaluated: &'a Evaluated,
        folder: &'a Path,
        origin: &Origin,
    ) -> Told<'a> {
        let (evaluation, simulated) = (&evaluated.evaluation, origin.simulated);
        Told { evaluation, simulated, folds: self.folds.len(), folder }
    }

    /// Does what is not kept from before, and puts all together.
    pub(crate) fn evaluate(&self, folder: &Path, output: &Output) -> Result<Evaluated, CliError> {
        let kept = Kept::open(folder, self)?;
        let mut parts: Vec<Part> = kept.read("part-");
        parts.retain(|part| self.contenders.contains(&part.contender));
        if !parts.is_empty() {
            let done = parts.len();
            output.note(&format!("{done} parts were done before, and are taken as found"));
        }
        output.note("following the touches");
        let interrupted = || CliError::Interrupted {
            kept: format!(
                "; what is done is kept in `{}`, and the same command goes on from there",
                folder.display()
            ),
        };
        let config = &self.estimators[0];
        let tracked = Tracked::new(self.arm, config, self.touches, STOP)
            .map_err(|error| track_fault(self.recorded, error, &interrupted))?;
        let stopped = |error| match error {
            ContenderError::Stopped => interrupted(),
            other => CliError::file(other),
        };
        let plan = Plan {
            contenders: self.contenders.clone(),
            folds: self.folds.clone(),
            config: config.clone(),
            estimators: self.in_folds(&tracked, &kept, (output, &interrupted))?,
        };
        self.do_parts(&plan, &tracked, (&kept, &mut parts), (output, &interrupted))?;

        let everything: Vec<usize> = (0..self.touches.len()).collect();
        let estimator = contender::learn(&tracked, &everything, config, STOP).map_err(stopped)?;
        let field = contender::field(&tracked, estimator.as_ref(), config);
        let joints = self.arm.robot.joint_names().map(str::to_owned).collect();
        let against = if self.truth { "truth" } else { "measured" };
        let evaluation = plan.gather(&tracked, &parts, joints, against);
        kept.remove();
        let tuned = self.tune.then_some(plan.estimators);
        Ok(Evaluated { evaluation, field, tuned })
    }

    /// The estimators' settings in every fold: the given ones, or those that its training touches
    /// speak for.
    fn in_folds(
        &self,
        tracked: &Tracked,
        kept: &Kept,
        (output, interrupted): (&Output, &dyn Fn() -> CliError),
    ) -> Result<Vec<[Config; 2]>, CliError> {
        let mut in_folds = vec![self.estimators.clone(); self.folds.len()];
        for (index, contender) in [Contender::Map, Contender::Ekf].into_iter().enumerate() {
            if !self.tune || !self.contenders.contains(&contender) {
                continue;
            }
            let name = |fold: usize| format!("tuned-{}-{fold}", contender.name());
            let found: Vec<Option<Tuned>> =
                (0..self.folds.len()).map(|fold| kept.one(&name(fold))).collect();
            let mut tuner = None;
            let effort = Effort::of(self.estimators[index].method);
            let bar = output.progress_of(
                Some((effort.candidates + self.folds.len()) as u64),
                "steps",
                &format!("tuning {}", contender.name()),
            );
            for (fold, found) in found.into_iter().enumerate() {
                let tuned = match found {
                    Some(tuned) => tuned,
                    None => {
                        if tuner.is_none() {
                            let base = (self.arm, self.touches, tracked);
                            let config = &self.estimators[index];
                            let made = Tuner::new(base, config, effort, STOP, &|| bar.inc(1));
                            tuner =
                                Some(made.map_err(|error| {
                                    track_fault(self.recorded, error, interrupted)
                                })?);
                        }
                        let tuner = tuner.as_ref().expect("made above");
                        let tuned = tuner.tune(&self.folds[fold].train, STOP);
                        let tuned = tuned.map_err(|error| match error {
                            ContenderError::Stopped => interrupted(),
                            other => CliError::file(other),
                        })?;
                        kept.keep(&name(fold), &tuned)?;
                        tuned
                    }
                };
                bar.inc(1);
                in_folds[fold][index] = tuned.config;
            }
            bar.finish_and_clear();
        }
        Ok(in_folds)
    }

    /// Does the parts that are left, one contact model after another.
    fn do_parts(
        &self,
        plan: &Plan,
        tracked: &Tracked,
        (kept, parts): (&Kept, &mut Vec<Part>),
        (output, interrupted): (&Output, &dyn Fn() -> CliError),
    ) -> Result<(), CliError> {
        let all = plan.parts();
        let is_done = |&(contender, fold): &(Contender, usize)| {
            parts.iter().any(|part| part.contender == contender && part.fold == fold)
        };
        let mut left: Vec<_> = all.iter().copied().filter(|part| !is_done(part)).collect();
        let bar = output.progress_of(Some(all.len() as u64), "parts", "evaluating");
        bar.set_position(parts.len() as u64);
        let done = Mutex::new((parts, None));
        while let Some(&first) = left.first() {
            let contact: &contact::Config = &plan.config_of(first).contact;
            let alike = |part: &(Contender, usize)| plan.config_of(*part).contact == *contact;
            let group: Vec<_> = left.iter().copied().filter(alike).collect();
            left.retain(|part| !alike(part));
            let other;
            let tracked = if *contact == plan.config.contact {
                tracked
            } else {
                other = tracked
                    .under(contact, self.arm, &plan.config, self.touches, STOP)
                    .map_err(|error| track_fault(self.recorded, error, interrupted))?;
                &other
            };
            let worked = plan.run(tracked, &group, STOP, &|part| {
                let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                let name = format!("part-{}-{}", part.contender.name(), part.fold);
                if let Err(error) = kept.keep(&name, &part) {
                    done.1.get_or_insert(error);
                }
                bar.set_message(format!("{} fold {}", part.contender.name(), part.fold));
                bar.inc(1);
                done.0.push(part);
            });
            worked.map_err(|error| match error.source {
                ContenderError::Stopped => interrupted(),
                _ => CliError::file(error),
            })?;
        }
        bar.finish_and_clear();
        let unwritten = done.into_inner().unwrap_or_else(PoisonError::into_inner).1;
        unwritten.map_or(Ok(()), Err)
    }
}

/// What went wrong in tracking, with the log that it is in.
pub(crate) fn track_fault(
    recorded: &[Recorded],
    error: TrackError,
    interrupted: &dyn Fn() -> CliError,
) -> CliError {
    match error {
        TrackError::Sample { touch, sample, source } => {
            let one = &recorded[touch];
            one.fault(format!("touch `{}`, sample {sample} (from 0)", one.name), source)
        }
        TrackError::Stopped => interrupted(),
        other => CliError::file(other),
    }
}
