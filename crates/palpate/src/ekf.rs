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
//! filter has no slope there.
//!
//! # What the standard deviation means
//!
//! The filter's own: of κ, given a diagonal covariance. It leaves out correlations between
//! cells, and since replaying a measurement counts its data again, it is too small by an amount
//! that grows with the number of replays.

use nalgebra::DVector;

use crate::estimator::{
    Estimator, EstimatorConfig, EstimatorError, EstimatorState, Source, innovation_inverse, padded,
    shrink,
};
use crate::replay::Memory;
use crate::torque::Observation;

/// A past measurement.
#[derive(Debug, Clone)]
struct Frame {
    observation: Observation,
    source: Source,
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
    mean: Vec<f64>,
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

    /// The Kalman update of Eqs. 5 and 6.
    ///
    /// Nothing changes unless the innovation covariance can be inverted.
    fn update(
        &mut self,
        points_m: &[[f32; 3]],
        observation: &Observation,
    ) -> Result<(), EstimatorError> {
        let covariance = observation.gram(points_m, |row| self.variance_now(row));
        let gain = innovation_inverse(covariance, &self.torque_variance)?;
        let n_rows = points_m.len();
        self.mean.resize(n_rows, self.prior_mean);
        self.variance.resize(n_rows, self.prior_variance);
        self.seen.resize(n_rows, 0);
        let predicted = observation.predict(points_m, |row| self.mean[row].abs());
        let d = &gain * (&observation.tau - predicted);
        if d.iter().any(|x| !x.is_finite()) {
            return Err(EstimatorError::Degenerate);
        }
        for &row in observation.rows() {
            self.variance[row as usize] = self.variance_now(row as usize);
            self.seen[row as usize] = self.step;
        }
        let (mean, variance) = (&mut self.mean, &self.variance);
        observation.spread(points_m, &d, |row, lever| {
            // Column i of H is the lever times sgn κᵢ; `0.0.signum()` is `1.0` in Rust.
            mean[row] += variance[row] * lever * mean[row].signum();
        });
        shrink(&mut self.variance, points_m, observation, &gain);
        Ok(())
    }
}

/// The paper's estimator, `ekf`.
#[derive(Debug, Clone)]
pub struct EkfEstimator {
    config: EstimatorConfig,
    belief: Belief,
    counts: Vec<u32>,
    memory: Memory<Frame>,
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
            mean: Vec::new(),
            variance: Vec::new(),
            seen: Vec::new(),
            step: 0,
        };
        let memory = Memory::new(config.memory, config.seed);
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
        n_rows: usize,
        observations: Vec<Observation>,
    ) -> Result<Self, EstimatorError> {
        state.check(n_rows, self.belief.torque_variance.len())?;
        if state.seen.len() != state.mean.len() {
            let what = "the last steps of the cells are missing".to_owned();
            return Err(EstimatorError::State { what });
        }
        if let Some(seen) = state.seen.iter().find(|&&seen| seen > state.step) {
            let what = format!("a cell was last seen in step {seen}, after {} steps", state.step);
            return Err(EstimatorError::State { what });
        }
        self.belief.mean.clone_from(&state.mean);
        self.belief.variance.clone_from(&state.variance);
        self.belief.seen.clone_from(&state.seen);
        self.belief.step = state.step;
        self.counts.clone_from(&state.counts);
        self.memory = Memory::resume(self.config.memory, state.rng);
        for ((source, _), observation) in state.remembered.iter().zip(observations) {
            let bytes = observation.bytes() + size_of::<Frame>();
            self.memory.push(Frame { observation, source: *source }, bytes);
        }
        Ok(self)
    }
}

impl Estimator for EkfEstimator {
    fn stiffness(&self, row: usize) -> f64 {
        self.belief.mean.get(row).map_or(self.belief.prior_mean, |mean| mean.abs())
    }

    fn std(&self, row: usize) -> f64 {
        self.belief.variance_now(row).sqrt()
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
        self.belief.update(points_m, &observation)?;
        self.counts.resize(points_m.len(), 0);
        for &row in observation.rows() {
            self.counts[row as usize] += 1;
        }
        self.replay(points_m, self.config.replays);
        let bytes = observation.bytes() + size_of::<Frame>();
        self.memory.push(Frame { observation, source }, bytes);
        self.belief.step += 1;
        Ok(())
    }

    fn idle(&mut self) {
        self.belief.step += 1;
    }

    fn replay(&mut self, points_m: &[[f32; 3]], visits: u32) -> u32 {
        for visited in 0..visits {
            let Some(index) = self.memory.draw() else { return visited };
            // A frame that was fused once can be fused again, so this does not fail in practice.
            if self.belief.update(points_m, &self.memory.frames()[index].observation).is_err() {
                return visited;
            }
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
        EstimatorState {
            mean: padded(&self.belief.mean, n_rows, self.belief.prior_mean),
            variance: padded(&self.belief.variance, n_rows, self.belief.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: padded(&self.belief.seen, n_rows, 0),
            step: self.belief.step,
            remembered: self.memory.frames().iter().map(|f| (f.source, Vec::new())).collect(),
            rng: self.memory.rng_state(),
        }
    }
}
