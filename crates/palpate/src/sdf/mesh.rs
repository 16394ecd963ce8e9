//! Triangles of mesh files, cleaned for distance queries.
//!
//! Files have open shells, duplicate vertices, triangles without area and parts turned inside out.
//! Vertices at equal coordinates are welded to find connected parts that face one way. A *closed*
//! part with negative volume is flipped; so a hollow part is taken as solid. In an open part a
//! triangle is flipped if more rays from its back than from its front meet no other triangle, that
//! is, see the sky (after Takayama et al. 2014): lids of published meshes face the wrong way.
//! Remaining defects are left to the winding number.

use std::collections::HashMap;

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

use super::SdfError;
use super::bake::on_all_threads;
use super::winding::area_vector_of;

/// A triangle thinner than this part of its longest edge has no usable normal.
const SLIVER: f64 = 1e-9;

/// Largest coordinate of a vertex; with larger ones, areas and volumes would overflow.
const FARTHEST_M: f64 = 1e9;
/// Number of rays that are sent from a triangle of an open part.
const SAMPLED_DIRECTIONS: usize = 24;
/// A triangle whose front and back differ by more than this in the share of rays that see the sky
/// is oriented by itself; others follow the majority of their part.
const CLEAR_VOTE: f64 = 0.25;

/// Triangles in the frame of a mesh or a link.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// In metres, once transformed into a link's frame.
    pub vertices: Vec<Point3<f64>>,
    /// Three indices into `vertices` each, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// The mesh in the frame of its link: scaled first, as URDF says, then moved.
    ///
    /// A scale that mirrors turns the triangles round, so that their normals still point outwards.
    #[must_use]
    pub fn into_link(
        mut self,
        link_from_shape: &Isometry3<f64>,
        scale: &Vector3<f64>,
    ) -> TriangleMesh {
        for vertex in &mut self.vertices {
            *vertex = link_from_shape * Point3::from(vertex.coords.component_mul(scale));
        }
        if scale.product() < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        self
    }

    fn check(&self) -> Result<(), SdfError> {
        for (triangle, corners) in self.triangles.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= self.vertices.len()) {
                let vertices = self.vertices.len();
                return Err(SdfError::Vertex { triangle, vertex, vertices });
            }
        }
        let mut numbers = self.vertices.iter().flat_map(|vertex| vertex.iter());
        match numbers.find(|number| number.is_nan() || number.abs() > FARTHEST_M) {
            Some(&found) => Err(SdfError::Number {
                thing: "coordinate of a mesh vertex",
                found,
                wanted: "a finite number of at most 1e9 m",
            }),
            None => Ok(()),
        }
    }
}

/// All triangles of a link, cleaned, with the numbers of removed and of flipped ones.
#[derive(Debug)]
pub(super) struct Soup {
    pub triangles: Vec<[Point3<f64>; 3]>,
    pub degenerate: usize,
    pub flipped: usize,
}

impl Soup {
    /// Gathers and cleans; an error if a mesh is broken or nothing with an area is left.
    pub(super) fn new(meshes: &[TriangleMesh]) -> Result<Soup, SdfError> {
        let mut all = Vec::new();
        for mesh in meshes {
            mesh.check()?;
            let corner = |v: u32| mesh.vertices[v as usize];
            all.extend(mesh.triangles.iter().map(|corners| corners.map(corner)));
        }
        let turn = inside_out(&all);
        let (mut flipped, mut kept) = (0, Vec::with_capacity(all.len()));
        for (mut triangle, turn) in all.iter().copied().zip(turn) {
            if is_degenerate(&triangle) {
                continue;
            }
            if turn {
                triangle.swap(1, 2);
                flipped += 1;
            }
            kept.push(triangle);
        }
        let degenerate = all.len() - kept.len();
        if kept.is_empty() {
            return Err(SdfError::Empty { triangles: all.len() });
        }
        Ok(Soup { triangles: kept, degenerate, flipped })
    }
}

/// Which triangles face inwards.
fn inside_out(all: &[[Point3<f64>; 3]]) -> Vec<bool> {
    let parts = Parts::of(&weld(all));
    let sound: Vec<_> = all.iter().copied().filter(|triangle| !is_degenerate(triangle)).collect();
    if sound.is_empty() {
        return vec![false; all.len()];
    }
    let surface = Surface::new(&sound);
    let sky = on_all_threads(all.len(), |index| {
        let looks = parts.open[parts.of_triangle[index]] && !is_degenerate(&all[index]);
        if looks { sky_seen_in_front_minus_behind(&all[index], &surface) } else { 0.0 }
    });

    // A closed part is judged by its volume, an open one by its triangles' votes.
    let (mut votes, origin) = (vec![0.0; all.len()], sound[0][0]);
    for (index, (triangle, &part)) in all.iter().zip(&parts.of_triangle).enumerate() {
        let [a, b, c] = triangle.map(|vertex| vertex - origin);
        let volume = a.dot(&b.cross(&c));
        let vote = sky[index] * area_vector_of(triangle).norm();
        votes[part] += if parts.open[part] { vote } else { volume };
    }
    (sky.iter().zip(&parts.of_triangle))
        .map(|(&sky, &part)| if sky.abs() > CLEAR_VOTE { sky < 0.0 } else { votes[part] < 0.0 })
        .collect()
}

/// Share of rays that see the sky in front of a triangle, minus that behind it, −1 to 1.
fn sky_seen_in_front_minus_behind(triangle: &[Point3<f64>; 3], surface: &Surface) -> f64 {
    let normal = area_vector_of(triangle).normalize();
    let middle =
        Point3::from(triangle.iter().map(|vertex| vertex.coords).sum::<Vector3<f64>>() / 3.0);
    let votes = (0..SAMPLED_DIRECTIONS).map(|sample| {
        let ray = direction(sample);
        let side = normal.dot(&ray).signum();
        let sky = surface.sees_the_sky(&(middle + normal * (1e-5 * side)), &ray);
        if sky { side } else { 0.0 }
    });
    2.0 * votes.sum::<f64>() / SAMPLED_DIRECTIONS as f64
}

/// Directions that cover the sphere evenly (a golden spiral).
fn direction(sample: usize) -> Vector3<f64> {
    let z = 1.0 - (2 * sample + 1) as f64 / SAMPLED_DIRECTIONS as f64;
    let turn = sample as f64 * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let across = (1.0 - z * z).sqrt();
    Vector3::new(across * turn.cos(), across * turn.sin(), z)
}

fn is_degenerate(triangle: &[Point3<f64>; 3]) -> bool {
    let [a, b, c] = triangle;
    let longest_sq = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    area_vector_of(triangle).norm() <= SLIVER * longest_sq
}

/// Vertex numbers such that vertices at the same place have the same number.
fn weld(triangles: &[[Point3<f64>; 3]]) -> Vec<[usize; 3]> {
    let mut numbers = HashMap::new();
    let mut number = |vertex: &Point3<f64>| {
        let key = [vertex.x, vertex.y, vertex.z].map(|x| (x + 0.0).to_bits()); // -0.0 is 0.0
        let next = numbers.len();
        *numbers.entry(key).or_insert(next)
    };
    triangles.iter().map(|[a, b, c]| [number(a), number(b), number(c)]).collect()
}

/// Connected parts, each named by one of its triangles.
struct Parts {
    of_triangle: Vec<usize>,
    /// By name: whether an edge is not used equally often in both directions.
    open: Vec<bool>,
}

impl Parts {
    /// Triangles are connected if they share an edge and use it in opposite directions, so that all
    /// triangles of a part face the same way.
    fn of(welded: &[[usize; 3]]) -> Parts {
        let mut walks: HashMap<[usize; 2], Vec<usize>> = HashMap::new();
        let edges = |&[a, b, c]: &[usize; 3]| {
            [[a, b], [b, c], [c, a]].into_iter().filter(|[from, to]| from != to)
        };
        for (index, corners) in welded.iter().enumerate() {
            edges(corners).for_each(|edge| walks.entry(edge).or_default().push(index));
        }
        let mut leader: Vec<usize> = (0..welded.len()).collect();
        let mut unmatched = Vec::new();
        for (index, corners) in welded.iter().enumerate() {
            for [from, to] in edges(corners) {
                let (there, back) = (&walks[&[from, to]], walks.get(&[to, from]));
                if back.is_none_or(|back| back.len() != there.len()) {
                    unmatched.push(index);
                }
                for &other in back.into_iter().flatten() {
                    let (one, other) = (find(&mut leader, index), find(&mut leader, other));
                    leader[one.max(other)] = one.min(other);
                }
            }
        }
        let of_triangle: Vec<usize> =
            (0..welded.len()).map(|index| find(&mut leader, index)).collect();
        let mut open = vec![false; welded.len()];
        unmatched.iter().for_each(|&index| open[of_triangle[index]] = true);
        Parts { of_triangle, open }
    }
}

/// Root of a union-find tree, halving the path.
fn find(leader: &mut [usize], mut index: usize) -> usize {
    while leader[index] != index {
        leader[index] = leader[leader[index]];
        index = leader[index];
    }
    index
}

/// Triangles with fast queries of distance and of rays.
pub(super) struct Surface {
    mesh: TriMesh,
}

impl Surface {
    /// `triangles` must not be empty.
    pub(super) fn new(triangles: &[[Point3<f64>; 3]]) -> Surface {
        let vertices = triangles.iter().flatten().map(to_parry).collect();
        let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = TriMesh::new(vertices, indices).expect("there is at least one triangle");
        Surface { mesh }
    }

    /// Unsigned distance, m.
    pub(super) fn distance(&self, point: &Point3<f64>) -> f64 {
        self.mesh.distance_to_local_point(to_parry(point), false)
    }

    /// Whether a ray meets no triangle.
    fn sees_the_sky(&self, start: &Point3<f64>, direction: &Vector3<f64>) -> bool {
        let ray = Ray::new(to_parry(start), to_parry(&Point3::from(*direction)));
        !self.mesh.intersects_local_ray(&ray, f64::MAX)
    }

    /// Whether the surface is between two points.
    pub(super) fn separates(&self, a: &Point3<f64>, b: &Point3<f64>) -> bool {
        let ray = Ray::new(to_parry(a), to_parry(&Point3::from(b - a)));
        self.mesh.intersects_local_ray(&ray, 1.0)
    }
}

fn to_parry(point: &Point3<f64>) -> ParryVector {
    ParryVector::new(point.x, point.y, point.z)
}
