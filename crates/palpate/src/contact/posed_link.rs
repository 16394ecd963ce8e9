//! Pose of a link, distance of points from its box, and how far it moves.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Vector3};

use crate::sdf::DistanceGrid;

/// Pose of a link, prepared to transform points fast.
#[derive(Debug, Clone)]
pub(super) struct PosedLink {
    pub(super) world_from_link: Isometry3<f64>,
    /// The rotation as a matrix, which rotates points faster.
    pub(super) rotation: Rotation3<f64>,
}

impl PosedLink {
    pub(super) fn new(world_from_link: &Isometry3<f64>) -> Self {
        let rotation = world_from_link.rotation.to_rotation_matrix();
        Self { world_from_link: *world_from_link, rotation }
    }

    /// Transforms a point from the world frame to the link's frame.
    #[inline]
    pub(super) fn in_link(&self, point: &Point3<f64>) -> Point3<f64> {
        let from_origin = point.coords - self.world_from_link.translation.vector;
        Point3::from(self.rotation.matrix().tr_mul(&from_origin))
    }

    /// World-aligned box around the box of a link's surface: lowest and highest corner.
    pub(super) fn bounds(&self, surface: &DistanceGrid) -> (Point3<f64>, Point3<f64>) {
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for corner in corners(surface) {
            let corner = self.world_from_link * corner;
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        (low, high)
    }
}

/// How far a point is from the box of a link's surface, in the link's frame, m.
#[inline]
pub(super) fn box_distance_m(surface: &DistanceGrid, point_link: &Point3<f64>) -> f64 {
    let (low, high) = surface.bounds();
    let outside = (low - point_link).sup(&(point_link - high)).sup(&Vector3::zeros());
    outside.norm()
}

/// The eight corners of the box of a link's surface, in its frame.
fn corners(surface: &DistanceGrid) -> [Point3<f64>; 8] {
    let (low, high) = surface.bounds();
    std::array::from_fn(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
        Point3::new(pick(0), pick(1), pick(2))
    })
}

/// How far the arm moves between two sets of link poses, m: the largest straight-line displacement of a corner of any
/// link's bounding box.
pub(crate) fn travel_m(
    surfaces: &[Option<DistanceGrid>],
    from: &[Isometry3<f64>],
    to: &[Isometry3<f64>],
) -> f64 {
    let mut travel_m2: f64 = 0.0;
    for ((surface, from), to) in surfaces.iter().zip(from).zip(to) {
        if let Some(surface) = surface {
            travel_m2 = travel_m2.max(corner_travel_m2(surface, from, to));
        }
    }
    travel_m2.sqrt()
}

/// Squared displacement of the corner of a link's box that moves farthest, m². A corner c moves from
/// `R c + t` to `R' c + t'`; its displacement is `(R' − R) c + t' − t`.
fn corner_travel_m2(surface: &DistanceGrid, from: &Isometry3<f64>, to: &Isometry3<f64>) -> f64 {
    let matrix = |pose: &Isometry3<f64>| *pose.rotation.to_rotation_matrix().matrix();
    let turn: Matrix3<f64> = matrix(to) - matrix(from);
    let shift = to.translation.vector - from.translation.vector;
    let corners = corners(surface).into_iter();
    corners.map(|corner| (turn * corner.coords + shift).norm_squared()).fold(0.0, f64::max)
}

/// Upper bound of the motion in the link's frame, m, of a point within `within_m` of a link's box while the link moves.
///
/// In this frame a point x moves to `x' = M x` with `M = to⁻¹ from`. No point within a ball of radius ρ about the
/// centre c of the box moves farther than `|M c − c| + 2 sin(θ/2) ρ`. Points within `within_m` of the box are in the
/// ball whose radius is half the box's diagonal plus `within_m`; a point outside the ball comes closer by at most
/// `|M c − c|` in a motion.
pub(super) fn travel_in_link_m(
    surface: &DistanceGrid,
    within_m: f64,
    from: &Isometry3<f64>,
    to: &Isometry3<f64>,
) -> f64 {
    let (low, high) = surface.bounds();
    let (middle, half) = (nalgebra::center(&low, &high), (high - low) / 2.0);
    let motion = to.inv_mul(from);
    let chord = 2.0 * motion.rotation.imag().norm();
    (motion * middle - middle).norm() + chord * (half.norm() + within_m)
}
