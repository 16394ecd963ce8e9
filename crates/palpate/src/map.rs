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
//! Frames come back at random and, every other time, as the one of several random ones that
//! contradicted the belief most when it was last visited: `r·d` is what a visit gains. On the
//! bundled touches this leaves a quarter of the contradiction that chance alone leaves after the
//! same number of visits, and the optimum, to which both lead, is the same.
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
    shrunk,
};
use crate::replay::Memory;
use crate::torque::{Cell, Observation, Stiffness};

/// A remembered frame with its multiplier.
#[derive(Debug, Clone)]
struct Frame {
    observation: Observation,
    source: Source,
    /// αₜ, n_joints.
    alpha: DVector<f64>,
    /// `(HₜS₀Hₜᵀ + R)⁻¹`, n × n.
    gain: DMatrix<f64>,
    /// r·d of the last visit: by how much the frame then contradicted the belief, in units of
    /// what is expected of noise.
    contradiction: f64,
}

/// The unknown and its model: z, its prior, and the torque noise.
#[derive(Debug, Clone)]
struct Belief {
    /// Rest points and z, by row.
    cells: Vec<Cell>,
    /// m₀ and the diagonal of S₀ at this lattice's spacing.
    prior_mean: f64,
    prior_variance: f64,
    /// The diagonal of R, n_joints, (N·m)².
    torque_variance: DVector<f64>,
}

impl Belief {
    /// `H K`.
    fn predict(&self, observation: &Observation) -> DVector<f64> {
        observation.predict(&self.cells, Stiffness::Positive)
    }

    /// `τ − H K − R α` of a frame.
    fn residual(&self, frame: &Frame) -> DVector<f64> {
        let mut residual = frame.observation.tau() - self.predict(&frame.observation);
        for (joint, r) in residual.iter_mut().enumerate() {
            *r -= self.torque_variance[joint] * frame.alpha[joint];
        }
        residual
    }

    /// Solves one frame's own condition.
    fn visit(&mut self, frame: &mut Frame) {
        frame.observation.fetch();
        let residual = self.residual(frame);
        let d = &frame.gain * &residual;
        frame.contradiction = residual.dot(&d);
        self.add(&frame.observation, &d);
        frame.alpha += d;
    }

    /// `z += S₀Hᵀ d`.
    fn add(&mut self, observation: &Observation, d: &DVector<f64>) {
        let d = self.prior_variance * d;
        observation.spread(&mut self.cells, &d, |cell, _, value| *cell.unknown_mut() += value);
    }

    /// Gives rows that are new their prior.
    fn grow(&mut self, points_m: &[[f64; 3]]) {
        let known = self.cells.len().min(points_m.len());
        self.cells.extend(points_m[known..].iter().map(|&point| Cell::new(point, self.prior_mean)));
    }
}

/// Random frames of which the one that contradicts most is visited.
const TRIES: u32 = 8;

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
            belief: Belief { cells: Vec::new(), prior_mean, prior_variance, torque_variance },
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
        points_m: &[[f64; 3]],
        observations: Vec<Observation>,
    ) -> Result<Self, EstimatorError> {
        let n_joints = self.belief.torque_variance.len();
        state.check(points_m.len(), n_joints)?;
        self.belief.grow(points_m);
        for (cell, z) in self.belief.cells.iter_mut().zip(&state.mean) {
            *cell.unknown_mut() = *z;
        }
        self.variance.clone_from(&state.variance);
        self.counts.clone_from(&state.counts);
        self.step = state.step;
        self.memory = Memory::resume(self.config.memory, state.rng);
        let mut contradictions = state.contradictions.iter().copied();
        for ((source, alpha), observation) in state.remembered.iter().zip(observations) {
            let [gain, _] = self.gains(&observation)?;
            let alpha = match alpha.is_empty() {
                true => DVector::zeros(n_joints),
                false => DVector::from_column_slice(alpha),
            };
            let contradiction = contradictions.next().unwrap_or_default();
            self.remember(Frame { observation, source: *source, alpha, gain, contradiction });
        }
        Ok(self)
    }

    /// Takes back all that a remembered frame has said, as if it had never been seen.
    ///
    /// The stiffness then is what it would be once the other frames are visited again. The
    /// frame's effect on the standard deviation and on the counts stays.
    ///
    /// Returns whether the frame was remembered.
    pub fn forget(&mut self, source: Source) -> bool {
        let Some(index) = self.memory.frames().iter().position(|frame| frame.source == source)
        else {
            return false;
        };
        let frame = self.memory.remove(index);
        self.belief.add(&frame.observation, &-frame.alpha);
        true
    }

    /// The largest violation of `R α = τ − H K` over the remembered frames, N·m: zero at the
    /// optimum.
    pub fn kkt_residual(&self) -> f64 {
        let residual = |frame: &Frame| self.belief.residual(frame).amax();
        self.memory.frames().iter().map(residual).fold(0.0, f64::max)
    }

    /// A row's variance, (N/m)²; the prior's if it was never seen.
    fn variance_of(&self, row: usize) -> f64 {
        self.variance.get(row).copied().unwrap_or(self.belief.prior_variance)
    }

    /// `(H S₀ Hᵀ + R)⁻¹` of a frame, and `(H P Hᵀ + R)⁻¹` with the variances as they are.
    fn gains(&self, observation: &Observation) -> Result<[DMatrix<f64>; 2], EstimatorError> {
        let Belief { cells, prior_variance, torque_variance, .. } = &self.belief;
        let at_prior = observation.gram(cells, |_| *prior_variance);
        let now = observation.gram(cells, |row| self.variance_of(row));
        Ok([
            innovation_inverse(at_prior, torque_variance)?,
            innovation_inverse(now, torque_variance)?,
        ])
    }

    /// Remembers a frame; whoever leaves for it is frozen: its share of z stays.
    fn remember(&mut self, frame: Frame) {
        let bytes = frame.bytes();
        self.memory.push(frame, bytes);
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
        self.belief.cells.get(row).map_or(self.belief.prior_mean, |cell| cell.unknown().max(0.0))
    }

    fn std(&self, row: usize) -> f64 {
        self.variance_of(row).sqrt()
    }

    fn count(&self, row: usize) -> u32 {
        self.counts.get(row).copied().unwrap_or(0)
    }

    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        source: Source,
    ) -> Result<DVector<f64>, EstimatorError> {
        self.belief.grow(points_m);
        let [gain, shrinkage] = self.gains(&observation)?;
        let predicted = self.belief.predict(&observation);
        let alpha = &gain * (observation.tau() - &predicted);
        if alpha.iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }

        self.step += 1;
        self.variance.resize(points_m.len(), self.belief.prior_variance);
        self.counts.resize(points_m.len(), 0);
        observation.rows().for_each(|row| self.counts[row] += 1);
        let variance = &mut self.variance;
        observation.quadratic(&self.belief.cells, &shrinkage, |row, value| {
            variance[row] = shrunk(variance[row], value);
        });
        self.belief.add(&observation, &alpha);
        let contradiction = (observation.tau() - &predicted).dot(&alpha);
        self.remember(Frame { observation, source, alpha, gain, contradiction });
        Ok(predicted)
    }

    fn idle(&mut self) {
        self.step += 1;
    }

    fn replay(&mut self, visits: u32) -> u32 {
        for visited in 0..visits {
            // Chance sees to it that every frame comes back; between, those that contradict most.
            let tries = if visited % 2 == 0 { 1 } else { TRIES };
            let drawn = self.memory.draw_best(tries, |frame| frame.contradiction);
            let Some(index) = drawn else { return visited };
            self.belief.visit(&mut self.memory.frames_mut()[index]);
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
        let z: Vec<f64> = self.belief.cells.iter().map(|cell| cell.unknown()).collect();
        EstimatorState {
            mean: padded(&z, n_rows, self.belief.prior_mean),
            variance: padded(&self.variance, n_rows, self.belief.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: Vec::new(),
            step: self.step,
            remembered: self.memory.frames().iter().map(remembered).collect(),
            contradictions: self.memory.frames().iter().map(|frame| frame.contradiction).collect(),
            rng: self.memory.rng_state(),
        }
    }
}
