//! Triangles as they come in files, made fit to be asked for distances.
//!
//! Files hold open shells, doubled vertices, triangles without area and parts turned inside out.
//! Vertices at equal coordinates are welded to find the connected parts. A *closed* part whose
//! volume is negative is turned round; so a hollow part is taken as solid. If all that is open
//! taken together has a negative volume, it is turned round too. What is left is for the winding
//! number to judge.

use std::collections::HashMap;

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::query::{PointQuery, Ray, RayCast};
use parry3d_f64::shape::TriMesh;

use super::SdfError;
use super::winding::area_vector_of;

/// A triangle thinner than this part of its longest edge has no usable normal.
const SLIVER: f64 = 1e-9;

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
        match numbers.find(|number| !number.is_finite()) {
            Some(&found) => Err(SdfError::Number {
                thing: "coordinate of a mesh vertex",
                found,
                wanted: "a finite number of m",
            }),
            None => Ok(()),
        }
    }
}

/// All triangles of a link, cleaned, and what the cleaning did.
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
        let welded = weld(&all);
        let parts = parts(&welded);
        let (mut volume, mut closed) = (vec![0.0; all.len()], vec![true; all.len()]);
        let middle = average(&all);
        for (triangle, &part) in all.iter().zip(&parts.of_triangle) {
            let [a, b, c] = triangle.map(|vertex| vertex - middle);
            volume[part] += a.dot(&b.cross(&c));
        }
        parts.open.iter().for_each(|&part| closed[part] = false);
        let open_volume: f64 =
            volume.iter().zip(&closed).filter(|(_, closed)| !**closed).map(|(v, _)| v).sum();

        let (mut flipped, mut kept) = (0, Vec::with_capacity(all.len()));
        for (mut triangle, &part) in all.iter().copied().zip(&parts.of_triangle) {
            if (if closed[part] { volume[part] } else { open_volume }) < 0.0 {
                triangle.swap(1, 2);
                flipped += 1;
            }
            if !is_degenerate(&triangle) {
                kept.push(triangle);
            }
        }
        let degenerate = all.len() - kept.len();
        if kept.is_empty() {
            return Err(SdfError::Empty { triangles: all.len() });
        }
        Ok(Soup { triangles: kept, degenerate, flipped })
    }
}

fn average(triangles: &[[Point3<f64>; 3]]) -> Point3<f64> {
    let sum: Vector3<f64> = triangles.iter().flatten().map(|vertex| vertex.coords).sum();
    Point3::from(sum / (3.0 * triangles.len().max(1) as f64))
}

fn is_degenerate(triangle: &[Point3<f64>; 3]) -> bool {
    let [a, b, c] = triangle;
    let longest_sq = (b - a).norm_squared().max((c - b).norm_squared()).max((a - c).norm_squared());
    area_vector_of(triangle).norm() <= SLIVER * longest_sq
}

/// Vertex numbers such that vertices at the same place have the same one.
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
    /// Parts with an edge that is not walked as often one way as the other.
    open: Vec<usize>,
}

fn parts(welded: &[[usize; 3]]) -> Parts {
    // Per edge: a triangle that has it, and how much oftener it is walked upwards.
    let mut edges: HashMap<[usize; 2], (usize, i64)> = HashMap::new();
    let mut leader: Vec<usize> = (0..welded.len()).collect();
    for (index, &[a, b, c]) in welded.iter().enumerate() {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if from == to {
                continue; // A collapsed triangle walks its one edge both ways.
            }
            let edge = edges.entry([from.min(to), from.max(to)]).or_insert((index, 0));
            edge.1 += if from < to { 1 } else { -1 };
            let (one, other) = (find(&mut leader, edge.0), find(&mut leader, index));
            leader[one.max(other)] = one.min(other);
        }
    }
    let of_triangle = (0..welded.len()).map(|index| find(&mut leader, index)).collect();
    let open = (edges.values().filter(|(_, balance)| *balance != 0))
        .map(|(index, _)| find(&mut leader, *index))
        .collect();
    Parts { of_triangle, open }
}

/// Root of a union-find tree, halving the path.
fn find(leader: &mut [usize], mut index: usize) -> usize {
    while leader[index] != index {
        leader[index] = leader[leader[index]];
        index = leader[index];
    }
    index
}

/// Triangles that can be asked for the closest point.
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

    /// Whether the surface stands between two points.
    pub(super) fn separates(&self, a: &Point3<f64>, b: &Point3<f64>) -> bool {
        let ray = Ray::new(to_parry(a), to_parry(&Point3::from(b - a)));
        self.mesh.intersects_local_ray(&ray, 1.0)
    }
}

fn to_parry(point: &Point3<f64>) -> ParryVector {
    ParryVector::new(point.x, point.y, point.z)
}
