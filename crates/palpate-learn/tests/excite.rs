//! A motion for identification keeps to its limits.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use palpate::{Arm, BakeConfig, Robot};
use palpate_learn::LearnError;
use palpate_learn::excite::{ExciteConfig, excite};

fn gen3() -> Arm {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    Arm::bake(robot, &BakeConfig::default(), |_| unreachable!("no meshes")).unwrap().0
}

fn config() -> ExciteConfig {
    ExciteConfig { rate_hz: 200.0, tries: 30, ..ExciteConfig::default() }
}

#[test]
fn a_motion_begins_and_ends_at_rest_and_keeps_to_all_limits() {
    let (arm, config) = (gen3(), config());
    let found = excite(&arm, &config, &|| false, &|| ()).unwrap();
    for [q, speed, _] in [&found.points[0], found.points.last().unwrap()] {
        assert!(q.iter().all(|q| q.abs() < 1e-9) && speed.iter().all(|speed| speed.abs() < 1e-9));
    }
    let step = found.times_s[1] - found.times_s[0];
    for (k, three) in found.points.windows(3).enumerate() {
        let slope = |of: usize, j: usize| (three[2][of][j] - three[0][of][j]) / (2.0 * step);
        for (j, (speed, acceleration)) in three[1][1].iter().zip(&three[1][2]).enumerate() {
            assert!((slope(0, j) - speed).abs() < 1e-3, "point {k}, joint {j}");
            assert!((slope(1, j) - acceleration).abs() < 2e-2, "point {k}, joint {j}");
        }
    }
    for [q, speed, acceleration] in &found.points {
        let poses = arm.robot.forward(q).unwrap();
        let torque = arm.robot.inverse_dynamics(&poses, speed, acceleration);
        for (j, joint) in arm.robot.joints().iter().enumerate() {
            assert!(speed[j].abs() <= config.speed_share * joint.velocity.unwrap() * 1.01);
            assert!(torque[j].abs() <= config.torque_share * joint.effort.unwrap() * 1.01);
            if let Some([low, high]) = joint.range {
                assert!((low..=high).contains(&q[j]));
            }
        }
    }
    assert!(found.speed_share > 0.4 && found.speed_share <= 0.505, "{}", found.speed_share);
    assert!(found.lowest_m.unwrap() > 0.045 && found.nearest_m.unwrap() > 0.025, "{found:?}");
    assert!(found.condition < found.first_condition, "{found:?}");
    assert_eq!(found, excite(&arm, &config, &|| false, &|| ()).unwrap(), "a seed says the motion");
}

#[test]
fn impossible_starts_are_refused_with_the_reason() {
    let arm = gen3();
    let refused = |around: Vec<f64>, ground_m| {
        let config = ExciteConfig { around: Some(around), ground_m, ..config() };
        excite(&arm, &config, &|| false, &|| ()).unwrap_err().to_string()
    };
    assert!(refused(vec![0.0; 3], None).contains("3 joint positions"));
    assert!(refused(vec![0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0], None).contains("its range is"));
    assert!(refused(vec![0.0; 7], Some(2.0)).contains("reaches down to"));
    let stopped = excite(&arm, &config(), &|| true, &|| ());
    assert!(matches!(stopped, Err(LearnError::Stopped)));
}
