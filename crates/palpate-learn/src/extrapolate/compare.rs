//! Evaluation of an extrapolated prior by the predicted torques of held-out touches.
//!
//! Touches are halved at random. A field is learnt from one half, and with the cloud it is
//! extrapolated to cells that this half did not touch. The other half is predicted by the field
//! without a prior, by the field with the extrapolated stiffness in untouched cells, and by a field
//! that is learnt again with the extrapolated stiffness as its prior.

use palpate::MapperConfig;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;

use super::cloud::SeenCloud;
use super::config::{ExtrapolationConfig, ExtrapolationMethod};
use super::error::ExtrapolateError;
use super::extrapolation::extrapolate;
use super::process::{Evidence, Process};
use super::torque_evidence;
use crate::error::{LearnError, Stop, unless_stopped};
use crate::evaluation::{MeanStd, MethodSummary};
use crate::folds::Fold;
use crate::method;
use crate::regression::shuffle;
use crate::torque_errors::{ErrorSum, TorqueErrors};
use crate::tracked::TrackedTouches;

/// Seed of the random halves.
const SEED: u64 = 0;

/// Settings that are compared, and the number of random halves.
#[derive(Debug, Clone)]
pub struct ComparisonPlan {
    /// The chosen settings, then those with other methods and features.
    pub variants: Vec<ExtrapolationConfig>,
    /// Number of random divisions into halves.
    pub halves: u32,
}

/// Errors of one kind of prediction, by half: means over its test touches.
#[derive(Debug, Clone, PartialEq)]
pub struct VariantErrors {
    /// Name of the kind of prediction.
    pub name: String,
    /// Average error, N·m, by half.
    pub avg_error: Vec<f64>,
    /// Average relative error by half, without halves whose touches never reach 1 N·m.
    pub avg_relative: Vec<f64>,
}

/// Errors of the comparison.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum CompareError {
    #[error(transparent)]
    Extrapolate(#[from] ExtrapolateError),
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// Nothing to halve.
    #[error("a comparison needs at least two touches to learn from one half; found {touches}")]
    TooFew { touches: usize },
}

impl ComparisonPlan {
    /// The standard comparison: the chosen settings, then `torque` with every set of features, and
    /// the two other methods.
    pub fn of(config: &ExtrapolationConfig) -> Self {
        let sets =
            ["chroma", "rgb", "oklab", "chroma+height", "chroma+shape", "chroma+height+shape"];
        let sets = sets.map(|set| set.parse().expect("our own names"));
        let torque = sets.map(|features| (ExtrapolationMethod::Torque, features));
        let rgb = sets[1];
        let chosen = (config.method, config.features);
        let mut others = torque.to_vec();
        others.extend([
            (ExtrapolationMethod::Cells, config.features),
            (ExtrapolationMethod::Knn, rgb),
        ]);
        others.retain(|other| *other != chosen);
        let variant =
            |(method, features)| ExtrapolationConfig { method, features, ..config.clone() };
        let variants = std::iter::once(chosen).chain(others).map(variant).collect();
        Self { variants, halves: 5 }
    }

    /// `torque` and `cells`, the configured one first.
    pub fn methods(config: &ExtrapolationConfig) -> Self {
        let mut methods = vec![ExtrapolationMethod::Torque, ExtrapolationMethod::Cells];
        methods.sort_by_key(|&method| method != config.method);
        let variant = |method| ExtrapolationConfig { method, ..config.clone() };
        Self { variants: methods.into_iter().map(variant).collect(), halves: 5 }
    }

    /// The folds; of an odd number of touches, the smaller half is learnt from.
    pub fn folds(&self, touches: usize) -> Vec<Fold> {
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let half = |_| {
            let mut order: Vec<usize> = (0..touches).collect();
            shuffle(&mut order, &mut rng);
            let mut test = order.split_off(touches / 2);
            test.sort_unstable();
            Fold::testing(test, touches)
        };
        (0..self.halves).map(half).collect()
    }

    /// Compares all variants; `done` is called after each half.
    ///
    /// # Errors
    ///
    /// With fewer than two touches, or on being stopped. A half whose touches are not near the
    /// cloud is no error: its prior is that of untouched cells.
    pub fn run(
        &self,
        tracked: &TrackedTouches,
        seen: &SeenCloud,
        mapper: &MapperConfig,
        stop: Stop<'_>,
        done: &(dyn Fn() + Sync),
    ) -> Result<Vec<VariantErrors>, CompareError> {
        let touches = tracked.touches.len();
        if touches < 2 {
            return Err(CompareError::TooFew { touches });
        }
        let at = seen.at(&tracked.points_m, self.variants[0].reach_m(&tracked.lattice));
        unless_stopped(stop)?;
        let variants: Vec<Variant> =
            self.variants.iter().map(|config| Variant::new(config, tracked, seen, &at)).collect();
        let halves = self.folds(touches);
        let halves: Vec<Vec<MethodSummary>> = (halves.par_iter().with_max_len(1))
            .map(|fold| {
                let errors = Half { tracked, seen, at: &at, mapper, fold }.run(&variants, stop);
                done();
                errors
            })
            .collect::<Result<_, _>>()?;
        let row = |row: usize| {
            let error =
                |half: &Vec<MethodSummary>| half[row].avg_error.map_or(0.0, |error| error.mean);
            let relative = |half: &Vec<MethodSummary>| Some(half[row].avg_relative?.mean);
            VariantErrors {
                name: halves[0][row].name.clone(),
                avg_error: halves.iter().map(error).collect(),
                avg_relative: halves.iter().filter_map(relative).collect(),
            }
        };
        Ok((0..halves.first().map_or(0, Vec::len)).map(row).collect())
    }
}

impl VariantErrors {
    /// Mean over the halves of the relative error, and of the error, N·m.
    pub fn means(&self) -> (Option<f64>, f64) {
        let mean = |values: &[f64]| Some(MeanStd::of(values.iter().copied())?.mean);
        (mean(&self.avg_relative), mean(&self.avg_error).unwrap_or(f64::NAN))
    }
}

/// A method with its features, and the evidence of all touches.
struct Variant<'a> {
    config: &'a ExtrapolationConfig,
    /// Process and evidence of the touches; only for the method `torque`.
    torque: Option<(Process, Vec<Evidence>)>,
}

impl<'a> Variant<'a> {
    fn new(
        config: &'a ExtrapolationConfig,
        tracked: &TrackedTouches,
        seen: &SeenCloud,
        at: &[Option<u32>],
    ) -> Self {
        let torque = (config.method == ExtrapolationMethod::Torque).then(|| {
            let process = Process::new(config.features.of(seen), config.length_scale);
            let evidence = torque_evidence::evidence(tracked, &process, at);
            (process, evidence)
        });
        Self { config, torque }
    }
}

/// One division of the touches into halves.
struct Half<'a> {
    tracked: &'a TrackedTouches,
    seen: &'a SeenCloud,
    /// By row, the seen point near the cell, if any.
    at: &'a [Option<u32>],
    mapper: &'a MapperConfig,
    fold: &'a Fold,
}

impl Half<'_> {
    /// Errors of four kinds of prediction: zero; without a prior; learnt again with the first
    /// variant as the prior; and, for each variant, with the extrapolated stiffness in untouched
    /// cells.
    fn run(
        &self,
        variants: &[Variant<'_>],
        stop: Stop<'_>,
    ) -> Result<Vec<MethodSummary>, CompareError> {
        let (tracked, train) = (self.tracked, &self.fold.train);
        let estimator = method::learn(tracked, train, self.mapper, &[], stop)?;
        let untouched = estimator.stiffness(usize::MAX);
        let field = method::field(tracked, estimator.as_ref(), self.mapper);
        let met = tracked.touched_rows(train);
        let mut errors = vec![
            self.score("predicting zero", |_| 0.0),
            self.score(
                "no prior",
                |row| if met[row] { estimator.stiffness(row) } else { untouched },
            ),
        ];
        let mut filled = Vec::new();
        for (number, variant) in variants.iter().enumerate() {
            unless_stopped(stop)?;
            let points = match &variant.torque {
                Some((process, evidence)) => {
                    let some: Vec<&Evidence> =
                        train.iter().map(|&touch| &evidence[touch]).collect();
                    let prior_std = variant.config.prior_std(&tracked.lattice);
                    let posterior =
                        torque_evidence::posterior(&some, prior_std, variant.config.torque_std);
                    process.at_all_points(&posterior).0
                }
                None => match extrapolate(self.seen, &field, None, variant.config) {
                    Ok(found) => found.stiffness_n_per_m,
                    // The touches of this half are not near the cloud, so there is no
                    // extrapolation.
                    Err(
                        ExtrapolateError::NothingTouched
                        | ExtrapolateError::NoneTouched { .. }
                        | ExtrapolateError::Apart { .. },
                    ) => vec![untouched; self.seen.len()],
                    Err(other) => return Err(other.into()),
                },
            };
            let expected: Vec<f64> = self
                .at
                .iter()
                .map(|at| at.map_or(untouched, |point| points[point as usize]))
                .collect();
            let fill = |row: usize| if met[row] { estimator.stiffness(row) } else { expected[row] };
            let name = format!("{} {}", variant.config.method.name(), variant.config.features);
            filled.push(self.score(&format!("{name}, where the field met nothing"), fill));
            if number == 0 {
                let again = method::learn(tracked, train, self.mapper, &expected, stop)?;
                let name = format!("{name}, learnt again from it");
                errors.push(self.score(&name, |row| again.stiffness(row)));
            }
        }
        errors.extend(filled);
        Ok(errors)
    }

    /// Errors of a stiffness by row, as means over the test touches.
    fn score(&self, name: &str, stiffness: impl Fn(usize) -> f64) -> MethodSummary {
        let cells = self.tracked.with_stiffness(stiffness);
        let of = |&touch: &usize| {
            let frames = &self.tracked.touches[touch].frames;
            let predicted = frames.iter().map(|frame| frame.predict(&cells));
            ErrorSum::of(predicted, frames.iter().map(|frame| &frame.target)).errors()
        };
        let errors: Vec<TorqueErrors> = self.fold.test.iter().filter_map(of).collect();
        MethodSummary::of(name, &errors, [&[], &[]])
    }
}
