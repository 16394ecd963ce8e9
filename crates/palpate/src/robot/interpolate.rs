//! Between two joint positions.

use super::{JointKind, Robot};

impl Robot {
    /// The joint positions a part of the way from `from` to `to` (0 to 1).
    ///
    /// A continuous joint takes the shorter way round, so that a log that wraps its angles at
    /// ±π does not spin the arm.
    ///
    /// # Panics
    ///
    /// If either has not one value a joint, which is a bug in the caller.
    pub fn interpolate(&self, from: &[f64], to: &[f64], part: f64) -> Vec<f64> {
        assert!(from.len() == self.n_joints() && to.len() == self.n_joints(), "one value a joint");
        let between = |((joint, a), b): ((&super::Joint, &f64), &f64)| {
            let mut way = b - a;
            if joint.kind == JointKind::Continuous {
                way -= std::f64::consts::TAU * (way / std::f64::consts::TAU).round();
            }
            a + part * way
        };
        self.joints().iter().zip(from).zip(to).map(between).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_continuous_joint_takes_the_shorter_way_and_a_revolute_one_its_own() {
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
            joint("hinge", "revolute", "b", "c"),
        ))
        .unwrap();
        let between = robot.interpolate(&[3.0, 3.0], &[-3.0, -3.0], 0.5);
        assert!((between[0] - std::f64::consts::PI).abs() < 1e-12, "{between:?}");
        assert!(between[1].abs() < 1e-12, "{between:?}");
    }
}
