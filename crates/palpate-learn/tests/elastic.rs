//! A body whose touches are known: its constants come back, and no picture makes a field worse.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::sync::Arc;

use palpate::unstable::{ElasticBody, ElasticContactConfig, Equilibrium, Segment, SegmentKind};
use palpate::{Arm, BakeConfig, EstimatorKind, Lattice, MapperConfig, Robot, Sample};
use palpate_learn::elastic::{self, FRICTIONS};
use palpate_learn::folds::folds;
use palpate_learn::tracked::{Touch, Tracked};

const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

/// A rod that turns about the vertical, on a slide along x.
fn arm() -> Arc<Arm> {
    let urdf = r#"<robot name="paddle"><link name="base"/><link name="slide"/><link name="rod">
         <collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.04 0.04"/></geometry></collision>
         </link>
         <joint name="along" type="prismatic"><parent link="base"/><child link="slide"/>
         <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
         <joint name="turn" type="continuous"><parent link="slide"/><child link="rod"/>
         <axis xyz="0 0 1"/></joint></robot>"#;
    let robot = Robot::from_urdf(urdf).unwrap();
    Arc::new(Arm::bake(robot, &BakeConfig::default(), |_| unreachable!()).unwrap().0)
}

/// Three stems beside the rod.
fn body() -> Arc<ElasticBody> {
    let mut segments = Vec::new();
    for stem in 0..3_u32 {
        for piece in 0..6_u32 {
            let x = 0.2 + 0.1 * f64::from(stem);
            let z = |piece: u32| -0.25 + 0.06 * f64::from(piece);
            segments.push(Segment {
                parent: piece.checked_sub(1).map(|below| 6 * stem + below),
                kind: SegmentKind::Wood,
                start_m: [x, 0.1, z(piece)],
                end_m: [x + 0.003, 0.1, z(piece + 1)],
                bare_m: 0.0,
                radius_m: 0.008,
                half_width_m: [0.0; 3],
                stiffness_n_m_per_rad: 20.0,
                branch: stem,
            });
        }
    }
    Arc::new(ElasticBody::new(segments).unwrap())
}

fn config() -> MapperConfig {
    let mut config = MapperConfig::of(EstimatorKind::Map);
    config.lattice = Lattice::filling([-0.3, -0.3, -0.3], [0.8, 0.5, 0.3], 0.03).unwrap();
    config.estimator.replays = 3;
    config
}

/// Touches of a body that is stiffer by a factor, with a friction.
fn touches(arm: &Arc<Arm>, factor: f64, friction: f64) -> Vec<Touch> {
    let touch = |number: usize| {
        let config = ElasticContactConfig { friction, ..ElasticContactConfig::default() };
        let mut equilibrium = Equilibrium::new(Arc::clone(arm), body(), config);
        let sample = |frame: usize| {
            let way = frame.saturating_sub(8) as f64 / 40.0;
            let q = vec![-0.05 * number as f64 + 0.05 * way, 0.5 * way];
            let poses = arm.robot.forward(&q).unwrap();
            equilibrium.advance(&poses);
            let tau = equilibrium.torque(&poses) * factor;
            Sample::new(None, q, tau.as_slice().to_vec())
        };
        Touch {
            name: format!("touch_{number}"),
            samples: (0..48).map(sample).collect(),
            truth: None,
        }
    };
    (0..4).map(touch).collect()
}

fn tracked(arm: &Arc<Arm>, body: &Arc<ElasticBody>, touches: &[Touch]) -> Tracked {
    let tracked = Tracked::new(arm, &config(), touches, NEVER).unwrap();
    tracked.with_body(arm, body, touches, (NEVER, &|| ())).unwrap()
}

#[test]
fn stiffness_and_friction_of_a_known_body_come_back() {
    let arm = arm();
    let touches = touches(&arm, 2.0, FRICTIONS[2]);
    let tracked = tracked(&arm, &body(), &touches);
    for fold in folds(4, 4) {
        let found = elastic::predict(&tracked, &fold, &config(), NEVER).unwrap();
        assert_eq!(found.constants.friction(), FRICTIONS[2]);
        let factor = found.constants.stiffness_factor;
        assert!((factor / 2.0).ln().abs() < 0.04, "{factor}, wanted 2");
        assert!(found.weights.field < 0.1, "{:?}", found.weights);
        let wanted = &tracked.touches[fold.test[0]].frames;
        let peak = wanted.iter().map(|frame| frame.target[1].abs()).fold(0.0, f64::max);
        assert!(peak > 1.0, "the touch reaches {peak} N·m");
        for (torque, frame) in found.torques[0].iter().zip(wanted) {
            let off = (torque[1] - frame.target[1]).abs();
            assert!(off < 0.1 * peak, "{} N·m, wanted {}", torque[1], frame.target[1]);
        }
    }
}

#[test]
fn a_body_that_is_not_there_is_not_believed() {
    let arm = arm();
    let touches = touches(&arm, 1.0, 0.3);
    // A bush above the plane in which the rod moves.
    let body = body();
    let elsewhere = body.segments().iter().map(|segment| {
        let up = |[x, y, z]: [f64; 3]| [x, y, z + 0.6];
        let (start_m, end_m) = (up(segment.start_m), up(segment.end_m));
        Segment { start_m, end_m, ..segment.clone() }
    });
    let elsewhere = Arc::new(ElasticBody::new(elsewhere.collect()).unwrap());
    let tracked = tracked(&arm, &elsewhere, &touches);
    let fold = &folds(4, 4)[3];
    let found = elastic::predict(&tracked, fold, &config(), NEVER).unwrap();
    let map = palpate_learn::method::Method::Map.predict(&tracked, fold, &config(), NEVER).unwrap();
    assert!(found.weights.body < 0.05, "{:?}", found.weights);
    for (torque, map) in found.torques[0].iter().zip(&map[0]) {
        assert!((torque[1] - map[1]).abs() <= 0.05 * map[1].abs() + 1e-9, "{torque:?}, {map:?}");
    }
}
