//! The paper's experiment (Sec. III-A): every touch is predicted by methods that learnt from other touches.
//!
//! The work is divided into *parts*: one method on one fold. Parts are independent, run in parallel,
//! and can be saved and passed in again, so that an interrupted evaluation can be continued. The
//! result does not depend on the number of threads.

use palpate::{Calibration, MapperConfig};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bands::{Band, Uncertainty};
use crate::calibrate::{LEVEL, Learn, PredictedFrame, calibrate, learn_springs, of_other_objects};
use crate::elastic;
use crate::error::{LearnError, Stop};
use crate::evaluation::{Evaluation, HeldOutTouch, MethodPrediction, MethodSummary};
use crate::folds::Fold;
use crate::method::{Method, TorquesByTouch};
use crate::tracked::{TrackedFrame, TrackedTouch, TrackedTouches};

/// Largest torque that a part may contain, N·m.
const LARGEST_N_M: f64 = 1e12;

/// Methods, folds and settings of an evaluation.
#[derive(Debug, Clone)]
pub struct EvaluationPlan {
    /// The methods, in the order of the table.
    pub methods: Vec<Method>,
    /// The folds.
    pub folds: Vec<Fold>,
    /// Indices of the folds that this plan evaluates, in rising order.
    pub todo: Vec<usize>,
    /// Settings of everything but `map` and `ekf`.
    pub config: MapperConfig,
    /// Settings of the estimators in each fold: of `map`, then of `ekf`. They differ from `config`
    /// in estimator and contact model alone.
    pub estimators: Vec<[MapperConfig; 2]>,
}

/// One method on one fold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FoldPrediction {
    /// The method.
    pub method: Method,
    /// The fold's number.
    pub fold: usize,
    /// Predicted torques of the fold's test touches.
    pub torques: TorquesByTouch,
    /// Uncertainty of the torques, for an estimator that has learnt enough touches to determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<Uncertainty>,
}

/// An error in one part.
#[derive(Debug, thiserror::Error)]
#[error("{method} on fold {fold}: {source}", method = method.name())]
pub struct PartError {
    /// The method.
    pub method: Method,
    /// The fold's number.
    pub fold: usize,
    /// The cause.
    pub source: LearnError,
}

impl EvaluationPlan {
    /// All parts of the plan, those that take longest first.
    pub fn parts(&self) -> Vec<(Method, usize)> {
        let rank = |method: &Method| match method {
            Method::Elastic | Method::Ekf => 0,
            Method::Map => 1,
            Method::Mlp => 2,
            Method::Gp => 3,
            Method::Knn | Method::Uniform | Method::Zero => 4,
        };
        let mut methods = self.methods.clone();
        methods.sort_by_key(rank);
        let folds = |method: Method| self.todo.iter().map(move |&fold| (method, fold));
        methods.into_iter().flat_map(folds).collect()
    }

    /// The settings of a part.
    pub fn config_of(&self, (method, fold): (Method, usize)) -> &MapperConfig {
        match method {
            Method::Map => &self.estimators[fold][0],
            Method::Ekf => &self.estimators[fold][1],
            // Tuned settings do not suit `elastic`, whose field explains only the residual of a body.
            _ => &self.config,
        }
    }

    /// Whether a part, perhaps read from a file, fits this plan: method and fold are in it, and there is a finite
    /// torque for every joint and frame of the fold's test touches.
    pub fn has(&self, part: &FoldPrediction, tracked: &TrackedTouches) -> bool {
        let is_torque = |torque: &Vec<f64>| {
            torque.len() == tracked.n_joints && torque.iter().all(|tau| tau.abs() <= LARGEST_N_M)
        };
        let predicts = |(torques, &touch): (&Vec<Vec<f64>>, &usize)| {
            torques.len() == tracked.touches[touch].frames.len() && torques.iter().all(is_torque)
        };
        let fold = self.folds.get(part.fold).filter(|_| self.methods.contains(&part.method));
        let is_whole = |torques: &TorquesByTouch, fold: &Fold| {
            torques.len() == fold.test.len() && torques.iter().zip(&fold.test).all(predicts)
        };
        fold.is_some_and(|fold| {
            let is_sound = |own: &Uncertainty| {
                let mut bands = std::iter::once(&own.calibration).chain(&own.others);
                is_whole(&own.spread, fold)
                    && bands.all(|bands| bands.check(tracked.n_joints).is_ok())
            };
            is_whole(&part.torques, fold) && part.uncertainty.as_ref().is_none_or(is_sound)
        })
    }

    /// Computes parts that share the contact model of `tracked`, in parallel. `done` gets each
    /// finished part, from any thread.
    ///
    /// # Errors
    ///
    /// The error of a part that failed; parts finished before were passed to `done`.
    pub fn run(
        &self,
        tracked: &TrackedTouches,
        parts: &[(Method, usize)],
        stop: Stop<'_>,
        done: &(dyn Fn(FoldPrediction) + Sync),
    ) -> Result<(), PartError> {
        // Threads take one part at a time: durations of parts differ too much for larger chunks.
        parts.par_iter().with_max_len(1).try_for_each(|&(method, fold)| {
            let config = self.config_of((method, fold));
            let own = (&self.folds[fold], config);
            let (torques, uncertainty) = match method {
                Method::Elastic if tracked.body.is_some() => {
                    let counted = elastic::with_torque(tracked, &own.0.train);
                    with_uncertainty((elastic::learn_with_body, &counted), tracked, own, stop)
                }
                Method::Map => with_uncertainty((learn_springs, &own.0.train), tracked, own, stop),
                _ => method.predict(tracked, own.0, config, stop).map(|torques| (torques, None)),
            }
            .map_err(|source| PartError { method, fold, source })?;
            done(FoldPrediction { method, fold, torques, uncertainty });
            Ok(())
        })
    }

    /// Combines all parts into the evaluation.
    ///
    /// # Panics
    ///
    /// If a part is missing, which is a bug in the caller.
    pub fn gather(
        &self,
        tracked: &TrackedTouches,
        parts: &[FoldPrediction],
        joint_names: Vec<String>,
        against: &str,
    ) -> Evaluation {
        let of = |method: Method, fold: usize| {
            let part = parts.iter().find(|part| part.method == method && part.fold == fold);
            part.expect("all parts were done")
        };
        let mut touches: Vec<(usize, HeldOutTouch)> = Vec::new();
        for &number in &self.todo {
            let fold = &self.folds[number];
            let met = tracked.touched_rows(&fold.train);
            for (place, &touch) in fold.test.iter().enumerate() {
                let frames = &tracked.touches[touch].frames;
                let mut left_out = HeldOutTouch::of(&tracked.touches[touch], number, &met);
                for &method in &self.methods {
                    let FoldPrediction { torques, uncertainty, .. } = of(method, number);
                    let torques = torques[place].clone();
                    let mut prediction =
                        MethodPrediction::new(method.name(), torques, &left_out.external);
                    if let Some(uncertainty) = uncertainty {
                        let band = |of: &Calibration| {
                            let spread = &uncertainty.spread[place];
                            band((of, LEVEL), (frames, spread), &prediction, &left_out)
                        };
                        let others = uncertainty.others.as_ref().and_then(&band);
                        prediction.band = band(&uncertainty.calibration);
                        prediction.band_of_other_objects = others;
                    }
                    left_out.predictions.push(prediction);
                }
                touches.push((touch, left_out));
            }
        }
        touches.sort_by_key(|(touch, _)| *touch);
        let touches: Vec<HeldOutTouch> = touches.into_iter().map(|(_, touch)| touch).collect();
        let summary =
            |(index, method): (usize, &Method)| MethodSummary::new(method.name(), index, &touches);
        let methods = self.methods.iter().enumerate().map(summary).collect();
        Evaluation { joint_names, against: against.to_owned(), methods, touches }
    }
}

/// Torques that an estimator predicts for a fold's test touches, and their uncertainty: calibrated on the touches
/// `counted`, and that of other objects.
fn with_uncertainty(
    (learn, counted): (Learn, &[usize]),
    tracked: &TrackedTouches,
    (fold, config): (&Fold, &MapperConfig),
    stop: Stop<'_>,
) -> Result<(TorquesByTouch, Option<Uncertainty>), LearnError> {
    let predicted = learn(tracked, &fold.train, config, stop)?;
    let (mut torques, mut spreads) = (TorquesByTouch::new(), TorquesByTouch::new());
    for touch in &fold.test {
        let frames = predicted.frames(*touch);
        let (own, spread) = frames.map(|frame| (frame.torque, frame.spread)).unzip();
        torques.push(own);
        spreads.push(spread);
    }
    let calibration = calibrate(learn, tracked, counted, config, (stop, &|| ()))?;
    // With few touches the calibration is already of other objects, and a second one would differ from it only because
    // it follows other replays.
    let others = match calibration.as_ref().filter(|own| own.of_other_objects) {
        Some(own) => Some(own.clone()),
        None => of_other_objects(&predicted, &fold.train),
    };
    let calibration = calibration.or_else(|| others.clone());
    let uncertainty =
        calibration.map(|calibration| Uncertainty { spread: spreads, calibration, others });
    Ok((torques, uncertainty))
}

/// The band around the prediction of a test touch, with this spread.
fn band(
    calibration: (&Calibration, f64),
    (frames, spread): (&[TrackedFrame], &[Vec<f64>]),
    prediction: &MethodPrediction,
    touch: &HeldOutTouch,
) -> Option<Band> {
    let contacts = touch.contacts.iter().zip(&touch.known);
    let frames = frames.iter().zip(&prediction.predicted).zip(spread).zip(contacts);
    let frames = frames.map(|(((frame, torque), spread), (all, known))| PredictedFrame {
        torque: torque.clone(),
        spread: spread.clone(),
        measured: frame.observation.tau().as_slice().to_vec(),
        contacts: [*all as usize, *known as usize],
    });
    Band::of(calibration, &frames.collect::<Vec<_>>())
}

impl HeldOutTouch {
    /// A held-out touch without predictions; `met` is, by row, whether a training touch has displaced the cell.
    fn of(touch: &TrackedTouch, fold: usize, met: &[bool]) -> Self {
        let frames = &touch.frames;
        let start_s = frames.first().and_then(|frame| frame.time_s);
        let time_s = |(number, frame): (usize, &TrackedFrame)| match (frame.time_s, start_s) {
            (Some(time_s), Some(start_s)) => time_s - start_s,
            _ => number as f64,
        };
        let known =
            |frame: &TrackedFrame| frame.observation.rows().filter(|&row| met[row]).count() as u32;
        Self {
            name: touch.name.clone(),
            fold,
            time_s: frames.iter().enumerate().map(time_s).collect(),
            contacts: frames.iter().map(|frame| frame.observation.n_contacts() as u32).collect(),
            known: frames.iter().map(known).collect(),
            q: frames.iter().map(|frame| frame.q.clone()).collect(),
            external: frames.iter().map(|frame| frame.target.clone()).collect(),
            predictions: Vec::new(),
        }
    }
}
