//! Position of the camera: beside the arm, so that all of it is seen from the side.

use nalgebra::{Point3, Vector3};
use re_sdk_types::blueprint::archetypes::EyeControls3D;
use re_sdk_types::blueprint::components::Eye3DKind;

use crate::recording::Scene;
use crate::view_model::single;

/// Distance of the camera from the middle of the arm, in diagonals of its bounding box.
const DISTANCE: f64 = 1.0;
/// Offset of the camera forward along the reach of the arm, and upward, per unit sideways.
const BEFORE: f64 = 0.35;
const ABOVE: f64 = 0.3;

/// The camera for the first pose of the arm; `None` if no link has a shape.
pub(crate) fn eye(scene: &Scene) -> Option<EyeControls3D> {
    let links = scene.links.iter().zip(&scene.world_from_link);
    let corners = links.flat_map(|(link, pose)| link.vertices_m.iter().map(move |v| pose * v));
    let (position, target) = beside(corners)?;
    let eye = EyeControls3D::new().with_kind(Eye3DKind::Orbital);
    let eye = eye.with_position(single(&position)).with_look_target(single(&target));
    Some(eye.with_eye_up([0.0, 0.0, 1.0]))
}

/// Position and target of a camera that sees from the side an arm that reaches out from the origin.
fn beside(points: impl Iterator<Item = Point3<f64>>) -> Option<(Point3<f64>, Point3<f64>)> {
    let ends = points.map(|point| (point, point));
    let (low, high) = ends.reduce(|(low, high), (point, _)| (low.inf(&point), high.sup(&point)))?;
    let middle = nalgebra::center(&low, &high);
    let reach = Vector3::new(middle.x, middle.y, 0.0);
    let reach = reach.try_normalize(0.01).unwrap_or_else(Vector3::x);
    let side = reach.cross(&Vector3::z());
    let away = (side + BEFORE * reach + ABOVE * Vector3::z()).normalize();
    Some((middle + DISTANCE * (high - low).norm() * away, middle))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_is_seen_from_beside_and_above_whichever_way_it_points() {
        for angle in [0.0_f64, 1.0, 2.5, 4.0] {
            let reach = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let points =
                [Point3::origin(), Point3::from(reach), Point3::from(reach * 0.4 + Vector3::z())];
            let (eye, target) = beside(points.into_iter()).unwrap();
            let look = (target - eye).normalize();
            assert!(look.dot(&reach).abs() < 0.4 && look.z < -0.2, "{look}");
            assert!(points.iter().all(|point| (point - eye).normalize().dot(&look) > 0.8));
        }
        assert!(beside(std::iter::empty()).is_none());
    }
}
