//! Where a body comes to rest against an arm: non-linear statics, warm-started from the sample before.
//!
//! The energy is that of the joints' springs, `½ k θ²` with θ the angle of the joint's rotation, and of
//! the contacts ([`super::contact`]). Newton's method with the curvature of both (that of the springs
//! without the part that would make it negative), each step solved by [`super::tree`], with a line search.
//! Rotations are exact: a branch that bends moves on an arc, and that is where the gain over springs by
//! point comes from.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, Isometry3, Point3, UnitQuaternion, Vector3, Vector6};

use super::body::{ElasticBody, Segment, SegmentKind};
use super::contact::{Anchor, ElasticContactConfig, PlacedLink, Resistance, deepest};
use super::pose::{Joints, Pose};
use super::tree::{self, Node};
use crate::arm::Arm;
use crate::robot::{LinkId, Poses};

/// Distance between points of the body that are asked for contact, m.
const SAMPLE_SPACING_M: f64 = 0.006;
/// Such points of a block along its side.
const BLOCK_POINTS: f64 = 3.0;
/// Links farther than this from a segment are not looked at in a sub-step, m.
const REACH_M: f64 = 0.03;
/// Longest motion of a link in a sub-step, m.
const SUBSTEP_M: f64 = 0.004;
/// Longest motion of a point of the body in an iteration, m: it must not jump through a link.
const STRIDE_M: f64 = 0.01;
/// Largest turn of a joint in an iteration, rad.
const TURN_RAD: f64 = 0.4;
/// Iterations of a sub-step, at most.
const ITERATIONS: u32 = 25;
/// A step that lowers the energy by less than this, J, is the last.
const SETTLED_J: f64 = 1e-9;
/// The same as a share of the energy.
const SETTLED_SHARE: f64 = 1e-6;

/// A point of the body that may meet a link.
#[derive(Debug, Clone, Copy)]
struct SurfacePoint {
    segment: usize,
    /// From the start of the segment at rest, m.
    lever_m: Vector3<f64>,
    radius_m: f64,
}

/// How a motion went.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Settled {
    /// Newton steps.
    pub iterations: u32,
    /// Sub-steps that had not come to rest when their iterations were used up.
    pub unsettled: u32,
}

/// A body against an arm.
#[derive(Debug, Clone)]
pub struct Equilibrium {
    arm: Arc<Arm>,
    body: Arc<ElasticBody>,
    config: ElasticContactConfig,
    points: Vec<SurfacePoint>,
    /// Points of segment `i`: `first[i]..first[i + 1]`.
    first: Vec<usize>,
    state: State,
    /// Where the links were.
    before: Option<Vec<Isometry3<f64>>>,
    /// How long the sub-step takes that is being made, s; 0 between them.
    substep_s: f64,
}

#[derive(Debug, Clone)]
struct State {
    joints: Joints,
    /// By point.
    anchors: Vec<Option<Anchor>>,
    /// Points that were in a link when the touch began: the picture or the skin is wrong there.
    ignored: Vec<bool>,
}

impl State {
    fn at_rest(segments: usize, points: usize) -> Self {
        Self {
            joints: Joints::at_rest(segments),
            anchors: vec![None; points],
            ignored: vec![false; points],
        }
    }
}

impl Equilibrium {
    /// A body at rest.
    pub fn new(arm: Arc<Arm>, body: Arc<ElasticBody>, config: ElasticContactConfig) -> Self {
        let (mut points, mut first) = (Vec::new(), vec![0]);
        for (segment, part) in body.segments().iter().enumerate() {
            let length = part.axis().norm();
            let bare = part.bare_m.clamp(0.0, length) / length;
            let is_plate = part.half_width().norm() > 0.0;
            let is_block = part.kind == SegmentKind::Block;
            let spacing_m = if is_block { length / BLOCK_POINTS } else { SAMPLE_SPACING_M };
            let n = ((1.0 - bare) * length / spacing_m).ceil().max(1.0);
            for step in 0..n as usize {
                let share = (step as f64 + 0.5) / n;
                let (width, sides) = match (is_plate, is_block) {
                    (_, true) => (1.0, &[-0.67, 0.0, 0.67][..]),
                    // A plate is widest in its middle, as an ellipse.
                    (true, _) => {
                        ((1.0 - (2.0 * share - 1.0).powi(2)).sqrt(), &[-0.7, 0.0, 0.7][..])
                    }
                    (false, _) => (0.0, &[0.0][..]),
                };
                for side in sides {
                    let along = (bare + share * (1.0 - bare)) * part.axis();
                    let lever_m = along + *side * width * part.half_width();
                    points.push(SurfacePoint { segment, lever_m, radius_m: part.radius_m });
                }
            }
            first.push(points.len());
        }
        let state = State::at_rest(body.segments().len(), points.len());
        Self { arm, body, config, points, first, state, before: None, substep_s: 0.0 }
    }

    /// The body.
    pub fn body(&self) -> &Arc<ElasticBody> {
        &self.body
    }

    /// The arm that bends it.
    pub fn arm(&self) -> &Arc<Arm> {
        &self.arm
    }

    /// Begins a touch: the body is as it was at first.
    pub fn begin_touch(&mut self) {
        self.state = State::at_rest(self.body.segments().len(), self.points.len());
        self.before = None;
    }

    /// Where the segments are: start and end of each, m, world frame.
    pub fn segments_m(&self) -> Vec<[Point3<f64>; 2]> {
        let posed = self.posed();
        let ends = |(index, part): (usize, &Segment)| {
            [posed.starts[index], posed.point(index, &part.axis())]
        };
        self.body.segments().iter().enumerate().map(ends).collect()
    }

    /// Moves the arm's links on, which takes a time, s, and lets the body come to rest. The time matters
    /// only to contacts that creep; clocks that stand, go back or give no number count as no time. If
    /// nobody knows the time, the arm moves at [`ElasticContactConfig::speed_m_per_s`].
    ///
    /// The first position of a touch is taken to be free of the body: points of it that are in a link
    /// there are left out until the next touch.
    pub fn advance(&mut self, links: &[Isometry3<f64>], time_s: Option<f64>) -> Settled {
        let Some(before) = self.before.replace(links.to_vec()) else {
            self.ignore_what_is_in_the_arm(links);
            return Settled::default();
        };
        let travel_m = self.arm.travel_m(&before, links);
        let substeps = ((travel_m / SUBSTEP_M).ceil() as u32).clamp(1, 1000);
        let time_s = time_s.unwrap_or(travel_m / self.config.speed_m_per_s);
        let mut settled = Settled::default();
        self.substep_s = f64::max(time_s, 0.0) / f64::from(substeps); // 0 for NaN
        for step in 1..=substeps {
            let share = f64::from(step) / f64::from(substeps);
            let between: Vec<Isometry3<f64>> = before
                .iter()
                .zip(links)
                .map(|(a, b)| if step == substeps { *b } else { a.lerp_slerp(b, share) })
                .collect();
            self.settle(&between, &mut settled);
        }
        self.substep_s = 0.0;
        settled
    }

    /// The joint torque of the body on the arm at a stiffness factor of one, `Σ Sᵀ (f, m)` over the
    /// links, n_joints × trees of the body, N·m. `poses` are those of the last [`Equilibrium::advance`].
    pub fn torques(&self, poses: &Poses) -> DMatrix<f64> {
        let robot = &self.arm.robot;
        let mut torques = DMatrix::zeros(robot.n_joints(), self.body.n_trees());
        let Some(links) = &self.before else { return torques };
        let (placed, posed) = (placed(&self.arm, links), self.posed());
        let near = self.near(&placed, &posed);
        // Force, N, and moment about the world's origin, N·m, on each link by each tree.
        let mut wrenches: BTreeMap<(usize, u32), Vector6<f64>> = BTreeMap::new();
        self.each_pressed(&placed, &near, &posed, |pressed, at, resistance| {
            // The slope of the energy is minus the force on the body: the force on the arm.
            let (force, moment) = (resistance.slope, at.coords.cross(&resistance.slope));
            *wrenches.entry((pressed.link, self.body.trees()[pressed.segment])).or_default() +=
                Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
        });
        for ((link, tree), wrench) in wrenches {
            let spatial = robot.spatial_jacobian(poses, LinkId(placed[link].index as u16));
            let mut torque = torques.column_mut(tree as usize);
            torque += spatial.transpose() * wrench;
        }
        torques
    }

    fn ignore_what_is_in_the_arm(&mut self, links: &[Isometry3<f64>]) {
        let placed = placed(&self.arm, links);
        let posed = self.posed();
        let near = self.near(&placed, &posed);
        let inside: Vec<bool> = (self.points.iter())
            .map(|point| {
                let at = posed.point(point.segment, &point.lever_m);
                deepest(&placed, &near[point.segment], &at, point.radius_m).is_some()
            })
            .collect();
        self.state.ignored = inside;
    }

    fn posed(&self) -> Pose {
        Pose::of(&self.body, &self.state.joints)
    }

    /// For each segment the links, by their place in `placed`, that it could meet in a sub-step.
    fn near(&self, placed: &[PlacedLink<'_>], posed: &Pose) -> Vec<Vec<u16>> {
        let segments = self.body.segments().iter().enumerate();
        let near = segments.map(|(index, segment)| {
            let half = 0.5 * segment.axis();
            let middle = posed.starts[index] + posed.rotations[index] * half;
            let size = half.norm() + segment.half_width().norm() + segment.radius_m + REACH_M;
            let is_near = |link: &PlacedLink<'_>| link.distance(&middle) < size;
            (0..placed.len()).filter(|&at| is_near(&placed[at])).map(|at| at as u16).collect()
        });
        near.collect()
    }

    /// How far a point is from its anchor on a link, m, and how hard it was pressed, N.
    fn offset(
        &self,
        point: usize,
        placed: &[PlacedLink<'_>],
        link: usize,
        at: &Point3<f64>,
    ) -> (Vector3<f64>, f64) {
        match &self.state.anchors[point] {
            Some(anchor) if anchor.link == placed[link].index => {
                (at - placed[link].world_from_link * anchor.place_link, anchor.pressed_n)
            }
            _ => (Vector3::zeros(), 0.0),
        }
    }

    /// Lets the body come to rest against links that stand still.
    fn settle(&mut self, links: &[Isometry3<f64>], settled: &mut Settled) {
        let arm = Arc::clone(&self.arm);
        let placed = placed(&arm, links);
        let near = self.near(&placed, &self.posed());
        if near.iter().all(Vec::is_empty) && self.state.joints.are_at_rest() {
            return;
        }
        let mut settles = false;
        let mut stuck = 0;
        for _ in 0..ITERATIONS {
            settled.iterations += 1;
            let posed = self.posed();
            self.update_anchors(&placed, &near, &posed);
            let (mut nodes, energy) = self.model(&placed, &near, &posed);
            let (steps, decrement) = tree::minimise(&mut nodes);
            if decrement < SETTLED_J + SETTLED_SHARE * energy {
                settles = true;
                break;
            }
            let then = self.line_search(&placed, &near, (&posed, energy), (&steps, decrement));
            stuck = if energy - then < 1e-2 * decrement { stuck + 1 } else { 0 };
            if stuck == 3 {
                settles = decrement < 1e-3 * energy;
                break;
            }
        }
        settled.unsettled += u32::from(!settles);
        self.slide_anchors(&placed, &near);
    }

    /// Takes as much of a Newton step as lowers the energy, or nothing of it; returns the energy then, J.
    fn line_search(
        &mut self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        (posed, energy): (&Pose, f64),
        (steps, decrement): (&[Vector3<f64>], f64),
    ) -> f64 {
        let turns = self.body.segments().iter().zip(steps);
        let turns = turns.filter(|(segment, _)| segment.kind != SegmentKind::Block);
        let turn = turns.map(|(_, step)| step.norm()).fold(0.0, f64::max);
        let mut share = f64::min(1.0, TURN_RAD / turn);
        let mut lowest = (energy, None);
        for _ in 0..12 {
            let joints = posed.stepped(&self.body, &self.state.joints, (steps, share));
            let next = Pose::of(&self.body, &joints);
            let stride = next.farthest_from(posed, &self.body);
            if stride > STRIDE_M {
                share *= f64::max(0.9 * STRIDE_M / stride, 0.1);
                continue;
            }
            let then = self.energy(placed, near, &joints, &next);
            if then < lowest.0 {
                lowest = (then, Some(joints));
            }
            if then <= energy - 1e-4 * share * decrement {
                break;
            }
            share *= 0.5;
        }
        if let Some(joints) = lowest.1 {
            self.state.joints = joints;
        }
        lowest.0
    }

    /// Takes note of the points that meet or leave a link, and of how hard each is pressed.
    fn update_anchors(&mut self, placed: &[PlacedLink<'_>], near: &[Vec<u16>], posed: &Pose) {
        for index in 0..self.points.len() {
            let point = self.points[index];
            if near[point.segment].is_empty() || self.state.ignored[index] {
                self.state.anchors[index] = None;
                continue;
            }
            let at = posed.point(point.segment, &point.lever_m);
            let pressed = deepest(placed, &near[point.segment], &at, point.radius_m);
            self.state.anchors[index] = pressed.map(|pressed| {
                let link = &placed[pressed.link];
                let pressed_n = self.config.stiffness_n_per_m * pressed.depth_m;
                match self.state.anchors[index].filter(|anchor| anchor.link == link.index) {
                    Some(anchor) => Anchor { pressed_n, ..anchor },
                    None => {
                        let place_link = link.link_from_world * at;
                        Anchor { link: link.index, place_link, pressed_n }
                    }
                }
            });
        }
    }

    /// Moves the anchors of points that slipped after them.
    fn slide_anchors(&mut self, placed: &[PlacedLink<'_>], near: &[Vec<u16>]) {
        let posed = self.posed();
        self.update_anchors(placed, near, &posed);
        let mobilities = self.body.mobilities();
        for (index, point) in self.points.iter().enumerate() {
            let Some(anchor) = &mut self.state.anchors[index] else { continue };
            let Some(link) = placed.iter().find(|link| link.index == anchor.link) else { continue };
            let at = posed.point(point.segment, &point.lever_m);
            let (_, slope) = link.grid.smooth_distance_and_slope(&(link.link_from_world * at));
            let normal = link.world_from_link.rotation * slope;
            let normal = normal.try_normalize(1e-9).unwrap_or(Vector3::z());
            let offset = at - link.world_from_link * anchor.place_link;
            let slip = offset - normal * normal.dot(&offset);
            let slip = slip / self.config.yields(mobilities[point.segment], self.substep_s);
            let longest = self.config.longest_slip_m(anchor.pressed_n);
            // The anchor keeps the height of its point: only what is across counts.
            let kept = if slip.norm() > longest { slip * (longest / slip.norm()) } else { slip };
            anchor.place_link = link.link_from_world * (at - kept);
        }
    }

    /// Energy of springs and contacts, J.
    fn energy(
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

    /// Every point of the body that is in a link: where it is, m, and what resists there.
    fn each_pressed(
        &self,
        placed: &[PlacedLink<'_>],
        near: &[Vec<u16>],
        posed: &Pose,
        mut then: impl FnMut(&PressedAt, &Point3<f64>, &Resistance),
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
                let yields = self.config.yields(self.body.mobilities()[segment], self.substep_s);
                let resistance = self.config.resistance(&pressed, &offset, (pressed_n, yields));
                then(&PressedAt { segment, link: pressed.link }, &at, &resistance);
            }
        }
    }

    /// The quadratic model of the energy at the present position, and the energy, J.
    fn model(
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
struct PressedAt {
    segment: usize,
    link: usize,
}

/// The links that have a surface, where they are.
fn placed<'a>(arm: &'a Arm, links: &[Isometry3<f64>]) -> Vec<PlacedLink<'a>> {
    let links = arm.surfaces.iter().zip(links).enumerate();
    links
        .filter_map(|(index, (grid, pose))| Some(PlacedLink::new(index, grid.as_ref()?, *pose)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::body::{Segment, SegmentKind};
    use super::*;
    use crate::robot::Robot;
    use crate::sdf::BakeConfig;

    /// A plate of 40 cm by 40 cm that moves down along z, its lower face at z = 0 when q = 0.
    fn press() -> Arc<Arm> {
        let urdf = r#"<robot name="press"><link name="base"/><link name="plate"><collision>
             <origin xyz="0.3 0 0.05"/><geometry><box size="0.4 0.4 0.1"/></geometry></collision></link>
             <joint name="down" type="prismatic"><parent link="base"/><child link="plate"/>
             <axis xyz="0 0 -1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"#;
        let robot = Robot::from_urdf(urdf).expect("a robot");
        let no_mesh = |_: &str| unreachable!("primitives only");
        Arc::new(Arm::bake(robot, &BakeConfig::new(0.02, 0.3), no_mesh).expect("an arm").0)
    }

    const LENGTH_M: f64 = 0.3;
    const BALL_M: f64 = 0.25;

    /// A rod along x, fixed at the origin, with a bending stiffness of one N·m² and a ball at its end.
    fn cantilever(pieces: usize) -> Arc<ElasticBody> {
        let piece = LENGTH_M / pieces as f64;
        let rod = |at: usize| Segment {
            parent: at.checked_sub(1).map(|parent| parent as u32),
            kind: SegmentKind::Wood,
            start_m: [at as f64 * piece, 0.0, 0.0],
            end_m: [(at + 1) as f64 * piece, 0.0, 0.0],
            // The rod itself touches nothing.
            bare_m: piece - 1e-9,
            radius_m: 1e-4,
            half_width_m: [0.0; 3],
            joint_stiffness: if at == 0 { 2.0 / piece } else { 1.0 / piece },
            branch: 0,
        };
        let mut segments: Vec<Segment> = (0..pieces).map(rod).collect();
        segments[pieces - 1].radius_m = BALL_M;
        Arc::new(ElasticBody::new(segments).expect("a body"))
    }

    /// Force, N, on the plate at each depth of the ball, m.
    fn pressed(equilibrium: &mut Equilibrium, depths_m: &[f64]) -> Vec<f64> {
        let arm = Arc::clone(&equilibrium.arm);
        let force = |&depth: &f64| {
            let poses = arm.robot.forward(&[depth - BALL_M]).expect("one joint");
            let settled = equilibrium.advance(&poses.world_from_link, Some(0.01));
            assert_eq!(
                settled.unsettled, 0,
                "at {depth} m after {} iterations",
                settled.iterations
            );
            equilibrium.torques(&poses).sum().abs()
        };
        depths_m.iter().map(force).collect()
    }

    fn stiff(friction: f64) -> ElasticContactConfig {
        ElasticContactConfig { friction, stiffness_n_per_m: 1e5, ..ElasticContactConfig::default() }
    }

    fn ramp(to_m: f64, steps: usize) -> Vec<f64> {
        (0..=steps).map(|step| -0.002 + (to_m + 0.002) * step as f64 / steps as f64).collect()
    }

    #[test]
    fn a_cantilever_bends_by_the_cube_of_its_length() {
        let mut equilibrium = Equilibrium::new(press(), cantilever(30), stiff(0.0));
        let depths = ramp(0.003, 10);
        let forces = pressed(&mut equilibrium, &depths);
        let wanted = 3.0 * 0.003 / LENGTH_M.powi(3); // 3 EI δ / L³
        assert!((forces[10] / wanted - 1.0).abs() < 0.02, "{} N, wanted {wanted}", forces[10]);
        assert_eq!(forces[0], 0.0, "above the ball");
    }

    #[test]
    fn a_cantilever_that_bends_far_follows_the_elastica() {
        // P L² / EI and the deflection of the end by the length (Mattiasson 1981).
        for (load, deflection) in [(1.0, 0.30172), (2.0, 0.49346), (5.0, 0.71379)] {
            let mut equilibrium = Equilibrium::new(press(), cantilever(40), stiff(0.0));
            let depths = ramp(deflection * LENGTH_M, 100);
            let force = pressed(&mut equilibrium, &depths)[100];
            let got = force * LENGTH_M * LENGTH_M;
            assert!((got / load - 1.0).abs() < 0.02, "{got}, wanted {load}");
        }
    }

    #[test]
    fn without_friction_the_work_of_the_arm_is_the_energy_of_the_springs() {
        let mut equilibrium = Equilibrium::new(press(), cantilever(20), stiff(0.0));
        let depths = ramp(0.12, 200);
        let forces = pressed(&mut equilibrium, &depths);
        let work: f64 = (1..=200)
            .map(|i| 0.5 * (forces[i] + forces[i - 1]) * (depths[i] - depths[i - 1]))
            .sum();
        let springs = equilibrium.body.segments().iter().zip(&equilibrium.state.joints.turned);
        let energy: f64 =
            springs.map(|(s, turned)| 0.5 * s.joint_stiffness * turned.angle().powi(2)).sum();
        assert!((work / energy - 1.0).abs() < 0.01, "{work} J of work, {energy} J in springs");
    }

    #[test]
    fn a_body_goes_back_to_rest_when_the_arm_leaves_and_friction_takes_work() {
        let mut equilibrium = Equilibrium::new(press(), cantilever(20), stiff(0.5));
        let down = ramp(0.12, 60);
        let there = pressed(&mut equilibrium, &down);
        let up: Vec<f64> = down.iter().rev().copied().collect();
        let back = pressed(&mut equilibrium, &up);
        assert!(equilibrium.state.joints.are_at_rest() && back[60] == 0.0);
        let work = |forces: &[f64]| forces.iter().sum::<f64>();
        assert!(work(&back) < 0.98 * work(&there), "{} and {}", work(&back), work(&there));
    }

    #[test]
    fn all_springs_twice_as_stiff_push_back_twice_as_hard() {
        let depths = ramp(0.1, 50);
        let mut soft = Equilibrium::new(press(), cantilever(10), stiff(0.4));
        let twice = |segment: &Segment| Segment {
            joint_stiffness: 2.0 * segment.joint_stiffness,
            ..segment.clone()
        };
        let body = ElasticBody::new(cantilever(10).segments().iter().map(twice).collect())
            .expect("a body");
        let hard = ElasticContactConfig { stiffness_n_per_m: 2e5, ..stiff(0.4) };
        let mut hard = Equilibrium::new(press(), Arc::new(body), hard);
        let (soft, hard) = (pressed(&mut soft, &depths), pressed(&mut hard, &depths));
        for (soft, hard) in soft.iter().zip(&hard) {
            assert!((2.0 * soft - hard).abs() < 1e-3 * hard.max(0.1), "{soft} N and {hard} N");
        }
    }

    /// Three by three blocks of 4 cm under the plate, their tops at z = 0; those of one row are higher up.
    fn cushion(k_n_per_m: f64, higher_m: f64) -> Arc<ElasticBody> {
        let block = |at: usize| {
            let (x, y) = (0.26 + 0.04 * (at / 3) as f64, -0.04 + 0.04 * (at % 3) as f64);
            let z = -0.004 + if at % 3 == 1 { higher_m } else { 0.0 };
            Segment {
                parent: None,
                kind: SegmentKind::Block,
                start_m: [x - 0.02, y, z],
                end_m: [x + 0.02, y, z],
                bare_m: 0.0,
                radius_m: 0.004,
                half_width_m: [0.0, 0.02, 0.0],
                joint_stiffness: k_n_per_m,
                branch: 0,
            }
        };
        Arc::new(ElasticBody::new((0..9).map(block).collect()).expect("a body"))
    }

    /// Force, N, on the plate when it has gone down to this height, m.
    fn press_down(body: Arc<ElasticBody>, to_m: f64) -> f64 {
        let arm = press();
        let config = ElasticContactConfig { stiffness_n_per_m: 2e4, ..stiff(0.0) };
        let mut equilibrium = Equilibrium::new(Arc::clone(&arm), body, config);
        let mut force = 0.0;
        for step in 0..=40 {
            let down = -0.1 + (0.1 + to_m) * f64::from(step) / 40.0;
            let poses = arm.robot.forward(&[down]).expect("one joint");
            let settled = equilibrium.advance(&poses.world_from_link, Some(0.01));
            assert_eq!(settled.unsettled, 0, "at {down} m");
            force = equilibrium.torques(&poses).sum().abs();
        }
        force
    }

    #[test]
    fn a_cushion_pressed_flat_resists_as_all_its_blocks_do() {
        let force = press_down(cushion(20.0, 0.0), 0.02);
        let wanted = 9.0 * 20.0 * 0.02;
        assert!((force / wanted - 1.0).abs() < 0.01, "{force} N, wanted {wanted}");
    }

    #[test]
    fn a_row_that_is_pressed_alone_takes_its_neighbours_with_it() {
        // Each block of the row has two neighbours of its own stiffness k, each sheared with k and held with k:
        // they follow by half. So the row resists with 3 k (1 + 2 · ½).
        let force = press_down(cushion(20.0, 0.05), -0.02);
        let wanted = 3.0 * 20.0 * 0.03 * 2.0;
        assert!((force / wanted - 1.0).abs() < 0.02, "{force} N, wanted {wanted}");
    }
}
