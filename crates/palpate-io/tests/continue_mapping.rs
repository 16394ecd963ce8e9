//! Mapping that is saved, loaded and continued gives the same field as mapping without interruption.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod common;

use std::path::Path;
use std::sync::Arc;

use palpate::unstable::LogPosition;
use palpate::{
    Arm, BakeConfig, BandQuantiles, Calibration, CellId, EstimatorKind, Lattice, LearntTorques,
    Mapper, MapperConfig, Predictor, Robot, Sample,
};
use palpate_io::field::{SavedField, load, npz, save};

/// The first touches of the bundled set, with fewer samples after the still start.
fn touches(count: usize) -> Vec<Vec<Sample>> {
    let thinned = |(_, samples): (String, Vec<Sample>)| {
        let kept = samples.into_iter().enumerate().filter(|(n, _)| *n < 10 || n % 20 == 0);
        kept.map(|(_, sample)| sample).collect()
    };
    common::touches(&common::plant()).into_iter().take(count).map(thinned).collect()
}

fn arm() -> Arc<Arm> {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let bake = BakeConfig::new(0.01, 0.04);
    Arc::new(Arm::bake(robot, &bake, |_| unreachable!("primitives only")).unwrap().0)
}

fn config(method: EstimatorKind) -> MapperConfig {
    let lattice = Lattice::filling([-1.2; 3], [1.2; 3], 0.02).unwrap();
    let mut config = MapperConfig::of(method);
    config.lattice = lattice;
    config.estimator.drift_std_n_per_m = 0.1; // so that lazy drift must be saved
    config.estimator.memory.frames = 30; // so that frames leave memory before and after
    config
}

fn go_on(mapper: &mut Mapper, samples: &[Sample]) {
    for sample in samples {
        mapper.step(sample).unwrap();
    }
}

/// Learns a touch from its begin to its end.
fn learn(mapper: &mut Mapper, samples: &[Sample]) {
    mapper.begin_touch();
    go_on(mapper, samples);
    mapper.end_touch().unwrap();
}

/// A mapper that has learnt these touches.
fn learnt(arm: &Arc<Arm>, config: MapperConfig, touches: &[Vec<Sample>]) -> Mapper {
    let mut mapper = Mapper::new(Arc::clone(arm), config).unwrap();
    touches.iter().for_each(|samples| learn(&mut mapper, samples));
    mapper
}

fn through_a_file(mapper: Mapper, arm: &Arc<Arm>) -> Mapper {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    let saved = SavedField::of_mapper(&mapper);
    save(&path, &saved).unwrap();
    drop(mapper);
    let loaded = load(&path).unwrap();
    assert_eq!((&loaded.field, &loaded.prior_n_per_m), (&saved.field, &saved.prior_n_per_m));
    Mapper::resume(Arc::clone(arm), loaded.snapshot.unwrap()).unwrap()
}

#[test]
fn saved_loaded_and_continued_equals_uninterrupted_mapping() {
    assert_equal_to_uninterrupted_mapping(&[], &touches(3));
}

#[test]
fn with_a_prior_by_cell_saved_loaded_and_continued_equals_uninterrupted_mapping() {
    let lattice = config(EstimatorKind::Map).lattice;
    // Every third cell of a slab; the touches reach some of these cells.
    let cells = (0..lattice.n_cells() as u32).map(CellId);
    let slab = cells.filter(|&cell| cell.0 % 3 == 0 && lattice.point(cell).z.abs() < 0.3);
    let prior: Vec<_> = slab.map(|cell| (cell, 0.01 * f64::from(cell.0 % 100))).collect();
    assert_equal_to_uninterrupted_mapping(&prior, &touches(3));
}

#[test]
fn mapping_continues_if_some_torques_have_a_standard_deviation() {
    let mut touches = touches(3);
    for touch in &mut touches {
        for (n, sample) in touch.iter_mut().enumerate() {
            // A standard deviation of 0 is not a missing one; at the start, 0 would distinguish a load from the tare.
            let least = if n < 15 { 3.0 } else { 0.0 };
            let std = |joint: usize| least + 0.1 * ((n + joint) % 5) as f64;
            sample.tau_std = (n % 3 != 0).then(|| (0..7).map(std).collect());
        }
    }
    assert_equal_to_uninterrupted_mapping(&[], &touches);
}

#[test]
fn mapping_continues_with_samples_too_close_together_to_be_learned() {
    let mut touches = touches(3);
    for (n, sample) in touches.iter_mut().flat_map(|touch| touch.iter_mut().enumerate()) {
        // The first sample after the interruption follows closely on one that was learnt.
        sample.time_s = (n % 7 != 5).then_some(0.02 * n as f64);
    }
    assert_equal_to_uninterrupted_mapping(&[], &touches);
}

#[test]
fn mapping_continues_with_slow_samples_without_times() {
    let mut touches = touches(3);
    for touch in &mut touches {
        let end = touch.last().unwrap().q.clone();
        for sample in touch.iter_mut() {
            sample.time_s = None;
            sample.q.iter_mut().zip(&end).for_each(|(q, end)| *q = end + 0.02 * (*q - end));
        }
    }
    let mut mapper = Mapper::new(arm(), config(EstimatorKind::Map)).unwrap();
    mapper.begin_touch();
    go_on(&mut mapper, &touches[0]);
    let skipped =
        mapper.snapshot().sample_log[0].skipped.iter().filter(|skipped| **skipped).count();
    assert!((3..touches[0].len()).contains(&skipped), "{skipped} of {}", touches[0].len());
    assert_equal_to_uninterrupted_mapping(&[], &touches);
}

#[test]
fn what_is_logged_twice_within_a_millisecond_is_learned_once() {
    let (arm, touches) = (arm(), touches(1));
    let twice = |sample: &Sample| {
        let mut again = sample.clone();
        again.time_s = sample.time_s.map(|time_s| time_s + 0.001);
        [sample.clone(), again]
    };
    let twice: Vec<Sample> = touches[0].iter().flat_map(twice).collect();
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let field = |samples: &[Sample]| {
            let mut mapper = Mapper::new(Arc::clone(&arm), config(method)).unwrap();
            mapper.begin_touch();
            let steps = samples.iter().map(|sample| mapper.step(sample).unwrap());
            let predicted = steps.filter(|step| step.predicted.is_some()).count();
            mapper.end_touch().unwrap();
            (mapper.field(), predicted)
        };
        let (once, again) = (field(&touches[0]), field(&twice));
        assert!(once.0.counts.iter().any(|&count| count > 1));
        assert_eq!(once.0.counts, again.0.counts);
        let largest = once.0.stiffness_n_per_m.iter().copied().fold(0.0, f64::max);
        for (a, b) in once.0.stiffness_n_per_m.iter().zip(&again.0.stiffness_n_per_m) {
            assert!((a - b).abs() < 1e-9 * largest, "{a} and {b} N/m");
        }
        assert!(again.1 > 3 * once.1 / 2, "what is not learned from is predicted");
    }
}

#[test]
fn a_standard_deviation_of_the_torque_is_added_to_that_of_the_estimator() {
    let (arm, mut touches) = (arm(), touches(1));
    let learnt = |touch: &[Sample], torque_std: f64| {
        let mut config = config(EstimatorKind::Map);
        config.estimator.torque_std = vec![torque_std];
        let mut mapper = Mapper::new(Arc::clone(&arm), config).unwrap();
        mapper.begin_touch();
        go_on(&mut mapper, touch);
        mapper.field()
    };
    let alone = learnt(&touches[0], 0.5);
    touches[0].iter_mut().for_each(|sample| sample.tau_std = Some(vec![0.4; 7]));
    let together = learnt(&touches[0], 0.3);
    assert!(alone.cells.len() > 100 && alone.cells == together.cells);
    let largest = alone.stiffness_n_per_m.iter().copied().fold(0.0, f64::max);
    for (a, b) in alone.stiffness_n_per_m.iter().zip(&together.stiffness_n_per_m) {
        assert!((a - b).abs() < 1e-6 * largest, "{a} and {b} N/m");
    }
}

/// Compares learning three touches without interruption and with two.
fn assert_equal_to_uninterrupted_mapping(prior: &[(CellId, f64)], touches: &[Vec<Sample>]) {
    let arm = arm();
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut config = config(method);
        // Only torques of an identified arm have standard deviations.
        config.touch.identified = touches.iter().flatten().any(|sample| sample.tau_std.is_some());
        let new = || Mapper::with_prior(Arc::clone(&arm), config.clone(), prior).unwrap();
        let mut whole = new();
        touches.iter().for_each(|touch| learn(&mut whole, touch));

        let mut broken = new();
        learn(&mut broken, &touches[0]);
        broken = through_a_file(broken, &arm); // between touches
        broken.begin_touch();
        let (before, after) = touches[1].split_at(touches[1].len() / 2);
        go_on(&mut broken, before);
        broken = through_a_file(broken, &arm); // and in the middle of one
        go_on(&mut broken, after);
        broken.end_touch().unwrap();
        learn(&mut broken, &touches[2]);

        assert_eq!(whole.prior_n_per_m(), broken.prior_n_per_m());
        assert_eq!(whole.prior_means_n_per_m(), broken.prior_means_n_per_m());
        let (whole, broken) = (whole.field(), broken.field());
        assert!(whole.cells.len() >= 100, "{} cells touched", whole.cells.len());
        assert_eq!(whole, broken, "{method:?}: the two must agree to the bit");
    }
}

#[test]
fn a_file_that_promises_a_prior_and_lacks_it_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    let mapper =
        Mapper::with_prior(arm(), config(EstimatorKind::Map), &[(CellId(5), 1.0)]).unwrap();
    let saved = SavedField { prior_n_per_m: None, ..SavedField::of_mapper(&mapper) };
    save(&path, &saved).unwrap();
    let error = load(&path).unwrap_err().to_string();
    assert!(error.contains("1 cells should have a prior of their own"), "{error}");
}

#[test]
fn a_field_file_of_format_1_loads_and_continues_as_one_of_format_2() {
    let (arm, touches) = (arm(), touches(2));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut mapper = learnt(&arm, config(method), &touches[..1]);
        mapper.begin_touch();
        let (before, after) = touches[1].split_at(touches[1].len() / 2);
        go_on(&mut mapper, before);
        let folder = tempfile::tempdir().unwrap();
        let [new, old] = ["new.npz", "old.npz"].map(|name| folder.path().join(name));
        save(&new, &SavedField::of_mapper(&mapper)).unwrap();
        let frames = mapper.snapshot().state.remembered.len();
        assert!(frames > 0, "the test needs remembered frames");
        write_format_1(&new, &old, frames);

        let loaded = [new, old].map(|path| load(&path).unwrap());
        assert_eq!(loaded[0].field, loaded[1].field);
        let states = loaded.each_ref().map(|saved| &saved.snapshot.as_ref().unwrap().state);
        assert_eq!(states[0], states[1]);
        assert_eq!(states[0].remembered.len(), frames);
        let continued = loaded.map(|saved| {
            let mut mapper = Mapper::resume(Arc::clone(&arm), saved.snapshot.unwrap()).unwrap();
            go_on(&mut mapper, after);
            mapper.field()
        });
        assert_eq!(continued[0], continued[1], "{method:?}: the two must agree to the bit");
    }
}

/// Rewrites a field file in format 1: five arrays under their old names, and for `ekf` a zero for
/// each remembered frame where format 2 has an empty array.
fn write_format_1(new: &Path, old: &Path, frames: usize) {
    let read = npz::read_npz(new).unwrap();
    let mut arrays = npz::Arrays::new();
    for (name, array) in read.iter() {
        let (name, array) = match name {
            "memory_frame" => ("memory_source", array.clone()),
            "memory_nis" if array.shape() == [0] => {
                let zeros = npz::Data::F64(vec![0.0; frames]);
                ("memory_contradiction", npz::Array::flat(zeros))
            }
            "memory_nis" => ("memory_contradiction", array.clone()),
            "log_touch" => ("tape_touch", array.clone()),
            "log_q" => ("tape_q", array.clone()),
            "log_tau" => ("tape_tau", array.clone()),
            "palpate" => {
                let settings = read.text(name).unwrap();
                let changed = settings.replace("\"format\":2", "\"format\":1");
                assert_ne!(settings, changed, "the settings must say their format");
                (name, npz::Array::text(&changed))
            }
            other => (other, array.clone()),
        };
        arrays.insert(name, array);
    }
    npz::write_npz(old, &arrays).unwrap();
}

#[test]
fn a_touch_numbered_below_zero_or_beyond_32_bits_is_refused_with_its_row() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    let mapper = learnt(&arm(), config(EstimatorKind::Map), &touches(2));
    save(&path, &SavedField::of_mapper(&mapper)).unwrap();
    let whole = npz::read_npz(&path).unwrap();
    let rows = whole.require("log_touch").unwrap().shape()[0];
    assert_eq!(rows, 2);
    let negative = npz::Data::I64(vec![0, 1, 0, -1, 1, 0]);
    let beyond = npz::Data::U64(vec![0, 1, 0, 1 << 32, 1, 0]);
    for (numbers, wanted) in [(negative, "from 0 on"), (beyond, "below 4,294,967,296")] {
        let mut arrays = whole.clone();
        arrays.insert("log_touch", npz::Array::new(vec![rows, 3], numbers));
        npz::write_npz(&path, &arrays).unwrap();
        let error = load(&path).unwrap_err().to_string();
        assert!(error.contains("`log_touch` holds") && error.contains("in row 1"), "{error}");
        assert!(error.contains(wanted), "{error}");
    }
}

#[test]
fn a_state_whose_prediction_could_not_be_finite_is_refused_with_its_number() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    let mapper = learnt(&arm(), config(EstimatorKind::Map), &touches(1));
    save(&path, &SavedField::of_mapper(&mapper)).unwrap();
    let whole = npz::read_npz(&path).unwrap();
    for name in ["state_mean", "state_variance", "memory_alpha"] {
        let shape = whole.require(name).unwrap().shape().to_vec();
        let mut numbers = whole.floats(name, &vec![None; shape.len()]).unwrap();
        numbers[0] = 1e308;
        let mut arrays = whole.clone();
        arrays.insert(name, npz::Array::new(shape, npz::Data::F64(numbers)));
        npz::write_npz(&path, &arrays).unwrap();
        let error = load(&path).unwrap_err().to_string();
        assert!(error.contains(&format!("`{name}` holds")) && error.contains("1e24"), "{error}");
    }
}

#[test]
fn another_robot_and_a_broken_file_are_distinguished() {
    let (arm, touches) = (arm(), touches(1));
    let mut mapper = Mapper::new(Arc::clone(&arm), config(EstimatorKind::Map)).unwrap();
    mapper.begin_touch();
    go_on(&mut mapper, &touches[0]);
    let snapshot = mapper.snapshot();
    let heavier = palpate::Payload::new("Bracelet_Link", 0.5, [0.0; 3]);
    let robot = Robot::built_in("kinova_gen3").unwrap().with_payload(&heavier).unwrap();
    let other = Arm { robot, surfaces: Arc::clone(&arm.surfaces) };
    let error = Mapper::resume(Arc::new(other), snapshot.clone()).err().unwrap().to_string();
    assert!(error.contains("differs in joints, masses or shapes"), "{error}");

    let mut torn = snapshot;
    torn.sample_log.clear();
    let error = Mapper::resume(arm, torn).err().unwrap().to_string();
    assert!(error.contains("the sample log lacks a remembered frame"), "{error}");
}

#[test]
fn a_sample_log_that_outgrows_its_bound_condenses_old_touches_and_can_still_be_continued() {
    let (arm, touches) = (arm(), touches(3));
    let mut config = config(EstimatorKind::Map);
    let sample = 14 * size_of::<f64>();
    config.estimator.memory.bytes = 40 * sample; // less than two touches, more than one
    let mut mapper = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
    for touch in &touches {
        learn(&mut mapper, touch);
        let bytes = mapper.memory().1;
        assert!(bytes <= 2 * config.estimator.memory.bytes, "{bytes} bytes held");
    }
    let logged: usize = mapper.snapshot().sample_log.iter().map(|touch| touch.q.len()).sum();
    assert!(logged * 16 <= 40 * sample, "{logged} positions logged");
    let before = mapper.field();
    let continued = through_a_file(mapper, &arm);
    assert_eq!(before, continued.field());

    config.estimator.memory.bytes = 10 * sample; // less than a single touch
    let mut mapper = Mapper::new(Arc::clone(&arm), config).unwrap();
    mapper.begin_touch();
    go_on(&mut mapper, &touches[0]);
    let snapshot = mapper.snapshot();
    assert!(snapshot.sample_log.is_empty() && snapshot.state.remembered.is_empty());
    let error = mapper.log_from(LogPosition::default()).unwrap_err().to_string();
    assert!(error.contains("learnt touches (1) are no longer in memory"), "{error}");
    assert_eq!(mapper.field(), Mapper::resume(arm, snapshot).unwrap().field());
}

#[test]
fn a_mapper_saved_between_touches_waits_for_the_next_one_to_begin() {
    let (arm, touches) = (arm(), touches(1));
    let mapper = learnt(&arm, config(EstimatorKind::Map), &touches);
    let mut continued = Mapper::resume(arm, mapper.snapshot()).unwrap();
    let error = continued.step(&touches[0][0]).unwrap_err().to_string();
    assert!(error.contains("before a touch was begun"), "{error}");
}

#[test]
fn on_two_threads_the_field_is_the_same_to_the_bit_as_on_one() {
    let (arm, touches) = (arm(), touches(2));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let field = || learnt(&arm, config(method), &touches).field();
        let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let serial = on(1).install(field);
        assert_eq!(serial, on(2).install(field), "{method:?}, in a pool");
        assert_eq!(serial, field(), "{method:?}, in the pool of all cores");
    }
}

#[test]
fn forgetting_a_touch_gives_to_the_bit_the_field_without_it() {
    let (arm, touches) = (arm(), touches(4));
    let lattice = config(EstimatorKind::Map).lattice;
    let prior: Vec<_> =
        (0..lattice.n_cells() as u32).step_by(500).map(|k| (CellId(k), 0.3)).collect();
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let learned = |numbers: &[usize]| {
            let mut config = config(method);
            config.estimator.stiffness_scale = 0.8;
            // Frames leave memory, but some frames of every touch remain.
            config.estimator.memory.frames = 40;
            let mut mapper = Mapper::with_prior(Arc::clone(&arm), config, &prior).unwrap();
            for number in numbers {
                mapper.begin_touch();
                mapper.name_touch(&format!("touch {number}"));
                go_on(&mut mapper, &touches[*number]);
                mapper.end_touch().unwrap();
            }
            through_a_file(mapper, &arm)
        };
        let snapshot = learned(&[0, 1, 2, 3]).snapshot();
        assert_eq!(snapshot.sample_log[2].name, "touch 2");
        let without =
            Mapper::without(Arc::clone(&arm), &snapshot, &[0, 2], || true).unwrap().unwrap();
        let never = learned(&[1, 3]);
        assert_eq!(without.field(), never.field(), "{method:?}");
        assert_eq!(without.prior_n_per_m(), never.prior_n_per_m());
        // The mapper can forget another touch, and the numbers of the touches do not change.
        let snapshot = through_a_file(without, &arm).snapshot();
        assert_eq!((snapshot.touches, snapshot.gone), (4, 0));
        let numbers: Vec<u32> = snapshot.sample_log.iter().map(|touch| touch.touch).collect();
        assert_eq!(numbers, [1, 3]);
        let one = Mapper::without(Arc::clone(&arm), &snapshot, &[3], || true).unwrap().unwrap();
        assert_eq!(one.field(), learned(&[1]).field());
        let unknown = Mapper::without(Arc::clone(&arm), &snapshot, &[2], || true);
        let message = unknown.err().unwrap().to_string();
        assert!(message.contains("touch 2 is not in its sample log"), "{message}");
        assert!(Mapper::without(Arc::clone(&arm), &snapshot, &[3], || false).unwrap().is_none());
    }
}

#[test]
fn the_error_says_how_many_other_touches_would_be_lost() {
    let (arm, touches) = (arm(), touches(3));
    let mut config = config(EstimatorKind::Map);
    config.estimator.memory.frames = 1;
    let mut mapper = learnt(&arm, config, &touches);
    // During a touch, the previous touch may also have left the sample log.
    mapper.begin_touch();
    let snapshot = mapper.snapshot();
    assert_eq!(snapshot.sample_log.len() as u32 + snapshot.gone, 4);
    mapper.end_touch().unwrap_or_default();
    let snapshot = through_a_file(mapper, &arm).snapshot();
    let last = snapshot.sample_log[0].touch;
    let error = Mapper::without(arm, &snapshot, &[last], || true).err().unwrap();
    assert!(error.to_string().contains("2 touches that the field has learnt"), "{error}");
}

#[test]
fn a_mapper_that_catches_up_in_pieces_equals_the_one_that_goes_on_meanwhile() {
    let (arm, mut touches) = (arm(), touches(3));
    touches[2].truncate(28); // so that the first sample after it is too close
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut config = config(method);
        config.estimator.memory.frames = 10_000;
        let new = || Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
        // 55 ms and 20 ms apart in turn: every other sample is too close to the one before.
        let at = |sample: &Sample, n: usize| {
            let time_s = 1e9 + 0.0375 * n as f64 + 0.0175 * (n % 2) as f64;
            Sample::new(Some(time_s), sample.q.clone(), sample.tau.clone())
        };
        let (mut first, mut second) = (new(), new());
        for (number, samples) in touches.iter().enumerate() {
            first.begin_touch();
            first.name_touch(&format!("touch {number}"));
            for (n, sample) in samples.iter().enumerate() {
                first.step(&at(sample, n)).unwrap();
                // Across the begin of a touch, in the middle of one, and not at all in the last half of the second.
                if [3, 11, 12, 25].contains(&n) && number != 1 {
                    let log = first.log_from(second.position()).unwrap();
                    assert!(log.n_beyond(second.position(), 7) > 0);
                    assert!(second.catch_up(&log, || true).unwrap());
                    assert_eq!(log.n_beyond(second.position(), 7), 0);
                }
            }
            if number < 2 {
                first.end_touch().unwrap();
            }
        }
        let log = first.log_from(second.position()).unwrap();
        assert!(!second.catch_up(&log, || false).unwrap(), "stopped after a sample");
        assert!(second.catch_up(&log, || true).unwrap());
        second.go_on_after(&log);
        assert_eq!(second.field(), first.field(), "{method:?}");
        // Both go on alike: with the same sample too close, and the same number of the next touch.
        for mapper in [&mut first, &mut second] {
            let last = touches[2].last().unwrap();
            for n in 0..5 {
                mapper.step(&at(last, touches[2].len() + n)).unwrap();
            }
            mapper.end_touch().unwrap();
            learn(mapper, &touches[0]);
        }
        let (first, second) = (first.snapshot(), second.snapshot());
        assert_eq!(
            (second.state, second.sample_log),
            (first.state, first.sample_log),
            "{method:?}"
        );
    }
}

#[test]
fn without_held_out_touches_bands_are_those_of_other_objects() {
    let (arm, touches) = (arm(), touches(2));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut config = config(method);
        config.estimator.memory.frames = 10_000;
        let mut mapper = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
        assert_eq!(mapper.field().calibration, None);
        touches.iter().for_each(|samples| learn(&mut mapper, samples));
        let (field, bands) = (mapper.field(), mapper.calibration().unwrap().clone());
        assert_eq!((bands.touches, bands.of_other_objects), (2, true));
        // A given calibration is unchanged until the first contact; its misfits are kept even after that.
        let given = Calibration { misfits: vec![[0.5, 0.3]], ..bands.clone() };
        let beside = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
        let mut beside = beside.with_calibration(Some(given.clone()));
        beside.begin_touch();
        go_on(&mut beside, &touches[0][..10]); // the still start
        beside.end_touch().unwrap_or_default();
        assert_eq!(beside.calibration(), Some(&given));
        learn(&mut beside, &touches[0]);
        let after = beside.calibration().unwrap();
        assert_eq!((&after.misfits, after.touches), (&given.misfits, 1));
        // The bands follow from the errors on the learnt touches.
        let mut predictor = Predictor::new(Arc::clone(&arm), &field, config.touch.clone()).unwrap();
        let mut learnt = Vec::new();
        for samples in &touches {
            predictor.begin_touch();
            for sample in samples {
                let Some(said) = predictor.step(sample).unwrap() else { continue };
                if said.contacts > 0 {
                    let error = &said.external - &said.predicted;
                    learnt.push([error, said.external].map(|own| own.as_slice().to_vec()));
                }
            }
            predictor.end_touch().unwrap();
        }
        let learnt = LearntTorques::of(learnt).unwrap();
        let wanted =
            Calibration::of_other_objects(&learnt, 2, bands.untouched_std_n_per_m).unwrap();
        let off = |found: &[f64], wanted: &[f64]| {
            found.iter().zip(wanted).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
        };
        assert!(off(&bands.floor_n_m, &wanted.floor_n_m) < 1e-6, "{bands:?} and {wanted:?}");
        assert!(off(&bands.by_unknown_n_m, &wanted.by_unknown_n_m) < 1e-6);
        // The bands are the same after saving and loading.
        let mut again = through_a_file(mapper, &arm);
        assert_eq!(again.calibration(), Some(&bands));
        again.begin_touch();
        assert!(again.with_band(0.9).is_some());
    }
}

#[test]
fn a_known_standard_deviation_of_the_torques_does_not_narrow_bands() {
    // A standard deviation of five times the torque noise lowers the weight of a torque, but not the errors.
    let (arm, touches) = (arm(), touches(1));
    let bands = |std_n_m: Option<f64>| {
        let mut config = config(EstimatorKind::Map);
        let own = config.estimator.torque_std[0];
        (config.estimator.replays, config.touch.tare) = (0, palpate::Tare::None);
        // Without stiffness, the residual is the whole torque, for any weights.
        config.estimator.stiffness_scale = 0.0;
        let mut mapper = Mapper::new(Arc::clone(&arm), config).unwrap();
        mapper.begin_touch();
        for sample in &touches[0] {
            let mut sample = sample.clone();
            sample.tau_std = std_n_m.map(|times| vec![times * own; 7]);
            mapper.step(&sample).unwrap();
        }
        mapper.end_touch().unwrap();
        mapper.calibration().unwrap().clone()
    };
    let (plain, weighted) = (bands(None), bands(Some(5.0)));
    for (a, b) in plain.floor_n_m.iter().zip(&weighted.floor_n_m) {
        assert!((a / b - 1.0).abs() < 1e-9, "{plain:?} and {weighted:?}");
    }
}

#[test]
fn a_step_reports_the_band_that_a_predictor_has_at_the_same_field() {
    let (arm, touches) = (arm(), touches(2));
    let calibration = Calibration {
        floor_n_m: vec![0.1; 7],
        by_torque: 0.3,
        by_std: 0.5,
        relative_std: 10.0,
        untouched_std_n_per_m: 2.0,
        touches: 9,
        by_unknown_n_m: vec![],
        exponent: 0.5,
        of_other_objects: false,
        quantiles: vec![BandQuantiles { level: 0.9, frame: 0.1, peak: 1.2 }],
        misfits: Vec::new(),
    };
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut config = config(method);
        (config.estimator.drift_std_n_per_m, config.estimator.replays) = (0.0, 0);
        if method == EstimatorKind::Map {
            config.estimator.stiffness_scale = 0.8;
        }
        let mapper = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
        assert!(mapper.with_band(0.9).is_none());
        let mapper = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
        let mut mapper = mapper.with_calibration(Some(calibration.clone())).with_band(0.9).unwrap();
        learn(&mut mapper, &touches[0]);
        assert_eq!(mapper.calibration(), Some(&calibration), "its own bands stay");
        // Compared at the first frame with contacts of the next touch.
        let mut field = mapper.field();
        let untouched = config.estimator.stiffness_scale
            * config.estimator.prior.at_spacing(config.lattice.spacing_m()).1;
        field.calibration.as_mut().unwrap().untouched_std_n_per_m = untouched;
        let mut predictor = Predictor::new(Arc::clone(&arm), &field, config.touch.clone()).unwrap();
        predictor.begin_touch();
        mapper.begin_touch();
        for sample in &touches[1] {
            let (step, said) = (mapper.step(sample).unwrap(), predictor.step(sample).unwrap());
            let Some(said) = said else { continue };
            let spread = said.spread.unwrap();
            let wanted =
                1.2 * calibration.scale(said.predicted.as_slice(), spread.as_slice(), [1, 1]);
            let found = step.peak_half_width.unwrap();
            assert!((&found - &wanted).amax() < 1e-9 * wanted.amax(), "{found} and {wanted}");
            if step.contacts > 0 {
                break;
            }
        }
    }
}
