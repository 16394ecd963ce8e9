//! A session beside a robot that is played from the bundled touches, without a network.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::path::Path;
use std::sync::Arc;

use palpate::unstable::PauseConfig;
use palpate::{Arm, EstimatorKind, Mapper, MapperConfig, Sample};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, CachePlace, load_arm};
use palpate_live::guard::{Guard, Sentry};
use palpate_live::message::{Header, JointState, Stamp};
use palpate_live::session::{Session, State, StepOutcome};

fn arm() -> Arc<Arm> {
    let options = ArmOptions { cache: CachePlace::Off, ..ArmOptions::default() };
    Arc::new(load_arm("kinova_gen3", &options).unwrap().arm)
}

/// The bundled touches, each with times that go on from the one before.
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

/// A touch without the pause at its end, in which a session begins the next one.
fn without_last_pause(touch: &[Sample]) -> &[Sample] {
    let end = &touch.last().unwrap().q;
    let far = |q: &[f64]| q.iter().zip(end).any(|(q, end)| (q - end).abs() > 0.002);
    &touch[..=touch.iter().rposition(|sample| far(&sample.q)).unwrap()]
}

/// A mapper with so many replays for each frame.
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
fn what_is_learnt_live_is_what_a_log_of_the_same_touches_teaches() {
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
    // One in the first pause, one where the arm is suddenly elsewhere.
    assert_eq!(outcomes.iter().filter(|outcome| outcome.begins).count(), 2);
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
    assert_eq!((live.state(), live.mapper().n_cells()), (State::Waiting, 0));

    // A tare that is asked for while the arm moves through the lattice cannot be taken.
    live.tare();
    let outcomes = play(&mut live, &touches[0][120..160]);
    let faults: Vec<&String> =
        outcomes.iter().filter_map(|outcome| outcome.fault.as_ref()).collect();
    assert!(faults.len() == 1 && faults[0].contains("no contact-free start"), "{faults:?}");
    assert_eq!(live.state(), State::Waiting);

    live.tare();
    let outcomes = play(&mut live, &touches[0]);
    assert!(outcomes.iter().any(|outcome| outcome.torques.is_some()));
}

#[test]
fn the_guard_says_once_which_joint_passed_the_limit_until_a_tare_takes_it_back() {
    let (arm, touches) = (arm(), touches(1));
    let mut live = session(&arm, 0, Some(Guard::new(1.5)));
    let outcomes = play(&mut live, &touches[0]);
    let first = outcomes.iter().position(|outcome| outcome.trip.is_some()).unwrap();
    assert_eq!(outcomes.iter().filter(|outcome| outcome.trip.is_some()).count(), 1);
    assert!(live.guard().unwrap().is_up());
    let over = |outcome: &StepOutcome| {
        outcome
            .torques
            .as_ref()
            .is_some_and(|(external, predicted)| external.amax() > 1.5 || predicted.amax() > 1.5)
    };
    assert_eq!(outcomes.iter().position(over), Some(first));
    live.tare();
    assert!(!live.guard().unwrap().is_up());
}

/// A sample as a robot would send it.
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

#[test]
fn a_sentry_sees_the_measured_torque_pass_the_limit_before_the_mapper_has_the_sample() {
    let (arm, touches) = (arm(), touches(1));
    let guard = Guard::new(1.5);
    let mut live = session(&arm, 0, Some(guard.clone()));
    let config = live.mapper().config().touch.clone();
    let mut sentry = Sentry::new(guard, Arc::clone(&arm), config);
    for sample in &touches[0] {
        let early = sentry.see(&joint_state(&arm, sample), 0.0);
        let outcome = live.take(sample);
        let Some(trip) = early else {
            assert_eq!(outcome.trip, None, "the sentry was later");
            continue;
        };
        let external = outcome.torques.unwrap().0;
        assert_eq!((trip.joint, trip.predicted), (external.iamax(), false));
        assert!(trip.torque_n_m.abs() > 1.5 && trip.torque_n_m == external[trip.joint]);
        assert_eq!(outcome.trip, None, "one flag is enough");
        return;
    }
    panic!("no torque passed the limit");
}

#[test]
fn a_session_goes_on_from_what_another_has_saved() {
    let (arm, touches) = (arm(), touches(2));
    let mut first = session(&arm, 0, None);
    play(&mut first, &touches[0][..200]);
    let snapshot = first.mapper().snapshot();
    let resumed = Mapper::resume(Arc::clone(&arm), snapshot).unwrap();
    let mut second = Session::new(resumed, PauseConfig::default(), None).unwrap();
    assert_eq!(second.state(), State::Waiting);
    assert!(second.mapper().field() == first.mapper().field());
    let outcomes = play(&mut second, &touches[1]);
    assert!(outcomes.iter().any(|outcome| outcome.torques.is_some()));
    assert!(second.mapper().n_cells() > first.mapper().n_cells());
}
