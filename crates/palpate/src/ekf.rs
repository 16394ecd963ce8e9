//! The paper's filter: an extended Kalman filter over κ with K = |κ| (Eqs. 3 to 6).
//!
//! | paper | here                                            | unit |
//! |-------|-------------------------------------------------|------|
//! | Eq. 3 | `Kᵢ = abs(κᵢ)`, `κᵢ ~ N(mean, variance)`        | N/m  |
//! | Eq. 4 | `κᵢ(t+1) = κᵢ(t) + ε`, ε ~ N(0, drift variance) | N/m  |
//! | Eq. 5 | `τ = Σ wᵢ abs(κᵢ)` + noise                      | N·m  |
//! | Eq. 6 | `H = ∂τ/∂κ`, column i is `wᵢ sgn(κᵢ)`           | m²   |
//!
//! The covariance is diagonal. After each new measurement, past ones (H, τ) drawn at random are fused again by the same
//! Kalman update, so that the filter does not forget them; H is stored without the sign and signed when replayed. Drift
//! is added lazily: each cell stores the step of its last update, and its variance gets the drift since then when it is
//! touched again. So a step costs only as much as the cells that it touches.
//!
//! sgn 0 is taken as +1; even so a prior mean of exactly zero is refused, because the slope of |κ| is undefined there
//! and the paper's filter never leaves it. For the same reason a cell whose own prior mean
//! ([`Estimator::set_prior_means`]) is below the prior mean of the settings starts from that of the settings.

use nalgebra::DVector;

use crate::calibration::spring_variance;
use crate::estimator::{
    Belief, Estimator, EstimatorConfig, EstimatorError, EstimatorState, FrameId, RememberedFrame,
    Replayed, padded,
};
use crate::replay::ReplayMemory;
use crate::torque::{Observation, StiffnessRule};

/// The paper's estimator, `ekf`.
///
/// # What the standard deviation means
///
/// It is the standard deviation of κ in the filter, with a diagonal covariance. Correlations between cells are
/// neglected, and each replay counts the data of a measurement again. So it is too small, and the more so, the more
/// replays are made.
#[derive(Debug, Clone)]
pub struct EkfEstimator {
    filter: Filter,
    /// Past measurements.
    memory: ReplayMemory<Observation>,
}

/// The diagonal Gaussian over κ, with lazy drift.
#[derive(Debug, Clone)]
struct Filter {
    /// The unknown of a cell is the mean of its κ.
    belief: Belief,
    /// Variance of the drift ε of Eq. 4 per step, (N/m)².
    drift_variance: f64,
    /// The step up to which the variance includes the drift, by row.
    seen: Vec<u64>,
}

impl Filter {
    /// A row's variance with all its drift up to the present step (Eq. 4), (N/m)².
    fn variance_now(&self, row: usize) -> f64 {
        let seen = self.seen.get(row).copied().unwrap_or(0);
        self.belief.variance(row) + self.drift_variance * (self.belief.step - seen) as f64
    }

    /// Adds new rows with the prior; `points_m` are the rest points of all rows, world frame.
    fn grow(&mut self, points_m: &[[f64; 3]]) {
        self.belief.grow(points_m);
        self.seen.resize(self.belief.cells.len(), 0);
    }

    /// The Kalman update of Eqs. 5 and 6; returns the prediction before it, n_joints, N·m.
    ///
    /// Nothing changes unless the innovation covariance can be inverted.
    fn update(&mut self, observation: &Observation) -> Result<DVector<f64>, EstimatorError> {
        let inverse = self.belief.innovation_inverse(observation, |row| self.variance_now(row))?;
        let predicted = observation.predict(&self.belief.cells, StiffnessRule::Magnitude);
        let d = &inverse * (observation.tau() - &predicted);
        if d.iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }
        for row in observation.rows() {
            self.belief.variance[row] = self.variance_now(row);
            self.seen[row] = self.belief.step;
        }
        let (cells, variance) = (&mut self.belief.cells, &self.belief.variance);
        observation.transpose_times(cells, d.as_slice(), |cell, row, value| {
            // Column i of H is the lever times sgn κᵢ; `0.0.signum()` is `1.0` in Rust.
            *cell.unknown_mut() += variance[row] * value * cell.unknown().signum();
        });
        self.belief.shrink(observation, &inverse);
        Ok(predicted)
    }
}

impl EkfEstimator {
    /// An estimator with the prior for all cells, which have this spacing, and a robot of `n_joints`.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, or the prior mean is zero.
    pub fn new(
        config: &EstimatorConfig,
        spacing_m: f64,
        n_joints: usize,
    ) -> Result<Self, EstimatorError> {
        let belief = Belief::new(config, spacing_m, n_joints)?;
        if config.prior.mean_n_per_m == 0.0 {
            return Err(EstimatorError::EkfPriorMeanZero);
        }
        // Drift, like the prior, is white noise in space: its variance is proportional to h³.
        let (_, prior_std) = config.prior.at_spacing(spacing_m);
        let drift_std = config.drift_std_n_per_m * prior_std / config.prior.std_n_per_m;
        let filter = Filter { belief, drift_variance: drift_std * drift_std, seen: Vec::new() };
        let memory = ReplayMemory::new(config.memory, config.seed);
        Ok(Self { filter, memory })
    }

    /// Adds a frame to the memory; frames that no longer fit are removed.
    fn remember(&mut self, frame: Observation, id: FrameId) {
        let bytes = frame.bytes() + size_of::<(Observation, FrameId)>();
        self.memory.push(frame, id, bytes, 0.0);
    }
}

impl Estimator for EkfEstimator {
    fn stiffness(&self, row: usize) -> f64 {
        self.filter.belief.unknown(row).abs()
    }

    fn std(&self, row: usize) -> f64 {
        self.filter.variance_now(row).sqrt()
    }

    fn count(&self, row: usize) -> u32 {
        self.filter.belief.count(row)
    }

    fn set_prior_means(&mut self, points_m: &[[f64; 3]], mean_n_per_m: &[f64]) {
        let least = self.filter.belief.prior_mean;
        self.filter.belief.set_prior_means(points_m, mean_n_per_m, least);
        self.filter.seen.resize(self.filter.belief.cells.len(), 0);
    }

    fn predict(&mut self, points_m: &[[f64; 3]], observation: &Observation) -> DVector<f64> {
        self.filter.grow(points_m);
        observation.predict(&self.filter.belief.cells, StiffnessRule::Magnitude)
    }

    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        id: FrameId,
    ) -> Result<DVector<f64>, EstimatorError> {
        self.filter.grow(points_m);
        let predicted = self.filter.update(&observation)?;
        self.filter.belief.count_contacts(&observation);
        self.remember(observation, id);
        self.filter.belief.step += 1;
        Ok(predicted)
    }

    fn band_spread(
        &mut self,
        points_m: &[[f64; 3]],
        observation: &Observation,
        relative_std: f64,
    ) -> DVector<f64> {
        self.filter.grow(points_m);
        let variance =
            |row| spring_variance(relative_std, self.stiffness(row), self.filter.variance_now(row));
        self.filter.belief.band_spread(observation, variance)
    }

    fn advance_time(&mut self) {
        self.filter.belief.step += 1;
    }

    fn replay(&mut self, visits: u32) -> Replayed {
        let mut replayed = Replayed::default();
        for _ in 0..visits {
            let Some(index) = self.memory.draw() else { break };
            let observation = &self.memory.frames()[index];
            observation.prefetch().finish();
            // A frame that was fused once can be fused again, so this does not fail in practice.
            if self.filter.update(observation).is_err() {
                break;
            }
            replayed.add(observation);
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
        let cells = &self.filter.belief.cells;
        let error = |frame: &Observation| {
            let tau = frame.tau().into_owned();
            [&tau - frame.predict(cells, StiffnessRule::Magnitude), tau]
        };
        self.memory.some(most).map(|(id, frame)| (id, error(frame))).collect()
    }

    fn memory_bytes(&self) -> usize {
        self.memory.bytes()
    }

    fn state(&self, n_rows: usize) -> EstimatorState {
        let remembered = |id| RememberedFrame { id, alpha: Vec::new(), nis: 0.0 };
        let remembered = self.memory.ids().map(remembered).collect();
        EstimatorState {
            seen: padded(&self.filter.seen, n_rows, 0),
            ..self.filter.belief.state(n_rows, remembered, self.memory.rng_state())
        }
    }

    fn restore(
        &mut self,
        state: &EstimatorState,
        points_m: &[[f64; 3]],
        observations: Vec<Observation>,
    ) -> Result<(), EstimatorError> {
        if state.seen.len() != state.mean.len() {
            let what = "the last steps of the cells are missing".to_owned();
            return Err(EstimatorError::State { what });
        }
        if let Some(seen) = state.seen.iter().find(|&&seen| seen > state.step) {
            let what = format!("a cell was last seen in step {seen}, after {} steps", state.step);
            return Err(EstimatorError::State { what });
        }
        self.filter.belief.restore(state, points_m)?;
        self.filter.seen.resize(self.filter.belief.cells.len(), 0);
        self.filter.seen[..state.seen.len()].copy_from_slice(&state.seen);
        self.memory = ReplayMemory::resume(self.memory.limits(), state.rng);
        for (remembered, observation) in state.remembered.iter().zip(observations) {
            self.remember(observation, remembered.id);
        }
        Ok(())
    }
}
