//! Bodies whose rest position is known from mechanics.

use super::*;
use crate::robot::Robot;
use crate::sdf::BakeConfig;

/// A plate of 40 cm by 40 cm that moves down along z, its lower face at z = 0 when q = 0.
fn press() -> Arc<Arm> {
    let urdf = r#"<robot name="press"><link name="base"/><link name="plate"><collision>
         <origin xyz="0.3 0 0.05"/><geometry><box size="0.4 0.4 0.1"/></geometry></collision></link>
         <joint name="down" type="prismatic"><parent link="base"/><child link="plate"/>
         <axis xyz="0 0 -1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"#;
    let robot = Robot::from_urdf(urdf).expect("a robot");
    let no_mesh = |_: &str| unreachable!("primitives only");
    Arc::new(Arm::bake(robot, &BakeConfig::new(0.02, 0.3), no_mesh).expect("an arm").0)
}

const LENGTH_M: f64 = 0.3;
const BALL_M: f64 = 0.25;

/// A rod along x, fixed at the origin, with a bending stiffness of one N·m² and a ball at its end.
fn cantilever(pieces: usize) -> Arc<ElasticBody> {
    let piece = LENGTH_M / pieces as f64;
    let rod = |at: usize| Segment {
        parent: at.checked_sub(1).map(|parent| parent as u32),
        kind: SegmentKind::Wood,
        start_m: [at as f64 * piece, 0.0, 0.0],
        end_m: [(at + 1) as f64 * piece, 0.0, 0.0],
        // The rod itself touches nothing.
        bare_m: piece - 1e-9,
        radius_m: 1e-4,
        half_width_m: [0.0; 3],
        joint_stiffness: if at == 0 { 2.0 / piece } else { 1.0 / piece },
        branch: 0,
    };
    let mut segments: Vec<Segment> = (0..pieces).map(rod).collect();
    segments[pieces - 1].radius_m = BALL_M;
    Arc::new(ElasticBody::new(segments).expect("a body"))
}

/// Force, N, on the plate at each depth of a ball around z = 0, m.
fn pressed(equilibrium: &mut Equilibrium, depths_m: &[f64]) -> Vec<f64> {
    let arm = Arc::clone(&equilibrium.arm);
    let force = |&depth: &f64| {
        let poses = arm.robot.forward(&[depth - BALL_M]).expect("one joint");
        let convergence = equilibrium.advance(&poses.world_from_link, Some(0.01));
        assert_eq!(
            convergence.not_converged, 0,
            "at {depth} m after {} iterations",
            convergence.iterations
        );
        equilibrium.torques(&poses).sum().abs()
    };
    depths_m.iter().map(force).collect()
}

fn stiff(friction: f64) -> ElasticContactConfig {
    ElasticContactConfig { friction, stiffness_n_per_m: 1e5, ..ElasticContactConfig::default() }
}

fn ramp(to_m: f64, steps: usize) -> Vec<f64> {
    (0..=steps).map(|step| -0.002 + (to_m + 0.002) * step as f64 / steps as f64).collect()
}

#[test]
fn a_cantilever_bends_by_the_cube_of_its_length() {
    let mut equilibrium = Equilibrium::new(press(), cantilever(30), stiff(0.0));
    let depths = ramp(0.003, 10);
    let forces = pressed(&mut equilibrium, &depths);
    let wanted = 3.0 * 0.003 / LENGTH_M.powi(3); // 3 EI δ / L³
    assert!((forces[10] / wanted - 1.0).abs() < 0.02, "{} N, wanted {wanted}", forces[10]);
    assert_eq!(forces[0], 0.0, "above the ball");
}

#[test]
fn a_cantilever_that_bends_far_follows_the_elastica() {
    // P L² / EI and the deflection of the end by the length (Mattiasson 1981).
    for (load, deflection) in [(1.0, 0.30172), (2.0, 0.49346), (5.0, 0.71379)] {
        let mut equilibrium = Equilibrium::new(press(), cantilever(40), stiff(0.0));
        let depths = ramp(deflection * LENGTH_M, 100);
        let force = pressed(&mut equilibrium, &depths)[100];
        let got = force * LENGTH_M * LENGTH_M;
        assert!((got / load - 1.0).abs() < 0.02, "{got}, wanted {load}");
    }
}

#[test]
fn without_friction_the_work_of_the_arm_is_the_energy_of_the_springs() {
    let mut equilibrium = Equilibrium::new(press(), cantilever(20), stiff(0.0));
    let depths = ramp(0.12, 200);
    let forces = pressed(&mut equilibrium, &depths);
    let work: f64 =
        (1..=200).map(|i| 0.5 * (forces[i] + forces[i - 1]) * (depths[i] - depths[i - 1])).sum();
    let springs = equilibrium.body.segments().iter().zip(&equilibrium.state.joints.turned);
    let energy: f64 =
        springs.map(|(s, turned)| 0.5 * s.joint_stiffness * turned.angle().powi(2)).sum();
    assert!((work / energy - 1.0).abs() < 0.01, "{work} J of work, {energy} J in springs");
}

#[test]
fn a_body_goes_back_to_rest_when_the_arm_leaves_and_friction_takes_work() {
    let mut equilibrium = Equilibrium::new(press(), cantilever(20), stiff(0.5));
    let down = ramp(0.12, 60);
    let there = pressed(&mut equilibrium, &down);
    let up: Vec<f64> = down.iter().rev().copied().collect();
    let back = pressed(&mut equilibrium, &up);
    assert!(equilibrium.state.joints.are_at_rest() && back[60] == 0.0);
    let work = |forces: &[f64]| forces.iter().sum::<f64>();
    assert!(work(&back) < 0.98 * work(&there), "{} and {}", work(&back), work(&there));
}

#[test]
fn all_springs_twice_as_stiff_push_back_twice_as_hard() {
    let depths = ramp(0.1, 50);
    let mut soft = Equilibrium::new(press(), cantilever(10), stiff(0.4));
    let twice = |segment: &Segment| Segment {
        joint_stiffness: 2.0 * segment.joint_stiffness,
        ..segment.clone()
    };
    let body =
        ElasticBody::new(cantilever(10).segments().iter().map(twice).collect()).expect("a body");
    let hard = ElasticContactConfig { stiffness_n_per_m: 2e5, ..stiff(0.4) };
    let mut hard = Equilibrium::new(press(), Arc::new(body), hard);
    let (soft, hard) = (pressed(&mut soft, &depths), pressed(&mut hard, &depths));
    for (soft, hard) in soft.iter().zip(&hard) {
        assert!((2.0 * soft - hard).abs() < 1e-3 * hard.max(0.1), "{soft} N and {hard} N");
    }
}

/// Three by three blocks of 4 cm under the plate, their tops at z = 0; those of one row are higher up.
fn cushion(k_n_per_m: f64, higher_m: f64) -> Arc<ElasticBody> {
    let block = |at: usize| {
        let (x, y) = (0.26 + 0.04 * (at / 3) as f64, -0.04 + 0.04 * (at % 3) as f64);
        let z = -0.004 + if at % 3 == 1 { higher_m } else { 0.0 };
        Segment {
            parent: None,
            kind: SegmentKind::Block,
            start_m: [x - 0.02, y, z],
            end_m: [x + 0.02, y, z],
            bare_m: 0.0,
            radius_m: 0.004,
            half_width_m: [0.0, 0.02, 0.0],
            joint_stiffness: k_n_per_m,
            branch: 0,
        }
    };
    Arc::new(ElasticBody::new((0..9).map(block).collect()).expect("a body"))
}

/// Force, N, on the plate when it has gone down to this height, m.
fn press_down(body: Arc<ElasticBody>, to_m: f64) -> f64 {
    let config = ElasticContactConfig { stiffness_n_per_m: 2e4, ..stiff(0.0) };
    let depth_m = |step| BALL_M - 0.1 + (0.1 + to_m) * f64::from(step) / 40.0;
    let depths_m: Vec<f64> = (0..=40).map(depth_m).collect();
    pressed(&mut Equilibrium::new(press(), body, config), &depths_m)[40]
}

#[test]
fn a_cushion_pressed_flat_resists_as_all_its_blocks_do() {
    let force = press_down(cushion(20.0, 0.0), 0.02);
    let wanted = 9.0 * 20.0 * 0.02;
    assert!((force / wanted - 1.0).abs() < 0.01, "{force} N, wanted {wanted}");
}

#[test]
fn a_row_that_is_pressed_alone_takes_its_neighbours_with_it() {
    // Each block of the row has two neighbours of its own stiffness k, each sheared with k and held with k:
    // they follow by half. So the row resists with 3 k (1 + 2 · ½).
    let force = press_down(cushion(20.0, 0.05), -0.02);
    let wanted = 3.0 * 20.0 * 0.03 * 2.0;
    assert!((force / wanted - 1.0).abs() < 0.02, "{force} N, wanted {wanted}");
}
