//! Leaves: flat patches of one colour, attached to the nearest wood.

use nalgebra::{Point3, Vector3};
use palpate::unstable::{Segment, SegmentKind};

use super::graph::Graph;
use super::skeleton::principal_axes;
use super::view::Views;

/// Bending stiffness of a leaf's stalk, N·m/rad, for wood of modulus [`super::WOOD_MODULUS_PA`].
const STALK_N_M_PER_RAD: f64 = 0.006;
/// Half the thickness of a leaf, m.
const HALF_THICKNESS_M: f64 = 0.0016;
/// Leaves farther from wood than this are left out, m.
const FARTHEST_M: f64 = 0.10;

/// A flat patch of points.
struct Patch {
    middle: Point3<f64>,
    along: Vector3<f64>,
    normal: Vector3<f64>,
    half_length_m: f64,
    half_width_m: f64,
}

fn patches(points: &[Point3<f64>], colours: &[[u8; 3]]) -> Vec<Patch> {
    let colour: Vec<Vector3<f64>> = colours
        .iter()
        .map(|colour| Vector3::from(colour.map(|byte| f64::from(byte) / 255.0)))
        .collect();
    let is_alike = |a: usize, b: usize| {
        let (a, b) = (&colour[a], &colour[b]);
        (a - b).norm() < 0.12 * (a.norm().min(b.norm()) + 0.02)
    };
    let graph = Graph::new(points, 0.005, is_alike);
    let all: Vec<u32> = (0..points.len() as u32).collect();
    let pieces = graph.pieces(&all).into_iter().filter(|piece| piece.len() >= 15);
    pieces.map(|piece| patch(points, &piece)).collect()
}

fn patch(points: &[Point3<f64>], members: &[u32]) -> Patch {
    let (middle, [along, _, normal], std_m) =
        principal_axes(members.iter().map(|&at| points[at as usize]));
    Patch {
        middle,
        along,
        normal,
        half_length_m: (2.0 * std_m[0]).clamp(0.012, 0.045),
        half_width_m: (2.0 * std_m[1]).clamp(0.006, 0.024),
    }
}

/// Leaves attached to `wood`, as segments to be appended to it.
pub(super) fn leaves(
    points: &[Point3<f64>],
    colours: &[[u8; 3]],
    wood: &[Segment],
    views: &Views,
) -> Vec<Segment> {
    let mut places: Vec<([f64; 3], u32)> = Vec::new();
    for (number, segment) in wood.iter().enumerate() {
        let n = ((segment.axis().norm() / 0.004) as usize + 1).max(2);
        let at = |step: usize| segment.start() + segment.axis() * ((step as f64 + 0.5) / n as f64);
        places.extend((0..n).map(|step| (at(step).into(), number as u32)));
    }
    if places.is_empty() {
        return Vec::new();
    }
    let only: Vec<[f64; 3]> = places.iter().map(|(place, _)| *place).collect();
    let tree: kiddo::ImmutableKdTree<f64, 3> = kiddo::ImmutableKdTree::new_from_slice(&only);
    let hung = patches(points, colours).into_iter().filter_map(|patch| {
        let ends = [-1.0, 1.0].map(|side| patch.middle + side * patch.half_length_m * patch.along);
        let bridges = ends.map(|end| {
            let near = tree.nearest_one::<kiddo::SquaredEuclidean>(&end.into());
            let (place, distance) = (Point3::from(only[near.item as usize]), near.distance.sqrt());
            let free = if distance > 0.012 { views.seen_free(&place, &end) } else { 0.0 };
            (distance * (1.0 + 2.0 * free), distance, near.item as usize)
        });
        let [first, second] = bridges;
        let (_, distance, at) = if first.0 <= second.0 { first } else { second };
        (distance <= FARTHEST_M).then(|| hang(&patch, Point3::from(only[at]), places[at].1, wood))
    });
    hung.collect()
}

fn hang(patch: &Patch, start: Point3<f64>, parent: u32, wood: &[Segment]) -> Segment {
    let way = patch.middle - start;
    let reach = way.norm().max(1e-6);
    let along = way / reach;
    let level = patch.normal - along * patch.normal.dot(&along);
    let normal = if level.norm() < 0.2 { along.cross(&Vector3::z()) } else { level };
    let normal = normal.try_normalize(1e-9).unwrap_or(Vector3::x());
    Segment {
        parent: Some(parent),
        kind: SegmentKind::Leaf,
        start_m: start.into(),
        end_m: (start + along * (reach + patch.half_length_m)).into(),
        bare_m: (reach - patch.half_length_m).max(0.0),
        radius_m: HALF_THICKNESS_M,
        half_width_m: (normal.cross(&along) * patch.half_width_m).into(),
        joint_stiffness: STALK_N_M_PER_RAD,
        branch: wood[parent as usize].branch,
    }
}
