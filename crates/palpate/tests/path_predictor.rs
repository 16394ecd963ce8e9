//! Laws of the path predictor: what torque a motion would meet that has not been made yet.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use std::sync::Arc;

use nalgebra::DVector;
use palpate::{
    Arm, BandQuantiles, CLUSTER_WEIGHT, Calibration, EstimatorKind, Gravity, Lattice, MAX_POINTS,
    Mapper, MapperConfig, PathConfig, PathError, PathPoint, PathPrediction, PathPredictor,
    Predictor, Sample, Tare,
};
use scene::config;

const EVERY_POINT: PathConfig = PathConfig::new(0.0, 1.0);

/// A ball of 12 cm on a gantry.
fn arm() -> Arc<Arm> {
    scene::gantry("<sphere radius='0.06'/>", 0.005)
}

/// Springs of 1 cm from x = 0 on.
fn block() -> Lattice {
    Lattice::new([0.0, -0.15, -0.15], 0.01, [30; 3]).unwrap()
}

/// A mapper whose torques are external ones, with a prior of 0 ± `std` N/m.
fn mapper(lattice: Lattice, std: f64) -> Mapper {
    mapper_with(lattice, std, 3)
}

fn mapper_with(lattice: Lattice, std: f64, replays: u32) -> Mapper {
    let mut settings = MapperConfig::of(EstimatorKind::Map);
    (settings.lattice, settings.estimator) = (lattice, config(EstimatorKind::Map, 0.0, std, 0.1));
    settings.estimator.replays = replays;
    (settings.touch.gravity, settings.touch.tare) = (Gravity::Removed, Tare::None);
    Mapper::new(arm(), settings).unwrap()
}

/// To and fro along x in steps of about 2 mm, `y` to the side, in `points`.
fn push(y: f64, points: usize) -> Vec<Vec<f64>> {
    let depth = |point: usize| {
        let part = point as f64 / (points - 1) as f64;
        0.16 * (1.0 - (2.0 * part - 1.0).abs())
    };
    (0..points).map(|point| vec![depth(point) - 0.1, y + 0.3 * depth(point), 0.02]).collect()
}

/// What the arm reports at some positions, with a force that grows as it goes in.
fn sample(q: &[f64]) -> Sample {
    let force = (q[0] + 0.08).max(0.0);
    Sample::new(None, q.to_vec(), vec![-200.0 * force, -20.0 * force, 5.0 * force])
}

fn learn(mapper: &mut Mapper, path: &[Vec<f64>]) {
    path.iter().for_each(|q| drop(mapper.step(&sample(q)).unwrap()));
}

/// A mapper that has learnt two pushes and is not in a third.
fn learnt() -> Mapper {
    taught(mapper(block(), 5.0))
}

fn taught(mut mapper: Mapper) -> Mapper {
    for y in [-0.03, 0.04] {
        mapper.begin_touch();
        learn(&mut mapper, &push(y, 120));
        mapper.end_touch().unwrap();
    }
    mapper
}

/// Predictions for all samples of a touch.
fn predictions(mapper: &Mapper, path: &[Vec<f64>]) -> Vec<palpate::Prediction> {
    let (field, touch) = (mapper.field(), mapper.config().touch.clone());
    let mut predictor = Predictor::new(arm(), &field, touch).unwrap();
    predictor.begin_touch();
    path.iter().map(|q| predictor.step(&sample(q)).unwrap().unwrap()).collect()
}

/// Whether two torques are the same but for the order in which they were summed up.
fn close(a: &DVector<f64>, b: &DVector<f64>) -> bool {
    (a - b).amax() < 1e-12 * (1.0 + a.amax())
}

fn assert_predicted(answer: &PathPrediction, predicted: &[palpate::Prediction]) {
    assert_eq!(answer.points.len(), predicted.len());
    for (point, predicted) in answer.points.iter().zip(predicted) {
        assert!(close(&point.torque, &predicted.predicted));
        assert_eq!((point.contacts, point.known), (predicted.contacts, predicted.known));
    }
}

/// Mean difference of torques from those of another answer, against their mean size.
fn difference(answer: &PathPrediction, from: &PathPrediction) -> f64 {
    let sum = |of: &dyn Fn(usize) -> f64| (0..from.points.len()).map(of).sum::<f64>();
    let gap = |point: usize| (&answer.points[point].torque - &from.points[point].torque).norm();
    sum(&gap) / sum(&|point| from.points[point].torque.norm())
}

#[test]
fn with_a_stop_at_every_point_a_path_prediction_equals_the_predictors() {
    let (mapper, path) = (learnt(), push(0.01, 90));
    let answer = mapper.path_predictor().ask(&path, &EVERY_POINT).unwrap();
    assert!(!answer.goes_on && answer.stops == 90);
    assert!(answer.points.iter().any(|point| point.known > 100 && point.known < point.contacts));
    assert_predicted(&answer, &predictions(&mapper, &path));
}

#[test]
fn a_path_from_where_the_arm_is_goes_on_from_what_it_touches() {
    let (mut mapper, path) = (learnt(), push(0.01, 90));
    mapper.begin_touch();
    learn(&mut mapper, &path[..40]);
    let answer = mapper.path_predictor().ask(&path[40..], &EVERY_POINT).unwrap();
    assert!(answer.goes_on && answer.points[0].contacts > 0);
    assert_predicted(&answer, &predictions(&mapper, &path)[40..]);
    let report = mapper.step(&sample(&path[40])).unwrap();
    assert!(close(&report.predicted.unwrap(), &answer.points[0].torque));
    // From elsewhere, or once the touch is over, a path starts free of contact.
    assert!(!mapper.path_predictor().ask(&path, &EVERY_POINT).unwrap().goes_on);
    mapper.end_touch().unwrap();
    let answer = mapper.path_predictor().ask(&path[40..], &EVERY_POINT).unwrap();
    assert!(!answer.goes_on && answer.points[0].contacts == 0);
}

#[test]
fn predicting_a_path_changes_neither_the_mapper_nor_the_next_prediction() {
    let (mut asked, mut left_alone, path) = (learnt(), learnt(), push(0.0, 90));
    let predictor = asked.path_predictor();
    for mapper in [&mut asked, &mut left_alone] {
        mapper.begin_touch();
    }
    for q in &path {
        let other = push(0.05, 20);
        let answer = asked.path_predictor().ask(&other, &PathConfig::default()).unwrap();
        assert_eq!(answer.points.len(), 20);
        let [a, b] = [&mut asked, &mut left_alone].map(|mapper| mapper.step(&sample(q)).unwrap());
        assert_eq!((a.contacts, a.predicted), (b.contacts, b.predicted));
    }
    assert_eq!(asked.field(), left_alone.field());
    // What was learnt meanwhile is not in the predictor, and the order of questions is no matter.
    let same = predictor.clone();
    let first = predictor.ask(&path, &EVERY_POINT).unwrap();
    let second = predictor.ask(&push(0.03, 50), &EVERY_POINT).unwrap();
    assert_eq!(same.ask(&push(0.03, 50), &EVERY_POINT).unwrap(), second);
    assert_eq!(same.ask(&path, &EVERY_POINT).unwrap(), first);
    assert_predicted(&first, &predictions(&learnt(), &path));
}

/// Learns a reading of 1 N at 1 cm of the point where x, y and z are 0.
fn feel_one_newton(mapper: &mut Mapper) {
    mapper.begin_touch();
    for x in [-0.2, 0.01 - 0.084] {
        let tau = if x > -0.1 { vec![-1.0, 0.0, 0.0] } else { vec![0.0; 3] };
        mapper.step(&Sample::new(None, vec![x, 0.0, 0.0], tau)).unwrap();
    }
    mapper.end_touch().unwrap();
}

/// The torque and its deviation along x when the ball of 6 cm, inflated by 2.4 cm, pushes a single
/// point from its centre line, `depth_m` deep.
fn one_spring(mapper: &Mapper, depth_m: f64) -> [f64; 2] {
    let path = [[-0.2, 0.0, 0.0], [depth_m - 0.084, 0.0, 0.0]];
    let answer = mapper.path_predictor().ask(&path, &EVERY_POINT).unwrap();
    assert_eq!(answer.points[1].contacts, 1);
    assert!(answer.points[1].torque_std.rows(1, 2).amax() < 0.1 * answer.points[1].torque_std[0]);
    [answer.points[1].torque[0], answer.points[1].torque_std[0]]
}

#[test]
fn the_deviation_of_one_spring_is_its_displacement_times_that_of_its_stiffness() {
    let point = || Lattice::new([0.0; 3], 0.01, [1; 3]).unwrap();
    for depth_m in [0.005, 0.01, 0.02] {
        let [torque, std] = one_spring(&mapper(point(), 50.0), depth_m);
        assert!(torque == 0.0 && (std / (50.0 * depth_m) - 1.0).abs() < 0.05, "{std} N");
        let [_, twice] = one_spring(&mapper(point(), 100.0), depth_m);
        assert!((twice / std - 2.0).abs() < 1e-12);
    }
    // A reading of 1 N at 1 cm, ± 0.1 N, is 100 N/m ± 10 N/m beside which the prior hardly counts.
    let mut mapper = mapper(point(), 1e4);
    feel_one_newton(&mut mapper);
    let [torque, std] = one_spring(&mapper, 0.02);
    assert!((torque + 2.0).abs() < 0.1 && (std - 0.2).abs() < 0.01, "{torque} ± {std} N");
}

#[test]
fn a_coarse_resolution_still_stops_at_both_ends_and_where_the_arm_turns_round() {
    let predictor = learnt().path_predictor();
    let path = push(0.01, 91);
    let config = PathConfig::new(100.0, 1.0);
    let answer = predictor.ask(&path, &config).unwrap();
    assert_eq!((answer.stops, answer.points.len()), (3, 91));
    let [first, tip, last] = [0, 45, 90].map(|point| answer.points[point].torque.norm());
    assert!(answer.points.iter().all(|point| point.torque.norm() <= tip + 1e-12));
    assert!(tip > 1.0 && first == 0.0 && last < tip);
    let middle = (&answer.points[0].torque + &answer.points[45].torque) / 2.0;
    let way = |point: usize| (path[point][0] - path[0][0]) / (path[45][0] - path[0][0]);
    let halfway = answer.points[22].torque.lerp(&answer.points[23].torque, 0.5);
    assert!((way(22) + way(23) - 1.0).abs() < 1e-9 && (halfway - middle).norm() < 1e-9);
}

#[test]
fn the_arm_stops_where_it_turns_round_soon_after_a_stop() {
    let path = [0.0, 2.5, 5.0, 7.5, 10.0, 10.5, 10.0, 8.0].map(|mm| vec![mm / 1e3, 0.0, 0.0]);
    let answer = learnt().path_predictor().ask(&path, &PathConfig::default()).unwrap();
    assert_eq!(answer.stops, 4, "at 0, at a cell, where it turns round and at the end");
}

#[test]
fn a_coarse_resolution_is_close_to_a_stop_at_every_point() {
    let (mapper, path) = (learnt(), push(0.01, 200));
    let predictor = mapper.path_predictor();
    let fine = predictor.ask(&path, &EVERY_POINT).unwrap();
    let coarse = predictor.ask(&path, &PathConfig::default()).unwrap();
    assert!(coarse.stops * 4 < fine.stops, "{} stops", coarse.stops);
    assert!(difference(&coarse, &fine) < 0.05, "{}", difference(&coarse, &fine));
}

#[test]
fn a_coarse_predictor_is_close_to_the_exact_one_and_reproducible() {
    let (mut mapper, path) = (learnt(), push(0.01, 90));
    mapper.begin_touch();
    learn(&mut mapper, &path[..40]);
    for rest in [&path[..], &path[40..]] {
        let whole = mapper.path_predictor().ask(rest, &EVERY_POINT).unwrap();
        let ask = |predictor: PathPredictor| predictor.ask(rest, &EVERY_POINT).unwrap();
        assert_eq!(ask(mapper.coarse_path_predictor(1.0)), whole);
        let thinned = ask(mapper.coarse_path_predictor(CLUSTER_WEIGHT));
        assert_eq!(ask(mapper.coarse_path_predictor(CLUSTER_WEIGHT)), thinned);
        assert_eq!((thinned.goes_on, thinned.stops), (whole.goes_on, whole.stops));
        assert!(thinned != whole && difference(&thinned, &whole) < 0.05);
        let most = whole.points.iter().map(|point| point.contacts as f64).fold(0.0, f64::max);
        let stds = |point: &PathPoint| [&point.torque_std, &point.torque_rss].map(|own| own.norm());
        let widest =
            |which: usize| whole.points.iter().map(|own| stds(own)[which]).fold(0.0, f64::max);
        let widest = [0, 1].map(widest);
        for (thinned, whole) in thinned.points.iter().zip(&whole.points) {
            let [few, all] = [thinned, whole].map(|point| point.contacts as f64);
            assert!((few - all).abs() < 0.2 * all + 0.05 * most, "{few} of {all} contacts");
            for ((few, all), widest) in stds(thinned).into_iter().zip(stds(whole)).zip(widest) {
                assert!((few - all).abs() < 0.3 * all + 0.05 * widest, "± {few} for {all}");
            }
        }
    }
}

#[test]
fn an_answer_is_the_same_however_many_threads_take_part() {
    let (mut mapper, path) = (learnt(), push(0.01, 90));
    mapper.begin_touch();
    learn(&mut mapper, &path[..40]);
    for cluster_weight in [1.0, CLUSTER_WEIGHT] {
        for rest in [&path[..], &path[40..]] {
            let predictor = mapper.coarse_path_predictor(cluster_weight);
            let ask = || predictor.ask(rest, &EVERY_POINT).unwrap();
            let answer = ask();
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(ask), answer);
            }
        }
    }
}

#[test]
fn a_predictor_of_the_field_alone_equals_that_of_the_mapper() {
    let (mapper, path) = (learnt(), push(0.01, 90));
    for cluster_weight in [1.0, CLUSTER_WEIGHT] {
        let of_field = PathPredictor::of_field(&arm(), &mapper.field(), 5.0, cluster_weight);
        let of_mapper = mapper.coarse_path_predictor(cluster_weight).ask(&path, &EVERY_POINT);
        assert_eq!(of_field.unwrap().ask(&path, &EVERY_POINT).unwrap(), of_mapper.unwrap());
    }
}

#[test]
fn bands_are_those_of_the_arm_that_learnt_the_field() {
    let mut field = learnt().field();
    let bands = |joints: usize| Calibration {
        floor_n_m: vec![0.1; joints],
        by_torque: 0.2,
        by_std: 0.1,
        relative_std: 10.0,
        untouched_std_n_per_m: 5.0,
        touches: 9,
        by_unknown_n_m: vec![],
        exponent: 0.5,
        of_other_objects: false,
        quantiles: vec![BandQuantiles { level: 0.9, frame: 1.0, peak: 1.0 }],
        misfits: Vec::new(),
    };
    for (joints, has_bands) in [(3, true), (7, false)] {
        field.calibration = Some(bands(joints));
        let predictor = PathPredictor::of_field(&arm(), &field, 5.0, 1.0).unwrap();
        let answer = predictor.ask(&push(0.01, 90), &EVERY_POINT).unwrap();
        let widths = answer.half_width(0.9);
        assert_eq!(widths.is_some(), has_bands);
        // The bands are as wide as those of the predictor of frames.
        let mut frames = Predictor::new(arm(), &field, learnt().config().touch.clone()).unwrap();
        frames.begin_touch();
        for (q, width) in push(0.01, 90).iter().zip(widths.unwrap_or_default()) {
            let said = frames.step(&sample(q)).unwrap().unwrap();
            let spread = said.spread.unwrap();
            let (torque, contacts) = (said.predicted.as_slice(), [said.contacts, said.known]);
            let wanted = bands(joints).half_width(0.9, torque, spread.as_slice(), contacts);
            assert!(
                close(&width, &wanted.unwrap()) && (said.contacts == 0) == (spread.amax() == 0.0)
            );
        }
    }
}

#[test]
fn many_paths_are_answered_as_each_is() {
    let predictor = learnt().path_predictor();
    let mut paths: Vec<_> = [-0.02, 0.0, 0.03].map(|y| push(y, 40)).into();
    let all = predictor.ask_all(&paths, &EVERY_POINT, || false).unwrap().unwrap();
    for (path, answer) in paths.iter().zip(&all) {
        assert_eq!(*answer, predictor.ask(path, &EVERY_POINT).unwrap());
    }
    assert!(predictor.ask_all(&paths, &EVERY_POINT, || true).unwrap().is_none());
    paths[1][3].pop();
    let (number, error) = predictor.ask_all(&paths, &EVERY_POINT, || false).unwrap_err();
    assert!(number == 1 && matches!(error, PathError::Point { point: 3, .. }), "{number}: {error}");
}

#[test]
fn cells_inside_a_posture_are_pushed_out_to_the_nearest_surface() {
    let lattice = Lattice::new([0.0; 3], 0.01, [1; 3]).unwrap();
    let mut mapper = mapper(lattice, 1e4);
    feel_one_newton(&mut mapper);
    let predictor = mapper.path_predictor();
    let reach_m = 0.06 + mapper.config().contact.contact_distance_m;
    let mut inside = EVERY_POINT;
    inside.inside = true;
    for [x, y] in [[-0.05, 0.0], [-0.04, 0.01], [0.02, -0.03]] {
        let posture = vec![vec![x, y, 0.0]];
        let held = predictor.ask(&posture, &inside).unwrap();
        let gap_m = f64::hypot(x, y);
        let force = -mapper.field().stiffness_n_per_m[0] * (reach_m - gap_m);
        let expected = DVector::from_vec(vec![-x / gap_m * force, -y / gap_m * force, 0.0]);
        let torque = &held.points[0].torque;
        assert!(
            expected.norm() > 1.0 && (torque - &expected).norm() < 0.04 * expected.norm(),
            "{torque} for {expected}"
        );
        // Known to be empty, as a touch could not begin there otherwise.
        let begun = predictor.ask(&posture, &EVERY_POINT).unwrap();
        assert!(begun.points[0].contacts == 0 && held.points[0].contacts == 1);
        // Straight in from outside, it is held there as well.
        let way = |part: f64| {
            vec![
                x / gap_m * 0.09 * (1.0 - part) + x * part,
                y / gap_m * 0.09 * (1.0 - part) + y * part,
                0.0,
            ]
        };
        let path: Vec<_> = (0..=20).map(|step| way(f64::from(step) / 20.0)).collect();
        let reached = predictor.ask(&path, &EVERY_POINT).unwrap();
        let gap = (&reached.points[20].torque - torque).norm();
        assert!(gap < 0.04 * expected.norm(), "{gap} of {expected}");
    }
}

#[test]
fn a_path_that_cannot_be_followed_is_refused_with_the_place() {
    let predictor = learnt().path_predictor();
    let refused = |path: &[Vec<f64>]| predictor.ask(path, &EVERY_POINT).unwrap_err();
    let path = |x: f64| vec![vec![-0.1, 0.0, 0.0], vec![-0.09, 0.0, 0.0], vec![x, 0.0, 0.0]];
    assert!(matches!(refused(&[]), PathError::Empty));
    let error = refused(&[vec![0.0; 3], vec![0.0; 2]]).to_string();
    assert_eq!(error, "point 1 of the path: got 2 joint angles, the robot has 3 moving joints");
    for x in [f64::NAN, f64::INFINITY] {
        assert!(matches!(refused(&path(x)), PathError::Point { point: 2, .. }));
    }
    let error = refused(&path(1e300));
    assert!(matches!(&error, PathError::Jump { point: 2, joint, .. } if joint == "slide0"));
    assert!(matches!(refused(&path(13.0)), PathError::Jump { point: 2, .. }));
    let far: Vec<Vec<f64>> = (0..10).map(|x| vec![10.0 * f64::from(x), 0.0, 0.0]).collect();
    assert!(matches!(refused(&far), PathError::TooLong { .. }));
    let error = refused(&vec![vec![0.0; 3]; MAX_POINTS + 1]);
    assert!(matches!(error, PathError::TooManyPoints { found: 100_001 }));
    assert!(matches!(
        refused(&vec![vec![0.0; 3]; 10_001]),
        PathError::TooLong { point: 10_000, .. }
    ));
    for found in [f64::NAN, -1.0, 1e9] {
        let config = PathConfig::new(found, 1.0);
        let error = predictor.ask(&path(-0.08), &config).unwrap_err();
        assert!(
            matches!(error, PathError::Setting(ref setting) if setting.setting == "resolution_cells")
        );
    }
    // After all this the predictor is as before, and a single point is a path, however far away.
    let alone = predictor.ask(&[[1e300, 0.0, 0.0]], &EVERY_POINT).unwrap();
    assert_eq!((alone.points[0].contacts, alone.stops), (0, 1));
    assert!(predictor.ask(&push(0.01, 90), &EVERY_POINT).unwrap().points[45].contacts > 0);
}
