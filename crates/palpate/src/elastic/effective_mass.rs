//! Inverse effective mass of a segment: the acceleration of its centre under a unit force. It follows from the masses
//! of all segments of the tree; springs are neglected.

use std::f64::consts::{FRAC_PI_4, PI};

use nalgebra::{Matrix3, Vector3};

use super::body::{Segment, SegmentKind};
use super::tree::{self, Node};

/// Density of living wood, kg/m³.
const WOOD_KG_PER_M3: f64 = 700.0;
/// Density of leaves, kg/m³.
const LEAF_KG_PER_M3: f64 = 250.0;
/// Density of a cushion, kg/m³, and height of the part of a block that moves with its top, m.
const FOAM_KG_PER_M3: f64 = 50.0;
const MOVED_M: f64 = 0.05;
/// Inertia added to each joint, kg·m²: otherwise thin rods would turn about their own axis too easily.
const INERTIA: f64 = 1e-7;

/// Inverse effective mass of each segment, 1/kg, mean over three directions.
pub(super) fn inverse_effective_masses(segments: &[Segment]) -> Vec<f64> {
    let at_rest: Vec<Node> = segments.iter().map(|segment| node(segment, segments)).collect();
    let inverse_mass = |index: usize| {
        if segments[index].kind == SegmentKind::Block {
            return 1.0 / mass_kg(&segments[index]);
        }
        let along = |axis: usize| {
            let mut nodes = at_rest.clone();
            let (lever, push) = (0.5 * segments[index].axis(), Vector3::ith(axis, 1.0));
            nodes[index].add(&lever, &push, &Matrix3::zeros());
            tree::minimise(&mut nodes).1
        };
        (0..3).map(along).sum::<f64>() / 3.0
    };
    (0..segments.len()).map(inverse_mass).collect()
}

/// A segment with masses in place of stiffness: half of its mass at each of two points, so that the
/// moment of inertia is that of a rod.
fn node(segment: &Segment, segments: &[Segment]) -> Node {
    let parent = segment.parent.map(|parent| parent as usize);
    let arm = parent.map_or(Vector3::zeros(), |at| segment.start() - segments[at].start());
    let mut node = Node::free(parent, arm, INERTIA);
    let half = Matrix3::from_diagonal_element(0.5 * mass_kg(segment));
    let apart = 0.5 / 3_f64.sqrt();
    for share in [0.5 - apart, 0.5 + apart] {
        node.add(&(share * segment.axis()), &Vector3::zeros(), &half);
    }
    node
}

fn mass_kg(segment: &Segment) -> f64 {
    let (length_m, radius_m) = (segment.axis().norm(), segment.radius_m);
    match segment.kind {
        SegmentKind::Wood => WOOD_KG_PER_M3 * PI * radius_m * radius_m * length_m,
        // An ellipse of this length and width.
        SegmentKind::Leaf => {
            let width_m = 2.0 * segment.half_width().norm();
            LEAF_KG_PER_M3 * 2.0 * radius_m * FRAC_PI_4 * width_m * length_m
        }
        SegmentKind::Block => {
            let width_m = 2.0 * f64::max(segment.half_width().norm(), radius_m);
            FOAM_KG_PER_M3 * MOVED_M * width_m * length_m
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rod_on_a_joint_has_the_effective_mass_of_a_pendulum() {
        let rod = Segment {
            parent: None,
            kind: SegmentKind::Wood,
            start_m: [0.0; 3],
            end_m: [0.2, 0.0, 0.0],
            bare_m: 0.0,
            radius_m: 0.01,
            half_width_m: [0.0; 3],
            joint_stiffness: 1.0,
            branch: 0,
        };
        // Across in two directions, (L / 2)² over m L² / 3; along it the joint holds.
        let kg = 700.0 * PI * 0.01 * 0.01 * 0.2;
        let wanted = 2.0 / 3.0 * 0.75 / kg;
        let found = inverse_effective_masses(&[rod])[0];
        assert!((found / wanted - 1.0).abs() < 1e-3, "{found} and {wanted} per kg");
    }
}
