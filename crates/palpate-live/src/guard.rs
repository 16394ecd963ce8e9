//! `--guard`: a flag to stop that is up until it is known to be safe.
//!
//! The flag is down only while all of this holds: joint states come and can be used, the mapper keeps
//! up, a tare is known that gravity explains, and no joint's external torque passes the limit,
//! neither the measured nor the predicted one. A [`Sentry`] looks at each joint state as it comes in,
//! before it waits for the mapper; the predicted torque and the tare are the mapper's. Silence is
//! seen by whoever asks: [`Guard::cause`] is a question about a moment.
//!
//! The flag comes down by itself once, with the first tare. What raises it after that stays up until
//! somebody resets the guard: a robot that stopped where it presses must not start again because it
//! no longer moves.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::{Arm, ExternalTorqueConfig, MAX_TORQUE};

use crate::joints::JointReader;
use crate::message::JointState;

/// When the flag goes up.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GuardConfig {
    /// The largest external torque of a joint, N·m (N for a prismatic joint).
    pub limit_n_m: f64,
    /// The most by which the torques of an arm that stands free may differ from gravity, N·m (N).
    /// More is a load, or a payload that nobody told palpate of: then the tare is refused.
    pub bias_limit_n_m: f64,
    /// The longest time without a joint state that can be used.
    pub silence: Duration,
    /// The longest time that a joint state may wait for the mapper.
    pub lag: Duration,
}

impl GuardConfig {
    /// For a limit, N·m (N for a prismatic joint), with 0.1 s of silence and 0.25 s of lag. What is
    /// no load for the limit is none for the tare.
    pub fn new(limit_n_m: f64) -> Self {
        Self {
            limit_n_m,
            bias_limit_n_m: limit_n_m,
            silence: Duration::from_millis(100),
            lag: Duration::from_millis(250),
        }
    }
}

/// Why the flag is up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum Cause {
    #[error("palpate has ended")]
    Ended,
    #[error("{of} external torque of joint `{joint}` is {torque_n_m:.2} N·m")]
    Limit { joint: String, torque_n_m: f64, of: Torque },
    #[error("no joint state can be used any more: {0}")]
    Refused(String),
    #[error("no joint state comes")]
    Silence,
    #[error("the mapper does not keep up with the joint states")]
    Lag,
    #[error("palpate stood still for a while; is the computer too busy?")]
    Stalled,
    #[error(
        "the arm stands still but is loaded: the torque of joint `{joint}` differs from gravity by \
         {bias_n_m:.2} N·m, more than {limit_n_m:.2} (--guard-bias)"
    )]
    Loaded { joint: String, bias_n_m: f64, limit_n_m: f64 },
    #[error("no tare is known yet: the arm must stand still and free")]
    Untared,
}

/// Which torque passes the limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Torque {
    /// The measured one.
    Measured,
    /// The predicted one.
    Predicted,
    /// The outer end of the band around the predicted one.
    Band,
}

impl fmt::Display for Torque {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Measured => "the measured",
            Self::Predicted => "the predicted",
            Self::Band => "the outer end of the band around the predicted",
        })
    }
}

/// Watches the external torque. Clones are one guard.
#[derive(Debug, Clone)]
pub struct Guard {
    config: GuardConfig,
    joints: Arc<[String]>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    ended: bool,
    /// Bias of the measured torques, n_joints, N·m.
    tare: Option<DVector<f64>>,
    /// The last torques before the tare, n_joints, N·m, NaN where nobody knows.
    untared: Option<DVector<f64>>,
    /// The joint whose torque passed the limit at the mapper's last step.
    mapped_over: Option<Cause>,
    /// The last tare was refused.
    loaded: Option<Cause>,
    /// When the last joint state came that can be used, and why one since then cannot.
    usable: Option<Instant>,
    refused: Option<String>,
    /// Since when joint states wait for the mapper.
    waiting: Option<Instant>,
    /// Whether the flag has been down, and what has raised it since.
    was_down: bool,
    raised: Option<Cause>,
    /// Whether the next tare takes the flag back.
    resets: bool,
}

impl Guard {
    /// A guard of an arm's joints.
    pub fn new(config: GuardConfig, arm: &Arm) -> Self {
        let joints = arm.robot.joint_names().map(str::to_owned).collect();
        Self { config, joints, state: Arc::default() }
    }

    /// Why the flag is up at a moment; `None` if it is down.
    pub fn cause(&self, now: Instant) -> Option<Cause> {
        let mut state = self.state();
        if state.raised.is_none() {
            let cause = self.unsafe_now(&state, now);
            match cause {
                None => state.was_down = true,
                Some(cause) if !state.was_down => return Some(cause),
                Some(_) => state.raised = cause,
            }
        }
        state.raised.clone()
    }

    /// What is not safe at a moment, the most urgent first.
    fn unsafe_now(&self, state: &State, now: Instant) -> Option<Cause> {
        let longer = |since: Instant, time| now.saturating_duration_since(since) > time;
        if state.ended {
            return Some(Cause::Ended);
        }
        let measured = state.untared.as_ref().zip(state.tare.as_ref());
        let over =
            measured.and_then(|(untared, tare)| self.over(&(untared - tare), Torque::Measured));
        if let Some(over) = over.or_else(|| state.mapped_over.clone()) {
            return Some(over);
        }
        if state.usable.is_none_or(|usable| longer(usable, self.config.silence)) {
            return Some(state.refused.clone().map_or(Cause::Silence, Cause::Refused));
        }
        if state.waiting.is_some_and(|since| longer(since, self.config.lag)) {
            return Some(Cause::Lag);
        }
        state.loaded.clone().or_else(|| state.tare.is_none().then_some(Cause::Untared))
    }

    /// The joint whose torque passes the limit by most, n_joints, N·m, NaN where nobody knows.
    fn over(&self, torques: &DVector<f64>, of: Torque) -> Option<Cause> {
        let (joint, &torque_n_m) = largest(torques)?;
        (torque_n_m.abs() > self.config.limit_n_m).then(|| Cause::Limit {
            joint: self.joints[joint].clone(),
            torque_n_m,
            of,
        })
    }

    /// A joint state came that can be used. Nobody may have asked since the one before it, if all of
    /// palpate had stopped for a while: then the silence counts as well.
    fn usable(&self, now: Instant) {
        self.cause(now);
        let mut state = self.state();
        (state.usable, state.refused) = (Some(now), None);
        state.waiting.get_or_insert(now);
    }

    /// A joint state came that cannot be used.
    fn refused(&self, why: &impl ToString) {
        self.state().refused = Some(why.to_string());
    }

    /// Torques before the tare came, n_joints, N·m, NaN where nobody knows.
    fn measured(&self, untared: DVector<f64>) {
        self.state().untared = Some(untared);
    }

    /// The mapper has taken all joint states that came until a moment, and none waits any more or
    /// some still do.
    pub fn taken(&self, came: Instant, some_wait: bool) {
        self.state().waiting = some_wait.then_some(came);
    }

    /// Looks at the torques of the mapper's last step, measured and predicted, if it had any, and at the half-width of the
    /// band around the latter, if that is asked for, n_joints, N·m.
    pub fn mapped(
        &self,
        torques: Option<&(DVector<f64>, DVector<f64>)>,
        half_width: Option<&DVector<f64>>,
    ) {
        let over = torques.and_then(|(measured, predicted)| {
            let band = || {
                let outer = predicted.zip_map(half_width?, |own, width| own + width.copysign(own));
                self.over(&outer, Torque::Band)
            };
            self.over(measured, Torque::Measured)
                .or_else(|| self.over(predicted, Torque::Predicted))
                .or_else(band)
        });
        self.state().mapped_over = over;
    }

    /// Takes the bias of the torques of an arm that stands still, n_joints, N·m, as the tare, which
    /// counts until the next one.
    ///
    /// # Errors
    ///
    /// If gravity does not explain the torques; the tare before still counts.
    pub fn tare(&self, bias: &DVector<f64>) -> Result<(), Cause> {
        let mut state = self.state();
        let limit_n_m = self.config.bias_limit_n_m;
        if let Some((joint, &bias_n_m)) = largest(bias)
            && bias_n_m.abs() > limit_n_m
        {
            let joint = self.joints[joint].clone();
            let loaded = Cause::Loaded { joint, bias_n_m, limit_n_m };
            state.loaded = Some(loaded.clone());
            return Err(loaded);
        }
        (state.tare, state.loaded) = (Some(bias.clone()), None);
        if std::mem::take(&mut state.resets) {
            (state.raised, state.mapped_over) = (None, None);
        }
        Ok(())
    }

    /// Lets the next tare take the flag back: somebody is there who says that the arm stands free.
    pub fn reset_with_tare(&self) {
        self.state().resets = true;
    }

    /// Takes the flag back.
    ///
    /// # Errors
    ///
    /// What is not safe now; the flag stays up.
    pub fn reset(&self, now: Instant) -> Result<(), Cause> {
        let mut state = self.state();
        match self.unsafe_now(&state, now) {
            Some(cause) => Err(cause),
            None => {
                state.raised = None;
                Ok(())
            }
        }
    }

    /// Raises a flag that was down: nobody said so for too long.
    pub fn stalled(&self) {
        let mut state = self.state();
        if state.was_down {
            state.raised.get_or_insert(Cause::Stalled);
        }
    }

    /// Raises the flag for good.
    pub fn end(&self) {
        self.state().ended = true;
    }

    /// No thread panics while it holds the lock; if one did, the state would still be whole.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The number that is largest without its sign, and its place, among those that are numbers.
fn largest(numbers: &DVector<f64>) -> Option<(usize, &f64)> {
    let known = numbers.iter().enumerate().filter(|(_, number)| !number.is_nan());
    known.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

/// Watches joint states as they come in.
pub struct Sentry {
    guard: Guard,
    arm: Arc<Arm>,
    config: ExternalTorqueConfig,
    reader: JointReader,
    /// Where the joints were last, NaN before anybody knew.
    q: Vec<f64>,
}

impl Sentry {
    /// A sentry for an arm whose torques are logged as these settings say.
    pub fn new(guard: Guard, arm: Arc<Arm>, config: ExternalTorqueConfig) -> Self {
        let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
        let q = vec![f64::NAN; joints.len()];
        Self { guard, arm, config, reader: JointReader::new(joints), q }
    }

    /// Looks at a joint state, or why it cannot be decoded, which came at a moment and by the
    /// system's clock at `received_s`, s.
    ///
    /// Torques count whatever else is wrong with it: its stamp, or the torques of other joints.
    pub fn see(&mut self, state: Result<&JointState, &str>, now: Instant, received_s: f64) {
        let state = match state {
            Ok(state) => state,
            Err(why) => return self.guard.refused(&why),
        };
        let untared = match self.reader.joints(state) {
            Ok((q, tau)) => self.untared(&q, &tau),
            Err(refusal) => return self.guard.refused(&refusal),
        };
        let Some(untared) = untared else {
            return self.guard.refused(&"the arm cannot stand at these joint positions");
        };
        self.guard.measured(untared);
        match self.reader.read(state, received_s) {
            Ok(_) => self.guard.usable(now),
            Err(refusal) => self.guard.refused(&refusal),
        }
    }

    /// Torques before the tare, n_joints, N·m, NaN where the sensor says nothing. A joint without a
    /// position is taken to be where it was last.
    fn untared(&mut self, q: &[f64], tau: &[f64]) -> Option<DVector<f64>> {
        for (last, now) in self.q.iter_mut().zip(q) {
            *last = if now.is_finite() { *now } else { *last };
        }
        let robot = &self.arm.robot;
        let poses = robot.forward(&self.q).ok()?;
        // What is beyond all sensors is beyond all limits, too.
        let readable = |torque: &f64| match torque.is_nan() {
            true => 0.0,
            false => torque.clamp(-MAX_TORQUE, MAX_TORQUE),
        };
        let readable: Vec<f64> = tau.iter().map(readable).collect();
        let mut untared = self.config.untared(robot, &poses, &readable).ok()?;
        for (joint, torque) in tau.iter().enumerate() {
            if torque.is_nan() {
                untared[joint] = f64::NAN;
            }
        }
        Some(untared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Header, Stamp};
    use nalgebra::dvector;
    use palpate::{BakeConfig, Robot};

    /// Two joints that gravity does not turn.
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

    /// A robot beside a guard of 5 N·m, and a clock.
    struct Scene {
        guard: Guard,
        sentry: Sentry,
        start: Instant,
        /// Since the start, ms.
        now_ms: u64,
        state: JointState,
    }

    impl Scene {
        /// One that sends joint states, has a tare, and whose flag is down.
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
            let sentry = Sentry::new(guard.clone(), arm, ExternalTorqueConfig::default());
            let state = JointState {
                header: Header::default(),
                name: vec!["one".to_owned(), "two".to_owned()],
                position: vec![0.0; 2],
                velocity: Vec::new(),
                effort: vec![0.0; 2],
            };
            Self { guard, sentry, start: Instant::now(), now_ms: 1000, state }
        }

        fn now(&self) -> Instant {
            self.start + Duration::from_millis(self.now_ms)
        }

        fn cause(&self) -> Option<Cause> {
            self.guard.cause(self.now())
        }

        /// A joint state every 10 ms for so long, each spoilt, taken at once by the mapper; ends as
        /// soon as the flag is up. Returns how long that took, ms, and why.
        fn play(&mut self, ms: u64, spoil: impl Fn(&mut JointState)) -> (u64, Option<Cause>) {
            let began_ms = self.now_ms;
            for _ in 0..ms / 10 {
                self.now_ms += 10;
                let mut state = self.state.clone();
                state.header.stamp =
                    Stamp { sec: 0, nanosec: u32::try_from(self.now_ms).unwrap() * 1_000_000 };
                spoil(&mut state);
                let now = self.now();
                self.sentry.see(Ok(&state), now, 0.0);
                self.guard.taken(now, false);
                if self.cause().is_some() {
                    break;
                }
            }
            (self.now_ms - began_ms, self.cause())
        }
    }

    fn limit(joint: &str, torque_n_m: f64, of: Torque) -> Option<Cause> {
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
    fn torques_beyond_the_limit_raise_it_at_once_whatever_else_is_wrong_with_a_sample() {
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
            assert_eq!((ms, cause), (10, limit("two", -5.1, Torque::Measured)));
        }
        let mut scene = Scene::safe();
        let (ms, cause) = scene.play(100, |state| state.effort[0] = f64::INFINITY);
        assert_eq!((ms, cause), (10, limit("one", MAX_TORQUE, Torque::Measured)));
        let scene = Scene::safe();
        scene.guard.mapped(Some(&(dvector![0.0, 1.0], dvector![0.0, 6.0])), None);
        assert_eq!(scene.cause(), limit("two", 6.0, Torque::Predicted));
    }

    #[test]
    fn the_outer_end_of_a_band_counts_only_where_it_is_asked_for() {
        let mut scene = Scene::safe();
        let torques = (dvector![0.0, 1.0], dvector![0.0, -4.0]);
        scene.guard.mapped(Some(&torques), None);
        assert_eq!(scene.play(100, |_| {}).1, None);
        scene.guard.mapped(Some(&torques), Some(&dvector![0.5, 0.9]));
        assert_eq!(scene.play(100, |_| {}).1, None);
        scene.guard.mapped(Some(&torques), Some(&dvector![0.5, 1.5]));
        assert_eq!(scene.cause(), limit("two", -5.5, Torque::Band));
        let text = scene.cause().map(|cause| cause.to_string()).unwrap_or_default();
        assert!(text.contains("outer end of the band") && text.contains("-5.50 N·m"), "{text}");
    }

    #[test]
    fn what_cannot_be_used_raises_it_within_the_time_of_silence() {
        type Spoil = fn(&mut JointState);
        for (spoil, words) in [
            ((|state| state.effort = vec![f64::NAN; 2]) as Spoil, "effort of joint `one` is NaN"),
            (|state| state.effort.clear(), "0 efforts for 2 joints"),
            (|state| state.name[0] = "three".to_owned(), "`one` is not in the log"),
            (|state| state.position[1] = f64::INFINITY, "position of joint `two` is inf"),
            (|state| state.header.stamp = Stamp { sec: 1, nanosec: 50_000_000 }, "each moment"),
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
            scene.sentry.see(Err("cut off"), scene.now(), 0.0);
        }
        assert_eq!(scene.cause(), Some(Cause::Refused("cut off".to_owned())));
    }

    #[test]
    fn a_clock_that_jumps_blinds_it_for_no_longer_than_the_time_of_silence() {
        // A single stamp that is ahead makes all that follow come late.
        let mut scene = Scene::safe();
        let ahead = Stamp { sec: 0, nanosec: (scene.now_ms as u32 + 990) * 1_000_000 };
        scene.play(10, |state| state.header.stamp = ahead);
        let (ms, cause) = scene.play(1000, |_| {});
        assert!(matches!(cause, Some(Cause::Refused(_))) && ms <= 110, "{cause:?} in {ms} ms");
        // A clock that was set back or ahead for good is followed.
        for sec in [-1000, 1_000_000] {
            let mut scene = Scene::safe();
            assert_eq!(scene.play(1000, |state| state.header.stamp.sec += sec).1, None);
            let (ms, cause) = scene.play(100, |state| {
                state.header.stamp.sec += sec;
                state.effort[0] = 5.5;
            });
            assert_eq!((ms, cause), (10, limit("one", 5.5, Torque::Measured)));
        }
    }

    #[test]
    fn silence_a_slow_mapper_and_an_end_raise_it() {
        let mut scene = Scene::safe();
        scene.now_ms += 100;
        assert_eq!(scene.cause(), None);
        scene.now_ms += 1;
        assert_eq!(scene.cause(), Some(Cause::Silence));

        let mut scene = Scene::safe();
        for _ in 0..26 {
            scene.now_ms += 10;
            scene.state.header.stamp = Stamp { sec: 1, nanosec: scene.now_ms as u32 * 1_000_000 };
            scene.sentry.see(Ok(&scene.state), scene.now(), 0.0); // nobody takes it
        }
        assert_eq!(scene.cause(), None, "250 ms since the first of them");
        scene.now_ms += 1;
        assert_eq!(scene.cause(), Some(Cause::Lag));

        let mut scene = Scene::safe();
        scene.now_ms += 2000; // nobody asks, as in a process that was stopped
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
            Err(limit("one", 5.5, Torque::Measured).unwrap())
        );
    }

    #[test]
    fn having_stood_still_raises_it_unless_it_was_up_and_stays() {
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
    fn only_a_reset_takes_it_back_and_only_when_it_is_safe() {
        let mut scene = Scene::safe();
        let raised = limit("one", 7.0, Torque::Measured);
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
        let limit = limit("one", -5.5, Torque::Measured);
        assert_eq!(scene.play(10, |state| state.effort[0] = -2.5).1, limit, "3 N·m are bias");
    }
}
