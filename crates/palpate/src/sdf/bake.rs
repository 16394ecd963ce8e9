//! Bakes the shapes of a link into a grid.
//!
//! Primitives are exact. Triangles take five steps, since published meshes are open shells with inner walls, for which
//! the normal at the closest point gives the wrong side in a tenth of the volume:
//!
//! 1. every node gets its distance from the nearest triangle and its winding number `w`;
//! 2. a flood from the rim of the grid finds the nodes that no path from outside reaches;
//! 3. **inside is `w ≥ ½`, or sealed**: the winding number decides, and the flood only adds voids
//!    that are closed on all sides. It cannot mark nodes as outside, since it leaks through any
//!    crack. A second flood, which does not pass cracks narrower than a cell, finds the real
//!    openings of the shell: the [`BakeReport`] has the share of the volume that is inside by the
//!    winding number alone;
//! 4. inside, distances are measured from the *skin* only, the triangles with the outside on one of
//!    their sides: otherwise a point deep inside, at an inner wall, would count as near the surface;
//! 5. where the sign changes without a triangle (across an opening) the surface is where `w = ½`.
//!
//! The link is the union of its shapes: `φ = min φᵢ`. That is exact outside; inside, where shapes
//! overlap, the depth is that of the deepest shape alone.

use nalgebra::{Point3, Vector3, vector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::mesh::{Soup, Surface, TriangleMesh};
use super::winding::{WindingTree, area_vector_of};
use super::{DistanceGrid, SdfError, flood, primitive};
use crate::lattice::MAX_COORDINATE_M;
use crate::robot::Collision;

/// Largest number of nodes: at 5 mm, a cube of one metre. Baking takes some hundred bytes per node.
const MAX_NODES: f64 = 8e6;

/// Resolution and extent of the baked grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct BakeConfig {
    /// Distance between nodes. Smaller details are lost.
    pub spacing_m: f64,
    /// The grid reaches this far beyond the surface; farther out, distances are lower bounds. Must be at
    /// least the contact distance.
    pub margin_m: f64,
}

impl BakeConfig {
    /// Nodes every `spacing_m`, as far as `margin_m` from the surface.
    pub const fn new(spacing_m: f64, margin_m: f64) -> Self {
        Self { spacing_m, margin_m }
    }
}

impl Default for BakeConfig {
    fn default() -> Self {
        Self::new(0.005, 0.04)
    }
}

/// All shapes of one link, in its frame.
#[derive(Debug, Clone, Default)]
pub struct Solid {
    /// Box, cylinder, sphere, capsule.
    pub primitives: Vec<Collision>,
    /// Triangles, all meshes of the link.
    pub meshes: Vec<TriangleMesh>,
}

/// Report on the meshes of a link; all zero for primitives, except the volume.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct BakeReport {
    /// Number of baked triangles.
    pub triangles: usize,
    /// Number of triangles without area, which are left out.
    pub degenerate: usize,
    /// Number of triangles that faced inwards and were flipped.
    pub flipped: usize,
    /// Volume inside, by counting nodes.
    pub inside_m3: f64,
    /// Share of the meshes' inside volume that can be reached from outside through openings wider than about a cell: it
    /// is inside by the winding number alone. Zero for a closed mesh.
    pub leaked_fraction: f64,
    /// Share of the meshes' inside volume that is outside by the winding number, but counts as inside because no path
    /// from outside leads there.
    pub sealed_fraction: f64,
}

/// Bakes the shapes of a link, on all threads.
///
/// The result does not depend on the number of threads. Cost: some microseconds a node, divided by
/// the threads; `8 × 4,000` triangles at 5 mm take under two seconds on two cores.
///
/// # Errors
///
/// A config out of range, a solid without shapes, a broken mesh ([`SdfError`]), or a solid that is
/// too large.
pub fn bake(solid: &Solid, config: &BakeConfig) -> Result<(DistanceGrid, BakeReport), SdfError> {
    config.check()?;
    let soup = match &solid.meshes[..] {
        [] if solid.primitives.is_empty() => return Err(SdfError::Empty { triangles: 0 }),
        [] => None,
        meshes => Some(Soup::new(meshes)?),
    };
    let surface = surface_box(&solid.primitives, soup.as_ref());
    let lattice = NodeGrid::around(surface, config)?;

    let mut report = BakeReport::default();
    let mut nodes = vec![f64::INFINITY; lattice.len()];
    if let Some(soup) = soup {
        nodes = bake_soup(&lattice, &soup.triangles, &mut report);
        report.triangles = soup.triangles.len();
        report.degenerate = soup.degenerate;
        report.flipped = soup.flipped;
    }
    let nodes_m: Vec<f32> = on_all_threads(lattice.len(), |node| {
        let point = lattice.point(node);
        let union = |so_far: f64, part: &Collision| {
            let in_shape = part.link_from_shape.inverse_transform_point(&point);
            primitive::signed_distance(&part.shape, &in_shape)
                .map_or(so_far, |distance| so_far.min(distance))
        };
        solid.primitives.iter().fold(nodes[node], union) as f32
    });
    let n_inside = nodes_m.iter().filter(|&&distance| distance < 0.0).count();
    report.inside_m3 = n_inside as f64 * lattice.spacing_m.powi(3);
    let grid =
        DistanceGrid::new(lattice.origin_m, lattice.spacing_m, lattice.shape, surface, nodes_m);
    Ok((grid, report))
}

impl BakeConfig {
    fn check(&self) -> Result<(), SdfError> {
        let positive = |thing, found: f64| {
            let wanted = "a finite length above zero";
            let ok = found > 0.0 && found.is_finite();
            if ok { Ok(()) } else { Err(SdfError::Number { thing, found, wanted }) }
        };
        positive("grid spacing [m]", self.spacing_m)?;
        positive("grid margin [m]", self.margin_m)
    }
}

/// The smallest box around all shapes.
fn surface_box(primitives: &[Collision], soup: Option<&Soup>) -> [Point3<f64>; 2] {
    let mut low = Vector3::repeat(f64::INFINITY);
    let mut high = Vector3::repeat(f64::NEG_INFINITY);
    for part in primitives {
        let Some(half) = primitive::half_extent(&part.shape) else { continue };
        let turned = part.link_from_shape.rotation.to_rotation_matrix().matrix().abs() * half;
        low = low.inf(&(part.link_from_shape.translation.vector - turned));
        high = high.sup(&(part.link_from_shape.translation.vector + turned));
    }
    for vertex in soup.iter().flat_map(|soup| &soup.triangles).flatten() {
        low = low.inf(&vertex.coords);
        high = high.sup(&vertex.coords);
    }
    // Distances are rounded to f32, which must not put the surface outside its box.
    let slack = Vector3::repeat(1e-6);
    [Point3::from(low - slack), Point3::from(high + slack)]
}

/// `f(0)` to `f(n − 1)`, in this order, computed on all threads.
pub(super) fn on_all_threads<T: Send>(n: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..n).into_par_iter().with_min_len(256).map(f).collect()
}

/// Signed distance from triangles at every node: steps 1 to 5 of the module's header.
fn bake_soup(
    lattice: &NodeGrid,
    triangles: &[[Point3<f64>; 3]],
    report: &mut BakeReport,
) -> Vec<f64> {
    let (surface, tree) = (Surface::new(triangles), WindingTree::new(triangles.to_vec()));
    let n = lattice.len();
    let mut distance_m = on_all_threads(n, |node| surface.distance(&lattice.point(node)));
    let winding = on_all_threads(n, |node| tree.at(&lattice.point(node)) as f32);

    let walls = on_all_threads(n, |node| walls(lattice, &surface, &distance_m, node));
    let reached = flood::reached(lattice, |node, axis| walls[node][axis] == Wall::Triangle);
    let by_winding = |node: usize| winding[node] >= 0.5;
    let inside: Vec<bool> = (0..n).map(|node| by_winding(node) || !reached[node]).collect();

    let leaked = flood::reached(lattice, |node, axis| walls[node][axis] != Wall::None);
    let count = |holds: &dyn Fn(usize) -> bool| (0..n).filter(|&node| holds(node)).count() as f64;
    let n_inside = count(&|node| inside[node]).max(1.0);
    report.leaked_fraction = count(&|node| by_winding(node) && leaked[node]) / n_inside;
    report.sealed_fraction = count(&|node| !by_winding(node) && !reached[node]) / n_inside;

    let is_outside = |point: &Point3<f64>| {
        lattice.corners_of(point).iter().any(|&node| !inside[node]) && tree.at(point) < 0.5
    };
    let skin = skin(triangles, lattice.spacing_m, is_outside);
    if !skin.is_empty() && skin.len() != triangles.len() {
        let skin = Surface::new(&skin);
        distance_m = on_all_threads(n, |node| {
            if inside[node] { skin.distance(&lattice.point(node)) } else { distance_m[node] }
        });
    }
    let openings = flood::distance_to_openings(lattice, &winding, &inside, &distance_m);
    on_all_threads(n, |node| {
        let opening = openings.as_ref().map_or(f64::INFINITY, |distance| distance[node]);
        let unsigned = distance_m[node].min(opening);
        if inside[node] { -unsigned } else { unsigned }
    })
}

/// Obstacle between a node and the next.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wall {
    None,
    /// No triangle crosses the edge, but some may be so near that only a narrow gap is left.
    Slit,
    Triangle,
}

/// Obstacle between a node and the next along each axis.
fn walls(lattice: &NodeGrid, surface: &Surface, distance_m: &[f64], node: usize) -> [Wall; 3] {
    std::array::from_fn(|axis| {
        let (_, Some(next)) = lattice.neighbours(node, axis) else { return Wall::None };
        if lattice.proves_free(distance_m[node], distance_m[next]) {
            Wall::None
        } else if surface.separates(&lattice.point(node), &lattice.point(next)) {
            Wall::Triangle
        } else {
            Wall::Slit
        }
    })
}

/// The triangles with the outside on one side, cut down to about the spacing.
fn skin(
    triangles: &[[Point3<f64>; 3]],
    spacing_m: f64,
    is_outside: impl Fn(&Point3<f64>) -> bool + Sync + Send,
) -> Vec<[Point3<f64>; 3]> {
    let pieces_of = |index: usize| {
        let whole = triangles[index];
        let step = area_vector_of(&whole).normalize() * (0.1 * spacing_m);
        let (mut waiting, mut pieces, mut all) = (vec![whole], Vec::new(), true);
        while let Some(piece) = waiting.pop() {
            let [a, b, c] = piece;
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| nalgebra::center(&p, &q));
            let [of_ab, of_bc, of_ca] = [(b - a).norm(), (c - b).norm(), (a - c).norm()];
            let longest = of_ab.max(of_bc).max(of_ca);
            if longest > 2.0 * spacing_m {
                // A needle is halved across: quartering would give as many pieces as for a square.
                let needle = 16.0 * area_vector_of(&piece).norm() < longest.powi(2);
                waiting.extend(match needle {
                    false => vec![[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]],
                    true if longest == of_ab => vec![[a, ab, c], [ab, b, c]],
                    true if longest == of_bc => vec![[b, bc, a], [bc, c, a]],
                    true => vec![[c, ca, b], [ca, a, b]],
                });
                continue;
            }
            let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
            if is_outside(&(middle + step)) || is_outside(&(middle - step)) {
                pieces.push(piece);
            } else {
                all = false;
            }
        }
        if all { vec![whole] } else { pieces }
    };
    on_all_threads(triangles.len(), pieces_of).into_iter().flatten().collect()
}

/// Positions of the nodes of a grid.
pub(super) struct NodeGrid {
    pub origin_m: Point3<f64>,
    pub spacing_m: f64,
    pub shape: [usize; 3],
}

impl NodeGrid {
    /// Nodes that reach at least the margin beyond a box on every side.
    fn around([low, high]: [Point3<f64>; 2], config: &BakeConfig) -> Result<NodeGrid, SdfError> {
        let spacing_m = config.spacing_m;
        // A third of a cell keeps nodes off planes at round coordinates, where many faces lie.
        let origin_m = low - Vector3::repeat(config.margin_m + spacing_m / 3.0);
        let n = (high - origin_m).map(|span| ((span + config.margin_m) / spacing_m).ceil() + 1.0);
        if n.product() > MAX_NODES {
            return Err(SdfError::TooLarge { span_m: (high - low).into(), spacing_m });
        }
        let far = [low, high].into_iter().flat_map(|corner| [corner.x, corner.y, corner.z]);
        if let Some(found) = far.into_iter().find(|x| x.abs() > MAX_COORDINATE_M) {
            let wanted = "at most 1000 m; is it in millimetres?";
            return Err(SdfError::Number { thing: "a coordinate of the shape", found, wanted });
        }
        Ok(NodeGrid { origin_m, spacing_m, shape: [n.x as usize, n.y as usize, n.z as usize] })
    }

    pub(super) fn len(&self) -> usize {
        self.shape.iter().product()
    }

    pub(super) fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        i + self.shape[0] * (j + self.shape[1] * k)
    }

    fn coordinates(&self, node: usize) -> [usize; 3] {
        let [nx, ny, _] = self.shape;
        [node % nx, node / nx % ny, node / (nx * ny)]
    }

    fn point(&self, node: usize) -> Point3<f64> {
        let [i, j, k] = self.coordinates(node);
        self.origin_m + vector![i as f64, j as f64, k as f64] * self.spacing_m
    }

    pub(super) fn on_rim(&self, node: usize) -> bool {
        (0..3).any(|axis| {
            let (before, after) = self.neighbours(node, axis);
            before.is_none() || after.is_none()
        })
    }

    /// The nodes before and after a node along an axis.
    pub(super) fn neighbours(&self, node: usize, axis: usize) -> (Option<usize>, Option<usize>) {
        let at = self.coordinates(node)[axis];
        let substeps: usize = self.shape[..axis].iter().product();
        ((at > 0).then(|| node - substeps), (at + 1 < self.shape[axis]).then(|| node + substeps))
    }

    /// Whether the distances of two neighbours prove that no surface crosses their edge: the balls without surface
    /// around both nodes cover the edge, with a margin, since at a face perpendicular to the edge they just cover it.
    pub(super) fn proves_free(&self, one_m: f64, other_m: f64) -> bool {
        one_m + other_m > self.spacing_m * (1.0 + 1e-6)
    }

    /// The nodes of the cell that holds a point.
    fn corners_of(&self, point: &Point3<f64>) -> [usize; 8] {
        let scaled = (point - self.origin_m) / self.spacing_m;
        std::array::from_fn(|corner| {
            self.index(std::array::from_fn(|axis| {
                let cell = (scaled[axis] as usize).min(self.shape[axis] - 2);
                cell + (corner >> axis & 1)
            }))
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::point;

    use super::*;

    #[test]
    fn the_skin_of_a_long_needle_is_few_pieces_that_cover_what_is_outside() {
        let (length_m, width_m, spacing_m) = (80.0, 0.1, 0.05);
        let corners =
            [point![0.0, 0.0, 0.0], point![length_m, 0.0, 0.0], point![0.0, width_m, 0.0]];
        for turn in 0..3 {
            let mut needle = corners;
            needle.rotate_left(turn);
            let outside = |p: &Point3<f64>| p.x < length_m / 2.0;
            let pieces = skin(&[needle], spacing_m, outside);
            assert!(pieces.len() < 50_000, "{}", pieces.len());
            let area: f64 = pieces.iter().map(|piece| area_vector_of(piece).norm()).sum();
            let expected = length_m * width_m / 2.0 * 0.75;
            assert!((area / expected - 1.0).abs() < 0.01, "{area} m2 of {expected}");
        }
    }
}
