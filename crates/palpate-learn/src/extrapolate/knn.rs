//! The paper's regression (Sec. III-B): touched points get the stiffness of the touched cells around
//! them, all others the mean of the touched points with the most similar features, weighted by an
//! RBF kernel.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Dimension of the search: three features of a colour, one of height, three of shape.
const FEATURES: usize = 7;

/// Stiffness of every point and its standard deviation among the neighbours, N/m.
///
/// `touched` are the stiffness and the weight of each touched point; `features` are
/// n_features × points. A touched point keeps its stiffness.
pub(super) fn at_all_points(
    features: &DMatrix<f64>,
    touched: &[Option<(f64, f64)>],
    neighbours: usize,
    length_scale: f64,
) -> (Vec<f64>, Vec<f64>) {
    let place = |point: usize| {
        let mut place = [0.0; FEATURES];
        place.iter_mut().zip(&features.column(point)).for_each(|(place, value)| *place = *value);
        place
    };
    let trained: Vec<(usize, f64, f64)> = (touched.iter().enumerate())
        .filter_map(|(point, known)| known.map(|(k, weight)| (point, k, weight)))
        .collect();
    let places: Vec<[f64; FEATURES]> = trained.iter().map(|(point, ..)| place(*point)).collect();
    let tree: ImmutableKdTree<f64, FEATURES> = ImmutableKdTree::new_from_slice(&places);
    let count = NonZero::new(neighbours.min(trained.len())).unwrap_or(NonZero::<usize>::MIN);
    let at = |point: usize| {
        let near = tree.nearest_n::<SquaredEuclidean>(&place(point), count);
        let nearest = near.iter().map(|near| near.distance).fold(f64::INFINITY, f64::min);
        let (mut sum, mut squares, mut weights) = (0.0, 0.0, 0.0);
        for near in &near {
            let (_, k, weight) = trained[near.item as usize];
            // Relative to the nearest neighbour, so that not all weights underflow if all are far away.
            let weight = weight * (0.5 * (nearest - near.distance) / length_scale.powi(2)).exp();
            sum += weight * k;
            squares += weight * k * k;
            weights += weight;
        }
        let mean = sum / weights;
        let deviation = (squares / weights - mean * mean).max(0.0).sqrt();
        (touched[point].map_or(mean, |(k, _)| k), deviation)
    };
    (0..features.ncols()).into_par_iter().map(at).unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_take_the_stiffness_of_those_that_look_alike() {
        let features = DMatrix::from_row_slice(1, 6, &[0.0, 0.1, 5.0, 5.1, 0.05, 5.05]);
        let touched =
            [Some((1.0, 1.0)), Some((3.0, 1.0)), Some((10.0, 1.0)), Some((10.0, 1.0)), None, None];
        let (k, deviation) = at_all_points(&features, &touched, 2, 1.0);
        assert_eq!(k[..4], [1.0, 3.0, 10.0, 10.0]);
        assert!((k[4] - 2.0).abs() < 1e-9 && (k[5] - 10.0).abs() < 1e-9, "{k:?}");
        assert!((deviation[4] - 1.0).abs() < 1e-9 && deviation[5] < 1e-9);
    }

    #[test]
    fn a_cell_with_little_displacement_counts_less() {
        let features = DMatrix::from_row_slice(1, 3, &[0.0, 0.0, 0.0]);
        let touched = [Some((1.0, 0.9)), Some((10.0, 0.1)), None];
        let (k, _) = at_all_points(&features, &touched, 50, 1.0);
        assert!((k[2] - 1.9).abs() < 1e-9, "{k:?}");
    }
}
