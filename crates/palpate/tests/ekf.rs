//! Laws of `ekf`: the textbook filter where that is diagonal too, drift, and the sign.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{CellRows, EkfEstimator, Estimator, FrameId, Observation};
use palpate::{EstimatorError, EstimatorKind, Robot};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{cells_with, centimetre_lattice, config, contacts, gantry_urdf, uniform};

/// Frames of a gantry in which no joint's torque is that of two cells: each of three cells is pushed
/// along its own axis, or not at all. H S Hᵀ is then diagonal, and so stays the covariance.
fn diagonal_frames(count: usize) -> (CellRows, Vec<Observation>) {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let robot = Robot::from_urdf(&gantry_urdf("")).unwrap();
    let poses = robot.forward(&[0.0; 3]).unwrap();
    let mut rows = CellRows::new(centimetre_lattice());
    for place in 0..3 {
        rows.row_of(centimetre_lattice().cell([place, 0, 0]));
    }
    let mut frames = Vec::new();
    for _ in 0..count {
        let mut touched = Vec::new();
        for axis in 0..3_usize {
            if uniform(&mut rng, 0.0, 1.0) < 0.4 {
                let mut displacement = [0.0; 3];
                displacement[axis] = uniform(&mut rng, -0.1, 0.1) as f32;
                touched.push(([axis as u32, 0, 0], displacement));
            }
        }
        let tau = DVector::from_fn(3, |_, _| uniform(&mut rng, -3.0, 3.0));
        let contacts = contacts(rows.lattice(), 3, &touched);
        frames.push(Observation::new(&robot, &poses, &contacts, &mut rows, &tau));
    }
    (rows, frames)
}

/// The textbook filter with a full covariance, drifting eagerly after every step.
struct Textbook {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Textbook {
    fn step(&mut self, rows: &CellRows, frame: &Observation, r: f64, drift_variance: f64) {
        let levers = frame.levers(&cells_with(rows, |_| 0.0));
        let mut h = DMatrix::zeros(3, self.mean.len());
        for (contact, row) in frame.rows().enumerate() {
            let sign = self.mean[row].signum();
            h.set_column(row, &(levers.column(contact) * sign));
        }
        let innovation = &h * &self.covariance * h.transpose() + DMatrix::identity(3, 3) * r;
        let gain = &self.covariance * h.transpose() * innovation.try_inverse().unwrap();
        self.mean += &gain * (frame.tau() - &h * &self.mean); // H κ = Σ w |κ|
        let identity = DMatrix::identity(self.mean.len(), self.mean.len());
        self.covariance = (identity - gain * h) * &self.covariance;
        self.covariance += DMatrix::identity(3, 3) * drift_variance;
    }
}

#[test]
fn with_diagonal_levers_it_equals_the_textbook_filter_and_lazy_drift_equals_eager_drift() {
    let (rows, frames) = diagonal_frames(200);
    let mut settings = config(EstimatorKind::Ekf, 2.0, 30.0, 0.2);
    settings.drift_std_n_per_m = 0.7;
    let mut ekf = EkfEstimator::new(&settings, 0.01, 3).unwrap();
    let mut textbook = Textbook {
        mean: DVector::from_element(3, 2.0),
        covariance: DMatrix::identity(3, 3) * 900.0,
    };
    let mut signs_seen = [false; 2];
    for (number, frame) in frames.iter().enumerate() {
        let source = FrameId { touch: 0, sample: number as u32 };
        if frame.n_contacts() == 0 {
            ekf.advance_time();
        } else {
            ekf.correct(rows.points_m(), frame.clone(), source).unwrap();
        }
        textbook.step(&rows, frame, 0.04, 0.49);
        for row in 0..3 {
            signs_seen[usize::from(textbook.mean[row] < 0.0)] = true;
            assert!((ekf.stiffness(row) - textbook.mean[row].abs()).abs() < 1e-8, "frame {number}");
            let std = textbook.covariance[(row, row)].sqrt();
            assert!((ekf.std(row) - std).abs() < 1e-8, "frame {number}, row {row}");
        }
    }
    assert_eq!(signs_seen, [true; 2], "both branches of |κ| must have been visited");
}

#[test]
fn one_joint_one_contact_recovers_the_spring() {
    let (rows, frame) = scene::spring_frame();
    let mut ekf = EkfEstimator::new(&config(EstimatorKind::Ekf, 1e-3, 1e4, 1e-3), 0.01, 1).unwrap();
    ekf.correct(rows.points_m(), frame, FrameId { touch: 0, sample: 0 }).unwrap();
    assert!((ekf.stiffness(0) - 150.0).abs() < 1e-4, "{}", ekf.stiffness(0));
}

#[test]
fn a_replayed_measurement_is_fused_again() {
    let (rows, frames) = diagonal_frames(20);
    let frame = frames.iter().find(|frame| frame.n_contacts() == 3).unwrap();
    let settings = config(EstimatorKind::Ekf, 2.0, 30.0, 0.2);
    let learn = |replays: u32, times: u32| {
        let mut ekf = EkfEstimator::new(&settings, 0.01, 3).unwrap();
        for sample in 0..times {
            ekf.correct(rows.points_m(), frame.clone(), FrameId { touch: 0, sample }).unwrap();
        }
        assert_eq!(ekf.replay(replays).frames, replays);
        (ekf.state(rows.len()).mean, ekf.state(rows.len()).variance)
    };
    // Two measurements and three replays of either are five in all.
    assert_eq!(learn(3, 2), learn(0, 5));
}

#[test]
fn a_prior_mean_of_zero_is_refused_and_says_why() {
    let error = EkfEstimator::new(&config(EstimatorKind::Ekf, 0.0, 1.0, 0.1), 0.01, 3).unwrap_err();
    assert_eq!(error, EstimatorError::EkfPriorMeanZero);
    assert!(error.to_string().contains("never learns"));
}
