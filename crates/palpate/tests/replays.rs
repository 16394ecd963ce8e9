//! Laws of the replay policies: the same field whenever a mapper is saved and continued; no more
//! replays in spare time than may be made.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use std::sync::Arc;

use palpate::{
    EstimatorKind, Gravity, Lattice, Mapper, MapperConfig, MapperError, ReplayPolicy, Sample, Tare,
    TrackerError,
};
use scene::{gantry, learn};

/// Replays of a frame.
const REPLAYS: u32 = 5;

/// A mapper of a ball on a gantry beside a box of springs.
fn mapper(method: EstimatorKind, policy: ReplayPolicy) -> Mapper {
    let lattice = Lattice::new([0.1, -0.1, -0.1], 0.02, [12; 3]).unwrap();
    let mut config = MapperConfig::of(method);
    config.lattice = lattice;
    (config.touch.gravity, config.touch.tare) = (Gravity::Removed, Tare::None);
    config.estimator.replays = REPLAYS;
    Mapper::new(gantry("<sphere radius='0.06'/>", 0.01), config).unwrap().with_replays(policy)
}

/// The ball moves into the box, along it, and out again.
fn touch() -> Vec<Sample> {
    let sample = |frame: u32| {
        let t = f64::from(frame) / 40.0;
        let q = vec![0.4 * t * (1.0 - t), 0.05 * t, 0.02 * (9.0 * t).sin()];
        let tau = vec![-3.0 * t * (1.0 - t), -0.4 * t, 0.1 * (9.0 * t).sin()];
        Sample::new(None, q, tau)
    };
    (0..40).map(sample).collect()
}

fn learn_touch(mapper: &mut Mapper) {
    learn(mapper, &touch());
}

#[test]
fn a_mapper_saved_between_any_two_steps_continues_to_the_bit() {
    // The touch ends free of contact, or in contact.
    for samples in [touch(), touch()[..20].to_vec()] {
        let mut whole = mapper(EstimatorKind::Map, ReplayPolicy::Background);
        (0..3).for_each(|_| learn(&mut whole, &samples));
        for saved_at in [1, 12, 13, 20, 39, 40] {
            let Some((before, after)) = samples.split_at_checked(saved_at) else { continue };
            let mut first = mapper(EstimatorKind::Map, ReplayPolicy::Background);
            learn(&mut first, &samples);
            first.begin_touch();
            before.iter().for_each(|sample| drop(first.step(sample).unwrap()));
            let snapshot = first.snapshot();
            let mut second = Mapper::resume(Arc::clone(first.arm()), snapshot).unwrap();
            assert!(second.field() == first.field(), "saved after {saved_at} samples");
            for continued in [&mut first, &mut second] {
                after.iter().for_each(|sample| drop(continued.step(sample).unwrap()));
                continued.end_touch().unwrap();
                learn(continued, &samples);
                assert!(continued.field() == whole.field(), "saved after {saved_at} samples");
            }
        }
    }
}

#[test]
fn external_torques_without_a_free_start_are_taken_as_they_are() {
    let with_tare_given = mapper(EstimatorKind::Map, ReplayPolicy::Background);
    let mut config = with_tare_given.config().clone();
    (config.touch.tare, config.touch.gravity) = (Tare::Auto, Gravity::Removed);
    let mut mapper = Mapper::new(Arc::clone(with_tare_given.arm()), config).unwrap();
    mapper.begin_touch();
    let at = |x: f64| Sample::new(None, vec![x, 0.0, 0.0], vec![2.0, 0.0, -1.0]);
    assert!(mapper.step(&at(0.0)).unwrap().external.is_none(), "it may be a start yet");
    let external = mapper.step(&at(0.08)).unwrap().external.unwrap();
    assert_eq!(external.as_slice(), [2.0, 0.0, -1.0]);
}

#[test]
fn a_touch_without_a_tare_is_over_in_a_mapper_that_was_saved_and_continued_too() {
    let with_tare_given = mapper(EstimatorKind::Map, ReplayPolicy::Background);
    let mut config = with_tare_given.config().clone();
    (config.touch.tare, config.touch.gravity) = (Tare::Auto, Gravity::Included);
    let mut first = Mapper::new(Arc::clone(with_tare_given.arm()), config).unwrap();
    first.begin_touch();
    let at = |x: f64| Sample::new(None, vec![x, 0.0, 0.0], vec![0.0; 3]);
    first.step(&at(0.0)).unwrap();
    let error = first.step(&at(0.08)).unwrap_err();
    assert!(matches!(error, MapperError::Tracker(TrackerError::NoContactFreeStart { .. })));
    let mut second = Mapper::resume(Arc::clone(first.arm()), first.snapshot()).unwrap();
    for continued in [&mut first, &mut second] {
        let error = continued.step(&at(0.0)).unwrap_err();
        assert!(matches!(error, MapperError::Tracker(TrackerError::NotBegun)));
        learn(continued, &vec![at(0.0); 6]);
    }
}

#[test]
fn in_spare_time_no_more_replays_are_made_than_may_be() {
    let mut bounded = mapper(EstimatorKind::Map, ReplayPolicy::SpareTime);
    let mut unbounded = mapper(EstimatorKind::Map, ReplayPolicy::SpareTimeUnbounded);
    for mapper in [&mut bounded, &mut unbounded] {
        assert_eq!(mapper.spare_time(|_| 100), 0, "nothing is remembered yet");
        mapper.begin_touch();
    }
    let mut learnt = 0;
    for sample in &touch() {
        let touched = bounded.step(sample).unwrap().contacts > 0;
        assert_eq!(bounded.spare_replays(), bounded_by(touched));
        let mut granted = [2, 100, 100].into_iter();
        assert_eq!(bounded.spare_time(|_| granted.next().unwrap_or(0)), bounded_by(touched));
        learnt += u32::from(touched);

        unbounded.step(sample).unwrap();
        let mut granted = [2, 100, 0].into_iter();
        let made = unbounded.spare_time(|_| granted.next().unwrap());
        assert_eq!(made, if learnt > 0 { 102 } else { 0 });
    }
    assert!(learnt > 5, "{learnt} frames in contact");
}

/// Replays that a step may make in spare time.
fn bounded_by(touched: bool) -> u32 {
    if touched { REPLAYS } else { 0 }
}

#[test]
fn replays_in_spare_time_and_as_set_give_the_same_field_if_all_are_made() {
    let mut as_set = mapper(EstimatorKind::Ekf, ReplayPolicy::Background);
    learn_touch(&mut as_set);
    let mut spare = mapper(EstimatorKind::Ekf, ReplayPolicy::SpareTime);
    spare.begin_touch();
    for sample in &touch() {
        spare.step(sample).unwrap();
        spare.spare_time(|left| left);
    }
    spare.end_touch().unwrap();
    assert!(spare.field() == as_set.field());
}

#[test]
fn resuming_steps_once_for_each_sample_and_stops_when_asked() {
    let mut first = mapper(EstimatorKind::Map, ReplayPolicy::Background);
    learn_touch(&mut first);
    let resume = |step: &mut dyn FnMut() -> bool| {
        Mapper::resume_unless_stopped(Arc::clone(first.arm()), first.snapshot(), step).unwrap()
    };
    let mut samples = 0;
    let resumed = resume(&mut || {
        samples += 1;
        true
    });
    assert_eq!((samples, resumed.unwrap().field()), (touch().len(), first.field()));
    assert!(resume(&mut || false).is_none());
}
