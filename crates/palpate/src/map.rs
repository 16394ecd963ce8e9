//! The estimator `map`: the exact maximum a posteriori (MAP) of the stiffness, by replay.
//!
//! Under a Gaussian prior N(m₀, S₀), diagonal, and torque noise R, the most likely K ≥ 0 given
//! all remembered frames t solves a non-negative least-squares problem. Its optimality (KKT)
//! conditions are
//!
//! ```text
//! z = m₀ + S₀ Σₜ Hₜᵀ αₜ,   K = max(z, 0),   R αₜ = τₜ − Hₜ K   for every t,
//! ```
//!
//! Every frame keeps a multiplier αₜ (n_joints), and a *visit* of frame j solves the condition of this frame, assuming
//! that no cell changes sign:
//!
//! ```text
//! r = τⱼ − HⱼK − R αⱼ;   d = (HⱼS₀Hⱼᵀ + R)⁻¹ r;   αⱼ += d;   z += S₀Hⱼᵀ d.
//! ```
//!
//! The inverted matrix is an upper bound of the true curvature, so a visit never moves away from the optimum. A
//! repeated visit does not count the data twice, since α includes the effect of earlier visits. A frame is forgotten
//! exactly by subtracting S₀Hⱼᵀαⱼ from z. When memory is full, a frame is *condensed*: it is removed and its
//! contribution to z stays. z is kept in `f64`: the rounding errors of millions of visits are far below 1e-6 N/m, which
//! a test checks.
//!
//! K is multiplied by [`EstimatorConfig::stiffness_scale`] where it is returned or used in predictions; z does not
//! depend on that factor.
//!
//! m₀ may differ from cell to cell ([`Estimator::set_prior_means`]): z starts there, and no visit uses m₀
//! again.
//!
//! Frames are drawn at random. Every other draw takes several random frames and keeps the one whose normalised
//! innovation squared (NIS), `r·d = rᵀ(HS₀Hᵀ + R)⁻¹r`, was largest at its last visit. On the bundled touches the NIS
//! that remains is then a quarter of that with random draws alone, after the same number of visits; the optimum is the
//! same.

use nalgebra::{DMatrix, DVector};

use crate::calibration::spring_variance;
use crate::estimator::{
    Belief, Estimator, EstimatorConfig, EstimatorError, EstimatorState, FrameId, RememberedFrame,
    Replayed,
};
use crate::replay::ReplayMemory;
use crate::torque::{Observation, Prefetch, StiffnessRule};

/// Number of random frames of which the one with the largest NIS is visited.
const TRIES: u32 = 8;

/// The maximum a posteriori estimator, `map`.
///
/// # What the standard deviation means
///
/// The variance of a cell starts from the prior and is reduced by each *new* frame, once, as a Kalman filter with a
/// diagonal covariance would; replays do not change it. It measures how much evidence there is about a cell. It
/// neglects the correlation between cells that the same link presses together, takes neighbouring frames of a slow
/// motion as independent, ignores the bound K ≥ 0, and does not include errors of the contact model. Use it to rank
/// cells by how well they are known, and as a lower bound on the error.
///
/// Every remembered frame stores two notes: αₜ (n_joints), then `(HₜS₀Hₜᵀ + R)⁻¹` column by column (n_joints ×
/// n_joints).
#[derive(Debug, Clone)]
pub struct MapEstimator {
    /// The unknown of a cell is its z.
    belief: Belief,
    stiffness_scale: f64,
    memory: ReplayMemory<Observation>,
}

/// αₜ of a remembered frame, n_joints.
fn alpha(frame: &Observation) -> &[f64] {
    &frame.notes()[..frame.n_joints()]
}

impl MapEstimator {
    /// An estimator with the prior for all cells, which have this spacing, and a robot of `n_joints`.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(
        config: &EstimatorConfig,
        spacing_m: f64,
        n_joints: usize,
    ) -> Result<Self, EstimatorError> {
        let belief = Belief::new(config, spacing_m, n_joints)?;
        let memory = ReplayMemory::new(config.memory, config.seed);
        Ok(Self { belief, stiffness_scale: config.stiffness_scale, memory })
    }

    /// Removes a remembered frame and its contribution to the stiffness.
    ///
    /// Once the other frames are visited again, the stiffness is as if the frame had never been measured. The frame's
    /// effect on the standard deviation and on the counts stays.
    ///
    /// Returns whether the frame was remembered.
    pub fn forget(&mut self, id: FrameId) -> bool {
        let Some(index) = self.memory.ids().position(|remembered| remembered == id) else {
            return false;
        };
        let frame = self.memory.remove(index);
        let taken_back: Vec<f64> = alpha(&frame).iter().map(|alpha| -alpha).collect();
        add(&mut self.belief, &frame, &taken_back, &mut Prefetch::nothing());
        true
    }

    /// The largest violation of `R α = τ − H K` over the remembered frames, N·m: zero at the
    /// optimum.
    pub fn kkt_residual(&self) -> f64 {
        let of = |frame| residual(&self.belief, frame, &mut Prefetch::nothing()).amax();
        self.memory.frames().iter().map(of).fold(0.0, f64::max)
    }

    /// `(H S₀ Hᵀ + R)⁻¹` of a frame, with the prior variances.
    fn innovation_inverse(
        &self,
        observation: &Observation,
    ) -> Result<DMatrix<f64>, EstimatorError> {
        self.belief.innovation_inverse(observation, |_| self.belief.prior_variance)
    }

    /// Draws the frame of a visit: at random for even `visit`, so that every frame is visited again, else by NIS.
    fn draw(&mut self, visit: u32) -> Option<usize> {
        self.memory.draw_best(if visit.is_multiple_of(2) { 1 } else { TRIES })
    }

    /// Adds a frame with its notes and its NIS to the memory; frames removed to make room are condensed.
    fn remember(
        &mut self,
        mut frame: Observation,
        id: FrameId,
        alpha: &[f64],
        (inverse, nis): (&DMatrix<f64>, f64),
    ) {
        frame.note(alpha.iter().copied());
        frame.note(inverse.iter().copied());
        let bytes = frame.bytes() + size_of::<FrameId>();
        self.memory.push(frame, id, bytes, nis);
    }
}

/// `H K` of a frame.
fn predict(belief: &Belief, observation: &Observation) -> DVector<f64> {
    observation.predict(&belief.cells, StiffnessRule::Positive)
}

/// `τ − H K − R α` of a remembered frame.
fn residual(belief: &Belief, frame: &Observation, prefetch: &mut Prefetch<'_>) -> DVector<f64> {
    let mut residual = frame.predict_prefetching(prefetch, &belief.cells, StiffnessRule::Positive);
    let tau = frame.tau();
    let known = tau.iter().zip(alpha(frame)).zip(&belief.torque_variance);
    for (r, ((tau, alpha), variance)) in residual.iter_mut().zip(known) {
        *r = tau - *r - variance * alpha;
    }
    residual
}

/// Visits a frame: solves its optimality condition and returns its NIS, r·d. Prefetches the next frame meanwhile.
fn visit(belief: &mut Belief, frame: &mut Observation, mut prefetch: Prefetch<'_>) -> f64 {
    let residual = residual(belief, frame, &mut prefetch);
    let n_joints = residual.len();
    let (alpha, inverse) = frame.notes_mut().split_at_mut(n_joints);
    let mut d = DVector::zeros(n_joints);
    for (column, r) in inverse.chunks(n_joints).zip(&residual) {
        d.iter_mut().zip(column).for_each(|(d, inverse)| *d += inverse * r);
    }
    alpha.iter_mut().zip(&d).for_each(|(alpha, d)| *alpha += d);
    add(belief, frame, d.as_slice(), &mut prefetch);
    prefetch.finish();
    residual.dot(&d)
}

/// `z += S₀Hᵀ d`.
fn add(belief: &mut Belief, observation: &Observation, d: &[f64], prefetch: &mut Prefetch<'_>) {
    let scaled: Vec<f64> = d.iter().map(|d| belief.prior_variance * d).collect();
    observation.add(prefetch, &mut belief.cells, &scaled);
}

impl Estimator for MapEstimator {
    fn stiffness(&self, row: usize) -> f64 {
        self.stiffness_scale * self.belief.unknown(row).max(0.0)
    }

    fn std(&self, row: usize) -> f64 {
        self.stiffness_scale * self.belief.variance(row).sqrt()
    }

    fn count(&self, row: usize) -> u32 {
        self.belief.count(row)
    }

    fn set_prior_means(&mut self, points_m: &[[f64; 3]], mean_n_per_m: &[f64]) {
        // The given means include the stiffness scale, z does not.
        let unscaled: Vec<f64> = match self.stiffness_scale > 0.0 {
            true => mean_n_per_m.iter().map(|mean| mean / self.stiffness_scale).collect(),
            false => mean_n_per_m.to_vec(),
        };
        self.belief.set_prior_means(points_m, &unscaled, 0.0);
    }

    fn predict(&mut self, points_m: &[[f64; 3]], observation: &Observation) -> DVector<f64> {
        self.belief.grow(points_m);
        predict(&self.belief, observation) * self.stiffness_scale
    }

    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        id: FrameId,
    ) -> Result<DVector<f64>, EstimatorError> {
        self.belief.grow(points_m);
        let inverse = self.innovation_inverse(&observation)?;
        let belief = &mut self.belief;
        let inverse_now = belief.innovation_inverse(&observation, |row| belief.variance(row))?;
        let predicted = predict(belief, &observation);
        let innovation = observation.tau() - &predicted;
        let alpha = &inverse * &innovation;
        if alpha.iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }

        belief.step += 1;
        belief.count_contacts(&observation);
        belief.shrink(&observation, &inverse_now);
        add(belief, &observation, alpha.as_slice(), &mut Prefetch::nothing());
        let nis = innovation.dot(&alpha);
        self.remember(observation, id, alpha.as_slice(), (&inverse, nis));
        Ok(predicted * self.stiffness_scale)
    }

    fn band_spread(
        &mut self,
        points_m: &[[f64; 3]],
        observation: &Observation,
        relative_std: f64,
    ) -> DVector<f64> {
        self.belief.grow(points_m);
        let belief = &self.belief;
        let variance =
            |row| spring_variance(relative_std, belief.unknown(row).max(0.0), belief.variance(row));
        self.stiffness_scale * belief.band_spread(observation, variance)
    }

    fn advance_time(&mut self) {
        self.belief.step += 1;
    }

    fn replay(&mut self, visits: u32) -> Replayed {
        let mut replayed = Replayed::default();
        let mut next = self.draw(0);
        for number in 0..visits {
            let Some(index) = next else { break };
            next = if number + 1 < visits { self.draw(number + 1) } else { None };
            let frames = self.memory.frames_mut();
            let pair = next.and_then(|next| frames.get_disjoint_mut([index, next]).ok());
            let nis = match pair {
                Some([frame, next]) => visit(&mut self.belief, frame, next.prefetch()),
                None => visit(&mut self.belief, &mut frames[index], Prefetch::nothing()),
            };
            replayed.add(&self.memory.frames()[index]);
            self.memory.set_score(index, nis);
        }
        replayed
    }

    fn condense(&mut self, touch: u32) {
        self.memory.remove_touch(touch);
    }

    fn frame_ids(&self) -> Vec<FrameId> {
        self.memory.ids().collect()
    }

    fn errors(&self, most: usize) -> Vec<(FrameId, [DVector<f64>; 2])> {
        let error = |frame: &Observation| {
            let tau = frame.tau().into_owned();
            [&tau - self.stiffness_scale * predict(&self.belief, frame), tau]
        };
        self.memory.some(most).map(|(id, frame)| (id, error(frame))).collect()
    }

    fn memory_bytes(&self) -> usize {
        self.memory.bytes()
    }

    fn state(&self, n_rows: usize) -> EstimatorState {
        let frames = self.memory.frames().iter().zip(self.memory.ids()).zip(self.memory.scores());
        let remembered = frames.map(|((frame, id), nis)| {
            let alpha = alpha(frame).to_vec();
            RememberedFrame { id, alpha, nis }
        });
        self.belief.state(n_rows, remembered.collect(), self.memory.rng_state())
    }

    fn restore(
        &mut self,
        state: &EstimatorState,
        points_m: &[[f64; 3]],
        observations: Vec<Observation>,
    ) -> Result<(), EstimatorError> {
        self.belief.restore(state, points_m)?;
        self.memory = ReplayMemory::resume(self.memory.limits(), state.rng);
        let no_alpha = vec![0.0; self.belief.torque_variance.len()];
        for (remembered, observation) in state.remembered.iter().zip(observations) {
            let inverse = self.innovation_inverse(&observation)?;
            let alpha = if remembered.alpha.is_empty() { &no_alpha } else { &remembered.alpha };
            self.remember(observation, remembered.id, alpha, (&inverse, remembered.nis));
        }
        Ok(())
    }
}
