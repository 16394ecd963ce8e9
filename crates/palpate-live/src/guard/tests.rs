//! The guard with a simulated robot.

use nalgebra::dvector;
use palpate::{BakeConfig, ExternalTorqueConfig, MAX_TORQUE, Robot};

use super::*;
use crate::message::{Header, JointState, Stamp};

/// Two joints with vertical axes, on which gravity exerts no torque.
fn arm() -> Arc<Arm> {
    let ball = "<collision><geometry><sphere radius='0.1'/></geometry></collision>";
    let joint = |name, parent, child| {
        format!(
            "<joint name='{name}' type='continuous'><parent link='{parent}'/>\
             <child link='{child}'/><axis xyz='0 0 1'/></joint>"
        )
    };
    let urdf = format!(
        "<robot name='r'><link name='a'/><link name='b'>{ball}</link><link name='c'>{ball}</link>\
         {}{}</robot>",
        joint("one", "a", "b"),
        joint("two", "b", "c")
    );
    let robot = Robot::from_urdf(&urdf).unwrap();
    let arm = Arm::bake(robot, &BakeConfig::default(), |_| unreachable!("no meshes"));
    Arc::new(arm.unwrap().0)
}

/// A robot with a guard of limit 5 N·m, and a clock.
struct Scene {
    guard: Guard,
    monitor: JointStateMonitor,
    start: Instant,
    /// Time since the start, ms.
    now_ms: u64,
    state: JointState,
}

impl Scene {
    /// A robot that sends joint states and has a tare; the flag is down.
    fn safe() -> Self {
        let mut scene = Self::new();
        scene.play(50, |_| {});
        scene.guard.tare(&dvector![0.0, 0.0]).unwrap();
        assert_eq!(scene.cause(), None);
        scene
    }

    fn new() -> Self {
        let arm = arm();
        let guard = Guard::new(GuardConfig::new(5.0), &arm);
        let monitor = JointStateMonitor::new(guard.clone(), arm, ExternalTorqueConfig::default());
        let state = JointState {
            header: Header::default(),
            name: vec!["one".to_owned(), "two".to_owned()],
            position: vec![0.0; 2],
            velocity: Vec::new(),
            effort: vec![0.0; 2],
        };
        Self { guard, monitor, start: Instant::now(), now_ms: 1000, state }
    }

    fn now(&self) -> Instant {
        self.start + Duration::from_millis(self.now_ms)
    }

    fn cause(&self) -> Option<Cause> {
        self.guard.cause(self.now())
    }

    /// Sends a joint state every 10 ms for `ms`, each modified by `spoil` and taken by the mapper
    /// at once; ends when the flag goes up. Returns the time that this took, ms, and the cause.
    fn play(&mut self, ms: u64, spoil: impl Fn(&mut JointState)) -> (u64, Option<Cause>) {
        let began_ms = self.now_ms;
        for _ in 0..ms / 10 {
            self.now_ms += 10;
            let mut state = self.state.clone();
            state.header.stamp =
                Stamp { sec: 0, nanosec: u32::try_from(self.now_ms).unwrap() * 1_000_000 };
            spoil(&mut state);
            let now = self.now();
            self.monitor.see(Ok(&state), now, 0.0);
            self.guard.taken(now, false);
            if self.cause().is_some() {
                break;
            }
        }
        (self.now_ms - began_ms, self.cause())
    }
}

fn limit(joint: &str, torque_n_m: f64, of: TorqueSource) -> Option<Cause> {
    Some(Cause::Limit { joint: joint.to_owned(), torque_n_m, of })
}

#[test]
fn the_flag_is_up_until_joint_states_and_a_tare_have_come_and_then_comes_down_by_itself() {
    let mut scene = Scene::new();
    assert_eq!(scene.cause(), Some(Cause::Silence));
    assert_eq!(scene.play(50, |_| {}).1, Some(Cause::Untared));
    scene.guard.tare(&dvector![1.0, -1.0]).unwrap();
    assert_eq!(scene.cause(), None);
    assert_eq!(scene.play(1000, |_| {}).1, None);
}

#[test]
fn torques_beyond_the_limit_raise_the_flag_at_once_whatever_else_is_wrong_with_a_sample() {
    type Spoil = fn(&mut JointState);
    for spoil in [
        (|_| {}) as Spoil,
        |state| state.effort[0] = f64::NAN,
        |state| state.position[0] = f64::NAN,
        |state| state.header.stamp = Stamp { sec: 0, nanosec: 1 },
        |state| state.header.stamp = Stamp { sec: 1_000_000, nanosec: 0 },
    ] {
        let mut scene = Scene::safe();
        let (ms, cause) = scene.play(100, |state| {
            state.effort[1] = -5.1;
            spoil(state);
        });
        assert_eq!((ms, cause), (10, limit("two", -5.1, TorqueSource::Measured)));
    }
    let mut scene = Scene::safe();
    let (ms, cause) = scene.play(100, |state| state.effort[0] = f64::INFINITY);
    assert_eq!((ms, cause), (10, limit("one", MAX_TORQUE, TorqueSource::Measured)));
    let scene = Scene::safe();
    scene.guard.mapped(Some(&(dvector![0.0, 1.0], dvector![0.0, 6.0])), None);
    assert_eq!(scene.cause(), limit("two", 6.0, TorqueSource::Predicted));
}

#[test]
fn the_outer_end_of_a_band_is_checked_only_if_requested() {
    let mut scene = Scene::safe();
    let torques = (dvector![0.0, 1.0], dvector![0.0, -4.0]);
    scene.guard.mapped(Some(&torques), None);
    assert_eq!(scene.play(100, |_| {}).1, None);
    scene.guard.mapped(Some(&torques), Some(&dvector![0.5, 0.9]));
    assert_eq!(scene.play(100, |_| {}).1, None);
    scene.guard.mapped(Some(&torques), Some(&dvector![0.5, 1.5]));
    assert_eq!(scene.cause(), limit("two", -5.5, TorqueSource::Band));
    let text = scene.cause().map(|cause| cause.to_string()).unwrap_or_default();
    assert!(text.contains("outer end of the band") && text.contains("-5.50 N·m"), "{text}");
}

#[test]
fn unusable_joint_states_raise_the_flag_within_the_time_of_silence() {
    type Spoil = fn(&mut JointState);
    for (spoil, words) in [
        ((|state| state.effort = vec![f64::NAN; 2]) as Spoil, "effort of joint `one` is NaN"),
        (|state| state.effort.clear(), "0 efforts for 2 joints"),
        (|state| state.name[0] = "three".to_owned(), "`one` is not in the log"),
        (|state| state.position[1] = f64::INFINITY, "position of joint `two` is inf"),
        (|state| state.header.stamp = Stamp { sec: 1, nanosec: 50_000_000 }, "each time stamp"),
        (|state| state.header.stamp.nanosec -= 500_000_000, "came late"),
    ] {
        let mut scene = Scene::safe();
        let (ms, cause) = scene.play(1000, spoil);
        let Some(Cause::Refused(why)) = cause else { panic!("{words}: {cause:?} in {ms} ms") };
        assert!(why.contains(words) && ms <= 120, "{why} in {ms} ms");
    }
    let mut scene = Scene::safe();
    for _ in 0..11 {
        scene.now_ms += 10;
        scene.monitor.see(Err("cut off"), scene.now(), 0.0);
    }
    assert_eq!(scene.cause(), Some(Cause::Refused("cut off".to_owned())));
}

#[test]
fn a_clock_that_jumps_disables_the_guard_for_no_longer_than_the_time_of_silence() {
    // A single stamp in the future makes all later ones count as late.
    let mut scene = Scene::safe();
    let ahead = Stamp { sec: 0, nanosec: (scene.now_ms as u32 + 990) * 1_000_000 };
    scene.play(10, |state| state.header.stamp = ahead);
    let (ms, cause) = scene.play(1000, |_| {});
    assert!(matches!(cause, Some(Cause::Refused(_))) && ms <= 110, "{cause:?} in {ms} ms");
    // A permanent change of the clock is accepted.
    for sec in [-1000, 1_000_000] {
        let mut scene = Scene::safe();
        assert_eq!(scene.play(1000, |state| state.header.stamp.sec += sec).1, None);
        let (ms, cause) = scene.play(100, |state| {
            state.header.stamp.sec += sec;
            state.effort[0] = 5.5;
        });
        assert_eq!((ms, cause), (10, limit("one", 5.5, TorqueSource::Measured)));
    }
}

#[test]
fn silence_a_slow_mapper_and_an_end_raise_the_flag() {
    let mut scene = Scene::safe();
    scene.now_ms += 100;
    assert_eq!(scene.cause(), None);
    scene.now_ms += 1;
    assert_eq!(scene.cause(), Some(Cause::Silence));

    let mut scene = Scene::safe();
    for _ in 0..26 {
        scene.now_ms += 10;
        scene.state.header.stamp = Stamp { sec: 1, nanosec: scene.now_ms as u32 * 1_000_000 };
        scene.monitor.see(Ok(&scene.state), scene.now(), 0.0); // the mapper does not take it
    }
    assert_eq!(scene.cause(), None, "250 ms since the first of them");
    scene.now_ms += 1;
    assert_eq!(scene.cause(), Some(Cause::Lag));

    let mut scene = Scene::safe();
    scene.now_ms += 2000; // the cause is not evaluated, as in a suspended process
    assert_eq!(scene.play(10, |_| {}).1, Some(Cause::Silence));

    let scene = Scene::safe();
    scene.guard.end();
    assert_eq!(scene.cause(), Some(Cause::Ended));
    assert_eq!(scene.guard.reset(scene.now()), Err(Cause::Ended));
}

#[test]
fn an_arm_that_gravity_does_not_explain_is_loaded_before_its_first_tare_and_after() {
    let mut scene = Scene::new();
    scene.play(50, |_| {});
    let loaded = Cause::Loaded { joint: "two".to_owned(), bias_n_m: -30.0, limit_n_m: 5.0 };
    assert_eq!(scene.guard.tare(&dvector![2.0, -30.0]), Err(loaded.clone()));
    assert_eq!(scene.cause(), Some(loaded.clone()));
    scene.guard.tare(&dvector![2.0, -3.0]).unwrap();
    assert_eq!(scene.cause(), None, "it was freed");
    assert_eq!(scene.guard.tare(&dvector![2.0, -30.0]), Err(loaded.clone()));
    assert_eq!(scene.cause(), Some(loaded));
    let (ms, cause) = scene.play(10, |state| state.effort[0] = 7.5);
    assert!(ms == 10 && matches!(cause, Some(Cause::Loaded { .. })), "what was up stays up");
    assert_eq!(
        scene.guard.reset(scene.now()),
        Err(limit("one", 5.5, TorqueSource::Measured).unwrap())
    );
}

#[test]
fn a_stalled_process_raises_the_flag_which_then_stays_up_until_a_reset() {
    let mut scene = Scene::new();
    scene.guard.stalled();
    scene.play(50, |_| {});
    scene.guard.tare(&dvector![0.0, 0.0]).unwrap();
    assert_eq!(scene.cause(), None, "it was up anyway");
    scene.guard.stalled();
    assert_eq!(scene.play(500, |_| {}).1, Some(Cause::Stalled));
    assert_eq!(scene.guard.reset(scene.now()), Ok(()));
    assert_eq!(scene.cause(), None);
}

#[test]
fn only_a_reset_lowers_the_flag_and_only_when_it_is_safe() {
    let mut scene = Scene::safe();
    let raised = limit("one", 7.0, TorqueSource::Measured);
    assert_eq!(scene.play(10, |state| state.effort[0] = 7.0).1, raised);
    assert_eq!(scene.guard.reset(scene.now()), Err(raised.clone().unwrap()));
    scene.play(10, |_| {});
    assert_eq!(scene.cause(), raised, "the load is gone, but nobody has said so");
    scene.guard.tare(&dvector![0.0, 0.0]).unwrap();
    assert_eq!(scene.cause(), raised, "a tare that nobody asked for");
    assert_eq!(scene.guard.reset(scene.now()), Ok(()));
    assert_eq!(scene.cause(), None);

    scene.play(10, |state| state.effort[0] = 7.0);
    scene.guard.reset_with_tare();
    assert!(scene.guard.tare(&dvector![7.0, 0.0]).is_err());
    assert!(scene.cause().is_some(), "the tare that was asked for was refused");
    scene.play(10, |state| state.effort[0] = 3.0);
    scene.guard.tare(&dvector![3.0, 0.0]).unwrap();
    assert_eq!(scene.cause(), None);
    let limit = limit("one", -5.5, TorqueSource::Measured);
    assert_eq!(scene.play(10, |state| state.effort[0] = -2.5).1, limit, "3 N·m are bias");
}

#[test]
fn a_tare_far_from_the_one_of_the_free_arm_is_refused_unless_it_was_requested() {
    let mut scene = Scene::safe();
    scene.guard.tare(&dvector![2.4, 0.0]).unwrap();
    // The change is measured from the tare of the free arm, not from the previous one.
    let refused = scene.guard.tare(&dvector![2.6, 0.0]).unwrap_err();
    assert_eq!(refused, Cause::TareChanged { joint: "one".to_owned(), change_n_m: 2.6 });
    assert_eq!(scene.cause(), Some(refused.clone()));
    scene.play(50, |_| {});
    assert_eq!(scene.guard.reset(scene.now()), Err(refused));
    scene.guard.reset_with_tare();
    scene.guard.tare(&dvector![2.6, 0.0]).unwrap();
    assert_eq!(scene.play(50, |state| state.effort[0] = 2.6).1, None);
}

#[test]
fn a_driver_that_hangs_while_the_arm_moves_raises_the_flag_and_an_arm_at_rest_does_not() {
    let mut scene = Scene::safe();
    // Another joint in the message, whose effort is NaN, makes no difference.
    scene.state.name.push("finger".to_owned());
    scene.state.position.push(0.0);
    scene.state.effort.push(f64::NAN);
    assert_eq!(scene.play(1000, |_| {}).1, None, "at rest, nothing need change");
    scene.play(10, |state| state.position[0] = 0.0015);
    let tick = scene.play(1000, |state| state.position[0] = 0.0015).1;
    assert_eq!(tick, None, "a tick of an encoder is no motion");
    let start_ms = scene.now_ms;
    let at = |stamp: Stamp| 1e-3 * (f64::from(stamp.nanosec) * 1e-6 - start_ms as f64);
    scene.play(300, |state| state.position[0] = 0.2 * at(state.header.stamp));
    let (ms, cause) = scene.play(1000, |state| state.position[0] = 0.06);
    let Some(Cause::Refused(why)) = cause else { panic!("{cause:?}") };
    assert!(ms <= 220 && why.contains("repeat"), "{ms} ms: {why}");
}

#[test]
fn positions_that_jump_back_and_forth_raise_the_flag() {
    let mut scene = Scene::safe();
    scene.guard.jumping(true);
    assert_eq!(scene.play(50, |_| {}).1, Some(Cause::Jumping));
}

#[test]
fn efforts_of_exactly_zero_are_dead_where_gravity_turns_a_joint() {
    assert!(joint_state_monitor::are_all_zero(&[0.0, 0.0], &dvector![-3.0, 0.0]));
    assert!(
        !joint_state_monitor::are_all_zero(&[0.0, 0.0], &dvector![0.0, 0.0]),
        "a SCARA's joints bear nothing"
    );
    assert!(!joint_state_monitor::are_all_zero(&[0.0, 1e-6], &dvector![-3.0, 0.0]));
}
