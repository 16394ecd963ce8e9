//! Differences and interpolation of joint positions, and removal of whole turns.

use std::f64::consts::TAU;

use super::{Joint, JointKind, Robot};

impl Robot {
    /// Difference between two positions of each joint, rad or m.
    ///
    /// Angles are taken the shorter way round, so that a log that wraps at ±π or at 2π does not turn the arm by a whole
    /// turn. This holds for revolute joints too: no arm turns a joint by more than half a turn between two samples.
    ///
    /// # Panics
    ///
    /// If either does not have one value for each joint, which is a bug in the caller.
    pub fn difference(&self, from: &[f64], to: &[f64]) -> Vec<f64> {
        assert!(
            from.len() == self.n_joints() && to.len() == self.n_joints(),
            "one value for each joint"
        );
        let way = |((joint, a), b): ((&Joint, &f64), &f64)| match joint.kind {
            JointKind::Prismatic => b - a,
            JointKind::Continuous | JointKind::Revolute => {
                let way = b - a;
                way - TAU * (way / TAU).round()
            }
        };
        self.joints().iter().zip(from).zip(to).map(way).collect()
    }

    /// Removes the whole turns that are added by sensors that count from 0 to 360° or from −180 to 180°.
    ///
    /// An angle, rad, is changed by whole turns to within half a turn of the joint's position `before`. If it was
    /// changed, or `before` is `None`, and it is beyond the joint's limits, it is changed by one more turn if it is
    /// then within them. Angles that need no turn stay equal to the bit.
    ///
    /// # Panics
    ///
    /// As [`Robot::difference`].
    pub fn unwrap_angles(&self, before: Option<&[f64]>, q: &mut [f64]) {
        let is_first = before.is_none();
        let before = before.map_or_else(|| q.to_vec(), <[f64]>::to_vec);
        assert!(q.len() == self.n_joints() && before.len() == q.len(), "one value for each joint");
        for ((joint, before), q) in self.joints().iter().zip(before).zip(q) {
            if joint.kind == JointKind::Prismatic {
                continue;
            }
            let turns = ((*q - before) / TAU).round();
            if turns != 0.0 {
                *q -= TAU * turns;
            }
            let Some([low, high]) = joint.range else { continue };
            let is_within = |angle: &f64| (low..=high).contains(angle);
            if (is_first || turns != 0.0) && !is_within(q) {
                *q = [*q - TAU, *q + TAU].into_iter().find(is_within).unwrap_or(*q);
            }
        }
    }

    /// The joint positions at a share (0 to 1) of [`Robot::difference`].
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

    fn joint(name: &str, kind: &str, parent: &str, child: &str, limit: f64) -> String {
        format!(
            "<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>\
             <axis xyz='0 0 1'/><limit lower='-{limit}' upper='{limit}' effort='1' velocity='1'/>\
             </joint>"
        )
    }

    #[test]
    fn an_angle_takes_the_shorter_way_round_and_a_slide_its_own() {
        let robot = Robot::from_urdf(&format!(
            "<robot name='two'><link name='a'/><link name='b'/><link name='c'/>{}{}</robot>",
            joint("round", "continuous", "a", "b", 4.0),
            joint("slide", "prismatic", "b", "c", 4.0),
        ))
        .unwrap();
        let between = robot.interpolate(&[3.0, 3.0], &[-3.0, -3.0], 0.5);
        assert!((between[0] - std::f64::consts::PI).abs() < 1e-12, "{between:?}");
        assert!(between[1].abs() < 1e-12, "{between:?}");
        assert_eq!(robot.difference(&[0.5, 0.0], &[-0.5, 7.0]), [-1.0, 7.0]);
    }

    #[test]
    fn positions_counted_from_0_to_360_degrees_become_those_of_the_joints() {
        let links = ["a", "b", "c", "d"].map(|link| format!("<link name='{link}'/>")).concat();
        let joints = [
            joint("round", "continuous", "a", "b", 2.4),
            joint("limited", "revolute", "b", "c", 2.4),
            joint("slide", "prismatic", "c", "d", 2.4),
        ];
        let urdf = format!("<robot name='three'>{links}{}</robot>", joints.concat());
        let robot = Robot::from_urdf(&urdf).unwrap();
        let mut before: Option<Vec<f64>> = None;
        for step in -40..=40 {
            let way = 0.1 * f64::from(step);
            let moved = [way, 0.55 * way, way];
            let mut q = [way.rem_euclid(TAU), (0.55 * way).rem_euclid(TAU), way];
            robot.unwrap_angles(before.as_deref(), &mut q);
            // A continuous joint goes on from its first position, -4 + 2 π.
            for (found, wanted) in q.iter().zip([moved[0] + TAU, moved[1], moved[2]]) {
                assert!((found - wanted).abs() < 1e-12, "{q:?} for {moved:?}");
            }
            before = Some(q.to_vec());
        }
        // Angles that no turn brings within the limits, and degrees, stay as they are.
        for mut q in [[0.1, 2.5, 9.0], [90.0, 45.0, 0.0]] {
            let given = q;
            robot.unwrap_angles(None, &mut q);
            assert_eq!(q.map(f64::to_bits), given.map(f64::to_bits));
        }
    }
}
