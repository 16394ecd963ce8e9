//! The paper's filter: an extended Kalman filter over κ with K = |κ| (Eqs. 3 to 6).
//!
//! | paper  | here                                            | unit     |
//! |--------|-------------------------------------------------|----------|
//! | Eq. 3  | `Kᵢ = abs(κᵢ)`, `κᵢ ~ N(mean, variance)`         | N/m      |
//! | Eq. 4  | `κᵢ(t+1) = κᵢ(t) + ε`, ε ~ N(0, drift variance)  | N/m      |
//! | Eq. 5  | `τ = Σ wᵢ abs(κᵢ)` + noise                       | N·m      |
//! | Eq. 6  | `H = ∂τ/∂κ`, column i is `wᵢ sgn(κᵢ)`            | m²       |
//!
//! The covariance is diagonal. After each new measurement, past ones (H, τ) drawn at random are
//! fused again by the same Kalman update, so that the filter does not forget them; H is stored
//! without the sign and signed when replayed. Drift is lazy: a cell remembers the step at which
//! it was last seen and adds what it missed, so that a step costs what it touches.
//!
//! sgn 0 is taken as +1; even so a prior mean of exactly zero is refused, because the paper's
//! filter has no slope there. For the same reason a cell of which less is expected than the prior
//! mean ([`Estimator::set_prior_means`]) starts from the prior mean.
//!
//! # What the standard deviation means
//!
//! The filter's own: of κ, given a diagonal covariance. It leaves out correlations between
//! cells, and since replaying a measurement counts its data again, it is too small by an amount
//! that grows with the number of replays.

use nalgebra::DVector;

use crate::estimator::{
    Estimator, EstimatorConfig, EstimatorError, EstimatorState, FrameId, Replayed,
    cells_at_prior_means, innovation_inverse, padded, shrunk,
};
use crate::replay_memory::ReplayMemory;
use crate::torque::{Cell, Observation, Stiffness};

/// A past measurement.
#[derive(Debug, Clone)]
struct Frame {
    observation: Observation,
    frame_id: FrameId,
}

/// The diagonal Gaussian over κ, with lazy drift.
#[derive(Debug, Clone)]
struct Belief {
    prior_mean: f64,
    prior_variance: f64,
    /// σ_κ² of Eq. 4 a step.
    drift_variance: f64,
    /// The diagonal of R, n_joints, (N·m)².
    torque_variance: DVector<f64>,
    /// Rest points and means of κ, by row.
    cells: Vec<Cell>,
    variance: Vec<f64>,
    /// The step up to which each row's variance holds its drift.
    seen: Vec<u64>,
    step: u64,
}

impl Belief {
    /// A row's variance with all its drift up to the present step, (N/m)².
    fn variance_now(&self, row: usize) -> f64 {
        let (variance, seen) = match self.variance.get(row) {
            Some(&variance) => (variance, self.seen[row]),
            None => (self.prior_variance, 0),
        };
        variance + self.drift_variance * (self.step - seen) as f64
    }

    /// Gives rows that are new their prior.
    fn grow(&mut self, points_m: &[[f64; 3]]) {
        let known = self.cells.len().min(points_m.len());
        self.cells.extend(points_m[known..].iter().map(|&point| Cell::new(point, self.prior_mean)));
        self.resize();
    }

    /// Gives rows that are new the prior's variance.
    fn resize(&mut self) {
        self.variance.resize(self.cells.len(), self.prior_variance);
        self.seen.resize(self.cells.len(), 0);
    }

    /// The Kalman update of Eqs. 5 and 6; returns what was predicted before it.
    ///
    /// Nothing changes unless the innovation covariance can be inverted.
    fn update(&mut self, observation: &Observation) -> Result<DVector<f64>, EstimatorError> {
        let covariance = observation.gram(&self.cells, |row| self.variance_now(row));
        let gain = innovation_inverse(covariance, &self.torque_variance)?;
        let predicted = observation.predict(&self.cells, Stiffness::Magnitude);
        let d = &gain * (observation.tau() - &predicted);
        if d.iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }
        for row in observation.rows() {
            self.variance[row] = self.variance_now(row);
            self.seen[row] = self.step;
        }
        let variance = &mut self.variance;
        observation.spread(&mut self.cells, d.as_slice(), |cell, row, value| {
            // Column i of H is the lever times sgn κᵢ; `0.0.signum()` is `1.0` in Rust.
            *cell.unknown_mut() += variance[row] * value * cell.unknown().signum();
        });
        observation.quadratic(&self.cells, &gain, |row, value| {
            variance[row] = shrunk(variance[row], value);
        });
        Ok(predicted)
    }
}

/// The paper's estimator, `ekf`.
#[derive(Debug, Clone)]
pub struct EkfEstimator {
    config: EstimatorConfig,
    belief: Belief,
    counts: Vec<u32>,
    memory: ReplayMemory<Frame>,
}

impl EkfEstimator {
    /// A belief at its prior, for cells of the given spacing and a robot of `n_joints`.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, or the prior mean is zero.
    pub fn new(
        config: &EstimatorConfig,
        spacing_m: f64,
        n_joints: usize,
    ) -> Result<Self, EstimatorError> {
        let torque_variance = config.torque_variance(n_joints)?;
        if config.prior.mean_n_per_m == 0.0 {
            return Err(EstimatorError::EkfPriorMeanZero);
        }
        let (prior_mean, prior_std) = config.prior.at_spacing(spacing_m);
        // Drift, like the prior, is white noise in space: its variance goes with h³.
        let drift_std = config.drift_std_n_per_m * prior_std / config.prior.std_n_per_m;
        let belief = Belief {
            prior_mean,
            prior_variance: prior_std * prior_std,
            drift_variance: drift_std * drift_std,
            torque_variance,
            cells: Vec::new(),
            variance: Vec::new(),
            seen: Vec::new(),
            step: 0,
        };
        let memory = ReplayMemory::new(config.memory, config.seed);
        Ok(Self { config: config.clone(), belief, counts: Vec::new(), memory })
    }

    /// Goes on from a saved state, given the remembered frames' observations in its order.
    ///
    /// # Errors
    ///
    /// If the state contradicts itself.
    pub fn restore(
        mut self,
        state: &EstimatorState,
        points_m: &[[f64; 3]],
        observations: Vec<Observation>,
    ) -> Result<Self, EstimatorError> {
        state.check(points_m.len(), self.belief.torque_variance.len())?;
        if state.seen.len() != state.mean.len() {
            let what = "the last steps of the cells are missing".to_owned();
            return Err(EstimatorError::State { what });
        }
        if let Some(seen) = state.seen.iter().find(|&&seen| seen > state.step) {
            let what = format!("a cell was last seen in step {seen}, after {} steps", state.step);
            return Err(EstimatorError::State { what });
        }
        self.belief.grow(points_m);
        for (cell, mean) in self.belief.cells.iter_mut().zip(&state.mean) {
            *cell.unknown_mut() = *mean;
        }
        self.belief.variance[..state.mean.len()].copy_from_slice(&state.variance);
        self.belief.seen[..state.mean.len()].copy_from_slice(&state.seen);
        self.belief.step = state.step;
        self.counts.clone_from(&state.counts);
        self.memory = ReplayMemory::resume(self.config.memory, state.rng);
        for ((frame_id, _), observation) in state.remembered.iter().zip(observations) {
            self.remember(Frame { observation, frame_id: *frame_id });
        }
        Ok(self)
    }

    /// Remembers a frame; what no longer fits leaves.
    fn remember(&mut self, frame: Frame) {
        let bytes = frame.observation.bytes() + size_of::<Frame>();
        self.memory.push(frame, bytes, 0.0);
    }
}

impl Estimator for EkfEstimator {
    fn stiffness(&self, row: usize) -> f64 {
        self.belief.cells.get(row).map_or(self.belief.prior_mean, |cell| cell.unknown().abs())
    }

    fn std(&self, row: usize) -> f64 {
        self.belief.variance_now(row).sqrt()
    }

    fn count(&self, row: usize) -> u32 {
        self.counts.get(row).copied().unwrap_or(0)
    }

    fn set_prior_means(&mut self, points_m: &[[f64; 3]], mean_n_per_m: &[f64]) {
        let (known, least) = (self.belief.cells.len(), self.belief.prior_mean);
        self.belief.cells.extend(cells_at_prior_means(known, points_m, mean_n_per_m).map(
            |mut cell| {
                *cell.unknown_mut() = cell.unknown().max(least);
                cell
            },
        ));
        self.belief.resize();
    }

    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        frame_id: FrameId,
    ) -> Result<DVector<f64>, EstimatorError> {
        self.belief.grow(points_m);
        let predicted = self.belief.update(&observation)?;
        self.counts.resize(points_m.len(), 0);
        observation.rows().for_each(|row| self.counts[row] += 1);
        self.remember(Frame { observation, frame_id });
        self.belief.step += 1;
        Ok(predicted)
    }

    fn advance_time(&mut self) {
        self.belief.step += 1;
    }

    fn replay(&mut self, visits: u32) -> Replayed {
        let mut replayed = Replayed::default();
        for _ in 0..visits {
            let Some(index) = self.memory.draw() else { break };
            let observation = &self.memory.frames()[index].observation;
            observation.prefetch().finish();
            // A frame that was fused once can be fused again, so this does not fail in practice.
            if self.belief.update(observation).is_err() {
                break;
            }
            replayed.add(observation);
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
        let means: Vec<f64> = self.belief.cells.iter().map(Cell::unknown).collect();
        EstimatorState {
            mean: padded(&means, n_rows, self.belief.prior_mean),
            variance: padded(&self.belief.variance, n_rows, self.belief.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: padded(&self.belief.seen, n_rows, 0),
            step: self.belief.step,
            remembered: self.memory.frames().iter().map(|f| (f.frame_id, Vec::new())).collect(),
            nis: Vec::new(),
            rng: self.memory.rng_state(),
        }
    }
}
