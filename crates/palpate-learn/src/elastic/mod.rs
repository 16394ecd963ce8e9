//! The estimator `elastic`: an elastic body, and a field for the torque that the body does not explain.
//!
//! The torque of an elastic body is proportional to its stiffness: a touch is simulated once, and the
//! stiffness factor is fitted afterwards. If several trees stand side by side, each has its own factor,
//! regularised towards the common one. Friction changes how the body moves, so every touch is
//! simulated with each of a few contacts ([`CONTACT_CANDIDATES`]); the one that explains the training touches
//! best is kept. If a cloud allows several bodies, their torques are averaged, each with the weight
//! error⁻⁸, where the error is that on the training touches. The residual torque is learnt by `map`.
//!
//! The prediction is an average of three: of the field alone, of the body alone, and of the body with a
//! field for its residual. The weight of each is error⁻⁴, where the error is that on the second half of
//! the training touches, each predicted before it was learnt. So the result is not much worse than the
//! best of the three, also on a touch that is unlike the training touches.
//!
//! | file        | does                                                                    |
//! |-------------|-------------------------------------------------------------------------|
//! | `learner`   | learns touches one by one                                               |
//! | `simulated` | simulates the torques of the bodies along all touches, for each contact |
//! | `stiffness` | fits contact and stiffness to training touches                          |

mod learner;
mod simulated;
mod stiffness;

use nalgebra::DVector;
use palpate::MapperConfig;
use palpate::unstable::{CellState, ElasticContactConfig, ElasticModel, Estimator, FrameId};

use self::stiffness::touch_error;
use crate::calibrate::{FramePredictor, of_other_objects};
use crate::error::{LearnError, Stop, unless_stopped};
use crate::folds::Fold;
use crate::method::TorquesByTouch;
use crate::tracked::TrackedTouches;

pub use self::learner::ElasticBodyLearner;
pub(crate) use self::simulated::BodyTorques;
pub use self::simulated::{CONTACT_CANDIDATES, ConvergenceCounts, steps};
pub use self::stiffness::ElasticParameters;
pub(crate) use self::stiffness::with_torque;

/// Weights of the three predictions; they sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// The field alone.
    pub field: f64,
    /// The body alone.
    pub body: f64,
    /// The body, and the field for its residual.
    pub both: f64,
}

impl Weights {
    /// From the errors of field, body and both.
    fn of(errors: [f64; 3]) -> Self {
        let weights = errors.map(|error| f64::max(error, 1e-6).powi(-4));
        let [field, body, both] = weights.map(|weight| weight / weights.iter().sum::<f64>());
        Self { field, body, both }
    }
}

/// Prediction of a fold's test touches.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// Predicted torques of the test touches.
    pub torques: TorquesByTouch,
    /// Contact and stiffness of the body.
    pub constants: ElasticParameters,
    /// Weights of field, body and both in the prediction.
    pub weights: Weights,
}

/// A field that learns the residual of the body, and the error of both together on touches before
/// they were learnt.
struct Learner<'a> {
    body: &'a BodyTorques,
    tracked: &'a TrackedTouches,
    config: &'a MapperConfig,
    /// `None` for the field alone, without a body.
    constants: Option<ElasticParameters>,
    estimator: Box<dyn Estimator>,
    /// Sum over touches of the average relative error.
    error: f64,
}

impl<'a> Learner<'a> {
    fn new(
        (body, tracked): (&'a BodyTorques, &'a TrackedTouches),
        config: &'a MapperConfig,
        constants: Option<ElasticParameters>,
    ) -> Result<Self, LearnError> {
        let estimator = config.estimator(tracked.n_joints)?;
        Ok(Self { body, tracked, config, constants, estimator, error: 0.0 })
    }

    fn cells(&self) -> Vec<CellState> {
        self.tracked.with_stiffness(|row| self.estimator.stiffness(row))
    }

    /// Torque of body and field in a frame, n_joints, N·m.
    fn torque(&self, cells: &[CellState], touch: usize, frame: usize) -> DVector<f64> {
        let field = self.tracked.touches[touch].frames[frame].predict(cells);
        DVector::from_vec(field) + self.of_body(touch, frame)
    }

    fn of_body(&self, touch: usize, frame: usize) -> DVector<f64> {
        match &self.constants {
            Some(constants) => self.body.torque(constants, touch, frame),
            None => DVector::zeros(self.tracked.n_joints),
        }
    }

    /// Learns a touch; if it `counts`, predicts it before and adds its error.
    fn learn(
        &mut self,
        place: usize,
        touch: usize,
        counts: bool,
        stop: Stop<'_>,
    ) -> Result<(), LearnError> {
        if counts {
            let cells = self.cells();
            self.error +=
                touch_error(self.tracked, touch, |frame| self.torque(&cells, touch, frame));
        }
        for (index, frame) in self.tracked.touches[touch].frames.iter().enumerate() {
            unless_stopped(stop)?;
            if frame.observation.n_contacts() == 0 {
                self.estimator.advance_time();
                continue;
            }
            let residual = frame.observation.tau() - self.of_body(touch, index);
            let observation = frame
                .weighted(frame.observation.clone().with_tau(&residual), &self.config.estimator);
            let source = FrameId { touch: place as u32, sample: frame.sample };
            self.estimator.correct(&self.tracked.points_m, observation, source)?;
            self.estimator.replay(self.config.estimator.replays);
        }
        Ok(())
    }
}

/// Field and body, learnt from touches.
struct Lesson<'a> {
    field: Learner<'a>,
    both: Learner<'a>,
    constants: ElasticParameters,
    weights: Weights,
}

impl<'a> Lesson<'a> {
    fn learn(
        tracked: &'a TrackedTouches,
        touches: &[usize],
        config: &'a MapperConfig,
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        let body = tracked.body.as_deref().expect("the caller gave a body");
        let constants = body.constants(tracked, touches);
        let mut field = Learner::new((body, tracked), config, None)?;
        let mut both = Learner::new((body, tracked), config, Some(constants.clone()))?;
        let mut body_error = 0.0;
        for (place, &touch) in touches.iter().enumerate() {
            let counts = 2 * place >= touches.len() || touches.len() == 1;
            if counts {
                let of_body = |frame: usize| body.torque(&constants, touch, frame);
                body_error += touch_error(tracked, touch, of_body);
            }
            field.learn(place, touch, counts, stop)?;
            both.learn(place, touch, counts, stop)?;
        }
        let weights = match with_torque(tracked, touches).is_empty() {
            true => Weights { field: 0.0, body: 1.0, both: 0.0 },
            false => Weights::of([field.error, body_error, both.error]),
        };
        Ok(Self { field, both, constants, weights })
    }

    /// Weight of the body's torque in the prediction.
    fn share(&self) -> f64 {
        (self.weights.body + self.weights.both).min(1.0)
    }

    /// The part of a spring's stiffness in the prediction that explains the residual of the body, N/m.
    fn residual_n_per_m(&self, row: usize) -> f64 {
        self.weights.both * f64::max(self.both.estimator.stiffness(row), 0.0)
    }

    /// What was learnt, for predictions of the touches of `tracked`.
    fn predictor<'t>(&self, tracked: &'t TrackedTouches) -> FramePredictor<'t> {
        let (share, constants) = (self.share(), self.constants.clone());
        let body = tracked.body.as_deref().expect("the caller gave a body");
        let of_body = move |touch, at| share * body.torque(&constants, touch, at);
        let field = &*self.field.estimator;
        let stiffness = |row: usize| {
            ElasticModel::spring_beside(share, field.stiffness(row), self.residual_n_per_m(row))
        };
        FramePredictor::by(tracked, field, stiffness).with_body(of_body)
    }
}

/// Learns a fold's training touches, and predicts its test touches by field and body.
///
/// # Errors
///
/// If a setting is out of its range, or a frame cannot be used.
///
/// # Panics
///
/// If the touches were tracked without a body ([`TrackedTouches::with_bodies`]).
pub fn predict(
    tracked: &TrackedTouches,
    fold: &Fold,
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<Predicted, LearnError> {
    let lesson = Lesson::learn(tracked, &fold.train, config, stop)?;
    let predictor = lesson.predictor(tracked);
    let torques = |&touch: &usize| predictor.frames(touch).map(|frame| frame.torque).collect();
    let torques = fold.test.iter().map(torques).collect();
    let Lesson { constants, weights, .. } = lesson;
    Ok(Predicted { torques, constants, weights })
}

/// Learns touches, for predictions by field and body.
///
/// # Errors
///
/// As [`predict`].
///
/// # Panics
///
/// As [`predict`].
pub(crate) fn learn_with_body<'a>(
    tracked: &'a TrackedTouches,
    touches: &[usize],
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<FramePredictor<'a>, LearnError> {
    Ok(Lesson::learn(tracked, touches, config, stop)?.predictor(tracked))
}

/// Learns touches, and returns the body. Together with a field of the same touches it gives the same prediction as
/// [`predict`], since torques are linear in the stiffness of body and springs. Without touches, the body has the
/// typical stiffness and contact of other plants. The bands are those of other objects; [`ElasticBodyLearner`] can
/// calibrate them.
///
/// # Errors
///
/// As [`predict`].
///
/// # Panics
///
/// As [`predict`].
pub fn model(
    tracked: &TrackedTouches,
    touches: &[usize],
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<ElasticModel, LearnError> {
    let lesson = Lesson::learn(tracked, touches, config, stop)?;
    let of_touches = || touches.iter().map(|&touch| &tracked.touches[touch].in_contact);
    let path_m: f64 = of_touches().map(|motion| motion.path_m).sum();
    let time_s: f64 = of_touches().map(|motion| motion.time_s).sum();
    let speed_m_per_s = match path_m > 0.0 && time_s > 0.0 {
        true => (path_m / time_s).clamp(1e-3, 10.0),
        false => ElasticContactConfig::default().speed_m_per_s,
    };
    let Lesson { both, constants, .. } = &lesson;
    let residual = |row| lesson.residual_n_per_m(row);
    Ok(ElasticModel {
        variants: both.body.variants(constants),
        friction: constants.friction(),
        creep_s: constants.creep_s(),
        torque_limit_n_m: constants.torque_limit_n_m(),
        share: lesson.share(),
        n_touches: touches.len(),
        speed_m_per_s,
        residual_cells: tracked.cells.clone(),
        residual_n_per_m: (0..tracked.cells.len()).map(residual).collect(),
        untouched_residual_n_per_m: residual(usize::MAX),
        calibration: of_other_objects(&lesson.predictor(tracked), touches),
    })
}
