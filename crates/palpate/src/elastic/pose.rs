//! Positions of the segments of a body, for given rotations of its joints.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::body::{ElasticBody, SegmentKind};

/// Rotations of joints and displacements of blocks.
#[derive(Debug, Clone)]
pub(super) struct Joints {
    /// Rotation of each joint, in the frame of the segment that carries it.
    pub turned: Vec<UnitQuaternion<f64>>,
    /// Displacement of each block, m; zero for other segments.
    pub slid_m: Vec<Vector3<f64>>,
}

impl Joints {
    /// `segments` segments at rest.
    pub(super) fn at_rest(segments: usize) -> Self {
        Self {
            turned: vec![UnitQuaternion::identity(); segments],
            slid_m: vec![Vector3::zeros(); segments],
        }
    }

    /// Whether nothing is rotated or displaced.
    pub(super) fn are_at_rest(&self) -> bool {
        self.turned.iter().all(|turned| turned.angle() < 1e-9)
            && self.slid_m.iter().all(|slid| slid.norm() < 1e-9)
    }
}

/// The body in one position.
pub(super) struct Pose {
    /// Rotation of each segment from rest, world frame.
    pub rotations: Vec<UnitQuaternion<f64>>,
    /// Start of each segment, world frame, m.
    pub starts: Vec<Point3<f64>>,
}

impl Pose {
    /// The position of a body with these rotations and displacements.
    pub(super) fn of(body: &ElasticBody, joints: &Joints) -> Self {
        let n = joints.turned.len();
        let mut pose = Self { rotations: Vec::with_capacity(n), starts: Vec::with_capacity(n) };
        let moved = joints.turned.iter().zip(&joints.slid_m);
        for (segment, (turned, slid_m)) in body.segments().iter().zip(moved) {
            let (start, rotation) = match segment.parent {
                None => (segment.start() + slid_m, *turned),
                Some(parent) => {
                    let parent = parent as usize;
                    let arm = segment.start() - body.segments()[parent].start();
                    let carried = pose.rotations[parent];
                    (pose.starts[parent] + carried * arm, carried * turned)
                }
            };
            pose.starts.push(start);
            pose.rotations.push(rotation);
        }
        pose
    }

    /// A point of a segment, m; `lever_m` is the vector from the start to the point at rest.
    pub(super) fn point(&self, segment: usize, lever_m: &Vector3<f64>) -> Point3<f64> {
        self.starts[segment] + self.rotations[segment] * lever_m
    }

    /// The joints after a share of a step; `steps` are rotation vectors in the world frame, rad, or displacements of
    /// blocks, m.
    pub(super) fn stepped(
        &self,
        body: &ElasticBody,
        joints: &Joints,
        (steps, share): (&[Vector3<f64>], f64),
    ) -> Joints {
        let mut joints = joints.clone();
        for (index, (segment, step)) in body.segments().iter().zip(steps).enumerate() {
            if segment.kind == SegmentKind::Block {
                joints.slid_m[index] += step * share;
                continue;
            }
            let step = match segment.parent {
                Some(parent) => self.rotations[parent as usize].inverse() * (step * share),
                None => step * share,
            };
            let turned = &mut joints.turned[index];
            *turned = UnitQuaternion::from_scaled_axis(step) * *turned;
        }
        joints
    }

    /// Largest distance between the ends of segments in this and in another position, m.
    pub(super) fn farthest_from(&self, other: &Self, body: &ElasticBody) -> f64 {
        let ends = body.segments().iter().enumerate().map(|(index, segment)| {
            let axis = segment.axis();
            (self.point(index, &axis) - other.point(index, &axis)).norm()
        });
        ends.fold(0.0, f64::max)
    }
}
