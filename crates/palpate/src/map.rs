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
//! forgotten exactly by taking S₀Hⱼᵀαⱼ back. When memory is full a frame is *condensed*: it leaves
//! and its share of z stays. z is kept in `f64`, where the rounding of millions of visits stays
//! far below a millionth of a newton per metre; a test holds it to that.
//!
//! m₀ may differ from cell to cell ([`Estimator::set_prior_means`]): it is where z starts, and none of the
//! above looks at it again.
//!
//! Frames come back at random and, every other time, as the one of several random ones that
//! contradicted the belief most when it was last visited: `r·d` is what a visit gains. On the
//! bundled touches this leaves a quarter of the nis that chance alone leaves after the
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
    Estimator, EstimatorConfig, EstimatorError, EstimatorState, FrameId, Replayed,
    cells_at_prior_means, innovation_inverse, padded, shrunk,
};
use crate::replay_memory::ReplayMemory;
use crate::torque::{Cell, Observation, Prefetch, Stiffness};

/// A remembered frame with its multiplier.
#[derive(Debug, Clone)]
struct Frame {
    /// With two notes: αₜ (n_joints), then `(HₜS₀Hₜᵀ + R)⁻¹` column by column (n × n).
    observation: Observation,
    frame_id: FrameId,
}

impl Frame {
    fn new(
        mut observation: Observation,
        frame_id: FrameId,
        alpha: &[f64],
        gain: &DMatrix<f64>,
    ) -> Self {
        observation.note(alpha.iter().copied());
        observation.note(gain.iter().copied());
        Self { observation, frame_id }
    }

    /// αₜ, n_joints.
    fn alpha(&self) -> &[f64] {
        &self.observation.notes()[..self.observation.n_joints()]
    }

    /// ReplayMemory that the frame holds.
    fn bytes(&self) -> usize {
        size_of::<Self>() - size_of::<Observation>() + self.observation.bytes()
    }
}

/// The unknown and its model: z, its prior, and the torque noise.
#[derive(Debug, Clone)]
struct Belief {
    /// Rest points and z, by row.
    cells: Vec<Cell>,
    /// m₀ of cells of which nothing else is expected, and the diagonal of S₀, at this lattice's
    /// spacing.
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
    fn residual(&self, frame: &Frame, prefetch: &mut Prefetch<'_>) -> DVector<f64> {
        let observation = &frame.observation;
        let mut residual =
            observation.predict_prefetching(prefetch, &self.cells, Stiffness::Positive);
        let tau = frame.observation.tau();
        let known = tau.iter().zip(frame.alpha()).zip(&self.torque_variance);
        for (r, ((tau, alpha), variance)) in residual.iter_mut().zip(known) {
            *r = tau - *r - variance * alpha;
        }
        residual
    }

    /// Solves one frame's own condition; returns r·d, by how much it contradicted the belief in
    /// units of what noise does. Brings the next frame closer meanwhile.
    fn visit(&mut self, frame: &mut Frame, mut prefetch: Prefetch<'_>) -> f64 {
        let residual = self.residual(frame, &mut prefetch);
        let n_joints = residual.len();
        let (alpha, gain) = frame.observation.notes_mut().split_at_mut(n_joints);
        let mut d = DVector::zeros(n_joints);
        for (column, r) in gain.chunks(n_joints).zip(&residual) {
            d.iter_mut().zip(column).for_each(|(d, gain)| *d += gain * r);
        }
        alpha.iter_mut().zip(&d).for_each(|(alpha, d)| *alpha += d);
        self.add(&frame.observation, d.as_slice(), &mut prefetch);
        prefetch.finish();
        residual.dot(&d)
    }

    /// `z += S₀Hᵀ d`.
    fn add(&mut self, observation: &Observation, d: &[f64], prefetch: &mut Prefetch<'_>) {
        let scaled: Vec<f64> = d.iter().map(|d| self.prior_variance * d).collect();
        observation.add(prefetch, &mut self.cells, &scaled);
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
    memory: ReplayMemory<Frame>,
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
            memory: ReplayMemory::new(config.memory, config.seed),
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
        self.memory = ReplayMemory::resume(self.config.memory, state.rng);
        let mut nis = state.nis.iter().copied();
        for ((frame_id, alpha), observation) in state.remembered.iter().zip(observations) {
            let [gain, _] = self.gains(&observation)?;
            let alpha = if alpha.is_empty() { &vec![0.0; n_joints] } else { alpha };
            let score = nis.next().unwrap_or_default();
            self.remember(Frame::new(observation, *frame_id, alpha, &gain), score);
        }
        Ok(self)
    }

    /// Takes back all that a remembered frame has said, as if it had never been seen.
    ///
    /// The stiffness then is what it would be once the other frames are visited again. The
    /// frame's effect on the standard deviation and on the counts stays.
    ///
    /// Returns whether the frame was remembered.
    pub fn forget(&mut self, frame_id: FrameId) -> bool {
        let Some(index) = self.memory.frames().iter().position(|frame| frame.frame_id == frame_id)
        else {
            return false;
        };
        let frame = self.memory.remove(index);
        let taken_back: Vec<f64> = frame.alpha().iter().map(|alpha| -alpha).collect();
        self.belief.add(&frame.observation, &taken_back, &mut Prefetch::nothing());
        true
    }

    /// The largest violation of `R α = τ − H K` over the remembered frames, N·m: zero at the
    /// optimum.
    pub fn kkt_residual(&self) -> f64 {
        let residual = |frame: &Frame| self.belief.residual(frame, &mut Prefetch::nothing()).amax();
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

    /// Draws the frame of a visit.
    ///
    /// Chance sees to it that every frame comes back; between, those that contradict most.
    fn draw(&mut self, visit: u32) -> Option<usize> {
        self.memory.draw_best(if visit.is_multiple_of(2) { 1 } else { TRIES })
    }

    /// Remembers a frame and by how much it contradicted the belief; whoever leaves for it is
    /// condensed: its share of z stays.
    fn remember(&mut self, frame: Frame, nis: f64) {
        let bytes = frame.bytes();
        self.memory.push(frame, bytes, nis);
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

    fn set_prior_means(&mut self, points_m: &[[f64; 3]], mean_n_per_m: &[f64]) {
        let known = self.belief.cells.len();
        self.belief.cells.extend(cells_at_prior_means(known, points_m, mean_n_per_m));
    }

    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        frame_id: FrameId,
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
        self.belief.add(&observation, alpha.as_slice(), &mut Prefetch::nothing());
        let nis = (observation.tau() - &predicted).dot(&alpha);
        self.remember(Frame::new(observation, frame_id, alpha.as_slice(), &gain), nis);
        Ok(predicted)
    }

    fn advance_time(&mut self) {
        self.step += 1;
    }

    fn replay(&mut self, visits: u32) -> Replayed {
        let mut replayed = Replayed::default();
        let mut next = self.draw(0);
        for visit in 0..visits {
            let Some(index) = next else { break };
            next = if visit + 1 < visits { self.draw(visit + 1) } else { None };
            let frames = self.memory.frames_mut();
            let pair = next.and_then(|next| frames.get_disjoint_mut([index, next]).ok());
            let nis = match pair {
                Some([frame, next]) => self.belief.visit(frame, next.observation.prefetch()),
                None => self.belief.visit(&mut frames[index], Prefetch::nothing()),
            };
            replayed.add(&self.memory.frames()[index].observation);
            self.memory.set_score(index, nis);
        }
        replayed
    }

    fn condense(&mut self, touch: u32) {
        self.memory.retain(|frame| frame.frame_id.touch != touch);
    }

    fn frame_ids(&self) -> Vec<FrameId> {
        self.memory.frames().iter().map(|frame| frame.frame_id).collect()
    }

    fn memory_bytes(&self) -> usize {
        self.memory.bytes()
    }

    fn state(&self, n_rows: usize) -> EstimatorState {
        let remembered = |frame: &Frame| (frame.frame_id, frame.alpha().to_vec());
        let z: Vec<f64> = self.belief.cells.iter().map(|cell| cell.unknown()).collect();
        EstimatorState {
            mean: padded(&z, n_rows, self.belief.prior_mean),
            variance: padded(&self.variance, n_rows, self.belief.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: Vec::new(),
            step: self.step,
            remembered: self.memory.frames().iter().map(remembered).collect(),
            nis: self.memory.scores().collect(),
            rng: self.memory.rng_state(),
        }
    }
}
