//! An oblique view without perspective, z up: the scale is the same everywhere, so that a scale bar
//! can be drawn.

use nalgebra::{Point3, Vector3};

/// Elevation of the eye above the horizon.
const ELEVATION_RAD: f64 = 0.30;
/// Azimuth of the eye, measured from the direction from the object to the robot. At zero the arm
/// would hide the object; at a right angle the side of the object that faces the robot would not be
/// seen.
const ASIDE_RAD: f64 = 1.0;

/// A viewing direction, as unit vectors in the world frame.
pub(crate) struct View {
    right: Vector3<f64>,
    up: Vector3<f64>,
    /// From the object to the eye.
    towards: Vector3<f64>,
}

impl View {
    /// The view from the robot's side of an object around `middle`; the robot is at the origin and
    /// faces it.
    pub(crate) fn of(middle: &Point3<f64>) -> Self {
        let back = (-middle.y).atan2(-middle.x);
        let around = if middle.x.hypot(middle.y) > 1e-6 { back + ASIDE_RAD } else { -ASIDE_RAD };
        let (across, above) = (ELEVATION_RAD.cos(), ELEVATION_RAD.sin());
        let towards = Vector3::new(across * around.cos(), across * around.sin(), above);
        let right = Vector3::new(-around.sin(), around.cos(), 0.0);
        Self { right, up: towards.cross(&right), towards }
    }

    /// Unit vector from the object to the eye, world frame.
    pub(crate) fn towards(&self) -> Vector3<f64> {
        self.towards
    }

    /// Coordinates of a point to the right, up and towards the eye, m.
    pub(super) fn seen(&self, point: &Point3<f64>) -> [f64; 3] {
        self.turned(&point.coords)
    }

    /// Components of a direction to the right, up and towards the eye.
    pub(super) fn turned(&self, direction: &Vector3<f64>) -> [f64; 3] {
        [self.right, self.up, self.towards].map(|axis| axis.dot(direction))
    }
}

/// A rectangle of the view: to the right and up, m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rectangle {
    pub(super) low: [f64; 2],
    pub(super) high: [f64; 2],
}

impl Rectangle {
    /// The smallest rectangle around all points; `None` if there is no point.
    pub(super) fn around(points: impl Iterator<Item = [f64; 3]>) -> Option<Self> {
        points.fold(None, |frame: Option<Self>, [x, y, _]| {
            let frame = frame.unwrap_or(Self { low: [x, y], high: [x, y] });
            let low = [frame.low[0].min(x), frame.low[1].min(y)];
            Some(Self { low, high: [frame.high[0].max(x), frame.high[1].max(y)] })
        })
    }

    /// The smallest rectangle around both.
    pub(super) fn and(self, other: Self) -> Self {
        let low = [0, 1].map(|axis| self.low[axis].min(other.low[axis]));
        Self { low, high: [0, 1].map(|axis| self.high[axis].max(other.high[axis])) }
    }

    /// Wider by a margin on each side, m.
    pub(super) fn with_margin(self, [across, up]: [f64; 2]) -> Self {
        let Self { low, high } = self;
        Self { low: [low[0] - across, low[1] - up], high: [high[0] + across, high[1] + up] }
    }

    /// The part within another rectangle; the two must overlap.
    pub(super) fn within(self, other: Self) -> Self {
        let low = [0, 1].map(|axis| self.low[axis].max(other.low[axis]));
        Self { low, high: [0, 1].map(|axis| self.high[axis].min(other.high[axis])) }
    }

    pub(super) fn size(&self) -> [f64; 2] {
        [self.high[0] - self.low[0], self.high[1] - self.low[1]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_keeps_lengths_and_handedness_and_has_z_up() {
        for middle in [[0.6, 0.0, 0.5], [0.0, -0.7, 0.2], [0.0, 0.0, 1.0]] {
            let view = View::of(&Point3::from(middle));
            let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
            let [x, y, z] = axes.map(|axis| Vector3::from(view.turned(&axis)));
            assert!((x.cross(&y) - z).norm() < 1e-12, "{middle:?}");
            assert!((x.norm() - 1.0).abs() < 1e-12 && z.x.abs() < 1e-12 && z.y > 0.9);
            // The robot stands nearer to the eye than what it faces, where it faces anything.
            let [robot, object] = [[0.0, 0.0], [middle[0], middle[1]]]
                .map(|[x, y]| view.seen(&Point3::new(x, y, 0.0))[2]);
            assert!(robot > object || middle[0] == middle[1], "{middle:?}");
        }
    }

    #[test]
    fn a_frame_holds_what_it_is_around() {
        let points = [[1.0, 2.0, 9.0], [-1.0, 5.0, -9.0]];
        let frame = Rectangle::around(points.into_iter()).unwrap();
        assert_eq!(frame, Rectangle { low: [-1.0, 2.0], high: [1.0, 5.0] });
        assert_eq!(frame.with_margin([1.0, 0.5]).size(), [4.0, 4.0]);
        assert_eq!(frame.and(Rectangle { low: [0.0, 0.0], high: [0.0, 9.0] }).size(), [2.0, 9.0]);
        assert_eq!(
            frame.within(Rectangle { low: [0.0, 0.0], high: [9.0, 3.0] }).size(),
            [1.0, 1.0]
        );
        assert_eq!(Rectangle::around(std::iter::empty()), None);
    }
}
