//! The exact maximum a posteriori of the stiffness, by replay.
//!
//! Under a Gaussian prior N(m₀, S₀), diagonal, and torque noise R, the most likely K ≥ 0 given
//! all remembered frames t solves a non-negative least-squares problem. Its optimality (KKT)
//! conditions are
//!
//! ```text
//! z = m₀ + S₀ Σₜ Hₜᵀ αₜ,   K = max(z, 0),   R αₜ = τₜ − Hₜ K   for every t,
//! ```
//!
//! so every frame keeps a multiplier αₜ, one number a joint, and a *visit* of frame j solves its
//! own condition as if no cell changed sign:
//!
//! ```text
//! r = τⱼ − HⱼK − R αⱼ;   d = (HⱼS₀Hⱼᵀ + R)⁻¹ r;   αⱼ += d;   z += S₀Hⱼᵀ d.
//! ```
//!
//! That matrix bounds the true curvature, so a visit never moves away from the optimum, and
//! repeating one never counts its data twice: α holds what was already said. A frame is
//! forgotten exactly by taking S₀Hⱼᵀαⱼ back. When memory is full a frame is *frozen*: it leaves
//! and its share of z stays. z is kept in `f64`, where the rounding of millions of visits stays
//! far below a millionth of a newton per metre; a test holds it to that.
//!
//! # What the standard deviation means
//!
//! The variance of a cell starts from the prior and is reduced by each *new* frame, once, as a
//! Kalman filter with a diagonal covariance would; replays do not touch it. It says how much
//! evidence there is about a cell. It leaves out the correlation between cells that the same
//! link presses together, counts neighbouring frames of a slow motion as independent, ignores
//! the bound K ≥ 0, and knows nothing of errors of the contact model: take it as a ranking of
//! what is known well and what is not, and as a lower bound on the error.

use nalgebra::{DMatrix, DVector};

use crate::estimator::{
    Estimator, EstimatorConfig, EstimatorError, EstimatorState, Source, innovation_inverse, padded,
    shrink,
};
use crate::replay::Memory;
use crate::torque::Observation;

/// A remembered frame with its multiplier.
#[derive(Debug, Clone)]
struct Frame {
    observation: Observation,
    source: Source,
    /// αₜ, n_joints.
    alpha: DVector<f64>,
    /// `(HₜS₀Hₜᵀ + R)⁻¹`, n × n.
    gain: DMatrix<f64>,
}

/// The unknown and its model: z, its prior, and the torque noise.
#[derive(Debug, Clone)]
struct Belief {
    z: Vec<f64>,
    /// m₀ and the diagonal of S₀ at this lattice's spacing.
    prior_mean: f64,
    prior_variance: f64,
    /// The diagonal of R, n_joints, (N·m)².
    torque_variance: DVector<f64>,
}

impl Belief {
    /// `τ − H K − R α` of a frame.
    fn residual(&self, points_m: &[[f32; 3]], frame: &Frame) -> DVector<f64> {
        let predicted = frame.observation.predict(points_m, |row| self.z[row].max(0.0));
        &frame.observation.tau - predicted - self.torque_variance.component_mul(&frame.alpha)
    }

    /// The change of a frame's multiplier that solves its own condition.
    fn solve(&self, points_m: &[[f32; 3]], frame: &Frame) -> DVector<f64> {
        &frame.gain * self.residual(points_m, frame)
    }

    /// Solves one frame's own condition.
    fn visit(&mut self, points_m: &[[f32; 3]], frame: &mut Frame) {
        let d = self.solve(points_m, frame);
        self.add(points_m, &frame.observation, &d);
        frame.alpha += d;
    }

    /// `z += S₀Hᵀ d`.
    fn add(&mut self, points_m: &[[f32; 3]], observation: &Observation, d: &DVector<f64>) {
        let (z, s0) = (&mut self.z, self.prior_variance);
        observation.spread(points_m, d, |row, lever| z[row] += s0 * lever);
    }
}

/// The maximum a posteriori estimator, `map`.
#[derive(Debug, Clone)]
pub struct MapEstimator {
    config: EstimatorConfig,
    belief: Belief,
    variance: Vec<f64>,
    counts: Vec<u32>,
    memory: Memory<Frame>,
    step: u64,
}

impl MapEstimator {
    /// A belief at its prior, for cells of the given spacing and a robot of `n_joints`.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(
        config: &EstimatorConfig,
        spacing_m: f64,
        n_joints: usize,
    ) -> Result<Self, EstimatorError> {
        let torque_variance = config.torque_variance(n_joints)?;
        let (prior_mean, prior_std) = config.prior.at_spacing(spacing_m);
        let prior_variance = prior_std * prior_std;
        Ok(Self {
            belief: Belief { z: Vec::new(), prior_mean, prior_variance, torque_variance },
            variance: Vec::new(),
            counts: Vec::new(),
            memory: Memory::new(config.memory, config.seed),
            step: 0,
            config: config.clone(),
        })
    }

    /// Goes on from a saved state, given the remembered frames' observations in its order.
    ///
    /// # Errors
    ///
    /// If the state contradicts itself or the observations.
    pub fn restore(
        mut self,
        state: &EstimatorState,
        points_m: &[[f32; 3]],
        observations: Vec<Observation>,
    ) -> Result<Self, EstimatorError> {
        let n_joints = self.belief.torque_variance.len();
        state.check(points_m.len(), n_joints)?;
        self.belief.z.clone_from(&state.mean);
        self.variance.clone_from(&state.variance);
        self.counts.clone_from(&state.counts);
        self.step = state.step;
        self.memory = Memory::resume(self.config.memory, state.rng);
        for ((source, alpha), observation) in state.remembered.iter().zip(observations) {
            let mut frame = self.frame(points_m, observation, *source)?;
            if !alpha.is_empty() {
                frame.alpha = DVector::from_column_slice(alpha);
            }
            let bytes = frame.bytes();
            self.memory.push(frame, bytes);
        }
        Ok(self)
    }

    /// Takes back all that a remembered frame has said, as if it had never been seen.
    ///
    /// The stiffness then is what it would be once the other frames are visited again. The
    /// frame's effect on the standard deviation and on the counts stays.
    ///
    /// Returns whether the frame was remembered.
    pub fn forget(&mut self, points_m: &[[f32; 3]], source: Source) -> bool {
        let Some(index) = self.memory.frames().iter().position(|frame| frame.source == source)
        else {
            return false;
        };
        let frame = self.memory.remove(index);
        self.belief.add(points_m, &frame.observation, &-frame.alpha);
        true
    }

    /// The largest violation of `R α = τ − H K` over the remembered frames, N·m: zero at the
    /// optimum.
    pub fn kkt_residual(&self, points_m: &[[f32; 3]]) -> f64 {
        let residual = |frame: &Frame| self.belief.residual(points_m, frame).amax();
        self.memory.frames().iter().map(residual).fold(0.0, f64::max)
    }

    /// A frame with its gain, and nothing said yet.
    fn frame(
        &self,
        points_m: &[[f32; 3]],
        observation: Observation,
        source: Source,
    ) -> Result<Frame, EstimatorError> {
        let gram = observation.gram(points_m, |_| self.belief.prior_variance);
        let gain = innovation_inverse(gram, &self.belief.torque_variance)?;
        let alpha = DVector::zeros(observation.tau.len());
        Ok(Frame { observation, source, alpha, gain })
    }

    /// A row's variance, (N/m)²; the prior's if it was never seen.
    fn variance_of(&self, row: usize) -> f64 {
        self.variance.get(row).copied().unwrap_or(self.belief.prior_variance)
    }

    /// Gives rows that are new their prior.
    fn grow(&mut self, n_rows: usize) {
        self.belief.z.resize(n_rows, self.belief.prior_mean);
        self.variance.resize(n_rows, self.belief.prior_variance);
        self.counts.resize(n_rows, 0);
    }
}

impl Frame {
    /// Memory that the frame holds.
    fn bytes(&self) -> usize {
        self.observation.bytes()
            + size_of::<Self>()
            + (self.alpha.len() + self.gain.len()) * size_of::<f64>()
    }
}

impl Estimator for MapEstimator {
    fn stiffness(&self, row: usize) -> f64 {
        self.belief.z.get(row).map_or(self.belief.prior_mean, |z| z.max(0.0))
    }

    fn std(&self, row: usize) -> f64 {
        self.variance_of(row).sqrt()
    }

    fn count(&self, row: usize) -> u32 {
        self.counts.get(row).copied().unwrap_or(0)
    }

    fn correct(
        &mut self,
        points_m: &[[f32; 3]],
        observation: Observation,
        source: Source,
    ) -> Result<(), EstimatorError> {
        let mut frame = self.frame(points_m, observation, source)?;
        let spread = frame.observation.gram(points_m, |row| self.variance_of(row));
        let shrinkage = innovation_inverse(spread, &self.belief.torque_variance)?;

        self.grow(points_m.len());
        if self.belief.solve(points_m, &frame).iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }

        self.step += 1;
        for &row in frame.observation.rows() {
            self.counts[row as usize] += 1;
        }
        shrink(&mut self.variance, points_m, &frame.observation, &shrinkage);
        self.belief.visit(points_m, &mut frame);
        self.replay(points_m, self.config.replays);
        let bytes = frame.bytes();
        self.memory.push(frame, bytes); // whoever leaves is frozen: its share of z stays
        Ok(())
    }

    fn idle(&mut self) {
        self.step += 1;
    }

    fn replay(&mut self, points_m: &[[f32; 3]], visits: u32) -> u32 {
        for visited in 0..visits {
            let Some(index) = self.memory.draw() else { return visited };
            self.belief.visit(points_m, &mut self.memory.frames_mut()[index]);
        }
        visits
    }

    fn freeze(&mut self, touch: u32) {
        self.memory.retain(|frame| frame.source.touch != touch);
    }

    fn sources(&self) -> Vec<Source> {
        self.memory.frames().iter().map(|frame| frame.source).collect()
    }

    fn memory_bytes(&self) -> usize {
        self.memory.bytes()
    }

    fn state(&self, n_rows: usize) -> EstimatorState {
        let remembered = |frame: &Frame| (frame.source, frame.alpha.as_slice().to_vec());
        EstimatorState {
            mean: padded(&self.belief.z, n_rows, self.belief.prior_mean),
            variance: padded(&self.variance, n_rows, self.belief.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: Vec::new(),
            step: self.step,
            remembered: self.memory.frames().iter().map(remembered).collect(),
            rng: self.memory.rng_state(),
        }
    }
}
