//! Between two joint positions.

use std::f64::consts::TAU;

use super::{Joint, JointKind, Robot};

impl Robot {
    /// How far each joint goes from one position to another, rad or m.
    ///
    /// An angle takes the shorter way round, so that a log that wraps at ±π or at 2π does not spin
    /// the arm: a continuous joint always, a revolute one where the other way would be more than
    /// half a turn, which no arm makes between two samples.
    ///
    /// # Panics
    ///
    /// If either has not one value a joint, which is a bug in the caller.
    pub fn difference(&self, from: &[f64], to: &[f64]) -> Vec<f64> {
        assert!(from.len() == self.n_joints() && to.len() == self.n_joints(), "one value a joint");
        let way = |((joint, a), b): ((&Joint, &f64), &f64)| match joint.kind {
            JointKind::Prismatic => b - a,
            JointKind::Continuous | JointKind::Revolute => {
                let way = b - a;
                way - TAU * (way / TAU).round()
            }
        };
        self.joints().iter().zip(from).zip(to).map(way).collect()
    }

    /// The joint positions a part (0 to 1) of the way of [`Robot::difference`].
    ///
    /// # Panics
    ///
    /// As [`Robot::difference`].
    pub fn interpolate(&self, from: &[f64], to: &[f64], part: f64) -> Vec<f64> {
        let way = self.difference(from, to);
        from.iter().zip(way).map(|(a, way)| a + part * way).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_angle_takes_the_shorter_way_round_and_a_slide_its_own() {
        let joint = |name: &str, kind: &str, parent: &str, child: &str| {
            format!(
                "<joint name='{name}' type='{kind}'><parent link='{parent}'/><child \
                 link='{child}'/><axis xyz='0 0 1'/><limit lower='-4' upper='4' effort='1' \
                 velocity='1'/></joint>"
            )
        };
        let robot = Robot::from_urdf(&format!(
            "<robot name='two'><link name='a'/><link name='b'/><link name='c'/>{}{}</robot>",
            joint("round", "continuous", "a", "b"),
            joint("slide", "prismatic", "b", "c"),
        ))
        .unwrap();
        let between = robot.interpolate(&[3.0, 3.0], &[-3.0, -3.0], 0.5);
        assert!((between[0] - std::f64::consts::PI).abs() < 1e-12, "{between:?}");
        assert!(between[1].abs() < 1e-12, "{between:?}");
        assert_eq!(robot.difference(&[0.5, 0.0], &[-0.5, 7.0]), [-1.0, 7.0]);
    }
}
