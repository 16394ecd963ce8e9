//! Laws of `map`: the optimum, what repeating, forgetting and bounded memory do.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{
    CellRows, CellState, Estimator, MapEstimator, Observation, RememberedFrame,
};
use palpate::{EstimatorConfig, EstimatorError, EstimatorKind};
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{cells_with, centimetre_lattice, config, contacts, crooked_arm, random_frame, source};

/// Frames of a field in which every third cell is empty, with an error on every torque.
fn frames(seed: u64, count: usize) -> (CellRows, Vec<Observation>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let robot = crooked_arm();
    let mut rows = CellRows::new(centimetre_lattice());
    let stiffness: Vec<f64> =
        (0..30).map(|i| if i % 3 == 0 { 0.0 } else { 20.0 + 5.0 * f64::from(i) }).collect();
    let frames =
        (0..count).map(|_| random_frame(&mut rng, &robot, &mut rows, &stiffness, 0.05)).collect();
    (rows, frames)
}

fn learn(config: &EstimatorConfig, rows: &CellRows, frames: &[Observation]) -> MapEstimator {
    let mut map = MapEstimator::new(config, 0.01, 4).unwrap();
    teach(&mut map, rows, frames);
    map
}

fn teach(map: &mut MapEstimator, rows: &CellRows, frames: &[Observation]) {
    for (number, frame) in frames.iter().enumerate() {
        map.correct(rows.points_m(), frame.clone(), source(number as u32)).unwrap();
    }
}

fn stiffness(map: &MapEstimator, rows: &CellRows) -> DVector<f64> {
    DVector::from_fn(rows.len(), |row, _| map.stiffness(row))
}

/// min ‖A x − b‖ over x ≥ 0 by the active-set method of Lawson and Hanson (1974).
fn non_negative_least_squares(a: &DMatrix<f64>, b: &DVector<f64>) -> DVector<f64> {
    let n = a.ncols();
    let mut x = DVector::zeros(n);
    let mut passive = vec![false; n];
    let solve = |passive: &[bool]| {
        let columns: Vec<usize> = (0..n).filter(|&i| passive[i]).collect();
        let part = a.select_columns(&columns);
        let solution = part.svd(true, true).solve(b, 1e-14).unwrap();
        let mut full = DVector::zeros(n);
        for (value, &column) in solution.iter().zip(&columns) {
            full[column] = *value;
        }
        full
    };
    loop {
        let slope = a.transpose() * (b - a * &x);
        let best = (0..n).filter(|&i| !passive[i]).max_by(|&i, &j| slope[i].total_cmp(&slope[j]));
        let Some(enter) = best.filter(|&i| slope[i] > 1e-10) else { return x };
        passive[enter] = true;
        loop {
            let trial = solve(&passive);
            let step = (0..n)
                .filter(|&i| passive[i] && trial[i] <= 0.0)
                .map(|i| x[i] / (x[i] - trial[i]))
                .fold(1.0, f64::min);
            x += (&trial - &x) * step;
            if step == 1.0 {
                break;
            }
            for i in 0..n {
                passive[i] &= x[i] > 1e-12;
            }
        }
    }
}

#[test]
fn one_joint_one_contact_recovers_the_spring() {
    let (rows, frame) = scene::spring_frame();
    let mut map = MapEstimator::new(&config(EstimatorKind::Map, 0.0, 1e4, 1e-3), 0.01, 1).unwrap();
    map.correct(rows.points_m(), frame, source(0)).unwrap();
    assert!((map.stiffness(0) - 150.0).abs() < 1e-4, "{}", map.stiffness(0));
    assert_eq!((map.count(0), map.count(1)), (1, 0));
    assert!(map.std(0) < 0.1 && map.std(1) == 1e4);
}

#[test]
fn many_replays_converge_to_the_optimum_of_an_independent_solver() {
    let (rows, frames) = frames(3, 25);
    let mut expected = vec![5.0; rows.len()];
    ends_at_the_optimum(&rows, &frames, &expected);
    // The same with a prior by cell, of every cell but the last few.
    for (row, mean) in expected[..rows.len() - 4].iter_mut().enumerate() {
        *mean = (7 * row % 31) as f64;
    }
    ends_at_the_optimum(&rows, &frames, &expected);
}

/// The prior means by row are `expected`, N/m, and 5 N/m in the settings.
#[track_caller]
fn ends_at_the_optimum(rows: &CellRows, frames: &[Observation], expected: &[f64]) {
    let (std, torque_std) = (40.0, 0.1);
    let mut map =
        MapEstimator::new(&config(EstimatorKind::Map, 5.0, std, torque_std), 0.01, 4).unwrap();
    map.set_prior_means(rows.points_m(), &expected[..rows.len() - 4]);
    teach(&mut map, rows, frames);
    map.replay(2_000_000);
    let residual = map.kkt_residual();
    assert!(residual < 1e-8, "{residual} N·m");

    let n = rows.len();
    let mut a = DMatrix::zeros(frames.len() * 4 + n, n);
    let mut b = DVector::zeros(a.nrows());
    for (t, frame) in frames.iter().enumerate() {
        let levers = frame.levers(&cells_with(rows, |_| 0.0)) / torque_std;
        for (contact, row) in frame.rows().enumerate() {
            a.view_mut((4 * t, row), (4, 1)).copy_from(&levers.column(contact));
        }
        b.rows_mut(4 * t, 4).copy_from(&(frame.tau() / torque_std));
    }
    a.view_mut((frames.len() * 4, 0), (n, n)).fill_diagonal(1.0 / std);
    let prior = DVector::from_column_slice(expected) / std;
    b.rows_mut(frames.len() * 4, n).copy_from(&prior);
    let best = non_negative_least_squares(&a, &b);

    assert!(best.iter().any(|&k| k == 0.0) && best.iter().any(|&k| k > 20.0));
    assert!((stiffness(&map, rows) - &best).amax() < 1e-6);
}

#[test]
fn the_stiffness_scale_changes_what_is_reported_and_predicted_and_nothing_that_is_learnt() {
    let (rows, frames) = frames(3, 12);
    let given = config(EstimatorKind::Map, 0.1, 1.0, 0.1);
    let mut half = given.clone();
    half.stiffness_scale = 0.5;
    let (whole, halved) = (learn(&given, &rows, &frames), learn(&half, &rows, &frames));
    assert_eq!(stiffness(&whole, &rows) * 0.5, stiffness(&halved, &rows));
    assert_eq!(whole.std(0) * 0.5, halved.std(0));
    assert_eq!(whole.state(rows.len()), halved.state(rows.len()));
    let predict = |mut map: MapEstimator| {
        map.correct(rows.points_m(), frames[0].clone(), source(99)).unwrap()
    };
    assert_eq!(predict(whole) * 0.5, predict(halved));
    half.stiffness_scale = 1.5;
    assert!(half.torque_variance(1).unwrap_err().to_string().contains("stiffness_scale"));
}

#[test]
fn forgetting_a_frame_equals_never_learning_from_it() {
    let (rows, frames) = frames(4, 12);
    let config = config(EstimatorKind::Map, 5.0, 40.0, 0.1);
    let mut forgetful = learn(&config, &rows, &frames);
    assert!(forgetful.forget(source(11)));
    assert!(!forgetful.forget(source(11)));
    let mut innocent = learn(&config, &rows, &frames[..11]);
    // Before any further visit the two agree exactly in z; no replay ran in either.
    assert!((stiffness(&forgetful, &rows) - stiffness(&innocent, &rows)).amax() < 1e-9);

    forgetful.forget(source(3));
    let mut without = frames[..11].to_vec();
    without.remove(3);
    let mut other = learn(&config, &rows, &without);
    for map in [&mut forgetful, &mut other, &mut innocent] {
        map.replay(100_000);
    }
    assert!((stiffness(&forgetful, &rows) - stiffness(&other, &rows)).amax() < 1e-7);
    assert!((stiffness(&forgetful, &rows) - stiffness(&innocent, &rows)).amax() > 1e-3);
}

#[test]
fn rounding_does_not_accumulate_over_a_million_replays() {
    let (rows, frames) = frames(5, 6);
    let mut map = learn(&config(EstimatorKind::Map, 0.0, 40.0, 0.1), &rows, &frames);
    map.replay(1_000_000);
    // z as it stands against z computed afresh from the multipliers.
    let state = map.state(rows.len());
    let mut afresh = cells_with(&rows, |_| 0.0);
    for RememberedFrame { id, alpha, .. } in &state.remembered {
        frames[id.sample as usize].transpose_times(&mut afresh, alpha, |cell, _, value| {
            *cell.unknown_mut() += 40.0 * 40.0 * value;
        });
    }
    let afresh = DVector::from_iterator(rows.len(), afresh.iter().map(CellState::unknown));
    let drift = (DVector::from_column_slice(&state.mean) - afresh).amax();
    assert!(drift < 1e-8, "{drift} N/m");
}

#[test]
fn frames_that_leave_a_full_memory_are_condensed() {
    let (rows, frames) = frames(6, 12);
    let mut settings = config(EstimatorKind::Map, 5.0, 40.0, 0.1);
    settings.memory.frames = 4;
    let map = learn(&settings, &rows, &frames);
    let unbounded = learn(&config(EstimatorKind::Map, 5.0, 40.0, 0.1), &rows, &frames);
    assert_eq!(map.frame_ids().len(), 4);
    // Without replays both said the same things in the same order: nothing was taken back.
    assert!((stiffness(&map, &rows) - stiffness(&unbounded, &rows)).amax() < 1e-9);
}

#[test]
fn a_bad_frame_is_refused_and_changes_no_estimate() {
    let (rows, frames) = frames(7, 5);
    let mut map = learn(&config(EstimatorKind::Map, 5.0, 40.0, 0.1), &rows, &frames);
    let before = map.state(rows.len());
    let huge = contacts(rows.lattice(), 4, &[([1, 40, 60], [f32::MAX, 0.0, f32::MAX])]);
    let robot = crooked_arm();
    let poses = robot.forward(&[0.1; 4]).unwrap();
    let mut rows = rows.clone();
    let frame = Observation::new(&robot, &poses, &huge, &mut rows, &DVector::zeros(4));
    let error = map.correct(rows.points_m(), frame, source(9)).unwrap_err();
    assert_eq!(error, EstimatorError::Degenerate);
    assert_eq!(map.state(rows.len()), before);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn an_update_lowers_variances_and_keeps_them_positive(seed in 0_u64..1000) {
        let (rows, frames) = frames(seed, 8);
        let mut map = MapEstimator::new(&config(EstimatorKind::Map, 0.0, 40.0, 0.1), 0.01, 4).unwrap();
        let mut before = vec![40.0; rows.len()];
        for (number, frame) in frames.iter().enumerate() {
            map.correct(rows.points_m(), frame.clone(), source(number as u32)).unwrap();
            for (row, before) in before.iter_mut().enumerate() {
                let now = map.std(row);
                prop_assert!(now > 0.0 && now <= *before, "row {row}: {before} to {now}");
                *before = now;
            }
        }
    }
}
