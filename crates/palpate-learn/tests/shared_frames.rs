//! With frames that are tracked once, methods learn and predict as with frames of their own, and no
//! touch under test is used for learning.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use palpate::unstable::{ElasticBody, LoggedTouch, Segment, SegmentKind};
use palpate::{
    Arm, BakeConfig, EstimatorKind, Field, Lattice, Mapper, MapperConfig, Predictor, Robot, Sample,
};
use palpate_learn::choose::largest_changes;
use palpate_learn::evaluate::{EvaluationPlan, FoldPrediction};
use palpate_learn::folds::{Fold, folds};
use palpate_learn::method::{self, Method, TorquesByTouch};
use palpate_learn::tracked::{TouchSamples, TrackedFrame, TrackedTouches, largest_torques};
use palpate_learn::tune::{FixedSettings, Search, SearchBudget, Trial, Tuned, Tuner};

const URDF: &str = include_str!("data/tiny.urdf");

const STILL: usize = 8;
const FRAMES: usize = 28;
const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

fn arm() -> Arc<Arm> {
    let bake = BakeConfig::new(0.01, 0.04);
    let robot = Robot::from_urdf(URDF).unwrap();
    Arc::new(Arm::bake(robot, &bake, |_| unreachable!("primitives only")).unwrap().0)
}

fn config(method: EstimatorKind) -> MapperConfig {
    let lattice = Lattice::filling([-0.8, -0.8, -0.1], [0.8, 0.8, 0.1], 0.03).unwrap();
    let mut config = MapperConfig::of(method);
    config.lattice = lattice;
    config.estimator.drift_std_n_per_m = 0.1; // so that frames without contact count
    config.estimator.replays = 5;
    config
}

/// A stem beside the upper link.
fn stem() -> Arc<ElasticBody> {
    let piece = |piece: u32| Segment {
        parent: piece.checked_sub(1),
        kind: SegmentKind::Wood,
        start_m: [0.3, 0.08, 0.06 * f64::from(piece) - 0.15],
        end_m: [0.3, 0.08, 0.06 * f64::from(piece) - 0.09],
        bare_m: 0.0,
        radius_m: 0.01,
        half_width_m: [0.0; 3],
        joint_stiffness: 5.0,
        branch: 0,
    };
    Arc::new(ElasticBody::new((0..5).map(piece).collect()).unwrap())
}

/// Still frames, then a swing of the shoulder with the elbow bent, into something springy.
fn touch(number: usize) -> TouchSamples {
    let (way, bend) = (0.4 + 0.1 * number as f64, -0.3 * number as f64);
    let sample = |frame: usize| {
        let part = frame.saturating_sub(STILL) as f64 / (FRAMES - STILL) as f64;
        let noise = 0.01 * ((7 * frame + 3 * number) as f64).sin();
        let push = (way * part - 0.05).max(0.0);
        let q = vec![way * part, bend + 0.2 * part];
        let tau = vec![0.3 - 9.0 * push + noise, 0.1 - 3.0 * push - 0.5 * noise];
        Sample::new(None, q, tau)
    };
    TouchSamples {
        name: format!("touch_{number}"),
        samples: (0..FRAMES).map(sample).collect(),
        truth: None,
    }
}

fn touches(count: usize) -> Vec<TouchSamples> {
    (0..count).map(touch).collect()
}

fn tracked(arm: &Arc<Arm>, config: &MapperConfig, touches: &[TouchSamples]) -> TrackedTouches {
    let tracked = TrackedTouches::new(arm, config, touches, NEVER).unwrap();
    let in_contact = |touch: usize| tracked.touches[touch].frames_in_contact();
    assert!((0..touches.len()).all(|touch| in_contact(touch) > 5), "the arm must touch something");
    tracked
}

/// The field that a mapper learns from touches.
fn mapped<'a>(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: impl IntoIterator<Item = &'a TouchSamples>,
) -> Field {
    let mut mapper = Mapper::new(Arc::clone(arm), config.clone()).unwrap();
    touches.into_iter().for_each(|touch| map(&mut mapper, touch));
    mapper.field()
}

fn map(mapper: &mut Mapper, touch: &TouchSamples) {
    mapper.begin_touch();
    touch.samples.iter().for_each(|sample| drop(mapper.step(sample).unwrap()));
    mapper.end_touch().unwrap();
}

/// Torques that a field predicts for a touch from its tare on, frames × n_joints, N·m.
fn predicted(arm: &Arc<Arm>, field: &Field, touch: &TouchSamples) -> Vec<Vec<f64>> {
    let mut predictor = Predictor::new(Arc::clone(arm), field, field.touch.clone()).unwrap();
    predictor.begin_touch();
    let predictions = touch.samples.iter().map(|sample| predictor.step(sample).unwrap());
    predictions.flatten().map(|frame| frame.predicted.as_slice().to_vec()).collect()
}

/// For each cell, the bits of stiffness and standard deviation, and the count.
fn by_cell(field: &Field) -> BTreeMap<u32, (u64, u64, u32)> {
    let row = |(row, cell): (usize, &palpate::CellId)| {
        let bits = |numbers: &[f64]| numbers[row].to_bits();
        (cell.0, (bits(&field.stiffness_n_per_m), bits(&field.std_n_per_m), field.counts[row]))
    };
    field.cells.iter().enumerate().map(row).collect()
}

fn largest_gap(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    assert_eq!(
        a.iter().map(Vec::len).collect::<Vec<_>>(),
        b.iter().map(Vec::len).collect::<Vec<_>>()
    );
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn shared_frames_teach_what_a_mapper_learns_to_the_bit() {
    let (arm, touches) = (arm(), touches(3));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let config = config(method);
        let tracked = tracked(&arm, &config, &touches);
        // Also without the touch in the middle, and in another order: cells then have other rows.
        for some in [vec![0, 1, 2], vec![0, 2], vec![2, 0]] {
            let estimator = method::learn(&tracked, &some, &config, &[], NEVER).unwrap();
            let field = method::field(&tracked, estimator.as_ref(), &config);
            let whole = mapped(&arm, &config, some.iter().map(|&touch| &touches[touch]));
            assert!(whole.cells.len() > 100, "{} cells touched", whole.cells.len());
            assert_eq!(by_cell(&field), by_cell(&whole), "{method:?} of {some:?}");
            assert_eq!(field.untouched_n_per_m.to_bits(), whole.untouched_n_per_m.to_bits());
            assert_eq!((field.lattice, field.contact), (whole.lattice, whole.contact));
        }
    }
}

/// A touch with ten samples for each of [`touch`], 10 ms apart.
fn fast_touch(number: usize) -> TouchSamples {
    let mut fast = touch(number);
    let pairs: Vec<[Sample; 2]> =
        fast.samples.windows(2).map(|pair| [pair[0].clone(), pair[1].clone()]).collect();
    let between = |at: usize| {
        let ([from, to], part) = (&pairs[at / 10], (at % 10) as f64 / 10.0);
        let mix = |of: fn(&Sample) -> &Vec<f64>| {
            of(from).iter().zip(of(to)).map(|(from, to)| from + part * (to - from)).collect()
        };
        Sample::new(Some(0.01 * at as f64), mix(|own| &own.q), mix(|own| &own.tau))
    };
    fast.samples = (0..10 * pairs.len()).map(between).collect();
    fast
}

#[test]
fn a_mapper_that_passes_over_samples_learns_the_shared_frames_to_the_bit() {
    let (arm, touches) = (arm(), [fast_touch(0), fast_touch(1)]);
    let config = config(EstimatorKind::Map);
    let tracked = tracked(&arm, &config, &touches);
    let estimator = method::learn(&tracked, &[0, 1], &config, &[], NEVER).unwrap();
    let mut mapper = Mapper::new(Arc::clone(&arm), config.clone()).unwrap();
    let (mut learnt, mut passed) = (0, 0);
    for touch in &touches {
        mapper.begin_touch();
        for sample in &touch.samples {
            match mapper.step_if_learnt(sample).unwrap() {
                Some(report) => learnt += usize::from(report.external.is_some()),
                None => passed += 1,
            }
        }
        mapper.end_touch().unwrap();
    }
    let frames: usize = tracked.touches.iter().map(|touch| touch.frames.len()).sum();
    // The sample that ends a tare is simulated even if it is not learnt.
    assert!((frames..=frames + touches.len()).contains(&learnt), "{learnt} of {frames}");
    assert!(passed > 3 * learnt, "{passed} of {} samples passed over", learnt + passed);
    let field = method::field(&tracked, estimator.as_ref(), &config);
    assert_eq!(by_cell(&field), by_cell(&mapper.field()));
    assert!(mapper.step_if_learnt(&Sample::new(None, vec![0.0; 2], vec![0.0; 2])).is_err());
    // A touch is known again, though samples of it are not in the log; another touch is not.
    let samples = |touch: &TouchSamples, of: fn(&Sample) -> &Vec<f64>| -> Vec<f64> {
        touch.samples.iter().flat_map(of).copied().collect()
    };
    let logged = mapper.snapshot().sample_log;
    for (number, touch) in touches.iter().enumerate() {
        let (q, tau) = (samples(touch, |own| &own.q), samples(touch, |own| &own.tau));
        assert!(logged[number].q.len() < q.len() / 2, "samples that were passed over are stored");
        let starts = |touch: &LoggedTouch| touch.is_start_of(&q, &tau, 2);
        assert_eq!([starts(&logged[0]), starts(&logged[1])], [number == 0, number == 1]);
    }
    mapper.begin_touch();
    touches[1].samples.iter().for_each(|own| drop(mapper.step_if_learnt(own).unwrap()));
    assert_eq!(mapper.repeated_touch(), Some(1));
    // Also if its first log has all samples.
    let mut mapper = Mapper::new(Arc::clone(&arm), config).unwrap();
    mapper.begin_touch();
    touches[0].samples.iter().for_each(|own| drop(mapper.step(own).unwrap()));
    mapper.end_touch().unwrap();
    for (number, wanted) in [(1, None), (0, Some(0))] {
        mapper.begin_touch();
        touches[number].samples.iter().for_each(|own| drop(mapper.step_if_learnt(own).unwrap()));
        assert_eq!(mapper.repeated_touch(), wanted);
        mapper.end_touch().unwrap();
    }
}

#[test]
fn shared_frames_teach_what_a_mapper_learns_from_the_same_expectations() {
    let (arm, touches) = (arm(), touches(2));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let config = config(method);
        let tracked = tracked(&arm, &config, &touches);
        let means: Vec<f64> = (0..tracked.cells.len()).map(|row| (row % 5) as f64).collect();
        let estimator = method::learn(&tracked, &[1], &config, &means, NEVER).unwrap();
        let field = method::field(&tracked, estimator.as_ref(), &config);
        let prior: Vec<_> = tracked.cells.iter().copied().zip(means).collect();
        let mut mapper = Mapper::with_prior(Arc::clone(&arm), config, &prior).unwrap();
        map(&mut mapper, &touches[1]);
        let mut whole = by_cell(&mapper.field());
        whole.retain(|_, (_, _, count)| *count > 0);
        assert!(whole.len() > 100 && whole.len() < prior.len(), "{} cells", whole.len());
        assert_eq!(by_cell(&field), whole, "{method:?}");
        let untouched = (0..prior.len()).filter(|&row| estimator.count(row) == 0);
        let least = estimator.stiffness(usize::MAX);
        for row in untouched {
            assert_eq!(estimator.stiffness(row), prior[row].1.max(least), "{method:?}, row {row}");
        }
    }
}

#[test]
fn an_estimator_predicts_what_the_field_of_a_mapper_predicts() {
    let (arm, touches) = (arm(), touches(3));
    for (kind, method) in [(EstimatorKind::Map, Method::Map), (EstimatorKind::Ekf, Method::Ekf)] {
        let config = config(kind);
        let tracked = tracked(&arm, &config, &touches);
        for fold in folds(3, 3) {
            let torques = method.predict(&tracked, &fold, &config, NEVER).unwrap();
            let field = mapped(&arm, &config, fold.train.iter().map(|&touch| &touches[touch]));
            let expected = predicted(&arm, &field, &touches[fold.test[0]]);
            assert!(expected.iter().flatten().any(|tau| tau.abs() > 0.1), "something to predict");
            let gap = largest_gap(&torques[0], &expected);
            assert!(gap <= 1e-12, "{method:?}, {fold:?}: {gap} N·m apart");
        }
    }
}

/// A plan that tests every touch once.
fn plan(folds: Vec<Fold>, methods: Vec<Method>) -> EvaluationPlan {
    let config = [EstimatorKind::Map, EstimatorKind::Ekf].map(config);
    EvaluationPlan {
        todo: (0..folds.len()).collect(),
        methods,
        estimators: vec![config.clone(); folds.len()],
        folds,
        config: config[0].clone(),
    }
}

fn parts_of(
    plan: &EvaluationPlan,
    tracked: &TrackedTouches,
    which: &[(Method, usize)],
) -> Vec<FoldPrediction> {
    let done = Mutex::new(Vec::new());
    plan.run(tracked, which, NEVER, &|part| done.lock().unwrap().push(part)).unwrap();
    done.into_inner().unwrap()
}

#[test]
fn parts_are_the_same_to_the_bit_on_one_thread_and_on_two() {
    let (arm, touches) = (arm(), touches(4));
    let config = config(EstimatorKind::Map);
    let methods = Method::ALL.into_iter().filter(|method| method.is_built()).collect();
    let plan = plan(folds(4, 2), methods);
    let run = || {
        let tracked = tracked(&arm, &config, &touches);
        let seen = (&touches[..], &[vec![0, 1, 2, 3]][..]);
        let tracked = tracked.with_bodies(&arm, &[stem()], seen, (NEVER, &|| ())).unwrap();
        let bits = |part: FoldPrediction| {
            let numbers = part.torques.iter().flatten().flatten();
            let bits: Vec<u64> = numbers.map(|torque| torque.to_bits()).collect();
            ((part.method.name(), part.fold), bits)
        };
        parts_of(&plan, &tracked, &plan.parts()).into_iter().map(bits).collect::<BTreeMap<_, _>>()
    };
    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let serial = on(1).install(run);
    assert_eq!(serial.len(), 2 * plan.methods.len());
    let parallel = on(2).install(run);
    for (part, bits) in &serial {
        assert!(*bits == parallel[part], "{part:?} depends on the number of threads");
    }
}

#[test]
fn a_part_of_another_shape_or_without_finite_torques_does_not_belong_to_the_plan() {
    let (arm, touches) = (arm(), touches(3));
    let config = config(EstimatorKind::Map);
    let plan = plan(folds(3, 3), vec![Method::Zero]);
    let tracked = tracked(&arm, &config, &touches);
    let part = parts_of(&plan, &tracked, &[(Method::Zero, 0)]).remove(0);
    assert!(part.torques.iter().flatten().flatten().all(|torque| *torque == 0.0));
    assert!(plan.has(&part, &tracked));
    let wrong: [fn(&mut FoldPrediction); 7] = [
        |part| part.fold = 99,
        |part| part.method = Method::Knn,
        |part| part.torques.clear(),
        |part| part.torques[0].truncate(5),
        |part| part.torques[0][3].truncate(1),
        |part| part.torques[0][3][0] = f64::NAN,
        |part| part.torques[0][3][0] = 1e300,
    ];
    for (number, make) in wrong.iter().enumerate() {
        let mut part = part.clone();
        make(&mut part);
        assert!(!plan.has(&part, &tracked), "change {number}");
    }
}

/// Number, positions, unwrapped positions, torques and targets of a frame.
type Measured = (u32, Vec<f64>, Vec<f64>, Vec<f64>, Vec<f64>);

/// The part of a frame that does not depend on the contact model.
fn measured(frame: &TrackedFrame) -> Measured {
    let tau = frame.observation.tau().as_slice().to_vec();
    (frame.sample, frame.q.clone(), frame.unwrapped.clone(), tau, frame.target.clone())
}

fn all_measured(tracked: &TrackedTouches) -> Vec<Vec<Measured>> {
    let touches = tracked.touches.iter();
    touches.map(|touch| touch.frames.iter().map(measured).collect()).collect()
}

#[test]
fn under_the_same_contact_model_frames_are_the_same() {
    let (arm, mut touches) = (arm(), touches(3));
    touches[1].truth = Some(vec![vec![0.5, -0.5]; FRAMES]);
    let config = config(EstimatorKind::Map);
    let tracked = tracked(&arm, &config, &touches);
    let again =
        tracked.with_contact_model(&config.contact, &arm, &config, (&touches, 1), NEVER).unwrap();
    assert_eq!(all_measured(&tracked), all_measured(&again));
    assert_eq!(tracked.noise_std(&[0, 2]), again.noise_std(&[0, 2]));
    for fold in folds(3, 3) {
        let of =
            |tracked: &TrackedTouches| Method::Map.predict(tracked, &fold, &config, NEVER).unwrap();
        assert_eq!(of(&tracked), of(&again));
    }
}

#[test]
fn under_another_contact_model_contacts_change_and_torques_do_not() {
    let (arm, touches) = (arm(), touches(3));
    let config = config(EstimatorKind::Map);
    let tracked = tracked(&arm, &config, &touches);
    let given = config.contact.contact_distance_m;
    for contact_distance_m in [0.6 * given, 1.5 * given] {
        let mut contact = config.contact.clone();
        contact.contact_distance_m = contact_distance_m;
        let other =
            tracked.with_contact_model(&contact, &arm, &config, (&touches, 1), NEVER).unwrap();
        assert_eq!(all_measured(&tracked), all_measured(&other));
        assert_eq!(tracked.noise_std(&[0, 2]), other.noise_std(&[0, 2]));
        let contacts = |tracked: &TrackedTouches| -> usize {
            let frames = tracked.touches.iter().flat_map(|touch| &touch.frames);
            frames.map(|frame| frame.observation.n_contacts()).sum()
        };
        assert_ne!(contacts(&tracked), contacts(&other));
    }
}

/// [`touch`], then to and fro until it has so many samples.
fn long_touch(number: usize, samples: usize) -> TouchSamples {
    let mut long = touch(number);
    let swing = long.samples[STILL..].to_vec();
    let to_and_fro = swing.iter().rev().chain(&swing).cycle().cloned();
    long.samples.extend(to_and_fro.take(samples - FRAMES));
    long
}

#[test]
fn of_a_long_log_fewer_samples_are_tracked_but_no_part_is_left_out() {
    let (arm, config) = (arm(), config(EstimatorKind::Map));
    let sparse =
        |touches: &[TouchSamples]| TrackedTouches::sparse(&arm, &config, touches, NEVER).unwrap();
    let frames = |tracked: &TrackedTouches| -> usize {
        tracked.touches.iter().map(|touch| touch.frames.len()).sum()
    };
    let short: Vec<TouchSamples> = (0..3).map(|number| long_touch(number, 400)).collect();
    assert!(all_measured(&sparse(&short)) == all_measured(&tracked(&arm, &config, &short)));
    for samples in [3_000, 12_000] {
        let long: Vec<TouchSamples> = (0..3).map(|number| long_touch(number, samples)).collect();
        let (some, all) = (sparse(&long), tracked(&arm, &config, &long));
        let count = frames(&some);
        assert!(count > 1_000 && 2 * count <= frames(&all) + long.len(), "{count} frames");
        for (some, all) in all_measured(&some).iter().zip(&all_measured(&all)) {
            let numbered: BTreeMap<u32, &Measured> = all.iter().map(|of| (of.0, of)).collect();
            assert!(some.iter().all(|frame| frame.3 == numbered[&frame.0].3), "other torques");
            let gaps = some.windows(2).map(|pair| pair[1].0 - pair[0].0);
            let end = all.last().unwrap().0 - some.last().unwrap().0;
            assert!(gaps.chain([end]).all(|gap| gap <= 8), "a part is left out");
        }
        let same = some.again(&arm, &config, &long, NEVER).unwrap();
        assert!(all_measured(&some) == all_measured(&same), "other frames");
        let mut contact = config.contact.clone();
        contact.contact_distance_m *= 1.5;
        let other = some.with_contact_model(&contact, &arm, &config, (&long, 1), NEVER).unwrap();
        assert!(all_measured(&some) == all_measured(&other), "other frames");
    }
}

#[test]
fn the_largest_torques_of_touches_are_found_in_short_and_long_logs() {
    let (arm, config) = (arm(), config(EstimatorKind::Map));
    for samples in [400, 6_000] {
        let mut touches: Vec<TouchSamples> =
            (0..3).map(|number| long_touch(number, samples)).collect();
        for (touch, factor) in touches.iter_mut().zip([1.0, 4.0, 2.0]) {
            let torques = touch.samples.iter_mut().flat_map(|sample| &mut sample.tau);
            torques.for_each(|tau| *tau *= factor);
        }
        let frames = tracked(&arm, &config, &touches);
        let in_contact = |touch: usize| {
            let frames = frames.touches[touch].frames.iter();
            let touching = frames.filter(|frame| frame.observation.n_contacts() > 0);
            touching.map(|frame| frame.observation.tau().norm()).fold(0.0, f64::max)
        };
        let wanted = [0, 1, 2].map(in_contact);
        let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
        assert_eq!(largest_torques(&arm, &config, &samples, NEVER).unwrap(), wanted);
        let changes = largest_changes(&arm, &config, &samples).unwrap();
        for (change, wanted) in changes.iter().zip(wanted) {
            assert!((change / wanted - 1.0).abs() < 0.1, "{changes:?}, in contact {wanted:?}");
        }
    }
}

#[test]
fn uniform_recovers_the_stiffness_of_a_uniform_field() {
    let (arm, mut touches) = (arm(), touches(3));
    let config = config(EstimatorKind::Map);
    let stiffness = 37.5;
    let mut field = mapped(&arm, &config, &touches);
    field.stiffness_n_per_m.fill(stiffness);
    field.untouched_n_per_m = stiffness;
    for touch in &mut touches {
        let torques = predicted(&arm, &field, touch);
        let tare = touch.samples.len() - torques.len();
        touch.samples.iter_mut().for_each(|sample| sample.tau.fill(0.2)); // a bias to tare off
        for (sample, torque) in touch.samples[tare..].iter_mut().zip(torques) {
            sample.tau.iter_mut().zip(torque).for_each(|(tau, torque)| *tau += torque);
        }
    }
    let tracked = tracked(&arm, &config, &touches);
    for fold in folds(3, 3) {
        let torques = Method::Uniform.predict(&tracked, &fold, &config, NEVER).unwrap();
        let expected = predicted(&arm, &field, &touches[fold.test[0]]);
        let size = expected.iter().flatten().fold(0.0, |most: f64, tau| most.max(tau.abs()));
        assert!(size > 0.1, "{size} N·m to recover");
        let gap = largest_gap(&torques[0], &expected);
        assert!(gap < 1e-12 * stiffness.max(size), "{gap} N·m apart");
    }
}

/// The same touches with other torques in one of them, in its tare too.
fn with_other_torques(touches: &[TouchSamples], touch: usize) -> Vec<TouchSamples> {
    let mut touches = touches.to_vec();
    for (number, sample) in touches[touch].samples.iter_mut().enumerate() {
        sample.tau[0] = 5.0 - 0.4 * sample.tau[0] + 2.0 * (number as f64).cos();
        sample.tau[1] = -7.0 * sample.tau[1] + (number as f64).sin();
    }
    touches
}

#[test]
fn a_touch_under_test_has_no_effect_on_its_own_prediction() {
    let (arm, touches) = (arm(), touches(3));
    let methods = [Method::Map, Method::Ekf, Method::Uniform, Method::Knn, Method::Gp];
    for test in 0..3 {
        let fold = Fold::testing(vec![test], 3);
        let others = with_other_torques(&touches, test);
        for method in methods.into_iter().filter(|method| method.is_built()) {
            let kind = if method == Method::Ekf { EstimatorKind::Ekf } else { EstimatorKind::Map };
            let config = config(kind);
            let torques_of = |touches: &[TouchSamples]| -> TorquesByTouch {
                let tracked = tracked(&arm, &config, touches);
                method.predict(&tracked, &fold, &config, NEVER).unwrap()
            };
            let first = torques_of(&touches);
            assert!(first.iter().flatten().flatten().any(|tau| *tau != 0.0), "a prediction");
            assert!(first == torques_of(&others), "{} saw touch {test}", method.name());
        }
    }
}

/// Number of candidates with which two reach the last round.
const CANDIDATES: usize = 10;

fn tuned(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[TouchSamples],
    train: &[usize],
) -> Tuned {
    let base = tracked(arm, config, touches);
    let search = Search::thorough(config, SearchBudget { candidates: CANDIDATES, seed: 3 });
    Tuner::new((arm, touches, &base), config, search, NEVER, &|| ())
        .unwrap()
        .tune(train, NEVER)
        .unwrap()
}

#[test]
fn tuning_refuses_settings_that_no_estimator_can_have() {
    let (arm, touches, mut config) = (arm(), touches(3), config(EstimatorKind::Map));
    let base = tracked(&arm, &config, &touches);
    config.estimator.torque_std.clear();
    let search = Search::thorough(&config, SearchBudget { candidates: 2, seed: 0 });
    let tuner = Tuner::new((&arm, &touches, &base), &config, search, NEVER, &|| ());
    assert!(tuner.is_err_and(|error| error.to_string().contains("torque_std has 0 values")));
}

#[test]
fn a_quick_search_scales_down_a_model_that_predicts_too_much() {
    let (arm, config) = (arm(), config(EstimatorKind::Map));
    let mut touches = touches(4);
    let chosen = |touches: &[TouchSamples]| {
        let base = tracked(&arm, &config, touches);
        let search = Search::quick(&config, FixedSettings::default());
        let tuner = Tuner::new((&arm, touches, &base), &config, search, NEVER, &|| ()).unwrap();
        tuner.tune(&[0, 1, 2, 3], NEVER).unwrap()
    };
    let alike = chosen(&touches);
    assert_eq!(alike.trials.len(), Search::quick(&config, FixedSettings::default()).candidates());
    assert!(alike.trials[0].scores.len() == 2 && alike.config == alike.trials[0].config);
    assert_eq!(alike, chosen(&touches), "nothing is left to chance");
    // Every other touch has no torque, so the others predict too much for it.
    for number in [1, 3] {
        let still = touches[number].samples[0].tau.clone();
        touches[number].samples.iter_mut().for_each(|sample| sample.tau.clone_from(&still));
    }
    let scale = chosen(&touches).config.estimator.stiffness_scale;
    assert!(scale < alike.config.estimator.stiffness_scale, "{scale}");
}

#[test]
fn tuning_does_not_look_at_the_touch_under_test() {
    let (arm, touches) = (arm(), touches(4));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let config = config(method);
        let first = tuned(&arm, &config, &touches, &[0, 1, 3]);
        let second = tuned(&arm, &config, &with_other_torques(&touches, 2), &[0, 1, 3]);
        assert!(first == second, "{method:?} saw the touch under test");
    }
}

#[test]
fn tuning_chooses_the_lowest_score_of_the_last_round_and_tries_what_was_given() {
    let (arm, touches) = (arm(), touches(4));
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let config = config(method);
        let Tuned { config: chosen, trials, .. } = tuned(&arm, &config, &touches, &[0, 1, 3]);
        assert_eq!(trials.len(), CANDIDATES);
        let as_given = |trial: &Trial| {
            let mut tried = trial.config.clone();
            tried.estimator.stiffness_scale = config.estimator.stiffness_scale;
            tried == config
        };
        assert!(trials.iter().any(as_given), "the given settings are tried");
        let is_thin = |trial: &Trial| trial.config.contact.contact_distance_m < 0.01;
        assert!(trials.iter().any(is_thin), "a model for hard things is tried");
        let last = trials.iter().filter(|trial| trial.scores.len() == 3);
        let last: Vec<(f64, &MapperConfig)> =
            last.map(|trial| (trial.scores[2], &trial.config)).collect();
        assert_eq!(last.len(), 2, "two are left in the last round");
        let lowest = last.iter().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        assert!(lowest.0.is_finite() && *lowest.1 == chosen);
        for round in 0..2 {
            let scores = |further: bool| {
                let there = trials.iter().filter(move |trial| trial.scores.len() > round);
                let of = there.filter(move |trial| (trial.scores.len() > round + 1) == further);
                of.map(move |trial| trial.scores[round])
            };
            let worst = scores(true).fold(f64::NEG_INFINITY, f64::max);
            assert!(scores(false).all(|score| score >= worst), "the better ones go on");
        }
        let reached: Vec<usize> = trials.iter().map(|trial| trial.scores.len()).collect();
        assert!(reached.is_sorted_by(|a, b| a >= b), "who came furthest comes first: {reached:?}");
    }
}
