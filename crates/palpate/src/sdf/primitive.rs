//! Exact signed distance of the primitive shapes of URDF.

use nalgebra::{Point3, Vector3};

use crate::robot::Shape;

/// Signed distance of a point from a shape, in the shape's own frame, m; negative inside.
///
/// Exact (Euclidean) everywhere. `None` for a mesh, of which only the file's name is known here.
pub fn signed_distance(shape: &Shape, point_shape: &Point3<f64>) -> Option<f64> {
    let p = point_shape;
    Some(match shape {
        Shape::Box { size_m } => {
            let beyond = p.coords.abs() - size_m / 2.0;
            beyond.sup(&Vector3::zeros()).norm() + beyond.max().min(0.0)
        }
        Shape::Cylinder { radius_m, length_m } => {
            let (across, along) = (p.x.hypot(p.y) - radius_m, p.z.abs() - length_m / 2.0);
            across.max(0.0).hypot(along.max(0.0)) + across.max(along).min(0.0)
        }
        Shape::Sphere { radius_m } => p.coords.norm() - radius_m,
        Shape::Capsule { radius_m, length_m } => {
            let on_axis = p.z.clamp(-length_m / 2.0, length_m / 2.0);
            Vector3::new(p.x, p.y, p.z - on_axis).norm() - radius_m
        }
        Shape::Mesh { .. } => return None,
    })
}

/// Half the size of the smallest box around a shape, centred and aligned with its frame.
pub(super) fn half_extent(shape: &Shape) -> Option<Vector3<f64>> {
    Some(match *shape {
        Shape::Box { size_m } => size_m / 2.0,
        Shape::Cylinder { radius_m, length_m } => Vector3::new(radius_m, radius_m, length_m / 2.0),
        Shape::Sphere { radius_m } => Vector3::repeat(radius_m),
        Shape::Capsule { radius_m, length_m } => {
            Vector3::new(radius_m, radius_m, length_m / 2.0 + radius_m)
        }
        Shape::Mesh { .. } => return None,
    })
}
