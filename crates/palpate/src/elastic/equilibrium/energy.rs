//! The energy of springs and contacts at a position, and its quadratic model there.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::Equilibrium;
use crate::elastic::body::SegmentKind;
use crate::elastic::contact::{ContactEnergy, PlacedLink, deepest};
use crate::elastic::pose::{Joints, Pose};
use crate::elastic::tree::Node;

impl Equilibrium {
    /// Energy of springs and contacts, J.
    pub(super) fn energy(
        &self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        joints: &Joints,
        posed: &Pose,
    ) -> f64 {
        let springs = self.body.segments().iter().zip(&joints.turned);
        let mut energy: f64 =
            springs.map(|(s, turned)| 0.5 * s.joint_stiffness * turned.angle().powi(2)).sum();
        energy += self.body.blocks().energy(&joints.slid_m);
        self.each_pressed(placed, near, posed, |_, _, resistance| energy += resistance.energy);
        energy
    }

    /// Calls `then` for every point of the body inside a link, with its position, m, and energy.
    pub(super) fn each_pressed(
        &self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        posed: &Pose,
        mut then: impl FnMut(&PressedAt, &Point3<f64>, &ContactEnergy),
    ) {
        for (segment, near) in near.iter().enumerate().filter(|(_, near)| !near.is_empty()) {
            for index in self.first[segment]..self.first[segment + 1] {
                if self.state.ignored[index] {
                    continue;
                }
                let point = &self.points[index];
                let at = posed.point(point.segment, &point.lever_m);
                let Some(pressed) = deepest(placed, near, &at, point.radius_m) else { continue };
                let (offset, pressed_n) = self.offset(index, placed, pressed.link, &at);
                let yields = self
                    .config
                    .creep_softening(self.body.inverse_effective_masses()[segment], self.substep_s);
                let resistance = self.config.contact_energy(&pressed, &offset, (pressed_n, yields));
                then(&PressedAt { segment, link: pressed.link }, &at, &resistance);
            }
        }
    }

    /// The quadratic model of the energy at the present position, and the energy, J.
    pub(super) fn model(
        &self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        posed: &Pose,
    ) -> (Vec<Node>, f64) {
        let segments = self.body.segments();
        let mut energy = 0.0;
        let mut nodes: Vec<Node> = Vec::with_capacity(segments.len());
        for (index, segment) in segments.iter().enumerate() {
            let parent = segment.parent.map(|parent| parent as usize);
            let arm = parent.map_or(Vector3::zeros(), |p| posed.starts[index] - posed.starts[p]);
            let k = segment.joint_stiffness;
            let mut node = Node::free(parent, arm, k);
            if segment.kind == SegmentKind::Block {
                let slid_m = &self.state.joints.slid_m;
                node.slides = Some(self.body.blocks().stiffness(index));
                node.joint_slope = self.body.blocks().slope(index, slid_m);
                nodes.push(node);
                continue;
            }
            let turned = self.state.joints.turned[index].scaled_axis();
            let carried = parent.map_or(UnitQuaternion::identity(), |p| posed.rotations[p]);
            node.joint_slope = carried * (k * turned);
            energy += 0.5 * k * turned.norm_squared();
            nodes.push(node);
        }
        energy += self.body.blocks().energy(&self.state.joints.slid_m);
        self.each_pressed(placed, near, posed, |PressedAt { segment, .. }, at, resistance| {
            energy += resistance.energy;
            let lever = at - posed.starts[*segment];
            nodes[*segment].add(&lever, &resistance.slope, &resistance.curvature);
        });
        (nodes, energy)
    }
}

/// Which segment is pressed by which of the placed links.
pub(super) struct PressedAt {
    pub(super) segment: usize,
    pub(super) link: usize,
}
