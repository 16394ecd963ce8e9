//! The predicted gain of a motion is that of a Kalman filter.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::NEVER;
use nalgebra::DMatrix;
use palpate::unstable::CellState;
use palpate::{EstimatorKind, Field, Gravity, MapperConfig, Sample, Tare};
use palpate_learn::LearnError;
use palpate_learn::next_touch::{Criterion, NextTouch, Task};
use palpate_learn::tracked::TrackedTouches;

const STD_N_PER_M: f64 = 1.5;

/// Some frames of bundled touches as planned motions; a number that occurs twice gives the same motion twice.
fn motions(numbers: &[usize]) -> (TrackedTouches, Field) {
    let mut touches = common::touches(numbers);
    for sample in touches.iter_mut().flat_map(|touch| &mut touch.samples) {
        *sample = Sample::new(None, sample.q.clone(), vec![0.0; 7]);
    }
    let mut config = MapperConfig::of(EstimatorKind::Map);
    (config.touch.gravity, config.touch.tare) = (Gravity::Removed, Tare::None);
    let tracked =
        TrackedTouches::new(&common::arm(), &config, &touches, NEVER).unwrap().thinned(80);
    let field = Field::new(tracked.lattice.clone(), config.contact, config.touch, 0.0);
    (tracked, field)
}

/// H of all frames of a motion in contact: a row for each joint in each frame, a column for each cell.
fn levers(tracked: &TrackedTouches, motion: usize) -> DMatrix<f64> {
    let mut cells: Vec<CellState> =
        tracked.points_m.iter().map(|point| CellState::new(*point, 0.0)).collect();
    let mut rows = Vec::new();
    for frame in tracked.touches[motion].frames.iter() {
        if frame.observation.n_contacts() == 0 {
            continue;
        }
        for joint in 0..tracked.n_joints {
            let mut row = vec![0.0; cells.len()];
            let mut unit = vec![0.0; tracked.n_joints];
            unit[joint] = 1.0;
            frame
                .observation
                .transpose_times(&mut cells, &unit, |_, cell, lever| row[cell] = lever);
            rows.extend(row);
        }
    }
    DMatrix::from_row_slice(rows.len() / cells.len(), cells.len(), &rows)
}

#[test]
fn the_variance_that_is_left_is_that_of_a_kalman_filter() {
    let (tracked, field) = motions(&[2, 6, 9]);
    let judge = NextTouch::new(&tracked, &field, (STD_N_PER_M, 0.2));
    let task = Task::Motions(vec![2]);
    let found = judge.rank((&[0, 1], 2), &task, Criterion::Variance, NEVER).unwrap();
    let h: Vec<DMatrix<f64>> = (0..3).map(|motion| levers(&tracked, motion)).collect();
    let p = STD_N_PER_M * STD_N_PER_M;
    // tr(H P Hᵀ) of the task after the motions, computed with all motions at once.
    let left = |made: &[usize]| {
        let before = (&h[2] * h[2].transpose()).trace() * p;
        let rows: usize = made.iter().map(|motion| h[*motion].nrows()).sum();
        let mut all = DMatrix::zeros(rows, h[2].ncols());
        let mut at = 0;
        for motion in made {
            all.rows_mut(at, h[*motion].nrows()).copy_from(&h[*motion]);
            at += h[*motion].nrows();
        }
        let inner = &all * all.transpose() * p + DMatrix::identity(rows, rows) * 0.04;
        let cross = &h[2] * all.transpose() * p;
        let gain = (&cross * inner.try_inverse().unwrap() * cross.transpose()).trace();
        (before - gain) / before
    };
    let best = if left(&[0]) < left(&[1]) { 0 } else { 1 };
    assert_eq!(found[0].motion, best);
    assert!((found[0].variance_left - left(&[best])).abs() < 1e-6, "{found:?}");
    assert!((found[1].variance_left - left(&[0, 1])).abs() < 1e-6, "{found:?}");
    assert!(found[0].variance_left < 0.999 && found[1].variance_left < found[0].variance_left);
    assert!(found.iter().all(|own| own.unknown == 1.0 && own.torque_n_m == 0.0));
}

#[test]
fn a_motion_that_was_made_teaches_little_more_and_the_task_itself_most() {
    let (tracked, field) = motions(&[2, 2, 9]);
    let judge = NextTouch::new(&tracked, &field, (STD_N_PER_M, 0.2));
    for criterion in [Criterion::Variance, Criterion::Information] {
        let own = judge.rank((&[0, 1, 2], 3), &Task::Motions(vec![0]), criterion, NEVER).unwrap();
        let of = |motion: usize| own.iter().find(|own| own.motion == motion).unwrap();
        assert!(of(1).information_nats < 0.5 * of(0).information_nats, "{own:?}");
    }
    let task =
        judge.rank((&[0, 2], 2), &Task::Motions(vec![2]), Criterion::Variance, NEVER).unwrap();
    assert_eq!(task[0].motion, 2);
    assert!(task[0].variance_left < 0.5, "{task:?}");
}

#[test]
fn a_box_is_learned_by_the_motion_that_enters_it() {
    let (tracked, field) = motions(&[2, 6]);
    let judge = NextTouch::new(&tracked, &field, (STD_N_PER_M, 0.2));
    let met: Vec<Vec<bool>> = [0, 1].map(|motion| tracked.touched_rows(&[motion])).to_vec();
    let only = |motion: usize| {
        let is = |row: &usize| met[motion][*row] && !met[1 - motion][*row];
        (0..tracked.points_m.len()).find(is).map(|row| tracked.points_m[row]).unwrap()
    };
    for motion in [0, 1] {
        let [x, y, z] = only(motion);
        let corners = [[x - 0.005, y - 0.005, z - 0.005], [x + 0.005, y + 0.005, z + 0.005]];
        let found = judge.rank((&[0, 1], 1), &Task::Box(corners), Criterion::Variance, NEVER);
        assert_eq!(found.unwrap()[0].motion, motion);
    }
    let far = Task::Box([[5.0; 3], [6.0; 3]]);
    let error = judge.rank((&[0, 1], 1), &far, Criterion::Variance, NEVER).unwrap_err();
    assert!(matches!(error, LearnError::NoTask), "{error}");
}
