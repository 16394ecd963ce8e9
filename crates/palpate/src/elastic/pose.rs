//! Where the segments of a body are, for given turns of its joints.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::body::ElasticBody;

/// The body in one position.
pub(super) struct Pose {
    /// Rotation of each segment from rest, world frame.
    pub rotations: Vec<UnitQuaternion<f64>>,
    /// Start of each segment, world frame, m.
    pub starts: Vec<Point3<f64>>,
}

impl Pose {
    /// The position of a body whose joints are `turned`, each in the frame of the carrying segment.
    pub(super) fn of(body: &ElasticBody, turned: &[UnitQuaternion<f64>]) -> Self {
        let n = turned.len();
        let mut pose = Self { rotations: Vec::with_capacity(n), starts: Vec::with_capacity(n) };
        for (segment, turned) in body.segments().iter().zip(turned) {
            let (start, rotation) = match segment.parent {
                None => (segment.start(), *turned),
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

    /// A point of a segment, m; `lever_m` leads to it from the start, at rest.
    pub(super) fn point(&self, segment: usize, lever_m: &Vector3<f64>) -> Point3<f64> {
        self.starts[segment] + self.rotations[segment] * lever_m
    }

    /// The turns of the joints after a share of a step, which turns each in the world frame, rad.
    pub(super) fn turned(
        &self,
        body: &ElasticBody,
        turned: &[UnitQuaternion<f64>],
        (steps, share): (&[Vector3<f64>], f64),
    ) -> Vec<UnitQuaternion<f64>> {
        let segments = body.segments().iter().zip(turned).zip(steps);
        let turned = segments.map(|((segment, turned), step)| {
            let step = match segment.parent {
                Some(parent) => self.rotations[parent as usize].inverse() * (step * share),
                None => step * share,
            };
            UnitQuaternion::from_scaled_axis(step) * turned
        });
        turned.collect()
    }

    /// How far the ends of segments are from those of another position, at most, m.
    pub(super) fn farthest_from(&self, other: &Self, body: &ElasticBody) -> f64 {
        let ends = body.segments().iter().enumerate().map(|(index, segment)| {
            let axis = segment.axis();
            (self.point(index, &axis) - other.point(index, &axis)).norm()
        });
        ends.fold(0.0, f64::max)
    }
}
