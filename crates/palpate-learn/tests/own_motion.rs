//! Friction of the arm is not learned as stiffness, and springs are not taken for friction.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::sync::Arc;

use palpate::{Arm, BakeConfig, EstimatorKind, Field, Lattice, MapperConfig, Robot, Sample};
use palpate_learn::method;
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::tune::{FixedSettings, Search, Tuned, Tuner};

const URDF: &str = include_str!("data/tiny.urdf");

const STILL: usize = 10;
const FRAMES: usize = 90;
const PERIOD_S: f64 = 0.05;
const TOUCHES: usize = 5;
const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

/// What the arm feels besides noise.
#[derive(Clone, Copy, Default)]
struct Felt {
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
    let robot = Robot::from_urdf(URDF).unwrap();
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
fn touch(number: usize, felt: Felt) -> TouchSamples {
    let is_free = felt.stiffness == 0.0;
    let q = |frame: usize| {
        let part = frame.saturating_sub(STILL) as f64 / (FRAMES - STILL) as f64;
        let turn = std::f64::consts::TAU * part;
        let swing = if felt.push_only { part } else { 0.5 * (1.0 - turn.cos()) };
        let bend = if is_free { 0.8 * turn.sin() } else { 0.3 * swing };
        [0.7 * swing, bend - 0.02 * number as f64]
    };
    let wall_m = if felt.push_only { 0.0 } else { 0.25 };
    let tip_m = |q: [f64; 2]| {
        let [upper, fore] = [q[0], q[0] + q[1]];
        [0.4 * upper.cos() + 0.3 * fore.cos(), 0.4 * upper.sin() + 0.3 * fore.sin()]
    };
    let sample = |frame: usize| {
        let (before, now, after) = (q(frame.max(1) - 1), q(frame), q(frame + 1));
        let force = -felt.stiffness * (tip_m(now)[1] - wall_m).max(0.0);
        let levers = [tip_m(now)[0], tip_m(now)[0] - 0.4 * now[0].cos()];
        let tau = |j: usize| {
            let speed = (after[j] - before[j]) / (2.0 * PERIOD_S);
            let friction = felt.friction * ((speed / 0.005).tanh() + speed);
            let noise = 0.05 * ((7 * frame + 3 * number + 5 * j) as f64).sin();
            0.2 + levers[j] * force - friction + noise
        };
        let time_s = (!felt.untimed).then_some(PERIOD_S * frame as f64);
        Sample::new(time_s, now.to_vec(), vec![tau(0), tau(1)])
    };
    let frames = if felt.push_only { FRAMES.midpoint(STILL) } else { FRAMES };
    let (name, samples) = (format!("touch_{number}"), (0..frames).map(sample).collect());
    TouchSamples { name, samples, truth: None }
}

fn touches(felt: Felt) -> Vec<TouchSamples> {
    (0..TOUCHES).map(|number| touch(number, felt)).collect()
}

/// The result of a quick search, and the numbers of stiff cells that are learned with the best candidate and with the
/// chosen settings.
fn tuned(felt: Felt) -> (Tuned, [usize; 2]) {
    let (arm, config, touches) = (arm(), config(), touches(felt));
    let everything: Vec<usize> = (0..TOUCHES).collect();
    let base = TrackedTouches::new(&arm, &config, &touches, NEVER).unwrap();
    let search = Search::quick(&config, FixedSettings::default());
    let tuner = Tuner::new((&arm, &touches, &base), &config, search, NEVER, &|| ()).unwrap();
    let tuned = tuner.tune(&everything, NEVER).unwrap();
    let stiff_with = |config: &MapperConfig| {
        let tracked = TrackedTouches::new(&arm, config, &touches, NEVER).unwrap();
        let estimator = method::learn(&tracked, &everything, config, &[], NEVER).unwrap();
        stiff(&method::field(&tracked, estimator.as_ref(), config))
    };
    let stiff = [&tuned.trials[0].config, &tuned.config].map(stiff_with);
    (tuned, stiff)
}

/// Number of cells that are stiffer than two standard deviations.
fn stiff(field: &Field) -> usize {
    let cells = field.stiffness_n_per_m.iter().zip(&field.std_n_per_m);
    cells.filter(|(stiffness, std)| **stiffness > 2.0 * **std).count()
}

#[test]
fn friction_on_a_repeated_free_motion_counts_as_noise_though_touches_predict_each_other() {
    for untimed in [false, true] {
        let felt = Felt { friction: 8.0, untimed, ..Felt::default() };
        let (tuned, stiff) = tuned(felt);
        let score = tuned.trials[0].scores.last().unwrap();
        assert!(*score < 0.95, "the touches predict each other: {score}");
        assert!(tuned.own_motion.is_some_and(|share| share > 0.9), "{:?}", tuned.own_motion);
        assert!(tuned.is_all_noise && stiff[0] > 0 && stiff[1] == 0, "{stiff:?}");
        // All frames of all touches count as one measurement of the torque.
        let felt = touches(felt);
        let torque = felt.iter().flat_map(|touch| &touch.samples).map(|sample| sample.tau[0]);
        let size = torque.map(|tau| tau * tau).sum::<f64>().sqrt();
        let std = tuned.config.estimator.torque_std[0] / size;
        assert!((0.8..1.2).contains(&std), "{std}");
    }
}

#[test]
fn springs_are_no_friction_with_and_without_friction_and_retreat() {
    let push_only = true;
    for felt in [
        Felt { stiffness: 200.0, ..Felt::default() },
        Felt { stiffness: 200.0, friction: 1.0, ..Felt::default() },
        Felt { stiffness: 200.0, push_only, ..Felt::default() },
    ] {
        let (tuned, stiff) = tuned(felt);
        assert_eq!((tuned.own_motion, tuned.is_all_noise), (None, false));
        assert!(stiff[0] == stiff[1] && tuned.trials[0].scores[1] < 0.7, "{:?}", tuned.trials[0]);
    }
}
