//! A coloured point cloud, and the cells of a lattice near it.

use std::collections::BTreeSet;
use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;
use palpate::{CellId, Lattice};
use rayon::prelude::*;

use super::error::ExtrapolateError;

/// A coloured point cloud of the object, in the world frame.
pub struct SeenCloud {
    points_m: Vec<[f64; 3]>,
    colours: Vec<[u8; 3]>,
    tree: ImmutableKdTree<f64, 3>,
}

impl SeenCloud {
    /// From points in the world frame, m, and the colour (sRGB) of each.
    ///
    /// # Errors
    ///
    /// Without a point.
    ///
    /// # Panics
    ///
    /// If there is not one colour for each point, which is a bug in the caller.
    pub fn new(points: &[Point3<f64>], colours: &[[u8; 3]]) -> Result<Self, ExtrapolateError> {
        assert_eq!(points.len(), colours.len(), "a colour for each point");
        if points.is_empty() {
            return Err(ExtrapolateError::NothingSeen);
        }
        let points_m: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
        let tree = ImmutableKdTree::new_from_slice(&points_m);
        Ok(Self { points_m, colours: colours.to_vec(), tree })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points_m.len()
    }

    /// Always false: there is at least one point.
    pub fn is_empty(&self) -> bool {
        self.points_m.is_empty()
    }

    /// The points, world frame, m.
    pub fn points_m(&self) -> &[[f64; 3]] {
        &self.points_m
    }

    /// Their colours, sRGB.
    pub fn colours(&self) -> &[[u8; 3]] {
        &self.colours
    }

    /// The seen point nearest to a place, and its distance, m.
    pub fn nearest(&self, place_m: &[f64; 3]) -> (usize, f64) {
        let nearest = self.tree.nearest_one::<SquaredEuclidean>(place_m);
        (nearest.item as usize, nearest.distance.sqrt())
    }

    /// The `count` seen points nearest to a place, or all of them.
    pub(super) fn neighbours(&self, place_m: &[f64; 3], count: usize) -> Vec<usize> {
        let count = NonZero::new(count).unwrap_or(NonZero::<usize>::MIN);
        let found = self.tree.nearest_n::<SquaredEuclidean>(place_m, count);
        found.iter().map(|neighbour| neighbour.item as usize).collect()
    }

    /// For each place, the nearest seen point, if it is within reach.
    pub fn at(&self, places_m: &[[f64; 3]], reach_m: f64) -> Vec<Option<u32>> {
        places_m.par_iter().map(|place| self.nearest_within(place, reach_m)).collect()
    }

    /// The seen point nearest to a place, if it is within reach.
    fn nearest_within(&self, place_m: &[f64; 3], reach_m: f64) -> Option<u32> {
        let (one, within) = (NonZero::<usize>::MIN, reach_m * reach_m);
        let found = self.tree.nearest_n_within::<SquaredEuclidean>(place_m, within, one, true);
        found.first().map(|nearest| nearest.item as u32)
    }

    /// The cells of a lattice within reach of a seen point, each with the point nearest to it, in
    /// the lattice's order.
    pub fn cells(&self, lattice: &Lattice, reach_m: f64) -> Vec<(CellId, u32)> {
        let reach = nalgebra::Vector3::repeat(reach_m);
        let places_about = |point: &[f64; 3]| {
            let point = Point3::from(*point);
            lattice.places_within(&(point - reach), &(point + reach))
        };
        // Points that are close together often have the same box of cells.
        let mut boxes: Vec<([u32; 3], [u32; 3])> =
            self.points_m.par_iter().map(places_about).collect();
        boxes.par_sort_unstable();
        boxes.dedup();
        let mut cells = BTreeSet::new();
        for (first, end) in boxes {
            for k in first[2]..end[2] {
                for j in first[1]..end[1] {
                    cells.extend((first[0]..end[0]).map(|i| lattice.cell([i, j, k])));
                }
            }
        }
        let cells: Vec<CellId> = cells.into_iter().collect();
        let at = |&cell: &CellId| {
            Some((cell, self.nearest_within(&lattice.point(cell).into(), reach_m)?))
        };
        cells.par_iter().filter_map(at).collect()
    }

    /// Checks that at least one touched place is within reach of a seen point.
    ///
    /// # Errors
    ///
    /// States the distance between cloud and touched places.
    pub(super) fn must_meet(
        &self,
        touched_m: &[[f64; 3]],
        reach_m: f64,
    ) -> Result<(), ExtrapolateError> {
        if touched_m.is_empty() {
            return Err(ExtrapolateError::NothingTouched);
        }
        let meets = |place: &[f64; 3]| self.nearest_within(place, reach_m).is_some();
        if touched_m.par_iter().any(meets) {
            return Ok(());
        }
        let distance = |place: &[f64; 3]| self.nearest(place).1;
        let gap_m = touched_m.par_iter().map(distance).reduce(|| f64::INFINITY, f64::min);
        let [cloud, field] = [bounds(&self.points_m), bounds(touched_m)];
        let apart_m = [0, 1, 2].map(|axis| {
            (cloud[0][axis] - field[1][axis]).max(field[0][axis] - cloud[1][axis]).max(0.0_f64)
        });
        if apart_m.iter().any(|&m| m > 0.0) {
            let (cloud, field) = (in_words(&cloud), in_words(&field));
            return Err(ExtrapolateError::Apart { gap_m, apart_m, cloud, field });
        }
        Err(ExtrapolateError::NoneTouched { gap_m, reach_m })
    }
}

/// The bounding box of points: its lowest and its highest corner, m.
fn bounds(points_m: &[[f64; 3]]) -> [[f64; 3]; 2] {
    let corner = |start: f64, pick: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|axis| points_m.iter().map(|point| point[axis]).fold(start, pick))
    };
    [corner(f64::INFINITY, f64::min), corner(f64::NEG_INFINITY, f64::max)]
}

fn in_words([low, high]: &[[f64; 3]; 2]) -> String {
    let side = |axis: usize| format!("{:.2} to {:.2}", low[axis], high[axis]);
    format!("x {}, y {}, z {}", side(0), side(1), side(2))
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn cells_and_points_are_those_of_looking_at_every_pair() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut place = || [(); 3].map(|()| f64::from(rng.next_u32()) / f64::from(u32::MAX));
        let lattice = Lattice::new([0.1; 3], 0.05, [16, 17, 18]).unwrap();
        let mut points: Vec<Point3<f64>> = (0..60).map(|_| Point3::from(place())).collect();
        points.extend_from_within(..20); // seen twice
        let seen = SeenCloud::new(&points, &vec![[0; 3]; points.len()]).unwrap();
        let reach_m = 0.08;
        let nearest = |at: &Point3<f64>| {
            points.iter().map(|point| (point - at).norm()).fold(f64::INFINITY, f64::min)
        };

        let cells = seen.cells(&lattice, reach_m);
        let wanted = (0..lattice.n_cells() as u32).map(CellId);
        let wanted = wanted.filter(|cell| nearest(&lattice.point(*cell)) <= reach_m);
        assert!(cells.iter().map(|(cell, _)| *cell).eq(wanted), "in the lattice's order");
        for (cell, point) in cells {
            let at = lattice.point(cell);
            assert!(((points[point as usize] - at).norm() - nearest(&at)).abs() < 1e-12);
        }

        let places: Vec<[f64; 3]> = (0..200).map(|_| place()).collect();
        for (found, place) in seen.at(&places, reach_m).into_iter().zip(&places) {
            assert_eq!(found.is_some(), nearest(&Point3::from(*place)) <= reach_m);
        }
    }
}
