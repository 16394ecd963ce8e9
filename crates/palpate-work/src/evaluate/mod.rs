//! Runs an evaluation: tracks the touches, tunes settings if asked to, and computes one part after another.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::unstable::ElasticBody;
use palpate::{Arm, ContactConfig, Field, MapperConfig};
use palpate_learn::LearnError;
use palpate_learn::choose::MIN_TUNING_TOUCHES;
use palpate_learn::elastic::model;
use palpate_learn::evaluate::{EvaluationPlan, FoldPrediction};
use palpate_learn::evaluation::Evaluation;
use palpate_learn::folds::Fold;
use palpate_learn::method::{self, Method};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::tune::{FixedSettings, Search, SearchBudget, Tuned, Tuner};

use crate::elastic::simulate_bodies;
use crate::error::WorkError;
use crate::progress::Progress;
use crate::touches::RecordedTouch;
use crate::tune::{Tune, doubt};

mod plan;

pub use plan::{
    configs, folds, make_unique, method_of, methods_to_compare, read, share, touch_samples,
};

/// Storage of finished parts, so that an interrupted evaluation can continue.
///
/// The default methods store nothing.
pub trait ResultStore: Sync {
    /// Parts that were finished before.
    fn stored_predictions(&self) -> Vec<FoldPrediction> {
        Vec::new()
    }

    /// Settings that were stored under a name before.
    fn tuned(&self, _name: &str) -> Option<Tuned> {
        None
    }

    /// Stores a part, if possible.
    fn keep_part(&self, _part: &FoldPrediction) {}

    /// Stores tuned settings under a name, if possible.
    fn keep_tuned(&self, _name: &str, _tuned: &Tuned) {}

    /// Text about stored parts for the error message, if the work is stopped.
    fn kept_message(&self) -> String {
        String::new()
    }
}

/// Stores nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoStore;

impl ResultStore for NoStore {}

/// Input of an evaluation.
pub struct EvaluationJob<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// The touches as read, for errors that name the log.
    pub recorded: &'a [RecordedTouch],
    /// The touches as they are evaluated.
    pub touches: &'a [TouchSamples],
    /// The methods, in the order of the table.
    pub methods: Vec<Method>,
    /// Which touches are predicted from which.
    pub folds: Vec<Fold>,
    /// Numbers of the folds to compute here; all, unless the work is divided into shares.
    pub todo: Vec<usize>,
    /// Settings of `map` and of `ekf`, in this order.
    pub estimators: [MapperConfig; 2],
    /// How the settings are chosen in every fold.
    pub tune: Tune,
    /// Settings that the user has given, which a quick search does not change.
    pub given: FixedSettings,
    /// Whether predictions are compared with true torques.
    pub truth: bool,
    /// Possible elastic bodies of the object, for [`Method::Elastic`]; empty without a cloud.
    pub bodies: Vec<Arc<ElasticBody>>,
    /// The touches as tracked by [`track`] under the settings of `map`, if that was done before.
    pub tracked: Option<Arc<TrackedTouches>>,
}

/// Result of an evaluation.
pub struct Evaluated {
    /// All figures and torques.
    pub evaluation: Evaluation,
    /// Settings of `map` and `ekf` in every computed fold, if they were tuned.
    pub tuned: Option<Vec<[MapperConfig; 2]>>,
    /// The touches, tracked under the given settings.
    tracked: Arc<TrackedTouches>,
    /// The tuner of `map`, if its settings were tuned.
    tuner: Option<Tuner>,
}

impl EvaluationJob<'_> {
    /// Computes all parts that are not stored already, and combines them.
    ///
    /// # Errors
    ///
    /// If a sample cannot be used, a method cannot learn, or on being stopped.
    pub fn evaluate(
        &self,
        keep: &dyn ResultStore,
        progress: &dyn Progress,
    ) -> Result<Evaluated, WorkError> {
        let config = &self.estimators[0];
        let tracked = match &self.tracked {
            Some(tracked) => Arc::clone(tracked),
            None => Arc::new(
                track(self.arm, config, self.touches, progress)
                    .map_err(|error| self.fault(error, keep))?,
            ),
        };
        let tracked = self.with_body_torques(tracked, (keep, progress))?;
        let (estimators, tuner) = self.in_folds(&tracked, (keep, progress))?;
        let plan = EvaluationPlan {
            methods: self.methods.clone(),
            folds: self.folds.clone(),
            todo: self.todo.clone(),
            config: config.clone(),
            estimators,
        };
        let mut parts: Vec<FoldPrediction> = keep.stored_predictions();
        parts.retain(|part| plan.has(part, &tracked));
        if !parts.is_empty() {
            let done = parts.len();
            progress
                .note(&format!("{done} parts were computed before; their stored results are used"));
        }
        self.do_parts(&plan, &tracked, (keep, progress), &mut parts)?;

        let joints = self.arm.robot.joint_names().map(str::to_owned).collect();
        let against = if self.truth { "truth" } else { "measured" };
        let evaluation = plan.gather(&tracked, &parts, joints, against);
        let in_fold = |&fold: &usize| plan.estimators[fold].clone();
        let is_tuned = self.tune != Tune::Off;
        let tuned = is_tuned.then(|| self.todo.iter().map(in_fold).collect());
        Ok(Evaluated { evaluation, tuned, tracked, tuner })
    }

    /// The field that `map` learns from all touches, for pictures. Settings are tuned on all touches, if tuning was
    /// asked for; with an elastic body, the given settings are used and the body is part of the field.
    ///
    /// # Errors
    ///
    /// If learning fails, or on being stopped; `keep` gives the text about stored parts.
    pub fn field(
        &self,
        evaluated: &mut Evaluated,
        (keep, progress): (&dyn ResultStore, &dyn Progress),
    ) -> Result<Field, WorkError> {
        let (mut tracked, mut config) = (&*evaluated.tracked, &self.estimators[0]);
        let everything: Vec<usize> = (0..self.touches.len()).collect();
        let stop = || progress.stopped();
        let (tuned, other);
        let is_tuned = self.search(Method::Map).is_some() && everything.len() >= MIN_TUNING_TOUCHES;
        if is_tuned && tracked.convergence().is_none() {
            let (tuner, train) = (&mut evaluated.tuner, ("tuned-map-all", &everything[..]));
            tuned =
                self.tuned(tuner, train, tracked, (Method::Map, &|| ()), (keep, progress))?.config;
            let given = std::mem::replace(&mut config, &tuned);
            if config.contact != given.contact {
                other = tracked
                    .with_contact_model(&config.contact, self.arm, given, (self.touches, 1), &stop)
                    .map_err(|error| self.fault(error, keep))?;
                tracked = &other;
            }
        }
        let learnt = method::learn(tracked, &everything, config, &[], &stop);
        let estimator = learnt.map_err(|error| self.fault(error, keep))?;
        let mut field = method::field(tracked, estimator.as_ref(), config);
        if tracked.convergence().is_some() {
            let model = model(tracked, &everything, config, &stop);
            field.elastic = Some(Arc::new(model.map_err(|error| self.fault(error, keep))?));
        }
        Ok(field)
    }

    /// Adds the torques of the elastic bodies, if [`Method::Elastic`] is evaluated.
    fn with_body_torques(
        &self,
        tracked: Arc<TrackedTouches>,
        (keep, progress): (&dyn ResultStore, &dyn Progress),
    ) -> Result<Arc<TrackedTouches>, WorkError> {
        let wanted = self.methods.contains(&Method::Elastic);
        if self.bodies.is_empty() || !wanted {
            return Ok(tracked);
        }
        let everything = (0..self.touches.len()).collect();
        let of_folds = self.folds.iter().map(|fold| fold.train.clone());
        let training: Vec<Vec<usize>> = of_folds.chain([everything]).collect();
        let touches = (self.touches, &training[..]);
        let tracked = Arc::unwrap_or_clone(tracked);
        simulate_bodies(tracked, (self.arm, &self.bodies), touches, progress)
            .map(Arc::new)
            .map_err(|error| self.fault(error, keep))
    }

    /// Settings of `map` and `ekf` in every fold: the given ones, or those tuned on its training touches; and the tuner
    /// of `map`.
    fn in_folds(
        &self,
        tracked: &TrackedTouches,
        (keep, progress): (&dyn ResultStore, &dyn Progress),
    ) -> Result<(Vec<[MapperConfig; 2]>, Option<Tuner>), WorkError> {
        let (mut of_map, mut warned) = (None, false);
        let mut in_folds = vec![self.estimators.clone(); self.folds.len()];
        for (index, method) in [Method::Map, Method::Ekf].into_iter().enumerate() {
            let Some(search) = self.search(method) else { continue };
            let can_tune = |fold: &&usize| self.folds[**fold].train.len() >= MIN_TUNING_TOUCHES;
            let todo: Vec<usize> = self.todo.iter().filter(can_tune).copied().collect();
            if todo.is_empty() {
                continue;
            }
            let steps = Some((search.candidates() + todo.len()) as u64);
            let bar = progress.begin(steps, "steps", &format!("tuning {}", method.name()));
            let mut tuner = None;
            for fold in todo {
                let name = format!("tuned-{}-{fold}", method.name());
                let train = (&*name, &self.folds[fold].train[..]);
                let step = || bar.step();
                let tuned =
                    self.tuned(&mut tuner, train, tracked, (method, &step), (keep, progress))?;
                bar.step();
                if let Some(text) = doubt(&tuned).filter(|_| tuned.own_motion.is_some() && !warned)
                {
                    progress.warn(&text);
                    warned = true;
                }
                in_folds[fold][index] = tuned.config;
            }
            if method == Method::Map {
                of_map = tuner;
            }
        }
        Ok((in_folds, of_map))
    }

    /// The search for settings of an estimator; `None` if they are not to be tuned.
    fn search(&self, method: Method) -> Option<Search> {
        let config = &self.estimators[usize::from(method == Method::Ekf)];
        match (self.tune, method) {
            _ if !self.methods.contains(&method) => None,
            (Tune::Off, _) | (Tune::Quick, Method::Ekf) => None,
            (Tune::Quick, _) => Some(Search::quick(config, self.given)),
            (Tune::Thorough, _) => Some(Search::thorough(config, SearchBudget::of(config.method))),
        }
    }

    /// Settings tuned on training touches: those stored under a name, or new ones, which are then stored.
    fn tuned(
        &self,
        tuner: &mut Option<Tuner>,
        (name, train): (&str, &[usize]),
        tracked: &TrackedTouches,
        (method, done): (Method, &(dyn Fn() + Sync)),
        (keep, progress): (&dyn ResultStore, &dyn Progress),
    ) -> Result<Tuned, WorkError> {
        if let Some(tuned) = keep.tuned(name) {
            return Ok(tuned);
        }
        let (stop, fault) = (|| progress.stopped(), |error| self.fault(error, keep));
        let tuner = match tuner {
            Some(tuner) => tuner,
            None => {
                let config = &self.estimators[usize::from(method == Method::Ekf)];
                let search = self.search(method).expect("asked for what is tuned");
                let sparse;
                let tracked = if search.is_quick() {
                    sparse = TrackedTouches::sparse(self.arm, config, self.touches, &stop)
                        .map_err(fault)?;
                    &sparse
                } else {
                    tracked
                };
                let base = (self.arm, self.touches, tracked);
                tuner.insert(Tuner::new(base, config, search, &stop, done).map_err(fault)?)
            }
        };
        let tuned = tuner.tune(train, &stop).map_err(fault)?;
        keep.keep_tuned(name, &tuned);
        Ok(tuned)
    }

    /// Computes the remaining parts, one contact model after another.
    fn do_parts(
        &self,
        plan: &EvaluationPlan,
        tracked: &TrackedTouches,
        (keep, progress): (&dyn ResultStore, &dyn Progress),
        parts: &mut Vec<FoldPrediction>,
    ) -> Result<(), WorkError> {
        let stop = || progress.stopped();
        let all = plan.parts();
        let is_done = |&(method, fold): &(Method, usize)| {
            parts.iter().any(|part| part.method == method && part.fold == fold)
        };
        let mut left: Vec<_> = all.iter().copied().filter(|part| !is_done(part)).collect();
        let bar = progress.begin(Some(all.len() as u64), "parts", "evaluating");
        parts.iter().for_each(|_| bar.step());
        let done = Mutex::new(parts);
        while let Some(&first) = left.first() {
            let contact: &ContactConfig = &plan.config_of(first).contact;
            let alike = |part: &(Method, usize)| plan.config_of(*part).contact == *contact;
            let group: Vec<_> = left.iter().copied().filter(alike).collect();
            left.retain(|part| !alike(part));
            let other;
            let tracked = if *contact == plan.config.contact {
                tracked
            } else {
                other = tracked
                    .with_contact_model(contact, self.arm, &plan.config, (self.touches, 1), &stop)
                    .map_err(|error| self.fault(error, keep))?;
                &other
            };
            let worked = plan.run(tracked, &group, &stop, &|part| {
                let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                keep.keep_part(&part);
                bar.at(&format!("{} fold {}", part.method.name(), part.fold));
                bar.step();
                done.push(part);
            });
            worked.map_err(|error| match error.source {
                LearnError::Stopped => self.fault(error.source, keep),
                _ => WorkError::file(error),
            })?;
        }
        Ok(())
    }

    fn fault(&self, error: LearnError, keep: &dyn ResultStore) -> WorkError {
        fault(self.recorded, error, keep.kept_message())
    }
}

/// Tracks touches under the settings of `map`: contacts, and torques with the tare subtracted.
///
/// # Errors
///
/// As [`TrackedTouches::new`].
pub fn track(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[TouchSamples],
    progress: &dyn Progress,
) -> Result<TrackedTouches, LearnError> {
    progress.note("simulating the contacts of the touches");
    TrackedTouches::new(arm, config, touches, &|| progress.stopped())
}

/// Turns an error of learning into one that names the log; `kept` is the text about stored results if the work was
/// stopped.
pub fn fault(recorded: &[RecordedTouch], error: LearnError, kept: String) -> WorkError {
    match error {
        LearnError::Sample { touch, sample, source } => {
            let one = &recorded[touch];
            one.fault(format!("touch `{}`, sample {sample} (from 0)", one.name), source)
        }
        LearnError::Stopped => WorkError::Interrupted { kept },
        other => WorkError::file(other),
    }
}
