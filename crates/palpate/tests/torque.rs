//! Laws of the levers: the wrench form against the definition.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use nalgebra::{DMatrix, DVector, Vector3};
use palpate::Contacts;
use palpate::unstable::{CellRows, Observation, StiffnessRule, lever};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{cells_with, centimetre_lattice, contacts, crooked_arm, random_frame, uniform};

#[test]
fn levers_by_wrenches_are_those_of_the_definition() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (robot, lattice) = (crooked_arm(), centimetre_lattice());
    for link in 1..5_u16 {
        let q: Vec<f64> = (0..4).map(|_| uniform(&mut rng, -2.0, 2.0)).collect();
        let poses = robot.forward(&q).unwrap();
        let displacement = [0.02, -0.03, 0.05_f32];
        let touched = contacts(&lattice, link, &[([80, 20, 60], displacement)]);
        let mut rows = CellRows::new(lattice.clone());
        let frame = Observation::new(&robot, &poses, &touched, &mut rows, &DVector::zeros(4));

        let cell = touched.links[0].cells[0];
        let u = Vector3::from(displacement.map(f64::from));
        let expected = lever(&robot, &poses, touched.links[0].link, &lattice.point(cell), &u);
        let found = frame.levers(&cells_with(&rows, |_| 0.0));
        assert!((found.column(0) - expected).amax() < 1e-8, "link {link}");
    }
}

#[test]
fn folded_products_are_those_of_the_lever_matrix() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let robot = crooked_arm();
    let mut rows = CellRows::new(centimetre_lattice());
    let frame = random_frame(&mut rng, &robot, &mut rows, &[30.0; 40], 0.1);
    let k = |row: usize| 10.0 + row as f64;
    let mut cells = cells_with(&rows, k);
    let h = frame.levers(&cells);
    let n = frame.n_contacts();
    let by_contact = DVector::from_iterator(n, frame.rows().map(k));

    let predicted = frame.predict(&cells, StiffnessRule::Positive);
    assert!((predicted - &h * &by_contact).amax() < 1e-12);
    let gram = &h * DMatrix::from_diagonal(&by_contact) * h.transpose();
    assert!((frame.weighted_gram(&cells, k) - gram).amax() < 1e-12);

    let m = DMatrix::from_fn(4, 4, |i, j| 1.0 / (1.0 + i as f64 + j as f64));
    let mut contact = 0;
    frame.quadratic(&cells, &m, |row, value| {
        assert_eq!(Some(row), frame.rows().nth(contact));
        let expected = (h.column(contact).transpose() * &m * h.column(contact))[0];
        assert!((value - expected).abs() < 1e-12);
        contact += 1;
    });
    assert_eq!(contact, n);
    let d = DVector::from_fn(4, |i, _| 1.0 - 0.7 * i as f64);
    let mut contact = 0;
    frame.transpose_times(&mut cells, d.as_slice(), |cell, row, value| {
        assert_eq!((Some(row), cell.unknown()), (frame.rows().nth(contact), k(row)));
        assert!((value - h.column(contact).dot(&d)).abs() < 1e-12);
        contact += 1;
    });
    assert_eq!(contact, n);
}

#[test]
fn stiffness_is_the_positive_part_or_the_magnitude_of_the_unknown() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let robot = crooked_arm();
    let mut rows = CellRows::new(centimetre_lattice());
    let frame = random_frame(&mut rng, &robot, &mut rows, &[30.0; 40], 0.1);
    let unknown = |row: usize| if row.is_multiple_of(3) { -20.0 } else { 10.0 + row as f64 };
    for (stiffness, k) in [
        (StiffnessRule::Positive, &f64::max as &dyn Fn(f64, f64) -> f64),
        (StiffnessRule::Magnitude, &|unknown: f64, _| unknown.abs()),
    ] {
        let predicted = frame.predict(&cells_with(&rows, unknown), stiffness);
        let plainly = cells_with(&rows, |row| k(unknown(row), 0.0));
        assert_eq!(predicted, frame.predict(&plainly, StiffnessRule::Positive), "{stiffness:?}");
    }
}

#[test]
fn without_contacts_the_predicted_torque_is_zero() {
    let robot = crooked_arm();
    let poses = robot.forward(&[0.1; 4]).unwrap();
    let mut rows = CellRows::new(centimetre_lattice());
    let none = Contacts::default();
    let frame = Observation::new(&robot, &poses, &none, &mut rows, &DVector::zeros(4));
    assert_eq!(
        frame.predict(&cells_with(&rows, |_| 1.0), StiffnessRule::Positive),
        DVector::zeros(4)
    );
}

#[test]
fn notes_are_read_back_and_take_no_more_memory_in_a_copy() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut rows = CellRows::new(centimetre_lattice());
    let mut frame = random_frame(&mut rng, &crooked_arm(), &mut rows, &[30.0; 40], 0.1);
    let (mut copy, levers) = (frame.clone(), frame.levers(&cells_with(&rows, |_| 0.0)));
    let bytes = frame.bytes();
    let notes: Vec<f64> = (0..4 * 5).map(f64::from).collect();
    for one in [&mut frame, &mut copy] {
        one.note(notes[..4].iter().copied());
        one.note(notes[4..].iter().copied());
        assert_eq!(one.notes(), notes);
        assert_eq!(one.levers(&cells_with(&rows, |_| 0.0)), levers);
        assert_eq!(one.bytes(), bytes, "room for a vector and a matrix was there already");
    }
}
