//! Laws of the kinematics, on robots of several makers' shapes.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use k::nalgebra as kna;
use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use palpate::unstable::{LinkId, Poses};
use palpate::{Payload, Robot};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{PANDA_LIKE, TWO_ARMS, random_q, robots, uniform};

fn ids(robot: &Robot) -> impl Iterator<Item = LinkId> + use<> {
    (0..robot.links().len() as u16).map(LinkId)
}

/// Poses with one joint moved.
fn nudged(robot: &Robot, q: &[f64], joint: usize, by: f64) -> Poses {
    let mut moved = q.to_vec();
    moved[joint] += by;
    robot.forward(&moved).unwrap()
}

fn potential_energy_j(robot: &Robot, poses: &Poses) -> f64 {
    (robot.links().iter().zip(&poses.world_from_link))
        .map(|(link, pose)| link.mass_kg * 9.81 * (pose * link.com_link_m).z)
        .sum()
}

#[test]
fn the_jacobian_is_the_derivative_of_forward() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (name, robot) in robots() {
        let q = random_q(&mut rng, robot.n_joints(), 1.5);
        let poses = robot.forward(&q).unwrap();
        for link in ids(&robot) {
            let point_link = Point3::from(Vector3::from_fn(|_, _| uniform(&mut rng, -0.3, 0.3)));
            let jacobian =
                robot.jacobian(&poses, link, &(poses.world_from_link[link.index()] * point_link));
            for joint in 0..robot.n_joints() {
                let at = |by: f64| {
                    nudged(&robot, &q, joint, by).world_from_link[link.index()] * point_link
                };
                let slope = (at(1e-6) - at(-1e-6)) / 2e-6;
                let error = (jacobian.column(joint) - slope).amax();
                assert!(error < 1e-8, "{name}, {link:?}, joint {joint}: {error}");
            }
        }
    }
}

#[test]
fn the_spatial_jacobian_gives_the_torque_of_a_force_at_any_point() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (name, robot) in robots() {
        let poses = robot.forward(&random_q(&mut rng, robot.n_joints(), 1.5)).unwrap();
        for link in ids(&robot) {
            let point = Point3::from(Vector3::from_fn(|_, _| uniform(&mut rng, -1.0, 1.0)));
            let force = Vector3::from_fn(|_, _| uniform(&mut rng, -10.0, 10.0));
            let moment = point.coords.cross(&force);
            let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);

            let at_point = robot.jacobian(&poses, link, &point).transpose() * force;
            let spatial = robot.spatial_jacobian(&poses, link).transpose() * wrench;

            assert!((at_point - spatial).amax() < 1e-12, "{name}, {link:?}");
        }
    }
}

#[test]
fn gravity_exerts_minus_the_slope_of_potential_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (name, robot) in robots() {
        let tool = robot.links().last().unwrap().name.clone();
        let payload = Payload::new(tool, 1.5, [0.02, -0.03, 0.1]);
        for robot in [robot.clone(), robot.with_payload(&payload).unwrap()] {
            let q = random_q(&mut rng, robot.n_joints(), 1.5);
            let torque = robot.gravity_torque(&robot.forward(&q).unwrap());
            assert!(torque.amax() > 0.1, "{name}: a case with something to find");
            for joint in 0..robot.n_joints() {
                let energy = |by: f64| potential_energy_j(&robot, &nudged(&robot, &q, joint, by));
                let slope = (energy(1e-5) - energy(-1e-5)) / 2e-5;
                assert!((torque[joint] + slope).abs() < 1e-7, "{name}, joint {joint}");
            }
        }
    }
}

/// The same robot in crate `k`, which knows the order of joints by name.
fn in_k(xml: &str, robot: &Robot, q: &[f64]) -> k::Chain<f64> {
    let mut urdf = urdf_rs_of_k::read_from_string(xml).unwrap();
    for joint in &mut urdf.joints {
        // `k` lets mimic joints follow only within limits.
        (joint.limit.lower, joint.limit.upper) = (-10.0, 10.0);
    }
    let chain = k::Chain::from(urdf);
    for (name, &position) in robot.joint_names().zip(q) {
        chain.find(name).unwrap().set_joint_position(position).unwrap();
    }
    chain.update_transforms();
    chain
}

/// A pose as twelve numbers, for either version of nalgebra.
fn numbers(pose: &Isometry3<f64>) -> Vec<f64> {
    pose.to_matrix().iter().copied().collect()
}

fn numbers_of_k(pose: &kna::Isometry3<f64>) -> Vec<f64> {
    pose.to_homogeneous().iter().copied().collect()
}

#[test]
fn poses_and_jacobian_agree_with_crate_k() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let gen3 = include_str!("../src/robot/kinova_gen3.urdf");
    for xml in [PANDA_LIKE, TWO_ARMS, gen3] {
        let robot = Robot::from_urdf(xml).unwrap();
        let q = random_q(&mut rng, robot.n_joints(), 1.5);
        let (poses, chain) = (robot.forward(&q).unwrap(), in_k(xml, &robot, &q));
        for (link, pose) in robot.links().iter().zip(&poses.world_from_link) {
            let theirs = chain.find_link(&link.name).unwrap().world_transform().unwrap();
            let far = (numbers(pose).iter().zip(numbers_of_k(&theirs)))
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            assert!(far < 1e-12, "{} {}: {far}", robot.name(), link.name);
        }
    }

    let robot = Robot::from_urdf(gen3).unwrap();
    let q = random_q(&mut rng, robot.n_joints(), 1.5);
    let (poses, chain) = (robot.forward(&q).unwrap(), in_k(gen3, &robot, &q));
    let tip = robot.links().len() - 1;
    let end = chain.find_link(&robot.links()[tip].name).unwrap();
    let theirs = k::jacobian(&k::SerialChain::from_end(end));
    let point = Point3::from(poses.world_from_link[tip].translation.vector);
    let ours = robot.jacobian(&poses, LinkId(tip as u16), &point);
    let far = (0..7)
        .flat_map(|joint| (0..3).map(move |row| (row, joint)))
        .map(|at| (ours[at] - theirs[at]).abs())
        .fold(0.0, f64::max);
    assert!(far < 1e-12, "jacobian: {far}");
}

#[test]
fn gravity_agrees_with_the_centre_of_mass_of_crate_k() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for xml in [PANDA_LIKE, TWO_ARMS, include_str!("../src/robot/kinova_gen3.urdf")] {
        let robot = Robot::from_urdf(xml).unwrap();
        let q = random_q(&mut rng, robot.n_joints(), 1.5);
        let mass_kg: f64 = robot.links().iter().map(|link| link.mass_kg).sum();
        let torque = robot.gravity_torque(&robot.forward(&q).unwrap());
        for joint in 0..robot.n_joints() {
            let height = |by: f64| {
                let mut moved = q.clone();
                moved[joint] += by;
                k::center_of_mass(&in_k(xml, &robot, &moved)).z
            };
            let slope = -mass_kg * 9.81 * (height(1e-5) - height(-1e-5)) / 2e-5;
            assert!((torque[joint] - slope).abs() < 1e-6, "{} joint {joint}", robot.name());
        }
    }
}

#[test]
fn a_payload_equals_a_link_of_that_mass() {
    let without = TWO_ARMS.replace("<!-- payload -->", "");
    let with = TWO_ARMS.replace(
        "<!-- payload -->",
        r#"<link name="load"><inertial><origin xyz="0.1 0 0.02" rpy="1 2 3"/><mass value="0.8"/>
           <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
           <joint name="grip" type="fixed"><parent link="left_hand"/><child link="load"/></joint>"#,
    );
    let payload = Payload::new("left_hand", 0.8, [0.1, 0.0, 0.02]);
    let one = Robot::from_urdf(&without).unwrap().with_payload(&payload).unwrap();
    let other = Robot::from_urdf(&with).unwrap();

    let q = random_q(&mut ChaCha8Rng::seed_from_u64(6), one.n_joints(), 1.5);
    let torque = |robot: &Robot| robot.gravity_torque(&robot.forward(&q).unwrap());
    assert!((torque(&one) - torque(&other)).amax() < 1e-12);
}
