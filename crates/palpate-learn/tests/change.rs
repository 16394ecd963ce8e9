//! The change of a field is found from the torques of the changed field.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::collections::HashMap;

use common::NEVER;
use palpate::{BandQuantiles, Calibration, Field};
use palpate_learn::LearnError;
use palpate_learn::calibrate::PredictedFrame;
use palpate_learn::change::moved::{ObjectMotion, moved};
use palpate_learn::change::{Change, compare};
use palpate_learn::tracked::{TrackedFrame, TrackedTouch, TrackedTouches};

fn tracked() -> TrackedTouches {
    common::tracked(&[2, 8], 4)
}

/// Stiffness of a place, N/m: three lumps around the middle of the touched cells.
fn lumps([x, y, z]: [f64; 3], middle: [f64; 3], apart_m: f64) -> f64 {
    let lump = |[dx, dy, dz]: [f64; 3], k: f64| {
        let square = (x - middle[0] - apart_m * dx).powi(2)
            + (y - middle[1] - apart_m * dy).powi(2)
            + (z - middle[2] - apart_m * dz).powi(2);
        k * (-square / (2.0 * 0.04_f64.powi(2))).exp()
    };
    lump([1.0, 0.0, 0.0], 3.0) + lump([-1.0, 0.5, 0.3], 5.0) + lump([0.0, -1.0, 0.5], 4.0)
}

fn middle(tracked: &TrackedTouches) -> [f64; 3] {
    let n = tracked.points_m.len() as f64;
    [0, 1, 2].map(|axis| tracked.points_m.iter().map(|point| point[axis]).sum::<f64>() / n)
}

/// A field of all touched cells with three lumps, and small misfits of its held-out touches.
fn field(tracked: &TrackedTouches) -> Field {
    let middle = middle(tracked);
    let mut field = common::field(tracked, |row| lumps(tracked.points_m[row], middle, 0.08));
    field.std_n_per_m.fill(0.1);
    field.calibration = Some(Calibration {
        floor_n_m: vec![0.05; tracked.n_joints],
        by_torque: 0.2,
        by_std: 0.2,
        relative_std: 10.0,
        untouched_std_n_per_m: 1.0,
        touches: 5,
        by_unknown_n_m: vec![],
        exponent: 0.5,
        of_other_objects: false,
        quantiles: vec![BandQuantiles { level: 0.8, frame: 1.0, peak: 1.0 }],
        misfits: [0.2, 0.25, 0.22, 0.27, 0.18].map(|own| [own, 0.5 * own]).to_vec(),
    });
    field
}

/// Gives every frame the torque of a field, times a factor.
fn with_torques_of(tracked: TrackedTouches, field: &Field, factor: f64) -> TrackedTouches {
    let known: HashMap<_, _> = field.cells.iter().zip(&field.stiffness_n_per_m).collect();
    let cells = tracked.cells.clone();
    let k = |row: usize| known.get(&cells[row]).map_or(0.0, |k| factor * **k);
    common::with_torques_of(tracked, k)
}

#[test]
fn with_an_elastic_body_its_predictions_are_compared_instead_of_the_springs() {
    let (arm, tracked) = (common::arm(), tracked());
    let field = field(&tracked);
    let now = with_torques_of(tracked, &field, 2.5);
    let frame = |frame: &TrackedFrame| PredictedFrame {
        torque: frame.observation.tau().as_slice().to_vec(),
        spread: vec![0.0; 7],
        measured: frame.observation.tau().as_slice().to_vec(),
        contacts: [1, 1],
    };
    let in_contact = |touch: &TrackedTouch| touch.in_contact().map(frame).collect();
    let with_body = now.touches.iter().map(in_contact).collect();
    let found = compare((&arm, &now), (&field, Some(with_body)), None, NEVER).unwrap().1;
    assert_eq!(found.change, Change::Unchanged, "{found:?}");
    let springs = compare((&arm, &now), (&field, None), None, NEVER).unwrap().1;
    assert!(matches!(springs.change, Change::Harder { .. }), "{springs:?}");
}

#[test]
fn the_kind_of_change_is_found() {
    let (arm, tracked) = (common::arm(), tracked());
    let field = field(&tracked);
    let found = |torques_of: &Field, factor: f64| {
        let (each, together) = compare(
            (&arm, &with_torques_of(tracked.clone(), torques_of, factor)),
            (&field, None),
            None,
            NEVER,
        )
        .unwrap();
        assert_eq!(each.len(), 2);
        together
    };
    assert_eq!(found(&field, 1.05).change, Change::Unchanged);
    for wanted in [0.4, 2.5] {
        let found = found(&field, wanted);
        let (Change::Softer { factor } | Change::Harder { factor }) = found.change else {
            panic!("{wanted}: {found:?}")
        };
        assert!((factor - wanted).abs() < 1e-9 && found.place.is_some(), "{found:?}");
    }
    let mut other = field.clone();
    let middle = middle(&tracked);
    let far = |[x, y, z]: [f64; 3]| [2.0 * middle[0] - x, 2.0 * middle[1] - y, z - 0.1];
    other.stiffness_n_per_m =
        tracked.points_m.iter().map(|point| lumps(far(*point), middle, 0.14)).collect();
    assert_eq!(found(&other, 1.0).change, Change::Other);

    let motion = ObjectMotion {
        shift_m: [0.02, -0.025, 0.0],
        turn_rad: 0.1,
        about_m: [middle[0], middle[1]],
    };
    let comparison = found(&moved(&field, motion), 1.0);
    let Change::Moved(back) = comparison.change else { panic!("{comparison:?}") };
    let centre = back.about_m;
    // The two motions have different centres of turn, so they are compared by where they move one
    // point.
    let goes = |motion: ObjectMotion| {
        let (sin, cos) = motion.turn_rad.sin_cos();
        let [x, y] = [centre[0] - motion.about_m[0], centre[1] - motion.about_m[1]];
        [
            cos * x - sin * y + motion.about_m[0] + motion.shift_m[0],
            sin * x + cos * y + motion.about_m[1] + motion.shift_m[1],
        ]
    };
    let [wanted, found] = [goes(motion), goes(back)];
    assert!((0..2).all(|axis| (wanted[axis] - found[axis]).abs() < 0.005), "{back:?}");
    assert!((back.turn_rad - 0.1).abs() < 0.03 && back.shift_m[2].abs() < 0.005, "{back:?}");
}

#[test]
fn a_repeated_touch_is_compared_with_the_earlier_torques_however_bad_the_field_is() {
    let (arm, tracked) = (common::arm(), tracked());
    let field = field(&tracked);
    let mut truth = field.clone();
    let (middle, cells) = (middle(&tracked), &tracked.points_m);
    truth.stiffness_n_per_m =
        cells.iter().map(|[x, y, z]| lumps([2.0 * middle[0] - x, *y, *z], middle, 0.14)).collect();
    let learnt = with_torques_of(tracked.clone(), &truth, 1.0);
    let found = |factor: f64, learnt: Option<&TrackedTouches>| {
        let new = with_torques_of(tracked.clone(), &truth, factor);
        compare((&arm, &new), (&field, None), learnt, NEVER).unwrap().1
    };
    let alone = found(1.0, None);
    assert!(alone.contradiction > 1.0 && alone.repeats.is_empty(), "a bad field: {alone:?}");
    let same = found(1.0, Some(&learnt));
    assert_eq!(same.change, Change::Unchanged, "{same:?}");
    assert_eq!(same.repeats.len(), 2);
    assert!(same.error.repeated.unwrap() < 1e-9 && same.contradiction < 0.2, "{same:?}");
    assert_eq!(found(1.2, Some(&learnt)).change, Change::Unchanged);
    for wanted in [0.5, 1.6] {
        let found = found(wanted, Some(&learnt));
        assert!(found.contradiction > 1.0, "{found:?}");
        let off = (wanted - 1.0_f64).abs() / wanted;
        assert!((found.error.repeated.unwrap() - off).abs() < 1e-6, "{found:?}");
        // Judged by the earlier torques, although the field predicts others.
        let (Change::Softer { factor } | Change::Harder { factor }) = found.change else {
            panic!("{wanted}: {found:?}")
        };
        assert!((factor - wanted).abs() < 1e-9, "{found:?}");
    }
    // A change in one touch does not affect the other.
    let mut new = learnt.clone();
    new.touches[1] = with_torques_of(tracked.clone(), &truth, 0.3).touches.remove(1);
    let of_one = compare((&arm, &new), (&field, None), Some(&learnt), NEVER).unwrap().1;
    let Change::Softer { factor } = of_one.change else { panic!("{of_one:?}") };
    assert!((factor - 0.3).abs() < 1e-9 && of_one.error.scaled.unwrap() < 1e-6, "{of_one:?}");
    // The earlier and the new torques are so small that they may be noise.
    let faint = with_torques_of(tracked.clone(), &truth, 1e-3);
    let none = with_torques_of(tracked.clone(), &truth, 0.0);
    let noisy = compare((&arm, &none), (&field, None), Some(&faint), NEVER).unwrap().1;
    assert_eq!(noisy.change, Change::Unchanged, "{noisy:?}");
    // A touch on another path repeats nothing.
    let others = common::tracked(&[5], 4);
    assert_eq!(found(1.0, Some(&others)), alone);
}

#[test]
fn a_touch_that_repeats_another_finds_a_moved_object_where_the_field_predicts_no_torque() {
    let (arm, tracked) = (common::arm(), tracked());
    let truth = field(&tracked);
    let mut field = truth.clone();
    field.stiffness_n_per_m.fill(0.0);
    let learnt = with_torques_of(tracked.clone(), &truth, 1.0);
    let middle = middle(&tracked);
    for shift_m in [[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0], [0.03, 0.03, 0.0]] {
        let motion = ObjectMotion { shift_m, turn_rad: 0.0, about_m: [middle[0], middle[1]] };
        let new = with_torques_of(tracked.clone(), &moved(&truth, motion), 1.0);
        let found = compare((&arm, &new), (&field, None), Some(&learnt), NEVER).unwrap().1;
        assert!(matches!(found.change, Change::Moved(_)), "{shift_m:?}: {found:?}");
    }
}

#[test]
fn a_field_moves_exactly_by_whole_cells_and_stays_under_a_zero_motion() {
    let tracked = tracked();
    let field = field(&tracked);
    let still = ObjectMotion { shift_m: [0.0; 3], turn_rad: 0.0, about_m: [0.3, 0.1] };
    let sorted = |field: &Field| {
        let rows = field.cells.iter().zip(&field.stiffness_n_per_m).zip(&field.counts);
        let mut rows: Vec<_> = rows.map(|((cell, k), count)| (cell.0, *k, *count)).collect();
        rows.sort_unstable_by_key(|row| row.0);
        rows
    };
    let same = |a: &Field, b: &Field| {
        let (a, b) = (sorted(a), sorted(b));
        let near = |(a, b): (&(u32, f64, u32), &(u32, f64, u32))| {
            a.0 == b.0 && (a.1 - b.1).abs() < 1e-6 && a.2 == b.2
        };
        a.len() == b.len() && a.iter().zip(&b).all(near)
    };
    assert!(same(&moved(&field, still), &field));
    let h = field.lattice.spacing_m();
    let by = ObjectMotion { shift_m: [2.0 * h, -h, h], ..still };
    let mut shifted = field.clone();
    for cell in &mut shifted.cells {
        let [i, j, k] = field.lattice.place(*cell);
        *cell = field.lattice.cell([i + 2, j - 1, k + 1]);
    }
    assert!(same(&moved(&field, by), &shifted));
}

#[test]
fn a_field_without_bands_is_refused() {
    let tracked = tracked();
    let mut field = field(&tracked);
    field.calibration = None;
    assert!(matches!(
        compare((&common::arm(), &tracked), (&field, None), None, NEVER),
        Err(LearnError::NoBands)
    ));
}
