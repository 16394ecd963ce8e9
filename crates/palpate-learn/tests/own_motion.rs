//! Friction of the arm is not learned as stiffness, and springs are not taken for friction.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::sync::Arc;

use palpate::unstable::{LogPosition, TouchLog};
use palpate::{
    Arm, BakeConfig, EstimatorKind, Field, Lattice, Mapper, MapperConfig, Robot, Sample,
};
use palpate_learn::choose::{choose, choose_for_log, refusal};
use palpate_learn::method;
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::tune::{FixedSettings, Search, Tuned, Tuner};

const URDF: &str = include_str!("data/tiny.urdf");

const STILL: usize = 10;
const FRAMES: usize = 90;
const PERIOD_S: f64 = 0.05;
const TOUCHES: usize = 5;
const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

/// External torques besides noise.
#[derive(Clone, Copy, Default)]
struct Torques {
    /// Coulomb friction, N·m; viscous friction is as large at 1 rad/s.
    friction: f64,
    /// Stiffness of a wall that the tip reaches halfway, N/m.
    stiffness: f64,
    /// Whether the tip touches the wall from the start on, and the touches end before it retreats, at full speed.
    push_only: bool,
    /// Whether samples have no times.
    untimed: bool,
}

fn arm() -> Arc<Arm> {
    arm_of(URDF)
}

fn arm_of(urdf: &str) -> Arc<Arm> {
    let robot = Robot::from_urdf(urdf).unwrap();
    let baked = Arm::bake(robot, &BakeConfig::new(0.01, 0.04), |_| unreachable!("primitives"));
    Arc::new(baked.unwrap().0)
}

fn config() -> MapperConfig {
    let mut config = MapperConfig::of(EstimatorKind::Map);
    config.lattice = Lattice::filling([-0.8, -0.8, -0.1], [0.8, 0.8, 0.1], 0.03).unwrap();
    config.estimator.replays = 5;
    config
}

/// A swing of the shoulder and back, nearly the same in each touch; the elbow swings too, and later if nothing is touched.
fn touch(number: usize, torques: Torques) -> TouchSamples {
    let is_free = torques.stiffness == 0.0;
    let q = |frame: usize| {
        let part = frame.saturating_sub(STILL) as f64 / (FRAMES - STILL) as f64;
        let turn = std::f64::consts::TAU * part;
        let swing = if torques.push_only { part } else { 0.5 * (1.0 - turn.cos()) };
        let bend = if is_free { 0.8 * turn.sin() } else { 0.3 * swing };
        [0.7 * swing, bend - 0.02 * number as f64]
    };
    let wall_m = if torques.push_only { 0.0 } else { 0.25 };
    let tip_m = |q: [f64; 2]| {
        let [upper, fore] = [q[0], q[0] + q[1]];
        [0.4 * upper.cos() + 0.3 * fore.cos(), 0.4 * upper.sin() + 0.3 * fore.sin()]
    };
    let sample = |frame: usize| {
        let (before, now, after) = (q(frame.max(1) - 1), q(frame), q(frame + 1));
        let force = -torques.stiffness * (tip_m(now)[1] - wall_m).max(0.0);
        let levers = [tip_m(now)[0], tip_m(now)[0] - 0.4 * now[0].cos()];
        let tau = |j: usize| {
            let speed = (after[j] - before[j]) / (2.0 * PERIOD_S);
            let friction = torques.friction * ((speed / 0.005).tanh() + speed);
            let noise = 0.05 * ((7 * frame + 3 * number + 5 * j) as f64).sin();
            0.2 + levers[j] * force - friction + noise
        };
        let time_s = (!torques.untimed).then_some(PERIOD_S * frame as f64);
        Sample::new(time_s, now.to_vec(), vec![tau(0), tau(1)])
    };
    let frames = if torques.push_only { FRAMES.midpoint(STILL) } else { FRAMES };
    let (name, samples) = (format!("touch_{number}"), (0..frames).map(sample).collect());
    TouchSamples { name, samples, truth: None }
}

fn touches(torques: Torques) -> Vec<TouchSamples> {
    (0..TOUCHES).map(|number| touch(number, torques)).collect()
}

/// The result of a quick search, and the numbers of stiff cells that are learned with the best candidate and with the
/// chosen settings.
fn tuned(torques: Torques) -> (Tuned, [usize; 2]) {
    let (arm, touches) = (arm(), touches(torques));
    let everything: Vec<usize> = (0..TOUCHES).collect();
    let tuned = tuned_for(&arm, &touches);
    let stiff_with = |config: &MapperConfig| {
        let tracked = TrackedTouches::new(&arm, config, &touches, NEVER).unwrap();
        let estimator = method::learn(&tracked, &everything, config, &[], NEVER).unwrap();
        stiff(&method::field(&tracked, estimator.as_ref(), config))
    };
    let stiff = [&tuned.trials[0].config, &tuned.config].map(stiff_with);
    (tuned, stiff)
}

fn tuned_for(arm: &Arc<Arm>, touches: &[TouchSamples]) -> Tuned {
    let (config, everything) = (config(), (0..TOUCHES).collect::<Vec<usize>>());
    let base = TrackedTouches::new(arm, &config, touches, NEVER).unwrap();
    let search = Search::quick(&config, FixedSettings::default());
    let tuner = Tuner::new((arm, touches, &base), &config, search, NEVER, &|| ()).unwrap();
    tuner.tune(&everything, NEVER).unwrap()
}

/// The log of a mapper that has learnt the touches.
fn log_of(arm: &Arc<Arm>, touches: &[TouchSamples]) -> TouchLog {
    let mut mapper = Mapper::new(Arc::clone(arm), config()).unwrap();
    for touch in touches {
        mapper.begin_touch();
        mapper.name_touch(&touch.name);
        touch.samples.iter().for_each(|sample| drop(mapper.step(sample).unwrap()));
        mapper.end_touch().unwrap();
    }
    mapper.log_from(LogPosition::default()).unwrap()
}

/// Number of cells that are stiffer than two standard deviations.
fn stiff(field: &Field) -> usize {
    let cells = field.stiffness_n_per_m.iter().zip(&field.std_n_per_m);
    cells.filter(|(stiffness, std)| **stiffness > 2.0 * **std).count()
}

#[test]
fn friction_on_a_repeated_free_motion_counts_as_noise_though_touches_predict_each_other() {
    for untimed in [false, true] {
        let torques = Torques { friction: 8.0, untimed, ..Torques::default() };
        let (tuned, stiff) = tuned(torques);
        let score = tuned.trials[0].scores.last().unwrap();
        assert!(*score < 0.95, "the touches predict each other: {score}");
        assert!(tuned.own_motion.is_some_and(|share| share > 0.9), "{:?}", tuned.own_motion);
        assert!(tuned.is_all_noise && stiff[0] > 0 && stiff[1] == 0, "{stiff:?}");
        // All frames of all touches count as one measurement of the torque.
        let touches = touches(torques);
        let torque = touches.iter().flat_map(|touch| &touch.samples).map(|sample| sample.tau[0]);
        let size = torque.map(|tau| tau * tau).sum::<f64>().sqrt();
        let std = tuned.config.estimator.torque_std[0] / size;
        assert!((0.8..1.2).contains(&std), "{std}");
    }
}

#[test]
fn springs_are_no_friction_with_and_without_friction_and_retreat() {
    let push_only = true;
    for torques in [
        Torques { stiffness: 200.0, ..Torques::default() },
        Torques { stiffness: 200.0, friction: 1.0, ..Torques::default() },
        Torques { stiffness: 200.0, push_only, ..Torques::default() },
    ] {
        let (tuned, stiff) = tuned(torques);
        assert_eq!((tuned.own_motion, tuned.is_all_noise), (None, false));
        assert!(stiff[0] == stiff[1] && tuned.trials[0].scores[1] < 0.7, "{:?}", tuned.trials[0]);
    }
}

#[test]
fn a_log_has_no_times_so_inertia_is_not_computed_from_it() {
    let inertial = "<link name=\"fore\"><inertial><origin xyz=\"0.15 0 0\"/><mass value=\"20\"/>\
        <inertia ixx=\"0.1\" iyy=\"0.1\" izz=\"0.1\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>";
    let arm = arm_of(&URDF.replace("<link name=\"fore\">", inertial));
    let mut touches = touches(Torques { stiffness: 1e-9, ..Torques::default() }); // swings together
    for touch in &mut touches {
        let q: Vec<Vec<f64>> = touch.samples.iter().map(|sample| sample.q.clone()).collect();
        for n in 1..q.len() - 1 {
            let of = |derivative: &dyn Fn(usize) -> f64| [0, 1].map(derivative);
            let speed = of(&|j| (q[n + 1][j] - q[n - 1][j]) / (2.0 * PERIOD_S));
            let second = of(&|j| (q[n + 1][j] - 2.0 * q[n][j] + q[n - 1][j]) / PERIOD_S.powi(2));
            let poses = arm.robot.forward(&q[n]).unwrap();
            let needed = arm.robot.inverse_dynamics(&poses, &speed, &second);
            touch.samples[n].tau.iter_mut().zip(needed.iter()).for_each(|(tau, own)| *tau -= own);
        }
    }
    let share = tuned_for(&arm, &touches).own_motion;
    assert!(share.is_some_and(|share| share > 0.9), "with times: {share:?}");
    let (log, setup) = (log_of(&arm, &touches), (&arm, &config()));
    let (chosen, _) =
        choose_for_log(setup, &log, FixedSettings::default(), NEVER).unwrap().unwrap();
    assert_eq!(chosen.tuned.own_motion, None);
}

#[test]
fn settings_are_refused_for_friction_unless_those_that_make_it_noise_are_given() {
    let arm = arm();
    let log = log_of(&arm, &touches(Torques { friction: 8.0, ..Torques::default() }));
    let choose = |given| choose_for_log((&arm, &config()), &log, given, NEVER).unwrap().unwrap();
    let (chosen, _) = choose(FixedSettings::default());
    let text = refusal(&chosen.tuned).unwrap();
    assert!(text.contains("follows the arm's own motion") && text.contains("identify"), "{text}");
    let (chosen, summary) = choose(FixedSettings { torque_std: true, ..FixedSettings::default() });
    assert_eq!(refusal(&chosen.tuned), None);
    assert!(summary.contains("follows the arm's own motion"), "{summary}");
    assert!(summary.contains("learned as stiffness all the same"), "{summary}");
}

#[test]
fn an_error_names_the_touch_of_the_log_and_the_estimator_must_be_map() {
    let (arm, mut config) = (arm(), config());
    let touches = touches(Torques { stiffness: 200.0, ..Torques::default() });
    let mut log = log_of(&arm, &touches);
    log.touches.remove(0);
    log.touches[2].q[2 * 5] = f64::NAN;
    let chosen = choose_for_log((&arm, &config), &log, FixedSettings::default(), NEVER);
    let error = chosen.unwrap_err().to_string();
    assert!(error.starts_with("touch `#3 touch_3`, sample 5 (from 0): "), "{error}");
    config.method = EstimatorKind::Ekf;
    let chosen = choose((&arm, &config), &touches, FixedSettings::default(), NEVER);
    assert!(chosen.unwrap_err().to_string().contains("not for `ekf`"));
}
