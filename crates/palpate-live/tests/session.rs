//! A session with the bundled touches in place of a robot, without a network.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::unstable::PauseConfig;
use palpate::{Arm, EstimatorKind, Mapper, MapperConfig, Sample};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, CachePlace, load_arm};
use palpate_live::guard::{Cause, Guard, GuardConfig, JointStateMonitor, TorqueSource};
use palpate_live::message::{Header, JointState, Stamp};
use palpate_live::session::{Session, SessionState, StepOutcome, Succession};

fn arm() -> Arc<Arm> {
    let options = ArmOptions { cache: CachePlace::Off, ..ArmOptions::default() };
    Arc::new(load_arm("kinova_gen3", &options).unwrap().arm)
}

/// The first `count` bundled touches; the times of each are later than those of the one before.
fn touches(count: usize) -> Vec<Vec<Sample>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/plant_a");
    let mut touches: Vec<Vec<Sample>> = Vec::new();
    for event in log::open(&folder, &LogOptions::default()).unwrap() {
        match event.unwrap() {
            LogEvent::TouchStarts { .. } if touches.len() == count => break,
            LogEvent::TouchStarts { .. } => touches.push(Vec::new()),
            LogEvent::Sample(mut sample) => {
                let start_s = 100.0 * touches.len() as f64;
                sample.time_s = sample.time_s.map(|time_s| start_s + time_s);
                touches.last_mut().unwrap().push(sample);
            }
        }
    }
    touches
}

/// A touch without the pause at its end, in which a session would begin the next touch.
fn without_last_pause(touch: &[Sample]) -> &[Sample] {
    let end = &touch.last().unwrap().q;
    let far = |q: &[f64]| q.iter().zip(end).any(|(q, end)| (q - end).abs() > 0.002);
    &touch[..=touch.iter().rposition(|sample| far(&sample.q)).unwrap()]
}

/// A mapper with this number of replays for each frame.
fn mapper(arm: &Arc<Arm>, replays: u32) -> Mapper {
    let mut config = MapperConfig::of(EstimatorKind::Map);
    config.estimator.replays = replays;
    Mapper::new(Arc::clone(arm), config).unwrap()
}

fn session(arm: &Arc<Arm>, replays: u32, guard: Option<Guard>) -> Session {
    Session::new(mapper(arm, replays), PauseConfig::default(), guard).unwrap()
}

fn play(session: &mut Session, samples: &[Sample]) -> Vec<StepOutcome> {
    samples.iter().map(|sample| session.take(sample)).collect()
}

#[test]
fn a_live_session_learns_the_same_field_as_a_log_of_the_same_touches() {
    let (arm, touches) = (arm(), touches(2));
    let touches: Vec<&[Sample]> = touches.iter().map(|touch| without_last_pause(touch)).collect();
    let mut live = session(&arm, 0, None);
    let outcomes: Vec<StepOutcome> =
        touches.iter().flat_map(|touch| play(&mut live, touch)).collect();
    live.finish();
    let mut from_log = mapper(&arm, 0);
    for touch in &touches {
        from_log.begin_touch();
        touch.iter().for_each(|sample| drop(from_log.step(sample).unwrap()));
        from_log.end_touch().unwrap();
    }
    assert!(live.mapper().field() == from_log.field());
    assert!(outcomes.iter().all(|outcome| outcome.fault.is_none()));
    // One touch begins in the first pause, one where the joint positions jump.
    assert_eq!(outcomes.iter().filter(|outcome| outcome.begins).count(), 2);
}

#[test]
fn a_mapper_with_other_settings_takes_over_in_a_touch_as_if_it_had_been_there_from_the_start() {
    let (arm, touches) = (arm(), touches(3));
    let touches: Vec<&[Sample]> = touches.iter().map(|touch| without_last_pause(touch)).collect();
    let other = || {
        let mut config = mapper(&arm, 0).config().clone();
        config.contact.contact_distance_m = 0.03;
        config.estimator.prior.mean_n_per_m = 0.04;
        Box::new(Mapper::new(Arc::clone(&arm), config).unwrap())
    };
    let mut live = session(&arm, 0, None);
    play(&mut live, touches[0]);
    let (before, after) = touches[1].split_at(touches[1].len() / 2);
    play(&mut live, before);
    // A mapper that has learned nothing is too far behind to take over at once.
    let Ok(Succession::Behind(mut second, log)) = live.go_on_with(other()) else {
        unreachable!("it lacks a touch and a half")
    };
    assert!(second.catch_up(&log, || true).unwrap());
    play(&mut live, &after[..10]);
    let Ok(Succession::Done(first)) = live.go_on_with(second) else {
        unreachable!("it lacks ten samples")
    };
    assert!(first.config() != live.mapper().config());
    assert_eq!(live.state(), SessionState::Mapping);
    let outcomes = play(&mut live, &after[10..]);
    assert!(outcomes.iter().all(|outcome| outcome.torques.is_some() && outcome.fault.is_none()));
    play(&mut live, touches[2]);
    live.finish();
    let mut from_log = other();
    for touch in &touches {
        from_log.begin_touch();
        touch.iter().for_each(|sample| drop(from_log.step(sample).unwrap()));
        from_log.end_touch().unwrap();
    }
    assert!(live.mapper().field() == from_log.field());
}

#[test]
fn a_mapper_that_cannot_take_over_is_returned_with_the_reason() {
    let (arm, touches) = (arm(), touches(2));
    let mut config = mapper(&arm, 0).config().clone();
    config.estimator.memory.frames = 1;
    let small = Mapper::new(Arc::clone(&arm), config).unwrap();
    let mut live = Session::new(small, PauseConfig::default(), None).unwrap();
    touches.iter().for_each(|touch| drop(play(&mut live, touch)));
    live.finish();
    let mut other = mapper(&arm, 0);
    other.begin_touch();
    other.name_touch("other");
    let Err((error, other)) = live.go_on_with(Box::new(other)) else {
        unreachable!("a touch has left the memory")
    };
    assert!(error.to_string().ends_with("cannot be learnt again; raise `memory_mib`"), "{error}");
    assert!(other.position().completed() == 0 && live.mapper().n_cells() > other.n_cells());
}

#[test]
fn replays_fill_spare_time_up_to_those_of_a_step() {
    let (arm, touches) = (arm(), touches(1));
    let mut live = session(&arm, 3, None);
    let mut made = Vec::new();
    for sample in &touches[0][..100] {
        live.take(sample);
        made.push((0..10).map(|_| live.spare()).sum::<u32>());
    }
    assert!(made.contains(&3) && made.iter().all(|&made| made == 0 || made == 3), "{made:?}");
}

#[test]
fn nothing_is_learnt_before_the_arm_has_paused_or_somebody_asked_for_a_tare() {
    let (arm, touches) = (arm(), touches(1));
    let pushing = &touches[0][60..120];
    let mut live = session(&arm, 0, None);
    assert!(play(&mut live, pushing).iter().all(|outcome| outcome.torques.is_none()));
    assert_eq!((live.state(), live.mapper().n_cells()), (SessionState::Waiting, 0));

    // A tare requested while the arm moves waits for a pause.
    live.wait();
    play(&mut live, &touches[0][120..160]);
    assert_eq!((live.state(), live.mapper().n_cells()), (SessionState::Waiting, 0));
    let still = |step: u32| {
        let mut sample = touches[0][160].clone();
        sample.time_s = sample.time_s.map(|time_s| time_s + 0.01 * f64::from(step));
        sample
    };
    let paused: Vec<Sample> = (0..60).map(still).collect();
    assert!(play(&mut live, &paused).iter().any(|outcome| outcome.begins));
    assert_eq!(live.state(), SessionState::Taring);
}

/// A sample as a joint state message.
fn joint_state(arm: &Arm, sample: &Sample) -> JointState {
    let time_s = sample.time_s.unwrap();
    let nanosec = (time_s.fract() * 1e9).round() as u32;
    let stamp = Stamp { sec: time_s as i32, nanosec };
    JointState {
        header: Header { stamp, ..Header::default() },
        name: arm.robot.joint_names().map(str::to_owned).collect(),
        position: sample.q.clone(),
        velocity: Vec::new(),
        effort: sample.tau.clone(),
    }
}

/// A session with its guard, and the monitor before it.
struct Guarded {
    live: Session,
    guard: Guard,
    monitor: JointStateMonitor,
    start: Instant,
}

impl Guarded {
    fn new(arm: &Arc<Arm>, limit_n_m: f64) -> Self {
        let guard = Guard::new(GuardConfig::new(limit_n_m), arm);
        let live = session(arm, 0, Some(guard.clone()));
        let config = live.mapper().config().touch.clone();
        let monitor = JointStateMonitor::new(guard.clone(), Arc::clone(arm), config);
        Self { live, guard, monitor, start: Instant::now() }
    }

    /// Takes a sample at its time; returns the cause after the monitor has checked it, the outcome, and the
    /// cause after the mapper has taken it.
    fn take(&mut self, sample: &Sample) -> (Option<Cause>, StepOutcome, Option<Cause>) {
        let now = self.start + Duration::from_secs_f64(sample.time_s.unwrap());
        let state = joint_state(self.live.mapper().arm(), sample);
        self.monitor.see(Ok(&state), now, 0.0);
        let before = self.guard.cause(now);
        let outcome = self.live.take(sample);
        self.guard.taken(now, false);
        (before, outcome, self.guard.cause(now))
    }
}

#[test]
fn the_flag_comes_down_with_the_first_tare_and_the_sentry_raises_it_before_the_mapper_could() {
    let (arm, touches) = (arm(), touches(1));
    let mut robot = Guarded::new(&arm, 1.5);
    let mut was_down = false;
    for sample in &touches[0] {
        let (before, outcome, after) = robot.take(sample);
        let over = outcome.torques.as_ref().is_some_and(|(external, _)| external.amax() > 1.5);
        match before {
            Some(cause) if !was_down => assert_eq!(cause, Cause::Untared),
            Some(Cause::Limit { joint, torque_n_m, of }) => {
                let external = outcome.torques.unwrap().0;
                assert!(over && of == TorqueSource::Measured && torque_n_m.abs() > 1.5);
                assert_eq!(arm.robot.joint_names().nth(external.iamax()), Some(joint.as_str()));
                assert!((torque_n_m - external[external.iamax()]).abs() < 0.1, "tares differ");
                return;
            }
            Some(cause) => panic!("{cause}"),
            None => assert!(!over, "the monitor missed it"),
        }
        was_down |= after.is_none();
        assert!(!was_down || robot.live.state() != SessionState::Waiting);
    }
    panic!("no torque passed the limit");
}

#[test]
fn an_arm_that_is_pressed_from_the_start_is_not_tared_and_nothing_is_learnt() {
    let (arm, touches) = (arm(), touches(1));
    let mut robot = Guarded::new(&arm, 5.0);
    for sample in &touches[0] {
        let mut sample = sample.clone();
        sample.tau[1] += 30.0;
        assert!(robot.take(&sample).2.is_some(), "the flag is up all along");
    }
    assert!(matches!(robot.guard.cause(Instant::now()), Some(Cause::Loaded { .. })));
    assert_eq!((robot.live.state(), robot.live.mapper().n_cells()), (SessionState::Waiting, 0));
}

#[test]
fn a_session_continues_from_the_field_that_another_one_saved() {
    let (arm, touches) = (arm(), touches(2));
    let mut first = session(&arm, 0, None);
    play(&mut first, &touches[0][..200]);
    let snapshot = first.mapper().snapshot();
    let resumed = Mapper::resume(Arc::clone(&arm), snapshot).unwrap();
    let mut second = Session::new(resumed, PauseConfig::default(), None).unwrap();
    assert_eq!(second.state(), SessionState::Waiting);
    // Resuming ended the touch under way, so the bands include it.
    let mut field = second.mapper().field();
    assert!(field.calibration.take().is_some());
    assert!(field == first.mapper().field());
    let outcomes = play(&mut second, &touches[1]);
    assert!(outcomes.iter().any(|outcome| outcome.torques.is_some()));
    assert!(second.mapper().n_cells() > first.mapper().n_cells());
}

#[test]
fn torques_with_the_other_sign_are_reported_at_the_first_pause_and_no_tare_is_taken() {
    let (arm, touches) = (arm(), touches(1));
    let mut guarded = Guarded::new(&arm, 50.0); // more than twice the torque of gravity
    let misread =
        |outcomes: Vec<StepOutcome>| outcomes.into_iter().find_map(|own| own.convention_warning);
    let negated = |sample: &Sample| {
        let mut sample = sample.clone();
        sample.tau.iter_mut().for_each(|torque| *torque = -*torque);
        sample
    };
    let start = &touches[0][..39];
    assert_eq!(misread(play(&mut session(&arm, 0, None), start)), None);
    let samples: Vec<Sample> = start.iter().map(negated).collect();
    let why = misread(play(&mut guarded.live, &samples)).unwrap();
    assert!(why.contains("--torque-sign minus --gravity included"), "{why}");
    assert_eq!(guarded.live.state(), SessionState::Waiting);
    let silent = vec![0.0; arm.robot.n_joints()];
    let dead = Sample::new(Some(1.0), start[0].q.clone(), silent);
    assert!(guarded.live.is_dead(&dead) && !guarded.live.is_dead(&start[0]));
}

#[test]
fn positions_that_jump_back_and_forth_are_reported_as_those_of_two_drivers() {
    let (arm, touches) = (arm(), touches(1));
    let mut guarded = Guarded::new(&arm, 25.0);
    play(&mut guarded.live, &touches[0][..39]);
    let last = &touches[0][38];
    let both: Vec<Sample> = (1..40)
        .map(|number| {
            let mut sample = last.clone();
            sample.time_s = last.time_s.map(|time_s| time_s + 0.01 * f64::from(number));
            sample.q[0] += if number % 2 == 0 { 0.0 } else { 1.0 };
            sample
        })
        .collect();
    let outcomes = play(&mut guarded.live, &both);
    let why = outcomes.last().unwrap().fault.as_deref().unwrap_or_default();
    assert!(why.contains("two drivers"), "{why}");
}
