//! What was put into simulated logs is found again, within the standard deviations that are told.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use std::f64::consts::TAU;

use palpate::unstable::FrictionState;
use palpate::{ExternalTorqueConfig, Friction, Gravity, Payload, Robot, Sample};
use palpate_learn::identify::{Identified, IdentifyConfig, IdentifyError, identify};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const RATE_HZ: f64 = 100.0;
const DELAY_S: f64 = 0.013;
const PAYLOAD_KG: f64 = 1.2;
const COM_M: [f64; 3] = [0.03, -0.02, -0.12];

fn friction(joint: usize) -> Friction {
    let coulomb = if joint < 4 { 0.6 } else { 0.25 };
    Friction { coulomb, viscous: 0.4, presliding: 1e-3, ..Friction::default() }
}

fn bias(joint: usize) -> f64 {
    0.1 * joint as f64 - 0.3
}

fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
}

/// Positions, speeds and accelerations of a sum of sines, which starts at rest.
struct Motion(Vec<Vec<(f64, f64, f64)>>);

impl Motion {
    fn draw(rng: &mut ChaCha8Rng, joints: usize) -> Self {
        let joint = |_| {
            let wave = |k| (0.25 * uniform(rng), TAU * 0.1 * f64::from(k + 1), 3.0 * uniform(rng));
            (0..4).map(wave).collect()
        };
        Self((0..joints).map(joint).collect())
    }

    fn at(&self, t: f64) -> [Vec<f64>; 3] {
        let sum = |of: &dyn Fn(f64, f64, f64) -> f64| {
            self.0.iter().map(|waves| waves.iter().map(|(a, w, p)| of(*a, *w, *p)).sum()).collect()
        };
        [
            sum(&|a, w, p| a * (w * t + p).sin() - a * p.sin() + 0.3 * a.signum()),
            sum(&|a, w, p| a * w * (w * t + p).cos()),
            sum(&|a, w, p| -a * w * w * (w * t + p).sin()),
        ]
    }
}

/// Logs of the Gen3 with a payload, friction, bias and delay, and 0.05 N·m of noise.
fn logs(joints_that_move: usize) -> Vec<Vec<Sample>> {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let last = robot.bodies().last().unwrap();
    let link = robot.links()[last.index()].name.clone();
    let robot = robot.with_payload(&Payload::new(link, PAYLOAD_KG, COM_M)).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let n = robot.n_joints();
    let touch = |_| {
        let mut motion = Motion::draw(&mut rng, n);
        motion.0[joints_that_move..].iter_mut().flatten().for_each(|wave| wave.0 = 0.0);
        let mut states = vec![FrictionState::default(); n];
        let (fine, mut torques) = (2_000.0, Vec::new());
        let mut last = motion.at(0.0)[0].clone();
        for step in 0..(10.0 * fine) as usize {
            let [q, speed, acceleration] = motion.at(step as f64 / fine);
            let poses = robot.forward(&q).unwrap();
            let motor = robot.inverse_dynamics(&poses, &speed, &acceleration);
            let torque = (0..n).map(|j| {
                states[j].advance(q[j] - last[j], friction(j).presliding);
                -motor[j] - friction(j).torque(states[j].middle(), speed[j]) + bias(j)
            });
            torques.push(torque.collect::<Vec<f64>>());
            last = q;
        }
        let sample = |k: usize| {
            let time = k as f64 / RATE_HZ;
            let late = (((time - DELAY_S) * fine).round().max(0.0) as usize).min(torques.len() - 1);
            let noise = |tau: &f64| {
                let sum: f64 = (0..12).map(|_| uniform(&mut rng)).sum();
                tau + 0.05 * sum / 2.0
            };
            let tau = torques[late].iter().map(noise).collect();
            Sample::new(Some(time), motion.at(time)[0].clone(), tau)
        };
        (0..(10.0 * RATE_HZ) as usize).map(sample).collect()
    };
    (0..3).map(touch).collect()
}

fn identified(logs: &[Vec<Sample>]) -> Result<Identified, IdentifyError> {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let payload_link = robot.bodies().last().unwrap();
    let touches: Vec<&[Sample]> = logs.iter().map(|touch| &touch[..]).collect();
    let config = IdentifyConfig { payload_link, currents: false };
    identify(&robot, &touches, &ExternalTorqueConfig::default(), &config)
}

#[test]
fn payload_friction_bias_and_delay_are_found_again() {
    let found = identified(&logs(7)).unwrap();
    let near = |what: &str, value: palpate_learn::identify::Value, truth: f64, most: f64| {
        let off = (value.value - truth).abs();
        assert!(off < most, "{what}: {value:?}, put in {truth}");
        assert!(off < 4.0 * value.std + 1e-4, "{what}: {value:?}, put in {truth}");
    };
    near("payload", found.payload.mass_kg, PAYLOAD_KG, 0.03 * PAYLOAD_KG);
    for (axis, truth) in found.payload.com_m.iter().zip(COM_M) {
        near("centre", *axis, truth, 0.01);
    }
    near("delay", found.delay_s, DELAY_S, 0.5 / RATE_HZ);
    for (j, joint) in found.joints.iter().enumerate() {
        near(&joint.name, joint.coulomb_n_m, friction(j).coulomb, 0.1 * friction(j).coulomb);
        near(&joint.name, joint.viscous_n_m_s, friction(j).viscous, 0.1);
        near(&joint.name, joint.bias_n_m, bias(j), 0.1);
    }
    let rms = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>().sqrt();
    let (own, urdf) = (rms(&found.held_out.identified), rms(&found.held_out.urdf));
    assert!(own < 0.2 && urdf > 5.0, "{own} of {urdf} N·m");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    assert!(found.payload.is_told && found.base_parameters == 43);
}

#[test]
fn joints_that_stand_still_are_named() {
    let found = identified(&logs(1)).unwrap();
    assert!(
        found.notes.iter().any(|note| note.contains("Actuator7 moved by less")),
        "{:?}",
        found.notes
    );
    assert!(found.joints[6].coulomb_n_m.std > 10.0 * found.joints[0].coulomb_n_m.std);
}

#[test]
fn logs_that_cannot_serve_are_refused() {
    let still = vec![vec![Sample::new(Some(0.0), vec![0.3; 7], vec![1.0; 7]); 100]];
    assert!(matches!(identified(&still), Err(IdentifyError::NoMotion { .. })));
    let mut silent = logs(7);
    silent.iter_mut().flatten().for_each(|sample| sample.tau.fill(0.0));
    assert!(matches!(identified(&silent), Err(IdentifyError::NoTorque(_))));
    assert!(matches!(identified(&silent[..0]), Err(IdentifyError::TooShort { .. })));

    let robot = Robot::built_in("kinova_gen3").unwrap();
    let mut torques = ExternalTorqueConfig::default();
    torques.gravity = Gravity::Removed;
    let config = IdentifyConfig { payload_link: robot.bodies().last().unwrap(), currents: false };
    let error = identify(&robot, &[&silent[0]], &torques, &config).unwrap_err();
    assert!(error.to_string().contains("tau_J"), "{error}");
    let fixed = IdentifyConfig {
        payload_link: robot.link_id("base_link").unwrap_or_default(),
        currents: false,
    };
    let error = identify(&robot, &[&silent[0]], &ExternalTorqueConfig::default(), &fixed);
    assert!(error.is_err());
}
