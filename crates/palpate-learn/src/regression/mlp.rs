//! A perceptron with two hidden layers, trained by Adam on mini-batches.
//!
//! Touches that are held out of the training frames stop the training early, and the weights of the
//! best epoch are kept. They also choose how strongly weights decay: a few touches say little of the
//! joint positions between them, and without decay a network predicts large torques where it has
//! learnt nothing. The network itself, its gradient and its arrangement in memory are in
//! [`network`](super::network).

use std::ops::Range;

use faer::Mat;
use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::draw::shuffle;
use super::error::{RegressionError, positive};
use super::frames::{Frames, HELD_OUT, Regressor};
use super::network::{Activations, Network};
use super::scale::Scales;

/// How a network is trained.
#[derive(Debug, Clone, PartialEq)]
pub struct MlpConfig {
    /// Units of each of the two hidden layers.
    pub hidden: usize,
    /// Frames in a mini-batch.
    pub batch: usize,
    /// Adam's step length.
    pub learning_rate: f64,
    /// Decays of weights to choose from, per step of length 1 (decoupled from the gradient).
    pub weight_decays: Vec<f64>,
    /// The most passes over the training frames.
    pub epochs: usize,
    /// Passes without improvement on the touches held out, after which training stops.
    pub patience: usize,
    /// Seed of the first weights, of the touches held out, and of the order of frames.
    pub seed: u64,
}

impl Default for MlpConfig {
    fn default() -> Self {
        Self {
            hidden: 128,
            batch: 64,
            learning_rate: 1e-3,
            weight_decays: vec![0.0, 1.0, 10.0],
            epochs: 150,
            patience: 20,
            seed: 0,
        }
    }
}

/// A network that has learnt torques.
#[derive(Debug, Clone)]
pub struct Mlp {
    scales: Scales,
    network: Network,
}

/// Frames in the network's numbers, and which of them are for what.
#[derive(Debug)]
struct Lesson {
    /// Standardised positions and torques of all frames, n_joints × frames.
    x: Mat<f32>,
    y: Mat<f32>,
    /// Frames to learn from.
    learnt: Vec<usize>,
    /// Frames that say how well it was learnt.
    held_out: Vec<usize>,
}

/// A training that came to its end.
#[derive(Debug)]
struct Trained {
    /// The network of the best epoch.
    network: Network,
    /// Loss on the frames held out after every epoch.
    losses: Vec<f64>,
    /// The least of them.
    loss: f64,
}

impl Mlp {
    /// Trains a network; a fifth of the touches (of a single touch, its last fifth) is held out to
    /// tell the best epoch and the best decay of weights.
    ///
    /// Cost: O(`weight_decays` · `epochs` · frames · `hidden`²), 5 ms an epoch of 3,600 frames.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite, with a setting out of its range.
    pub fn fit(frames: &Frames, config: &MlpConfig) -> Result<Self, RegressionError> {
        frames.check()?;
        config.check()?;
        let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
        let parts = hold_out(&frames.parts(), &mut rng);
        let is_held_out = |frame: &usize| parts.iter().any(|part| part.contains(frame));
        let (mut held_out, learnt): (Vec<usize>, Vec<usize>) =
            (0..frames.len()).partition(is_held_out);
        if held_out.is_empty() {
            held_out.clone_from(&learnt);
        }
        let scales = Scales::of(&frames.select(&learnt));
        let [x, y] = scales.standardised(frames).map(|numbers| columns(&numbers));
        let sizes = [x.nrows(), config.hidden, config.hidden, y.nrows()];
        let lesson = Lesson { x, y, learnt, held_out };

        let start = Network::random(&sizes, &mut rng);
        let mut best = (f64::INFINITY, start.clone());
        for &decay in &config.weight_decays {
            let trained = train(&lesson, start.clone(), config, decay, rng.clone());
            if trained.loss < best.0 {
                best = (trained.loss, trained.network);
            }
        }
        Ok(Self { scales, network: best.1 })
    }
}

impl MlpConfig {
    fn check(&self) -> Result<(), RegressionError> {
        positive("hidden", self.hidden as f64)?;
        positive("batch", self.batch as f64)?;
        positive("learning_rate", self.learning_rate)?;
        positive("epochs", self.epochs as f64)?;
        // Without any decay to try, and with one that turns weights round in a step, nothing is
        // learnt.
        let strongest = self.weight_decays.iter().copied().reduce(f64::max).unwrap_or(f64::NAN);
        let good = |decay: &f64| (0.0..1.0).contains(&(decay * self.learning_rate));
        if strongest.is_nan() || !self.weight_decays.iter().all(good) {
            let wanted = "one or more decays from 0 to below 1 / learning_rate";
            let setting = "weight_decays";
            return Err(RegressionError::Setting { setting, found: strongest, wanted });
        }
        Ok(())
    }
}

/// Trains until the loss on the frames held out has not improved for a while.
fn train(
    lesson: &Lesson,
    mut network: Network,
    config: &MlpConfig,
    weight_decay: f64,
    mut rng: ChaCha8Rng,
) -> Trained {
    let data = (&lesson.x, &lesson.y);
    let mut order = lesson.learnt.clone();
    let mut adam = Adam::new(network.weights().len(), config.learning_rate, weight_decay);
    let mut batch = Activations::new(network.sizes(), config.batch.min(order.len()));
    let mut validation = Activations::new(network.sizes(), lesson.held_out.len());
    let mut best = Trained { network: network.clone(), losses: Vec::new(), loss: f64::INFINITY };
    let mut since = 0;
    while best.losses.len() < config.epochs && since <= config.patience {
        shuffle(&mut order, &mut rng);
        // The few frames that do not fill a batch wait for another epoch.
        for drawn in order.chunks_exact(batch.frames()) {
            let gradient = batch.gradient(&network, data, drawn);
            adam.step(network.weights_mut(), gradient);
        }
        let loss = validation.loss(&network, data, &lesson.held_out);
        best.losses.push(loss);
        since += 1;
        if loss < best.loss {
            (best.network, best.loss, since) = (network.clone(), loss, 0);
        }
    }
    best
}

impl Regressor for Mlp {
    fn predict(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let x = columns(&self.scales.positions.standardised(q));
        let frames: Vec<usize> = (0..q.ncols()).collect();
        let mut activations = Activations::new(self.network.sizes(), frames.len());
        let y = activations.forward(&self.network, &x, &frames);
        let y = DMatrix::from_fn(y.nrows(), y.ncols(), |row, frame| f64::from(y[(row, frame)]));
        self.scales.torques.restored(&y)
    }
}

/// A fifth of the parts, at least one, drawn at random.
fn hold_out(parts: &[Range<usize>], rng: &mut ChaCha8Rng) -> Vec<Range<usize>> {
    let mut drawn: Vec<usize> = (0..parts.len()).collect();
    shuffle(&mut drawn, rng);
    drawn.truncate(parts.len().div_ceil(HELD_OUT));
    drawn.into_iter().map(|part| parts[part].clone()).collect()
}

/// The same numbers in single precision.
fn columns(matrix: &DMatrix<f64>) -> Mat<f32> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |row, frame| matrix[(row, frame)] as f32)
}

/// Gradient descent with a step length for every weight (Kingma and Ba), and decay
/// that the gradient does not see (Loshchilov and Hutter).
#[derive(Debug)]
struct Adam {
    learning_rate: f32,
    /// What a step leaves of a weight.
    left: f32,
    /// Running means of the gradient and of its squares, per weight.
    moments: Vec<(f32, f32)>,
    /// What is still missing in the running means, which began at 0.
    missing: (f32, f32),
}

impl Adam {
    const DECAY: (f32, f32) = (0.9, 0.999);

    fn new(weights: usize, learning_rate: f64, weight_decay: f64) -> Self {
        Self {
            learning_rate: learning_rate as f32,
            left: (1.0 - learning_rate * weight_decay) as f32,
            moments: vec![(0.0, 0.0); weights],
            missing: (1.0, 1.0),
        }
    }

    fn step(&mut self, weights: &mut [f32], gradient: &[f32]) {
        let (first, second) = Self::DECAY;
        self.missing.0 *= first;
        self.missing.1 *= second;
        let rate = self.learning_rate / (1.0 - self.missing.0);
        let unbias = 1.0 / (1.0 - self.missing.1);
        for ((weight, slope), (mean, square)) in
            weights.iter_mut().zip(gradient).zip(&mut self.moments)
        {
            *mean += (1.0 - first) * (slope - *mean);
            *square += (1.0 - second) * (slope * slope - *square);
            *weight = self.left * *weight - rate * *mean / ((*square * unbias).sqrt() + 1e-8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regression::frames::tests::{surface, unexplained};
    use crate::regression::scale::Scale;

    #[test]
    fn a_smooth_surface_is_learnt() {
        let all = surface(1_200, 6);
        let (learnt, unseen): (Vec<usize>, Vec<usize>) = (0..1_200).partition(|f| f % 6 != 0);
        let (learnt, unseen) = (all.select(&learnt), all.select(&unseen));
        let mlp = Mlp::fit(&learnt, &MlpConfig::default()).unwrap();
        let left = unexplained(&mlp.predict(&unseen.q), &unseen.tau);
        assert!(left < 0.05, "{left}");
    }

    #[test]
    fn stopping_early_restores_the_best_epoch() {
        // Torques that are drawn by lot: what is learnt of some frames is wrong of the others.
        let mut frames = surface(60, 5);
        frames.tau = frames.tau.select_columns(&(0..60).map(|f| f * 37 % 60).collect::<Vec<_>>());
        let numbers = |matrix: &DMatrix<f64>| columns(&Scale::of(matrix).standardised(matrix));
        let (x, y) = (numbers(&frames.q), numbers(&frames.tau));
        let lesson = Lesson { x, y, learnt: (0..40).collect(), held_out: (40..60).collect() };
        let config = MlpConfig { patience: 5, batch: 8, ..MlpConfig::default() };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let start = Network::random(&[2, 16, 16, 2], &mut rng);

        let trained = train(&lesson, start, &config, 0.0, rng);

        let best = trained.losses.iter().copied().fold(f64::INFINITY, f64::min);
        let best_epoch = trained.losses.iter().position(|&loss| loss == best).unwrap();
        assert_eq!(trained.losses.len(), best_epoch + 1 + config.patience + 1);
        assert!(trained.losses.len() < config.epochs);
        let mut validation = Activations::new(trained.network.sizes(), 20);
        let again = validation.loss(&trained.network, (&lesson.x, &lesson.y), &lesson.held_out);
        assert_eq!((again, trained.loss), (best, best));
    }

    #[test]
    fn the_first_step_of_adam_has_the_length_of_its_rate() {
        let mut weights = [1.0, 1.0];
        Adam::new(2, 0.1, 2.0).step(&mut weights, &[1e-3, -50.0]);
        // Decay leaves 0.8 of each weight, whatever the gradient.
        assert!((weights[0] - 0.7f32).abs() < 1e-4 && (weights[1] - 0.9f32).abs() < 1e-4);
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let frames = surface(10, 2);
        for weight_decays in [vec![], vec![-1.0], vec![1e3], vec![f64::NAN, 1.0]] {
            let config = MlpConfig { weight_decays, ..MlpConfig::default() };
            assert!(matches!(Mlp::fit(&frames, &config), Err(RegressionError::Setting { .. })));
        }
    }
}
