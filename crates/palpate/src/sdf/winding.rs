//! Generalised winding number: share of the full solid angle that a surface covers, seen from a
//! point.
//!
//! For a closed surface it is 1 at a point inside and 0 outside; for an open shell it is close to
//! these, and one half is the natural boundary (Jacobson et al. 2013). Far clusters of triangles
//! are approximated by one dipole (Barill et al. 2018), so a query costs O(log n): some
//! microseconds for 4,000 triangles.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};

/// Distance beyond which a cluster is approximated by a dipole, in radii of the cluster.
const FAR_RADII: f64 = 3.0;
const LEAF_TRIANGLES: usize = 6;

/// Triangles in clusters of clusters.
pub(super) struct WindingTree {
    /// Preorder: a node's first child follows it.
    nodes: Vec<Cluster>,
    /// In the order of the leaves.
    triangles: Vec<[Point3<f64>; 3]>,
}

struct Cluster {
    /// Area-weighted centre of its triangles.
    centre: Point3<f64>,
    /// Beyond this distance, squared, the cluster is a dipole.
    far_sq: f64,
    /// Sum of the triangles' normals times their areas.
    area_vector: Vector3<f64>,
    /// Its triangles, if it is a leaf; empty otherwise.
    leaf: std::ops::Range<usize>,
    /// The node that follows all of its descendants.
    next: usize,
}

impl WindingTree {
    pub(super) fn new(mut triangles: Vec<[Point3<f64>; 3]>) -> WindingTree {
        let mut nodes = Vec::new();
        let end = triangles.len();
        if end > 0 {
            split(&mut triangles, 0, &mut nodes);
        }
        WindingTree { nodes, triangles }
    }

    /// Winding number at a point: about 1 inside, 0 outside, any value near the rim of an opening.
    pub(super) fn at(&self, point: &Point3<f64>) -> f64 {
        let (mut sum, mut index) = (0.0, 0);
        while let Some(node) = self.nodes.get(index) {
            let away = node.centre - point;
            let distance_sq = away.norm_squared();
            if distance_sq > node.far_sq {
                sum += node.area_vector.dot(&away) / (distance_sq * distance_sq.sqrt());
                index = node.next;
            } else if node.leaf.is_empty() {
                index += 1;
            } else {
                sum += self.triangles[node.leaf.clone()]
                    .iter()
                    .map(|triangle| solid_angle(triangle, point))
                    .sum::<f64>();
                index = node.next;
            }
        }
        sum / (4.0 * PI)
    }
}

/// Appends the cluster of `triangles` and its descendants; `first` is the index of the first of
/// them.
fn split(triangles: &mut [[Point3<f64>; 3]], first: usize, nodes: &mut Vec<Cluster>) {
    let own = nodes.len();
    nodes.push(cluster(triangles));
    if triangles.len() <= LEAF_TRIANGLES {
        nodes[own].leaf = first..first + triangles.len();
    } else {
        let (mut low, mut high) = (Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN));
        for triangle in triangles.iter() {
            low = low.inf(&middle(triangle));
            high = high.sup(&middle(triangle));
        }
        let axis = (high - low).imax();
        let half = triangles.len() / 2;
        triangles.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        let (left, right) = triangles.split_at_mut(half);
        split(left, first, nodes);
        split(right, first + half, nodes);
    }
    nodes[own].next = nodes.len();
}

fn cluster(triangles: &[[Point3<f64>; 3]]) -> Cluster {
    let (mut area, mut area_vector, mut moment) = (0.0, Vector3::zeros(), Vector3::zeros());
    for triangle in triangles {
        let vector = area_vector_of(triangle);
        area_vector += vector;
        area += vector.norm();
        moment += vector.norm() * middle(triangle);
    }
    let centre = Point3::from(moment / area);
    let radius_sq = (triangles.iter().flatten())
        .map(|vertex| (vertex - centre).norm_squared())
        .fold(0.0, f64::max);
    let far_sq = FAR_RADII * FAR_RADII * radius_sq;
    Cluster { centre, far_sq, area_vector, leaf: 0..0, next: 0 }
}

/// Normal of a triangle, as long as its area.
pub(super) fn area_vector_of([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (b - a).cross(&(c - a)) / 2.0
}

fn middle([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (a.coords + b.coords + c.coords) / 3.0
}

/// Solid angle of a triangle, positive if seen from behind (van Oosterom, Strackee).
fn solid_angle(triangle: &[Point3<f64>; 3], point: &Point3<f64>) -> f64 {
    let [a, b, c] = triangle.map(|vertex| vertex - point);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    let determinant = a.dot(&b.cross(&c));
    let divisor = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
    // atan2(0, negative) would be π on the plane of the triangle, seen from its rim: take no side.
    if determinant == 0.0 { 0.0 } else { 2.0 * determinant.atan2(divisor) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of radius 1 about the origin: an octahedron, split and blown up.
    fn ball() -> Vec<[Point3<f64>; 3]> {
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(Point3::from);
        let mut triangles = Vec::new();
        for signs in 0..8 {
            let flip =
                |point: Point3<f64>, bit: u32| if signs >> bit & 1 == 0 { point } else { -point };
            let (a, b, c) = (flip(x, 0), flip(y, 1), flip(z, 2));
            let odd = u32::count_ones(signs) % 2 == 1;
            triangles.push(if odd { [a, c, b] } else { [a, b, c] });
        }
        for _ in 0..4 {
            triangles = triangles
                .into_iter()
                .flat_map(|[a, b, c]: [Point3<f64>; 3]| {
                    let [ab, bc, ca] = [(a, b), (b, c), (c, a)]
                        .map(|(p, q)| Point3::from((p.coords + q.coords).normalize()));
                    [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
                })
                .collect();
        }
        triangles
    }

    #[test]
    fn clusters_give_the_sum_over_all_triangles_even_for_half_a_ball() {
        let half: Vec<_> =
            ball().into_iter().filter(|corners| corners.iter().all(|v| v.x > -0.01)).collect();
        let tree = WindingTree::new(half.clone());
        for step in 0..400 {
            let turn = f64::from(step) * 2.4;
            let radius = f64::from(step) * 0.005;
            let point = Point3::new(radius * turn.cos(), radius * turn.sin(), 0.3 - radius / 4.0);
            let sum: f64 = half.iter().map(|triangle| solid_angle(triangle, &point)).sum();
            let (tree, sum) = (tree.at(&point), sum / (4.0 * PI));
            assert!((tree - sum).abs() < 0.01, "{point}: {tree}, should be {sum}");
        }
    }

    #[test]
    fn the_winding_number_of_a_closed_surface_is_one_inside_and_zero_outside() {
        let tree = WindingTree::new(ball());
        for (x, covered) in [(0.0, 1.0), (0.5, 1.0), (-0.9, 1.0), (1.1, 0.0), (30.0, 0.0)] {
            let found = tree.at(&Point3::new(x, 0.01, 0.02));
            assert!((found - covered).abs() < 0.02, "x = {x}: {found}, should be {covered}");
        }
    }
}
