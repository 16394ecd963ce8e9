//! The work of an evaluation: track, tune if asked to, and do part after part.

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

use crate::error::WorkError;
use crate::host::Host;
use crate::touches::Recorded;

mod plan;

pub use plan::{as_touches, configs, contender_of, each_once, folds, number, share};

/// Where what is done is kept, so that an evaluation that was broken off goes on.
pub trait Keep: Sync {
    /// Parts that were done before.
    fn parts(&self) -> Vec<Part>;

    /// Settings that were tuned before, by a name.
    fn tuned(&self, name: &str) -> Option<Tuned>;

    /// Keeps a part.
    ///
    /// # Errors
    ///
    /// If it cannot be written.
    fn keep_part(&self, part: &Part) -> Result<(), WorkError>;

    /// Keeps tuned settings under a name.
    ///
    /// # Errors
    ///
    /// If they cannot be written.
    fn keep_tuned(&self, name: &str, tuned: &Tuned) -> Result<(), WorkError>;

    /// What is said of that on being stopped.
    fn told(&self) -> String;
}

/// Keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Nowhere;

impl Keep for Nowhere {
    fn parts(&self) -> Vec<Part> {
        Vec::new()
    }

    fn tuned(&self, _: &str) -> Option<Tuned> {
        None
    }

    fn keep_part(&self, _: &Part) -> Result<(), WorkError> {
        Ok(())
    }

    fn keep_tuned(&self, _: &str, _: &Tuned) -> Result<(), WorkError> {
        Ok(())
    }

    fn told(&self) -> String {
        String::new()
    }
}

/// What is evaluated.
pub struct Work<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// As read, for errors that name the log.
    pub recorded: &'a [Recorded],
    /// As they are evaluated.
    pub touches: &'a [Touch],
    /// The methods, in the order of the table.
    pub contenders: Vec<Contender>,
    /// Which touches are predicted from which.
    pub folds: Vec<Fold>,
    /// Numbers of the folds that are done here; all, unless work is shared out.
    pub todo: Vec<usize>,
    /// Settings of `map` and of `ekf`.
    pub estimators: [Config; 2],
    /// Whether these are tuned in every fold.
    pub tune: bool,
    /// Whether true torques are to be predicted.
    pub truth: bool,
}

/// What came out.
pub struct Evaluated {
    /// All figures and torques.
    pub evaluation: Evaluation,
    /// The estimators' settings in every fold that was done, if they were tuned.
    pub tuned: Option<Vec<[Config; 2]>>,
    /// The touches, followed under the given settings.
    tracked: Tracked,
}

impl Work<'_> {
    /// Does what is not kept from before, and puts all together.
    ///
    /// # Errors
    ///
    /// If a sample cannot be used, a method cannot learn, what is done cannot be kept, or on being
    /// stopped.
    pub fn evaluate(&self, keep: &dyn Keep, host: &dyn Host) -> Result<Evaluated, WorkError> {
        let mut parts: Vec<Part> = keep.parts();
        parts.retain(|part| self.contenders.contains(&part.contender));
        if !parts.is_empty() {
            let done = parts.len();
            host.note(&format!("{done} parts were done before, and are taken as found"));
        }
        host.note("following the touches");
        let stop = || host.stopped();
        let interrupted = || WorkError::Interrupted { kept: keep.told() };
        let config = &self.estimators[0];
        let tracked = Tracked::new(self.arm, config, self.touches, &stop)
            .map_err(|error| track_fault(self.recorded, error, &interrupted))?;
        let plan = Plan {
            contenders: self.contenders.clone(),
            folds: self.folds.clone(),
            todo: self.todo.clone(),
            config: config.clone(),
            estimators: self.in_folds(&tracked, (keep, host))?,
        };
        self.do_parts(&plan, &tracked, (keep, host), &mut parts)?;

        let joints = self.arm.robot.joint_names().map(str::to_owned).collect();
        let against = if self.truth { "truth" } else { "measured" };
        let evaluation = plan.gather(&tracked, &parts, joints, against);
        let in_fold = |&fold: &usize| plan.estimators[fold].clone();
        let tuned = self.tune.then(|| self.todo.iter().map(in_fold).collect());
        Ok(Evaluated { evaluation, tuned, tracked })
    }

    /// What the given settings learn from all touches, for the picture of it.
    ///
    /// # Errors
    ///
    /// If they cannot learn, or on being stopped; `keep` is what holds the parts then.
    pub fn field(
        &self,
        evaluated: &Evaluated,
        (keep, host): (&dyn Keep, &dyn Host),
    ) -> Result<Field, WorkError> {
        let (tracked, config) = (&evaluated.tracked, &self.estimators[0]);
        let everything: Vec<usize> = (0..self.touches.len()).collect();
        let learnt = contender::learn(tracked, &everything, config, &|| host.stopped());
        let estimator = learnt.map_err(|error| match error {
            ContenderError::Stopped => WorkError::Interrupted { kept: keep.told() },
            other => WorkError::file(other),
        })?;
        Ok(contender::field(tracked, estimator.as_ref(), config))
    }

    /// The estimators' settings in every fold: the given ones, or those that its training touches
    /// speak for.
    fn in_folds(
        &self,
        tracked: &Tracked,
        (keep, host): (&dyn Keep, &dyn Host),
    ) -> Result<Vec<[Config; 2]>, WorkError> {
        let stop = || host.stopped();
        let interrupted = || WorkError::Interrupted { kept: keep.told() };
        let mut in_folds = vec![self.estimators.clone(); self.folds.len()];
        for (index, contender) in [Contender::Map, Contender::Ekf].into_iter().enumerate() {
            if !self.tune || !self.contenders.contains(&contender) {
                continue;
            }
            let name = |fold: usize| format!("tuned-{}-{fold}", contender.name());
            let mut tuner = None;
            let effort = Effort::of(self.estimators[index].method);
            let steps = Some((effort.candidates + self.todo.len()) as u64);
            let bar = host.begin(steps, "steps", &format!("tuning {}", contender.name()));
            for &fold in &self.todo {
                let tuned = match keep.tuned(&name(fold)) {
                    Some(tuned) => tuned,
                    None => {
                        if tuner.is_none() {
                            let base = (self.arm, self.touches, tracked);
                            let config = &self.estimators[index];
                            let made = Tuner::new(base, config, effort, &stop, &|| bar.step());
                            tuner = Some(made.map_err(|error| {
                                track_fault(self.recorded, error, &interrupted)
                            })?);
                        }
                        let tuner = tuner.as_ref().expect("made above");
                        let tuned = tuner.tune(&self.folds[fold].train, &stop);
                        let tuned = tuned.map_err(|error| match error {
                            ContenderError::Stopped => interrupted(),
                            other => WorkError::file(other),
                        })?;
                        keep.keep_tuned(&name(fold), &tuned)?;
                        tuned
                    }
                };
                bar.step();
                in_folds[fold][index] = tuned.config;
            }
        }
        Ok(in_folds)
    }

    /// Does the parts that are left, one contact model after another.
    fn do_parts(
        &self,
        plan: &Plan,
        tracked: &Tracked,
        (keep, host): (&dyn Keep, &dyn Host),
        parts: &mut Vec<Part>,
    ) -> Result<(), WorkError> {
        let stop = || host.stopped();
        let interrupted = || WorkError::Interrupted { kept: keep.told() };
        let all = plan.parts();
        let is_done = |&(contender, fold): &(Contender, usize)| {
            parts.iter().any(|part| part.contender == contender && part.fold == fold)
        };
        let mut left: Vec<_> = all.iter().copied().filter(|part| !is_done(part)).collect();
        let bar = host.begin(Some(all.len() as u64), "parts", "evaluating");
        parts.iter().for_each(|_| bar.step());
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
                    .under(contact, self.arm, &plan.config, self.touches, &stop)
                    .map_err(|error| track_fault(self.recorded, error, &interrupted))?;
                &other
            };
            let worked = plan.run(tracked, &group, &stop, &|part| {
                let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                if let Err(error) = keep.keep_part(&part) {
                    done.1.get_or_insert(error);
                }
                bar.at(&format!("{} fold {}", part.contender.name(), part.fold));
                bar.step();
                done.0.push(part);
            });
            worked.map_err(|error| match error.source {
                ContenderError::Stopped => interrupted(),
                _ => WorkError::file(error),
            })?;
        }
        let unwritten = done.into_inner().unwrap_or_else(PoisonError::into_inner).1;
        unwritten.map_or(Ok(()), Err)
    }
}

/// What went wrong in tracking, with the log that it is in.
pub fn track_fault(
    recorded: &[Recorded],
    error: TrackError,
    interrupted: &dyn Fn() -> WorkError,
) -> WorkError {
    match error {
        TrackError::Sample { touch, sample, source } => {
            let one = &recorded[touch];
            one.fault(format!("touch `{}`, sample {sample} (from 0)", one.name), source)
        }
        TrackError::Stopped => interrupted(),
        other => WorkError::file(other),
    }
}
