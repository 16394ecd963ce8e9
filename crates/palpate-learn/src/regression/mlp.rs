//! A multilayer perceptron with two hidden layers, trained by Adam on mini-batches.
//!
//! Training stops early by the loss on held-out training touches, and the weights of the best epoch
//! are kept. The same loss chooses the weight decay: joint positions between a few touches are not
//! in the data, and without decay a network predicts large torques there. The network itself, its
//! gradient and its memory layout are in [`network`](super::network).

use std::ops::Range;

use faer::Mat;
use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::draw::shuffle;
use super::error::RegressionError;
use super::frames::{Frames, HELD_OUT, Regressor};
use super::network::{Activations, Network};
use super::scale::Scales;

/// Units of each of the two hidden layers.
const HIDDEN: usize = 128;
/// Learning rate of Adam.
const LEARNING_RATE: f64 = 1e-3;
/// Weight decays to choose from (decoupled from the gradient); each step shrinks weights by learning rate × decay.
const WEIGHT_DECAYS: [f64; 3] = [0.0, 1.0, 10.0];
/// Most passes over the training frames.
const EPOCHS: usize = 150;
/// Seed of the initial weights, of the held-out touches, and of the order of frames.
const SEED: u64 = 0;

/// A trained network.
#[derive(Debug, Clone)]
pub struct Mlp {
    scales: Scales,
    network: Network,
}

/// Standardised frames, their division, and the settings of a training.
#[derive(Debug)]
struct Lesson {
    /// Standardised positions and torques of all frames, n_joints × frames.
    x: Mat<f32>,
    y: Mat<f32>,
    /// Indices of the training frames.
    learnt: Vec<usize>,
    /// Indices of the validation frames.
    held_out: Vec<usize>,
    /// Frames in a mini-batch.
    batch: usize,
    /// Training stops after more than this number of epochs without improvement on the validation frames.
    patience: usize,
}

/// The result of a training.
#[derive(Debug)]
struct Trained {
    /// The network of the best epoch.
    network: Network,
    /// Loss on the validation frames after every epoch.
    losses: Vec<f64>,
    /// The least of these losses.
    loss: f64,
}

impl Mlp {
    /// Trains a network; a fifth of the touches (of a single touch, its last fifth) is held out to
    /// choose the best epoch and the best weight decay.
    ///
    /// Cost: 5 ms for an epoch of 3,600 frames; up to 150 epochs for each of three decays.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite.
    pub fn fit(frames: &Frames) -> Result<Self, RegressionError> {
        frames.check()?;
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let parts = hold_out(&frames.parts(), &mut rng);
        let is_held_out = |frame: &usize| parts.iter().any(|part| part.contains(frame));
        let (mut held_out, learnt): (Vec<usize>, Vec<usize>) =
            (0..frames.len()).partition(is_held_out);
        if held_out.is_empty() {
            held_out.clone_from(&learnt);
        }
        let scales = Scales::of(&frames.select(&learnt));
        let [x, y] = scales.standardised(frames).map(|numbers| columns(&numbers));
        let sizes = [x.nrows(), HIDDEN, HIDDEN, y.nrows()];
        let lesson = Lesson { x, y, learnt, held_out, batch: 64, patience: 20 };

        let start = Network::random(&sizes, &mut rng);
        let trained = WEIGHT_DECAYS.map(|decay| train(&lesson, start.clone(), decay, rng.clone()));
        let best = trained.into_iter().min_by(|a, b| a.loss.total_cmp(&b.loss));
        Ok(Self { scales, network: best.expect("there are decays to try").network })
    }
}

/// Trains until the loss on the validation frames has stopped improving (`patience`).
fn train(lesson: &Lesson, mut network: Network, weight_decay: f64, mut rng: ChaCha8Rng) -> Trained {
    let data = (&lesson.x, &lesson.y);
    let mut order = lesson.learnt.clone();
    let mut adam = Adam::new(network.weights.len(), LEARNING_RATE, weight_decay);
    let frames = lesson.batch.min(order.len());
    let mut batch = Activations::new(&network, frames);
    let mut validation = Activations::new(&network, lesson.held_out.len());
    let mut best = Trained { network: network.clone(), losses: Vec::new(), loss: f64::INFINITY };
    let mut since = 0;
    while best.losses.len() < EPOCHS && since <= lesson.patience {
        shuffle(&mut order, &mut rng);
        // The last frames, which do not fill a batch, are left out in this epoch.
        for drawn in order.chunks_exact(frames) {
            let gradient = batch.gradient(&network, data, drawn);
            adam.step(&mut network.weights, gradient);
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
        let mut activations = Activations::new(&self.network, frames.len());
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

/// Converts a matrix to single precision.
fn columns(matrix: &DMatrix<f64>) -> Mat<f32> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |row, frame| matrix[(row, frame)] as f32)
}

/// Adam (Kingma and Ba): gradient descent with a step length for every weight, with decoupled weight
/// decay (Loshchilov and Hutter).
#[derive(Debug)]
struct Adam {
    learning_rate: f32,
    /// Factor by which weight decay shrinks a weight in each step.
    left: f32,
    /// Running means of the gradient and of its squares, per weight.
    moments: Vec<(f32, f32)>,
    /// Share of the initial value 0 in each running mean; 1 minus this is its bias correction.
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
        let mlp = Mlp::fit(&learnt).unwrap();
        let left = unexplained(&mlp.predict(&unseen.q), &unseen.tau);
        assert!(left < 0.05, "{left}");
    }

    #[test]
    fn stopping_early_restores_the_best_epoch() {
        // Torques are permuted, so that what is learnt from some frames is wrong for the others.
        let mut frames = surface(60, 5);
        frames.tau = frames.tau.select_columns(&(0..60).map(|f| f * 37 % 60).collect::<Vec<_>>());
        let numbers = |matrix: &DMatrix<f64>| columns(&Scale::of(matrix).standardised(matrix));
        let (x, y) = (numbers(&frames.q), numbers(&frames.tau));
        let (learnt, held_out) = ((0..40).collect(), (40..60).collect());
        let lesson = Lesson { x, y, learnt, held_out, batch: 8, patience: 5 };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let start = Network::random(&[2, 16, 16, 2], &mut rng);

        let trained = train(&lesson, start, 0.0, rng);

        let best = trained.losses.iter().copied().fold(f64::INFINITY, f64::min);
        let best_epoch = trained.losses.iter().position(|&loss| loss == best).unwrap();
        assert_eq!(trained.losses.len(), best_epoch + 1 + lesson.patience + 1);
        assert!(trained.losses.len() < EPOCHS);
        let mut validation = Activations::new(&trained.network, 20);
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
}
