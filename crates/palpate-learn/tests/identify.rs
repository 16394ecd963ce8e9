//! The parameters of simulated logs are found again, within the reported standard deviations.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use std::f64::consts::TAU;

use palpate::unstable::{FrictionState, with_read_times};
use palpate::{
    Differentiation, ExternalTorqueConfig, Gravity, JointFriction, Payload, Robot, Sample,
    TorqueModel, external_torques,
};
use palpate_learn::identify::{IdentifiedArm, IdentifyConfig, IdentifyError, identify};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

const RATE_HZ: f64 = 100.0;
const DELAY_S: f64 = 0.013;
const PRESLIDING: f64 = 1e-3;
const PAYLOAD_KG: f64 = 1.2;
/// Is never stopped, and reports no progress.
const UNSTOPPED: (&(dyn Fn() -> bool + Sync), &dyn Fn()) = (&|| false, &|| ());
const COM_M: [f64; 3] = [0.03, -0.02, -0.12];

fn friction(joint: usize, presliding: f64) -> JointFriction {
    let coulomb = if joint < 4 { 0.6 } else { 0.25 };
    JointFriction { coulomb, viscous: 0.4, presliding, ..JointFriction::default() }
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

/// Logs of the Gen3 with a payload, friction with a presliding distance, bias, delay, and 0.05 N·m of noise.
fn logs(joints_that_move: usize, presliding: f64) -> Vec<Vec<Sample>> {
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
                states[j].advance(q[j] - last[j], presliding);
                -motor[j] - friction(j, presliding).torque(states[j].middle(), speed[j]) + bias(j)
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

fn identified(logs: &[Vec<Sample>]) -> Result<IdentifiedArm, IdentifyError> {
    identified_with(logs, &ExternalTorqueConfig::default(), false)
}

fn identified_with(
    logs: &[Vec<Sample>],
    torques: &ExternalTorqueConfig,
    currents: bool,
) -> Result<IdentifiedArm, IdentifyError> {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let payload_link = robot.bodies().last().unwrap();
    let touches: Vec<&[Sample]> = logs.iter().map(|touch| &touch[..]).collect();
    identify(&robot, &touches, torques, &IdentifyConfig { payload_link, currents }, UNSTOPPED)
}

#[test]
fn payload_friction_bias_and_delay_are_found_again() {
    is_found_again(&logs(7, PRESLIDING));
}

#[test]
fn friction_that_turns_at_once_is_no_delay() {
    is_found_again(&logs(7, 0.0));
}

#[test]
fn touches_of_a_few_samples_spoil_nothing() {
    let mut logs = logs(7, PRESLIDING);
    logs.push(logs[0][..2].to_vec());
    is_found_again(&logs);
}

fn is_found_again(logs: &[Vec<Sample>]) {
    let found = identified(logs).unwrap();
    assert!(found.touched == 0.0);
    is_right(&found);
}

fn is_right(found: &IdentifiedArm) {
    let near = |what: &str, value: palpate_learn::identify::Estimate, truth: f64, most: f64| {
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
        near(
            &joint.name,
            joint.coulomb_n_m,
            friction(j, 0.0).coulomb,
            0.1 * friction(j, 0.0).coulomb,
        );
        near(&joint.name, joint.viscous_n_m_s, friction(j, 0.0).viscous, 0.1);
        near(&joint.name, joint.bias_n_m, bias(j), 0.1);
    }
    let rms = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>().sqrt();
    let (own, urdf) = (rms(&found.held_out.identified), rms(&found.held_out.urdf));
    assert!(own < 0.2 && urdf > 5.0, "{own} of {urdf} N·m");
    assert!(found.notes.is_empty(), "{:?}", found.notes);
    assert!(found.payload.is_significant && found.base_parameters == 43);
}

#[test]
fn pushes_in_a_fifth_of_the_time_are_left_out() {
    let mut logs = logs(7, PRESLIDING);
    let push = [4.0, -6.0, 2.0, 3.0, -0.5, 0.8, 0.3];
    let is_pushed = |k: usize| k % 250 > 200;
    for touch in &mut logs {
        for (k, sample) in touch.iter_mut().enumerate().filter(|(k, _)| is_pushed(*k)) {
            let part = (TAU / 2.0 * ((k % 250 - 200) as f64 / 50.0)).sin();
            sample.tau.iter_mut().zip(push).for_each(|(tau, push)| *tau += part * push);
        }
    }
    let mut found = identified(&logs).unwrap();
    assert!((0.2..0.35).contains(&found.touched), "{}", found.touched);
    let notes = std::mem::take(&mut found.notes);
    assert!(notes.len() == 1 && notes[0].contains("something is touched"), "{notes:?}");
    is_right(&found);
}

/// The first joint is vertical, and friction in the last ones is far more than gravity.
#[test]
fn gains_of_currents_are_found_where_gravity_hardly_moves_a_joint() {
    let gains = [0.03, 0.08, 0.07, 0.08, 0.2, 0.25, 0.3];
    let mut logs = logs(7, PRESLIDING);
    for touch in &mut logs {
        let mut before = touch[0].q.clone();
        let mut states = [FrictionState::default(); 7];
        for sample in touch {
            for j in 0..7 {
                states[j].advance(sample.q[j] - before[j], PRESLIDING);
                sample.tau[j] -= 5.0 * states[j].middle();
                sample.tau[j] *= gains[j];
            }
            before.clone_from(&sample.q);
        }
    }
    let found = identified_with(&logs, &ExternalTorqueConfig::default(), true).unwrap();
    for (j, (joint, gain)) in found.joints.iter().zip(gains).enumerate() {
        let off = (joint.gain.value - gain).abs();
        // The gain of the last joint is uncertain: its gravity torque is almost zero.
        let most = if j < 6 { 0.15 * gain } else { 0.7 * gain };
        assert!(off < most && off < 4.0 * joint.gain.std, "{:?}, put in {gain}", joint.gain);
    }
    let mass = found.payload.mass_kg;
    assert!((mass.value - PAYLOAD_KG).abs() < 0.15 * PAYLOAD_KG, "{mass:?}");
}

#[test]
fn stamps_of_a_relay_are_as_good_as_those_of_the_robot() {
    let logs = logs(7, PRESLIDING);
    let every_fourth = |touch: &Vec<Sample>| touch.iter().step_by(4).cloned().collect();
    let read: Vec<Vec<Sample>> = logs.iter().map(every_fourth).collect();
    // The robot publishes every 40 ms, the relay every 39 ms.
    let relayed = |touch: &Vec<Sample>| {
        let at = |k: usize| {
            let time = 0.003 + 0.039 * k as f64;
            let last = &touch[(time / 0.04) as usize];
            Sample::new(Some(time), last.q.clone(), last.tau.clone())
        };
        (0..250).map(at).collect()
    };
    let relayed: Vec<Vec<Sample>> = read.iter().map(relayed).collect();
    let (true_times, found) = (identified(&read).unwrap(), identified(&relayed).unwrap());
    assert_eq!((true_times.read_times.corrected, found.read_times.corrected), (0, 3));
    assert!((0.01..0.02).contains(&found.read_times.rms_s), "{:?}", found.read_times);
    assert!(found.notes.len() == 1 && found.notes[0].contains("stamps"), "{:?}", found.notes);
    is_causal(&found.model, &relayed[0]);
    let rms = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>().sqrt();
    let [own, wanted] = [&found, &true_times].map(|found| rms(&found.held_out.identified));
    assert!(own < 1.15 * wanted, "{own} where true stamps have {wanted} N·m");
}

#[test]
fn the_time_window_serves_logs_of_lower_rates_too() {
    let logs = logs(7, PRESLIDING);
    let thinned = |every: usize| -> Vec<Vec<Sample>> {
        logs.iter().map(|touch| touch.iter().step_by(every).cloned().collect()).collect()
    };
    let model = identified(&thinned(3)).unwrap().model;
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let rms = |touch: &[Sample]| {
        let torques = ExternalTorqueConfig::default();
        let found = external_torques(&robot, &model, &torques, touch, Differentiation::Centred);
        let squares: f64 = found.unwrap().iter().map(|own| own.torque.norm_squared()).sum();
        (squares / touch.len() as f64).sqrt()
    };
    let (own, slower) = (rms(&thinned(3)[0]), rms(&thinned(4)[0]));
    assert!(slower < 1.3 * own, "{own} N·m at 33 Hz, {slower} N·m at 25 Hz");
}

/// Causal torques do not depend on later samples; centred ones use the times at which joints were read.
fn is_causal(model: &TorqueModel, touch: &[Sample]) {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let torques = ExternalTorqueConfig::default();
    let of = |touch: &[Sample], differentiation| {
        external_torques(&robot, model, &torques, touch, differentiation).unwrap()
    };
    let whole = of(touch, Differentiation::Causal);
    assert_eq!(of(&touch[..30], Differentiation::Causal), whole[..30]);
    let timed = with_read_times(&robot, touch).unwrap();
    assert_ne!(of(&timed, Differentiation::Causal), whole);
    let centred = of(touch, Differentiation::Centred);
    assert_eq!(of(&timed, Differentiation::Centred), centred);
}

#[test]
fn samples_in_which_the_arm_jerks_are_named_and_the_result_stays_right() {
    let mut logs = logs(7, PRESLIDING);
    logs.insert(0, logs[0][..2].to_vec());
    for (k, sample) in logs[2].iter_mut().enumerate().skip(100).take(6) {
        let sign = if k % 2 == 0 { 12.0 } else { -12.0 };
        sample.tau.iter_mut().take(4).for_each(|tau| *tau += sign);
    }
    let mut found = identified(&logs).unwrap();
    let few = found.held_out.few.take().expect("they hold nearly all of the squares");
    assert!(
        few.touch == 2 && few.of == 3_000 && (6..10).contains(&few.samples) && few.share > 0.9,
        "{few:?}"
    );
    assert!(few.rows == [100, 105] && (20.0..30.0).contains(&few.largest), "{few:?}");
    let notes = std::mem::take(&mut found.notes);
    assert!(notes.len() == 1 && notes[0].contains("jerks"), "{notes:?}");
    found.held_out.identified = vec![few.without[1]];
    is_right(&found);
}

#[test]
fn a_clock_that_stands_still_counts_as_no_clock() {
    let mut logs = logs(7, PRESLIDING);
    logs.truncate(1);
    let mut of = |time_s| {
        logs[0].iter_mut().for_each(|sample| sample.time_s = time_s);
        identified(&logs).unwrap()
    };
    let (still, none) = (of(Some(3.0)), of(None));
    assert!(!still.timed && still.held_out.identified.iter().all(|own| *own > 0.02));
    assert_eq!(still, none);
}

#[test]
fn joints_that_stand_still_are_named() {
    let found = identified(&logs(1, PRESLIDING)).unwrap();
    assert!(
        found.notes.iter().any(|note| note.contains("Actuator7 moved by less")),
        "{:?}",
        found.notes
    );
    assert!(found.joints[6].coulomb_n_m.std > 10.0 * found.joints[0].coulomb_n_m.std);
}

#[test]
fn a_joint_whose_torque_is_not_measured_is_named_and_the_others_are_found() {
    let mut logs = logs(7, PRESLIDING);
    logs.iter_mut().flatten().for_each(|sample| sample.tau[4] = 0.0);
    let found = identified_with(&logs, &ExternalTorqueConfig::default(), true).unwrap();
    assert!(found.notes.iter().any(|note| note.contains("Actuator5 never")), "{:?}", found.notes);
    for j in [0, 1, 2, 3, 5] {
        let (own, truth) = (found.joints[j].coulomb_n_m, friction(j, 0.0).coulomb);
        assert!((own.value - truth).abs() < 0.15 * truth, "{own:?}, put in {truth}");
    }
}

#[test]
fn poses_at_rest_determine_the_payload_but_no_friction() {
    let all = logs(7, PRESLIDING);
    let pose = |sample: &Sample| {
        let rest = |k: u32| {
            Sample::new(Some(f64::from(k) / RATE_HZ), sample.q.clone(), sample.tau.clone())
        };
        (0..20).map(rest).collect::<Vec<_>>()
    };
    let poses: Vec<Vec<Sample>> = all.iter().flatten().step_by(50).map(pose).collect();
    let found = identified(&poses).unwrap();
    assert!((found.payload.mass_kg.value - PAYLOAD_KG).abs() < 3.0 * found.payload.mass_kg.std);
    assert!(found.joints.iter().all(|joint| joint.moved == 0.0));
}

#[test]
fn logs_that_cannot_serve_are_refused() {
    let still = vec![vec![Sample::new(Some(0.0), vec![0.3; 7], vec![1.0; 7]); 100]];
    assert!(matches!(identified(&still), Err(IdentifyError::NoMotion { .. })));
    let moving = logs(7, PRESLIDING);
    let mut silent = moving.clone();
    silent.iter_mut().flatten().for_each(|sample| sample.tau.fill(0.0));
    assert!(matches!(identified(&silent), Err(IdentifyError::NoTorque(_))));
    assert!(matches!(identified(&silent[..0]), Err(IdentifyError::TooShort { .. })));

    let mut torques = ExternalTorqueConfig::default();
    torques.gravity = Gravity::Removed;
    let error = identified_with(&moving[..1], &torques, false).unwrap_err();
    assert!(error.to_string().contains("tau_J"), "{error}");
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let fixed = IdentifyConfig {
        payload_link: robot.link_id("base_link").unwrap_or_default(),
        currents: false,
    };
    let error =
        identify(&robot, &[&moving[0]], &ExternalTorqueConfig::default(), &fixed, UNSTOPPED);
    assert!(matches!(error, Err(IdentifyError::PayloadLink)));
}
