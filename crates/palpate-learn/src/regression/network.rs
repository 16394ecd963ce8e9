//! A feed-forward network of rectified layers, its loss and the loss's gradient.
//!
//! Columns are frames. The input of every layer has one more row, which is always 1: the layer's
//! bias is the last column of its weights. All weights are in one slice, layer by layer,
//! column-major, so that the optimiser needs no layers.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

/// Weights of all layers.
#[derive(Debug, Clone)]
pub(super) struct Network {
    sizes: Vec<usize>,
    pub(super) weights: Vec<f32>,
}

/// Buffers of the forward and the backward pass for a batch of frames.
#[derive(Debug)]
pub(super) struct Activations {
    /// Outputs of each layer: (size + 1) × frames, the last row 1; of the last layer, size × frames.
    values: Vec<Mat<f32>>,
    /// Derivatives of the loss by the inputs of each layer's rectifier, size × frames.
    deltas: Vec<Mat<f32>>,
    gradient: Vec<f32>,
}

impl Network {
    /// Random weights with He initialisation, biases 0.
    pub(super) fn random(sizes: &[usize], rng: &mut ChaCha8Rng) -> Self {
        let mut weights = Vec::new();
        for pair in sizes.windows(2) {
            let bound = (6.0 / pair[0] as f32).sqrt();
            let mut draw = || bound * (2.0 * (rng.next_u32() as f32 / u32::MAX as f32) - 1.0);
            weights.extend(std::iter::repeat_with(&mut draw).take(pair[0] * pair[1]));
            weights.extend(std::iter::repeat_n(0.0, pair[1]));
        }
        Self { sizes: sizes.to_vec(), weights }
    }

    /// Weights and biases of a layer, outputs × (inputs + 1).
    fn layer(&self, layer: usize) -> MatRef<'_, f32> {
        let (from, rows, columns) = place(&self.sizes, layer);
        MatRef::from_column_major_slice(&self.weights[from..][..rows * columns], rows, columns)
    }
}

/// Where a layer's weights begin, and their shape.
fn place(sizes: &[usize], layer: usize) -> (usize, usize, usize) {
    let length = |pair: &[usize]| (pair[0] + 1) * pair[1];
    let from = sizes.windows(2).take(layer).map(length).sum();
    (from, sizes[layer + 1], sizes[layer] + 1)
}

impl Activations {
    /// Buffers for this number of frames.
    pub(super) fn new(network: &Network, frames: usize) -> Self {
        let sizes = &network.sizes;
        let last = sizes.len() - 1;
        let value = |(layer, &size): (usize, &usize)| {
            let rows = if layer < last { size + 1 } else { size };
            Mat::from_fn(rows, frames, |row, _| if row == size { 1.0 } else { 0.0 })
        };
        Self {
            values: sizes.iter().enumerate().map(value).collect(),
            deltas: sizes[1..].iter().map(|&size| Mat::zeros(size, frames)).collect(),
            gradient: vec![0.0; network.weights.len()],
        }
    }

    /// The outputs, size × frames, for columns `frames` of `x`.
    pub(super) fn forward(
        &mut self,
        network: &Network,
        x: &Mat<f32>,
        frames: &[usize],
    ) -> MatRef<'_, f32> {
        for (column, &frame) in frames.iter().enumerate() {
            let inputs = &mut self.values[0].col_as_slice_mut(column)[..x.nrows()];
            inputs.copy_from_slice(x.col_as_slice(frame));
        }
        let last = self.values.len() - 1;
        for layer in 0..last {
            let (before, after) = self.values.split_at_mut(layer + 1);
            let (weights, size) = (network.layer(layer), network.sizes[layer + 1]);
            let outputs = after[0].as_mut().subrows_mut(0, size);
            matmul(outputs, Accum::Replace, weights, before[layer].as_ref(), 1.0, Par::Seq);
            if layer + 1 < last {
                for column in 0..after[0].ncols() {
                    for value in after[0].col_as_slice_mut(column) {
                        *value = value.max(0.0);
                    }
                }
            }
        }
        self.values[last].as_ref()
    }

    /// Mean squared error of the outputs for columns `frames` of `x` and `y`.
    pub(super) fn loss(
        &mut self,
        network: &Network,
        (x, y): (&Mat<f32>, &Mat<f32>),
        frames: &[usize],
    ) -> f64 {
        let outputs = self.forward(network, x, frames);
        let mut sum = 0.0;
        for (column, &frame) in frames.iter().enumerate() {
            for (row, wanted) in y.col_as_slice(frame).iter().enumerate() {
                sum += f64::from(outputs[(row, column)] - wanted).powi(2);
            }
        }
        sum / (y.nrows() * frames.len()) as f64
    }

    /// The gradient of [`Activations::loss`] by all weights, in their order.
    pub(super) fn gradient(
        &mut self,
        network: &Network,
        (x, y): (&Mat<f32>, &Mat<f32>),
        frames: &[usize],
    ) -> &[f32] {
        self.forward(network, x, frames);
        let last = self.deltas.len() - 1;
        let scale = 2.0 / (y.nrows() * frames.len()) as f32;
        for (column, &frame) in frames.iter().enumerate() {
            let outputs = self.values[last + 1].col_as_slice(column).iter();
            let deltas = self.deltas[last].col_as_slice_mut(column).iter_mut();
            for ((delta, output), wanted) in deltas.zip(outputs).zip(y.col_as_slice(frame)) {
                *delta = scale * (output - wanted);
            }
        }
        for layer in (0..=last).rev() {
            let (from, rows, columns) = place(&network.sizes, layer);
            let slice = &mut self.gradient[from..][..rows * columns];
            let gradient = MatMut::from_column_major_slice_mut(slice, rows, columns);
            let (before, after) = self.deltas.split_at_mut(layer);
            let inputs = self.values[layer].as_ref().transpose();
            matmul(gradient, Accum::Replace, after[0].as_ref(), inputs, 1.0, Par::Seq);
            let Some(before) = before.last_mut() else { continue };
            let weights = network.layer(layer).subcols(0, columns - 1).transpose();
            matmul(before.as_mut(), Accum::Replace, weights, after[0].as_ref(), 1.0, Par::Seq);
            for column in 0..before.ncols() {
                let values = self.values[layer].col_as_slice(column);
                for (delta, value) in before.col_as_slice_mut(column).iter_mut().zip(values) {
                    *delta = if *value > 0.0 { *delta } else { 0.0 };
                }
            }
        }
        &self.gradient
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    #[test]
    fn the_gradient_is_the_slope_of_the_loss() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut network = Network::random(&[3, 6, 5, 2], &mut rng);
        let mut uniform = || 2.0 * (rng.next_u32() as f32 / u32::MAX as f32) - 1.0;
        // Biases are changed too, so that no derivative is zero.
        network.weights.iter_mut().for_each(|weight| *weight += 0.2 * uniform());
        let x = Mat::from_fn(3, 8, |_, _| uniform());
        let y = Mat::from_fn(2, 8, |_, _| uniform());
        let drawn = [6, 1, 3, 4];
        let mut activations = Activations::new(&network, drawn.len());
        let gradient = activations.gradient(&network, (&x, &y), &drawn).to_vec();

        let step = 5e-4; // short enough that no rectifier switches in between
        for (index, slope) in gradient.iter().enumerate() {
            let mut at = |nudge: f32| {
                let mut nudged = network.clone();
                nudged.weights[index] += nudge;
                activations.loss(&nudged, (&x, &y), &drawn)
            };
            let wanted = (at(step) - at(-step)) / f64::from(2.0 * step);
            assert!((f64::from(*slope) - wanted).abs() < 1e-3, "{index}: {slope} {wanted}");
        }
    }
}
