//! A graph of points with edges to near neighbours: connected components, and distances along the surface.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;

/// Points with edges to all others within a radius.
pub(super) struct Graph {
    neighbours: Vec<Vec<(u32, f64)>>,
}

impl Graph {
    /// Joins points within `radius_m` of each other for which `joins` is true.
    pub(super) fn new(
        points: &[Point3<f64>],
        radius_m: f64,
        joins: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let places: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
        if places.is_empty() {
            return Self { neighbours: Vec::new() };
        }
        let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&places);
        let around = |(at, place): (usize, &[f64; 3])| {
            let found = tree.within_unsorted::<SquaredEuclidean>(place, radius_m * radius_m);
            let mut found: Vec<(u32, f64)> = (found.iter())
                .map(|near| (near.item as u32, near.distance.sqrt()))
                .filter(|(other, _)| *other as usize != at && joins(at, *other as usize))
                .collect();
            found.sort_unstable_by_key(|(other, _)| *other);
            found
        };
        Self { neighbours: places.iter().enumerate().map(around).collect() }
    }

    /// Neighbours of a point, and their distances, m.
    pub(super) fn neighbours(&self, point: usize) -> &[(u32, f64)] {
        &self.neighbours[point]
    }

    /// The connected components of these points, each in rising order, in the order of their first points.
    pub(super) fn pieces(&self, points: &[u32]) -> Vec<Vec<u32>> {
        let mut open = vec![false; self.neighbours.len()];
        points.iter().for_each(|&point| open[point as usize] = true);
        let mut pieces = Vec::new();
        for &first in points {
            if !std::mem::take(&mut open[first as usize]) {
                continue;
            }
            let (mut piece, mut next) = (vec![first], 0);
            while next < piece.len() {
                for &(other, _) in self.neighbours(piece[next] as usize) {
                    if std::mem::take(&mut open[other as usize]) {
                        piece.push(other);
                    }
                }
                next += 1;
            }
            piece.sort_unstable();
            pieces.push(piece);
        }
        pieces
    }

    /// Length of the shortest path along edges from any of `starts` to each point, m; infinite if there is none.
    pub(super) fn distances_m(&self, starts: &[u32]) -> Vec<f64> {
        let mut distances = vec![f64::INFINITY; self.neighbours.len()];
        // Distances are not negative, so their bits as integers have the same order.
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
        for &start in starts {
            distances[start as usize] = 0.0;
            queue.push(Reverse((0, start)));
        }
        while let Some(Reverse((bits, point))) = queue.pop() {
            let distance = f64::from_bits(bits);
            if distance > distances[point as usize] {
                continue;
            }
            for &(other, length) in self.neighbours(point as usize) {
                let through = distance + length;
                if through < distances[other as usize] {
                    distances[other as usize] = through;
                    queue.push(Reverse((through.to_bits(), other)));
                }
            }
        }
        distances
    }
}
