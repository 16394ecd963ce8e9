//! Weighted mean of the nearest frames.
//!
//! A neighbour at distance `d` in standardised positions has the weight `exp(−d²/2ℓ²)`. Weights are
//! taken relative to that of the nearest neighbour, which therefore has the weight 1. So for `ℓ → 0`,
//! or a query far from all frames, the prediction is the torque of the nearest neighbour, where plain
//! weights would all underflow to 0.

use std::ops::Range;

use nalgebra::DMatrix;

use super::draw::thinned;
use super::error::RegressionError;
use super::frames::{Frames, Regressor};
use super::scale::Scale;

/// Number of neighbours that are averaged.
const NEIGHBOURS: usize = 50;
/// About the most frames that are predicted, each without its own touch, to choose the length scale.
const MAX_QUERIES: usize = 1_000;

/// Training frames and settings of a k-nearest-neighbour regression.
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
    /// Keeps frames, and chooses the length scale by cross-validation: each touch is predicted from
    /// the others (of a single touch, its end from the rest).
    ///
    /// Cost: O(frames), 25 ms for 3,600 of them.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite.
    pub fn fit(frames: &Frames) -> Result<Self, RegressionError> {
        // From less than the distance of neighbouring frames to more than that of all frames.
        let length_scales = (-10..=6).map(|exponent| 2f64.powf(f64::from(exponent) / 2.0));
        let mut knn = Self::with_length_scale(frames, NEIGHBOURS, 1.0)?;
        knn.choose(frames, &length_scales.collect::<Vec<f64>>());
        Ok(knn)
    }

    /// Chooses the best of these length scales, in standard deviations of the joint positions.
    fn choose(&mut self, frames: &Frames, length_scales: &[f64]) {
        let losses = self.losses(frames, length_scales);
        let best = length_scales.iter().zip(losses).min_by(|a, b| a.1.total_cmp(&b.1));
        self.length_scale = best.map_or(self.length_scale, |(length_scale, _)| *length_scale);
    }

    /// Keeps frames, with a given length scale in standard deviations of the joint positions.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite.
    ///
    /// # Panics
    ///
    /// Without neighbours, or if the length scale is not positive.
    pub fn with_length_scale(
        frames: &Frames,
        neighbours: usize,
        length_scale: f64,
    ) -> Result<Self, RegressionError> {
        frames.check()?;
        assert!(neighbours > 0, "a mean of at least one neighbour");
        assert!(length_scale > 0.0, "a length scale is a length");
        let scale = Scale::of(&frames.q);
        let z = scale.standardised(&frames.q);
        Ok(Self { scale, z, tau: frames.tau.clone(), neighbours, length_scale })
    }

    /// For each length scale, the sum of squared errors, (N·m)², of frames that are predicted without
    /// their own part ([`Frames::parts`]).
    fn losses(&self, frames: &Frames, length_scales: &[f64]) -> Vec<f64> {
        let mut losses = vec![0.0; length_scales.len()];
        let parts = frames.parts();
        for part in &parts {
            for query in thinned(part.len(), MAX_QUERIES.div_ceil(parts.len())) {
                let query = part.start + query;
                let near = self.nearest(self.z.column(query).as_slice(), part);
                for (loss, &length_scale) in losses.iter_mut().zip(length_scales) {
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
            // Frames at the same distance are ordered by their index.
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
            let near = self.nearest(z.as_slice(), &(0..0));
            tau.copy_from_slice(&self.mean(&near, self.length_scale));
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
        // Two touches have the same positions and differ by noise of alternating sign, which only a
        // large length scale averages. With the touch itself among the neighbours, a small one would win.
        let q = DMatrix::from_fn(1, 200, |_, frame| (frame % 100) as f64);
        let tau = DMatrix::from_fn(1, 200, |_, frame| {
            let touch = frame / 100;
            if (frame + touch) % 2 == 0 { 1.0 } else { -1.0 }
        });
        let frames = Frames { q, tau, touch: (0..200).map(|frame| frame / 100).collect() };
        let length_scales = [0.01, 0.1, 1.0];
        let mut knn = Knn::with_length_scale(&frames, NEIGHBOURS, 0.01).unwrap();
        let losses = knn.losses(&frames, &length_scales);
        assert!(losses[0] > 2.0 * losses[2], "{losses:?}");
        knn.choose(&frames, &length_scales);
        assert_eq!(knn.length_scale, 1.0);
    }
}
