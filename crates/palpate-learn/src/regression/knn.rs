//! The mean of the nearest frames, near ones weighing more.
//!
//! A neighbour at distance `d` in standardised positions weighs `exp(−d²/2ℓ²)`. Weights count only
//! against each other, so they are taken relative to the nearest neighbour's: it weighs 1 however
//! far it is, and for `ℓ → 0`, or a query far from everything, its torque is the prediction,
//! where plain weights would all underflow and leave 0/0.

use std::ops::Range;

use nalgebra::DMatrix;

use super::draw::thinned;
use super::error::{RegressionError, positive};
use super::frames::{Frames, Regressor};
use super::scale::Scale;

/// How neighbours are taken.
#[derive(Debug, Clone, PartialEq)]
pub struct KnnConfig {
    /// Neighbours that are averaged.
    pub neighbours: usize,
    /// Length scales to choose from, in deviations of the joint positions.
    pub length_scales: Vec<f64>,
    /// Frames that are predicted, each without its own touch, to choose the length scale.
    pub max_queries: usize,
}

impl Default for KnnConfig {
    fn default() -> Self {
        Self {
            neighbours: 50,
            // From closer than a frame to the next, to farther than the whole set.
            length_scales: (-10..=6).map(|exponent| 2f64.powf(f64::from(exponent) / 2.0)).collect(),
            max_queries: 1_000,
        }
    }
}

/// Frames that are looked up.
#[derive(Debug, Clone)]
pub struct Knn {
    scale: Scale,
    /// Standardised positions, n_joints × frames.
    z: DMatrix<f64>,
    /// n_joints × frames, N·m.
    tau: DMatrix<f64>,
    neighbours: usize,
    length_scale: f64,
}

/// A training frame and its squared distance to a query.
type Neighbour = (f64, usize);

impl Knn {
    /// Keeps frames, and chooses the length scale with which they predict each other best, each
    /// touch without itself (of a single touch, its end from the rest).
    ///
    /// Cost: O(`max_queries` · frames), 25 ms for 3,600 frames.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite, without neighbours or length scales.
    pub fn fit(frames: &Frames, config: &KnnConfig) -> Result<Self, RegressionError> {
        let first = config.length_scales.first().copied().unwrap_or(f64::NAN);
        let mut knn = Self::with_length_scale(frames, config.neighbours, first)?;
        for &length_scale in &config.length_scales {
            positive("length_scales", length_scale)?;
        }
        let losses = knn.losses(frames, config);
        let best = losses.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
        knn.length_scale = best.map_or(first, |(index, _)| config.length_scales[index]);
        Ok(knn)
    }

    /// Keeps frames, to be looked up with a length scale that is known, in deviations of the
    /// joint positions.
    ///
    /// # Errors
    ///
    /// Without frames or neighbours, with values that are not finite.
    pub fn with_length_scale(
        frames: &Frames,
        neighbours: usize,
        length_scale: f64,
    ) -> Result<Self, RegressionError> {
        frames.check()?;
        positive("neighbours", neighbours as f64)?;
        positive("length_scale", length_scale)?;
        let scale = Scale::of(&frames.q);
        let z = scale.standardised(&frames.q);
        Ok(Self { scale, z, tau: frames.tau.clone(), neighbours, length_scale })
    }

    /// The length scale in use, in deviations of the joint positions.
    pub fn length_scale(&self) -> f64 {
        self.length_scale
    }

    /// Summed squared errors, (N·m)², of frames that are predicted without their own part, for
    /// each length scale.
    fn losses(&self, frames: &Frames, config: &KnnConfig) -> Vec<f64> {
        let mut losses = vec![0.0; config.length_scales.len()];
        let parts = frames.parts();
        for part in &parts {
            for query in thinned(part.len(), config.max_queries.div_ceil(parts.len())) {
                let query = part.start + query;
                let near = self.nearest(self.z.column(query).as_slice(), part);
                for (loss, &length_scale) in losses.iter_mut().zip(&config.length_scales) {
                    let predicted = self.mean(&near, length_scale);
                    for (predicted, tau) in predicted.iter().zip(&self.tau.column(query)) {
                        *loss += (predicted - tau).powi(2);
                    }
                }
            }
        }
        losses
    }

    /// The nearest frames outside `without` to a standardised position, in no order.
    fn nearest(&self, query: &[f64], without: &Range<usize>) -> Vec<Neighbour> {
        let columns = self.z.as_slice().chunks_exact(self.z.nrows()).enumerate();
        let mut near: Vec<Neighbour> = columns
            .filter(|(frame, _)| !without.contains(frame))
            .map(|(frame, z)| {
                (z.iter().zip(query).map(|(a, b)| (a - b) * (a - b)).sum::<f64>(), frame)
            })
            .collect();
        if near.len() > self.neighbours {
            // Frames at the same distance are told apart by their number.
            let order = |a: &Neighbour, b: &Neighbour| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            near.select_nth_unstable_by(self.neighbours, order);
            near.truncate(self.neighbours);
        }
        near
    }

    /// The weighted mean of neighbours' torques, n_joints, N·m.
    fn mean(&self, near: &[Neighbour], length_scale: f64) -> Vec<f64> {
        let nearest = near.iter().map(|neighbour| neighbour.0).fold(f64::INFINITY, f64::min);
        let mut sum = vec![0.0; self.tau.nrows()];
        let mut weights = 0.0;
        for &(squared_distance, frame) in near {
            let weight = ((nearest - squared_distance) / (2.0 * length_scale.powi(2))).exp();
            weights += weight;
            for (sum, tau) in sum.iter_mut().zip(&self.tau.column(frame)) {
                *sum += weight * tau;
            }
        }
        sum.iter().map(|sum| sum / weights).collect()
    }
}

impl Regressor for Knn {
    fn predict(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let z = self.scale.standardised(q);
        let mut tau = DMatrix::zeros(self.tau.nrows(), q.ncols());
        for (z, mut tau) in z.column_iter().zip(tau.column_iter_mut()) {
            tau.copy_from_slice(
                &self.mean(&self.nearest(z.as_slice(), &(0..0)), self.length_scale),
            );
        }
        tau
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, dmatrix};

    use super::*;
    use crate::regression::frames::tests::surface;

    #[test]
    fn one_neighbour_is_returned_as_it_is() {
        let frames = surface(50, 5);
        let knn = Knn::with_length_scale(&frames, 1, 0.3).unwrap();
        assert_eq!(knn.predict(&frames.q), frames.tau);
    }

    #[test]
    fn a_length_scale_beyond_everything_gives_the_mean_of_the_nearest() {
        let frames = Frames {
            q: dmatrix![0.0, 1.0, 2.0, 9.0],
            tau: dmatrix![3.0, 6.0, 0.0, 100.0],
            touch: vec![0; 4],
        };
        let mean = Knn::with_length_scale(&frames, 3, 1e6).unwrap().predict(&dmatrix![0.8]);
        assert!((mean[0] - 3.0).abs() < 1e-6, "{mean}");
    }

    #[test]
    fn far_from_everything_the_nearest_frame_is_the_prediction() {
        let frames =
            Frames { q: dmatrix![0.0, 1.0, 2.0], tau: dmatrix![3.0, 6.0, 5.0], touch: vec![0; 3] };
        let knn = Knn::with_length_scale(&frames, 3, 1e-3).unwrap();
        assert_eq!(knn.predict(&dmatrix![1e6, -1e6]), dmatrix![5.0, 3.0]);
    }

    #[test]
    fn the_length_scale_is_the_one_that_predicts_touches_from_each_other() {
        // Two touches go through the same positions and differ by noise of alternating sign: only
        // wide weights average it. A touch that saw its own frames would want narrow ones.
        let q = DMatrix::from_fn(1, 200, |_, frame| (frame % 100) as f64);
        let tau = DMatrix::from_fn(1, 200, |_, frame| {
            let touch = frame / 100;
            if (frame + touch) % 2 == 0 { 1.0 } else { -1.0 }
        });
        let frames = Frames { q, tau, touch: (0..200).map(|frame| frame / 100).collect() };
        let length_scales = vec![0.01, 0.1, 1.0];
        let config = KnnConfig { length_scales, ..KnnConfig::default() };
        let losses = Knn::fit(&frames, &config).unwrap().losses(&frames, &config);
        assert!(losses[0] > 2.0 * losses[2], "{losses:?}");
        assert_eq!(Knn::fit(&frames, &config).unwrap().length_scale(), 1.0);
    }
}
