//! Laws of the inverse dynamics: Lagrange's equations, from energies that are computed another way.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use nalgebra::{DVector, Vector3};
use palpate::unstable::{LinkId, N_INERTIAL_PARAMETERS};
use palpate::{Payload, Robot};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{random_q, robots};

/// Kinetic less potential energy, J, from the velocity of each link's centre and its angular velocity.
fn lagrangian(robot: &Robot, q: &[f64], speed: &[f64]) -> f64 {
    let poses = robot.forward(q).unwrap();
    let speed = DVector::from_column_slice(speed);
    let energy = (0..robot.links().len()).map(|index| {
        let (link, pose) = (&robot.links()[index], &poses.world_from_link[index]);
        let id = LinkId(index as u16);
        let com = pose * link.com_link_m;
        let velocity = robot.jacobian(&poses, id, &com) * &speed;
        let spatial = robot.spatial_jacobian(&poses, id) * &speed;
        let turning = pose.rotation.inverse() * Vector3::new(spatial[3], spatial[4], spatial[5]);
        let kinetic = 0.5 * link.mass_kg * velocity.norm_squared()
            + 0.5 * turning.dot(&(link.inertia_com_kg_m2 * turning));
        kinetic - link.mass_kg * 9.81 * com.z
    });
    energy.sum()
}

#[test]
fn inverse_dynamics_are_lagranges_equations() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (name, robot) in robots() {
        let n = robot.n_joints();
        let (q, speed, acceleration) =
            (random_q(&mut rng, n, 1.5), random_q(&mut rng, n, 2.0), random_q(&mut rng, n, 5.0));
        let poses = robot.forward(&q).unwrap();
        let torque = robot.inverse_dynamics(&poses, &speed, &acceleration);
        let h = 1e-4;
        let moved = |from: &[f64], joint: usize, by: f64| {
            let mut moved = from.to_vec();
            moved[joint] += by;
            moved
        };
        // ∂L/∂q̇ at a time along the motion.
        let momentum = |joint: usize, time: f64| {
            let q: Vec<f64> = (0..n)
                .map(|j| q[j] + speed[j] * time + 0.5 * acceleration[j] * time * time)
                .collect();
            let speed: Vec<f64> = (0..n).map(|j| speed[j] + acceleration[j] * time).collect();
            let at = |by: f64| lagrangian(&robot, &q, &moved(&speed, joint, by));
            (at(h) - at(-h)) / (2.0 * h)
        };
        for joint in 0..n {
            let change = (momentum(joint, h) - momentum(joint, -h)) / (2.0 * h);
            let at = |by: f64| lagrangian(&robot, &moved(&q, joint, by), &speed);
            let slope = (at(h) - at(-h)) / (2.0 * h);
            let error = (torque[joint] - (change - slope)).abs();
            assert!(error < 1e-4, "{name}, joint {joint}: {} N·m, off by {error}", torque[joint]);
        }
    }
}

#[test]
fn at_rest_motors_hold_gravity() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (name, robot) in robots() {
        let n = robot.n_joints();
        let poses = robot.forward(&random_q(&mut rng, n, 1.5)).unwrap();
        let rest = vec![0.0; n];
        let sum = robot.inverse_dynamics(&poses, &rest, &rest) + robot.gravity_torque(&poses);
        assert!(sum.amax() < 1e-12, "{name}: {sum}");
    }
}

#[test]
fn parameters_of_bodies_say_all_that_the_links_do() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (name, robot) in robots() {
        let n = robot.n_joints();
        assert_eq!(robot.inertial_parameters().len(), N_INERTIAL_PARAMETERS * robot.bodies().len());
        let merged = robot.clone().with_inertial_parameters(&robot.inertial_parameters());
        let (q, speed, acceleration) =
            (random_q(&mut rng, n, 1.5), random_q(&mut rng, n, 2.0), random_q(&mut rng, n, 5.0));
        let poses = robot.forward(&q).unwrap();
        let off = robot.inverse_dynamics(&poses, &speed, &acceleration)
            - merged.inverse_dynamics(&poses, &speed, &acceleration);
        assert!(off.amax() < 1e-10, "{name}: {off}");
        assert!((robot.gravity_torque(&poses) - merged.gravity_torque(&poses)).amax() < 1e-10);
    }
}

#[test]
fn a_payload_is_a_point_mass_of_its_body() {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let last = robot.bodies().last().unwrap();
    let link = robot.links()[last.index()].name.clone();
    let com = Vector3::new(0.03, -0.02, 0.1);
    let carrying = robot.clone().with_payload(&Payload::new(link, 1.5, com.into())).unwrap();
    let added = carrying.inertial_parameters() - robot.inertial_parameters();
    let inertia = 1.5 * com.norm_squared() - 1.5 * com.x * com.x;
    let own =
        added.rows(N_INERTIAL_PARAMETERS * robot.body_of(last).unwrap(), N_INERTIAL_PARAMETERS);
    assert!((own[0] - 1.5).abs() < 1e-12 && (own[3] - 0.15).abs() < 1e-12);
    assert!((own[4] - inertia).abs() < 1e-12 && (own[5] - 1.5 * 0.03 * 0.02).abs() < 1e-12);
}
