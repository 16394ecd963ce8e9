//! Static equilibrium of a body against an arm: non-linear, warm-started from the previous sample.
//!
//! The energy is that of the joints' springs, `½ k θ²` with θ the angle of the joint's rotation, and of the contacts
//! ([`super::contact`]). It is minimised by Newton's method with a line search; each step is solved by [`super::tree`].
//! The curvature is that of both energies (for the springs without the part that could make it negative). Rotations are
//! exact: a branch that bends moves on an arc, which is the main advantage over springs of single points.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, Isometry3, Point3, Vector3, Vector6};

use super::body::{ElasticBody, Segment, SegmentKind};
use super::contact::{Anchor, ElasticContactConfig, PlacedLink, deepest};
use super::pose::{Joints, Pose};
use super::tree;
use crate::arm::Arm;
use crate::robot::{LinkId, Poses};

mod anchors;
mod energy;
#[cfg(test)]
mod tests;

/// Distance between points of the body that are tested for contact, m.
const SAMPLE_SPACING_M: f64 = 0.006;
/// Number of tested points along the side of a block.
const BLOCK_POINTS: f64 = 3.0;
/// Links farther than this from a segment are not tested in a sub-step, m.
const REACH_M: f64 = 0.03;
/// Longest motion of a link in a sub-step, m.
const SUBSTEP_M: f64 = 0.004;
/// Longest motion of a point of the body in an iteration, m: it must not jump through a link.
const STRIDE_M: f64 = 0.01;
/// Largest turn of a joint in an iteration, rad.
const TURN_RAD: f64 = 0.4;
/// Largest number of iterations of a sub-step.
const ITERATIONS: u32 = 25;
/// The iteration ends when the Newton decrement is below this, J, plus [`SETTLED_SHARE`] of the energy.
const SETTLED_J: f64 = 1e-9;
/// See [`SETTLED_J`].
const SETTLED_SHARE: f64 = 1e-6;

/// A point of the body that may meet a link.
#[derive(Debug, Clone, Copy)]
struct SurfacePoint {
    segment: usize,
    /// From the start of the segment at rest, m.
    lever_m: Vector3<f64>,
    radius_m: f64,
}

/// Convergence of a motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Convergence {
    /// Number of Newton steps.
    pub iterations: u32,
    /// Number of sub-steps that did not converge.
    pub not_converged: u32,
}

/// A body in contact with an arm.
#[derive(Debug, Clone)]
pub struct Equilibrium {
    arm: Arc<Arm>,
    body: Arc<ElasticBody>,
    config: ElasticContactConfig,
    points: Vec<SurfacePoint>,
    /// Points of segment `i`: `first[i]..first[i + 1]`.
    first: Vec<usize>,
    state: State,
    /// Poses of the links at the previous position.
    before: Option<Vec<Isometry3<f64>>>,
    /// Duration of the present sub-step, s; 0 between sub-steps.
    substep_s: f64,
}

#[derive(Debug, Clone)]
struct State {
    joints: Joints,
    /// Anchors, by point.
    anchors: Vec<Option<Anchor>>,
    /// Points that were inside a link when the touch began: the shape of body or link is wrong there.
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

    /// Begins a touch: the body is at rest.
    pub fn begin_touch(&mut self) {
        self.state = State::at_rest(self.body.segments().len(), self.points.len());
        self.before = None;
    }

    /// Start and end of each segment, m, world frame.
    pub fn segments_m(&self) -> Vec<[Point3<f64>; 2]> {
        let posed = self.posed();
        let ends = |(index, part): (usize, &Segment)| {
            [posed.starts[index], posed.point(index, &part.axis())]
        };
        self.body.segments().iter().enumerate().map(ends).collect()
    }

    /// Moves the arm's links to these poses within `time_s` and computes the equilibrium of the body. The time matters
    /// only for contacts that creep; a time that is 0, negative or NaN counts as 0. Without a time, the arm moves at
    /// [`ElasticContactConfig::speed_m_per_s`].
    ///
    /// At the first position of a touch the arm counts as free of contact: points of the body that are inside a link
    /// there are ignored until the next touch.
    pub fn advance(&mut self, links: &[Isometry3<f64>], time_s: Option<f64>) -> Convergence {
        let Some(before) = self.before.replace(links.to_vec()) else {
            self.ignore_what_is_in_the_arm(links);
            return Convergence::default();
        };
        let travel_m = self.arm.travel_m(&before, links);
        let substeps = ((travel_m / SUBSTEP_M).ceil() as u32).clamp(1, 1000);
        let time_s = time_s.unwrap_or(travel_m / self.config.speed_m_per_s);
        let mut convergence = Convergence::default();
        self.substep_s = f64::max(time_s, 0.0) / f64::from(substeps); // 0 for NaN
        for step in 1..=substeps {
            let share = f64::from(step) / f64::from(substeps);
            let between: Vec<Isometry3<f64>> = before
                .iter()
                .zip(links)
                .map(|(a, b)| if step == substeps { *b } else { a.lerp_slerp(b, share) })
                .collect();
            self.converge(&between, &mut convergence);
        }
        self.substep_s = 0.0;
        convergence
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

    /// Ignores, until the next touch, the points that are inside a link now.
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

    /// For each segment, the links that it could touch in a sub-step, as indices into `placed`.
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

    /// Computes the equilibrium of the body against links at fixed poses.
    fn converge(&mut self, links: &[Isometry3<f64>], convergence: &mut Convergence) {
        let arm = Arc::clone(&self.arm);
        let placed = placed(&arm, links);
        let near = self.near(&placed, &self.posed());
        if near.iter().all(Vec::is_empty) && self.state.joints.are_at_rest() {
            return;
        }
        let mut converges = false;
        let mut stuck = 0;
        for _ in 0..ITERATIONS {
            convergence.iterations += 1;
            let posed = self.posed();
            self.update_anchors(&placed, &near, &posed);
            let (mut nodes, energy) = self.model(&placed, &near, &posed);
            let (steps, decrement) = tree::minimise(&mut nodes);
            if decrement < SETTLED_J + SETTLED_SHARE * energy {
                converges = true;
                break;
            }
            let then = self.line_search(&placed, &near, (&posed, energy), (&steps, decrement));
            stuck = if energy - then < 1e-2 * decrement { stuck + 1 } else { 0 };
            if stuck == 3 {
                converges = decrement < 1e-3 * energy;
                break;
            }
        }
        convergence.not_converged += u32::from(!converges);
        self.slide_anchors(&placed, &near);
    }

    /// Makes the part of a Newton step that lowers the energy, or no step; returns the energy after it, J.
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
}

/// The links with a surface, at these poses.
fn placed<'a>(arm: &'a Arm, links: &[Isometry3<f64>]) -> Vec<PlacedLink<'a>> {
    let links = arm.surfaces.iter().zip(links).enumerate();
    links
        .filter_map(|(index, (grid, pose))| Some(PlacedLink::new(index, grid.as_ref()?, *pose)))
        .collect()
}
