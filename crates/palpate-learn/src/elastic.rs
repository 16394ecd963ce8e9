//! A body that bends is what is expected, and a field explains what is left over.
//!
//! The torque of an elastic body is in proportion to its stiffness: a touch is simulated once, and the
//! factor of stiffness is fitted afterwards. Friction changes how the body moves, so every touch is
//! simulated with each of a few frictions ([`FRICTIONS`]); the one that explains the training touches
//! best is kept. The remaining torque is learnt by `map`.
//!
//! Field, body, and both are averaged, each with the weight of its error to the power of -4: how well it
//! predicted the later training touches before they were learnt. So the result is not much worse than the
//! best of them, also on a touch that is unlike those.

use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::{Cell, ElasticBody, ElasticContactConfig, Equilibrium, Estimator, FrameId};
use palpate::{Arm, MapperConfig, MapperError, RobotError};
use rayon::prelude::*;

use crate::error::{LearnError, Stop, unless_stopped};
use crate::folds::Fold;
use crate::method::Torques;
use crate::tracked::{Touch, Tracked};

/// Frictions between arm and body that are tried.
pub const FRICTIONS: [f64; 4] = [0.05, 0.15, 0.35, 0.7];
/// Factors of stiffness that are tried, from a tenth to ten.
const FACTORS: usize = 81;
/// Frames below this torque have no relative error, N·m.
const TORQUE_FLOOR: f64 = 1.0;

/// Torque of a body along every touch.
#[derive(Debug, Clone)]
pub(crate) struct BodyTorques {
    /// By friction, touch and frame of [`Tracked`]: n_joints, N·m at a stiffness factor of one.
    torques: Vec<Vec<Vec<DVector<f64>>>>,
    /// Samples, all frictions counted, and those in which the body did not come to rest.
    pub(crate) settled: Settled,
}

/// How often the body came to rest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Settled {
    /// Samples, each with every friction.
    pub samples: u64,
    /// Those in which the iterations were used up before the body was at rest: its torque is that of the
    /// last iteration.
    pub unsettled: u64,
}

/// What the training touches say of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constants {
    /// Which of [`FRICTIONS`].
    friction: usize,
    /// Factor on the stiffness of all springs of the body.
    pub stiffness_factor: f64,
}

impl Constants {
    /// Sliding friction between arm and body.
    pub fn friction(&self) -> f64 {
        FRICTIONS[self.friction]
    }
}

impl BodyTorques {
    /// Simulates all touches with every friction, several at a time; the result does not depend on how
    /// many. `step` is called after each.
    pub(crate) fn new(
        arm: &Arc<Arm>,
        body: &Arc<ElasticBody>,
        (tracked, touches): (&Tracked, &[Touch]),
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<Self, LearnError> {
        let n = touches.len();
        let follow = |job: usize| {
            let (friction, touch) = (FRICTIONS[job / n], job % n);
            let config = ElasticContactConfig { friction, ..ElasticContactConfig::default() };
            let equilibrium = Equilibrium::new(Arc::clone(arm), Arc::clone(body), config);
            let torques = follow(equilibrium, (touch, &touches[touch]), tracked, stop);
            step();
            torques
        };
        let jobs = (0..n * FRICTIONS.len()).into_par_iter().with_max_len(1);
        let all: Vec<_> = jobs.map(follow).collect::<Result<_, LearnError>>()?;
        let settled = all.iter().fold(Settled::default(), |sum, (_, settled)| Settled {
            samples: sum.samples + settled.samples,
            unsettled: sum.unsettled + settled.unsettled,
        });
        let all: Vec<Vec<DVector<f64>>> = all.into_iter().map(|(torques, _)| torques).collect();
        Ok(Self { torques: all.chunks(n.max(1)).map(<[_]>::to_vec).collect(), settled })
    }

    /// Every n-th frame of each touch, from the first on.
    pub(crate) fn thinned(&self, n: usize) -> Self {
        let touch = |frames: &Vec<DVector<f64>>| frames.iter().step_by(n.max(1)).cloned().collect();
        let touches = |touches: &Vec<Vec<DVector<f64>>>| touches.iter().map(touch).collect();
        Self { torques: self.torques.iter().map(touches).collect(), settled: self.settled }
    }

    /// Torque of the body in a frame, n_joints, N·m.
    fn torque(&self, constants: &Constants, touch: usize, frame: usize) -> DVector<f64> {
        &self.torques[constants.friction][touch][frame] * constants.stiffness_factor
    }

    /// Friction and stiffness that explain the measured torques of some touches best: they have the least
    /// mean over touches of the average relative error.
    fn constants(&self, tracked: &Tracked, touches: &[usize]) -> Constants {
        let mut best = (f64::INFINITY, Constants { friction: 0, stiffness_factor: 1.0 });
        for friction in 0..self.torques.len() {
            for factor in 0..FACTORS {
                let stiffness_factor = 0.1 * 100_f64.powf(factor as f64 / (FACTORS - 1) as f64);
                let constants = Constants { friction, stiffness_factor };
                let error = |&touch: &usize| {
                    touch_error(tracked, touch, |frame| self.torque(&constants, touch, frame))
                };
                let sum: f64 = touches.iter().map(error).sum();
                if sum < best.0 {
                    best = (sum, constants);
                }
            }
        }
        best.1
    }
}

/// The body's torque in the frames of a touch.
fn follow(
    mut equilibrium: Equilibrium,
    (number, touch): (usize, &Touch),
    tracked: &Tracked,
    stop: Stop<'_>,
) -> Result<(Vec<DVector<f64>>, Settled), LearnError> {
    let frames = &tracked.touches[number].frames;
    let mut torques = Vec::with_capacity(frames.len());
    let mut settled = Settled { samples: touch.samples.len() as u64, unsettled: 0 };
    for (sample, logged) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        let at = |error: RobotError| {
            let source = MapperError::from(error);
            LearnError::Sample { touch: number, sample, source }
        };
        let poses = equilibrium.arm().robot.forward(&logged.q).map_err(at)?;
        settled.unsettled += u64::from(equilibrium.advance(&poses).unsettled > 0);
        if frames.get(torques.len()).is_some_and(|frame| frame.sample as usize == sample) {
            torques.push(equilibrium.torque(&poses));
        }
    }
    assert_eq!(torques.len(), frames.len(), "the touches are those that were tracked");
    Ok((torques, settled))
}

/// How far each is believed; they add up to one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// The field alone.
    pub field: f64,
    /// The body alone.
    pub body: f64,
    /// The body, and the field for what it leaves over.
    pub both: f64,
}

impl Weights {
    /// By the errors of field, body and both.
    fn of(errors: [f64; 3]) -> Self {
        let weights = errors.map(|error| f64::max(error, 1e-6).powi(-4));
        let [field, body, both] = weights.map(|weight| weight / weights.iter().sum::<f64>());
        Self { field, body, both }
    }
}

/// What a fold's training touches say of its test touches.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// Predicted torques of the test touches.
    pub torques: Torques,
    /// Of the body.
    pub constants: Constants,
    /// What predicted them.
    pub weights: Weights,
}

/// A field that learns what the body leaves over, and how well both predicted touches before they were
/// learnt.
struct Learner<'a> {
    body: &'a BodyTorques,
    tracked: &'a Tracked,
    config: &'a MapperConfig,
    constants: Constants,
    estimator: Box<dyn Estimator>,
    error: f64,
}

impl<'a> Learner<'a> {
    fn new(
        (body, tracked): (&'a BodyTorques, &'a Tracked),
        config: &'a MapperConfig,
        constants: Constants,
    ) -> Result<Self, LearnError> {
        let estimator = config.estimator(tracked.n_joints)?;
        Ok(Self { body, tracked, config, constants, estimator, error: 0.0 })
    }

    fn cells(&self) -> Vec<Cell> {
        self.tracked.with_stiffness(|row| self.estimator.stiffness(row))
    }

    /// Torque of body and field in a frame, n_joints, N·m.
    fn torque(&self, cells: &[Cell], touch: usize, frame: usize) -> DVector<f64> {
        let field = self.tracked.touches[touch].frames[frame].predict(cells);
        self.body.torque(&self.constants, touch, frame) + DVector::from_vec(field)
    }

    /// Predicts a touch, if it `counts`, and learns it.
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
            let left_over =
                frame.observation.tau() - self.body.torque(&self.constants, touch, index);
            let observation = frame.observation.clone().with_tau(&left_over);
            let source = FrameId { touch: place as u32, sample: frame.sample };
            self.estimator.correct(&self.tracked.points_m, observation, source)?;
            self.estimator.replay(self.config.estimator.replays);
        }
        Ok(())
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
/// If the touches were tracked without a body ([`Tracked::with_body`]).
pub fn predict(
    tracked: &Tracked,
    fold: &Fold,
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<Predicted, LearnError> {
    let body = tracked.body.as_deref().expect("the caller gave a body");
    let constants = body.constants(tracked, &fold.train);
    let no_body = Constants { stiffness_factor: 0.0, ..constants };
    let mut field = Learner::new((body, tracked), config, no_body)?;
    let mut both = Learner::new((body, tracked), config, constants)?;
    let mut body_error = 0.0;
    for (place, &touch) in fold.train.iter().enumerate() {
        let counts = 2 * place >= fold.train.len();
        if counts {
            let of_body = |frame: usize| body.torque(&constants, touch, frame);
            body_error += touch_error(tracked, touch, of_body);
        }
        field.learn(place, touch, counts, stop)?;
        both.learn(place, touch, counts, stop)?;
    }
    let weights = Weights::of([field.error, body_error, both.error]);
    let cells = [field.cells(), both.cells()];
    let torque = |touch: usize, frame: usize| {
        weights.field * field.torque(&cells[0], touch, frame)
            + weights.body * body.torque(&constants, touch, frame)
            + weights.both * both.torque(&cells[1], touch, frame)
    };
    let frames = |&touch: &usize| {
        let frames = 0..tracked.touches[touch].frames.len();
        frames.map(|frame| torque(touch, frame).as_slice().to_vec()).collect()
    };
    Ok(Predicted { torques: fold.test.iter().map(frames).collect(), constants, weights })
}

/// The average relative error of a touch against what was measured; 0 if it has none.
fn touch_error(tracked: &Tracked, touch: usize, predict: impl Fn(usize) -> DVector<f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (number, frame) in tracked.touches[touch].frames.iter().enumerate() {
        let tau = frame.observation.tau();
        let size = tau.norm();
        if size >= TORQUE_FLOOR {
            sum += (predict(number) - tau).norm() / size;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
