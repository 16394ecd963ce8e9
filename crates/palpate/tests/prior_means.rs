//! Laws of a prior by cell: what is expected of cells before they are touched.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use std::collections::BTreeMap;
use std::sync::Arc;

use palpate::unstable::{CellRows, Estimator, MapEstimator, Observation};
use palpate::{
    Arm, CellId, EstimatorConfig, EstimatorKind, Field, Gravity, Lattice, Mapper, MapperConfig,
    Predictor, Sample, Tare,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{centimetre_lattice, config, crooked_arm, learn, random_frame, source};

/// An estimator of either kind, at its prior.
fn estimator(method: EstimatorKind, settings: EstimatorConfig) -> Box<dyn Estimator> {
    let mut config = MapperConfig::of(method);
    (config.lattice, config.estimator) = (centimetre_lattice(), settings);
    config.estimator(4).unwrap()
}

/// Frames of a field of springs from 1 to 30 N/m, without noise.
fn frames(count: usize) -> (CellRows, Vec<Observation>) {
    let (mut rng, robot) = (ChaCha8Rng::seed_from_u64(11), crooked_arm());
    let mut rows = CellRows::new(centimetre_lattice());
    let springs: Vec<f64> = (1..=30).map(f64::from).collect();
    let mut frame = || random_frame(&mut rng, &robot, &mut rows, &springs, 0.0);
    let frames = (0..count).map(|_| frame()).collect();
    (rows, frames)
}

#[test]
fn without_data_the_estimate_is_the_prior_mean() {
    let (rows, frames) = frames(1);
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let mut estimator = estimator(method, config(method, 2.0, 5.0, 0.1));
        estimator.set_prior_means(rows.points_m(), &[7.0, 3.0]);
        let k: Vec<f64> = (0..4).map(|row| estimator.stiffness(row)).collect();
        assert_eq!(k, [7.0, 3.0, 2.0, 2.0], "{method:?}");
        assert_eq!((estimator.std(0), estimator.count(0)), (5.0, 0));
        // Rows that are known are left alone; those after them are not.
        estimator.correct(rows.points_m(), frames[0].clone(), source(0)).unwrap();
        let before = estimator.state(rows.len());
        estimator.set_prior_means(rows.points_m(), &vec![9.0; rows.len()]);
        assert_eq!(estimator.state(rows.len()), before, "{method:?}");
    }
}

#[test]
fn ekf_expects_no_less_than_its_prior_since_at_zero_it_would_never_learn() {
    let (rows, frames) = frames(20);
    let mut ekf = estimator(EstimatorKind::Ekf, config(EstimatorKind::Ekf, 0.5, 5.0, 0.1));
    ekf.set_prior_means(rows.points_m(), &vec![0.0; rows.len()]);
    assert!((0..rows.len()).all(|row| ekf.stiffness(row) == 0.5));
    for (number, frame) in frames.iter().enumerate() {
        ekf.correct(rows.points_m(), frame.clone(), source(number as u32)).unwrap();
    }
    assert!((0..rows.len()).any(|row| ekf.stiffness(row) > 5.0));
}

#[test]
fn with_every_frame_forgotten_the_estimate_is_the_prior_mean() {
    let (rows, frames) = frames(12);
    let mut map = MapEstimator::new(&config(EstimatorKind::Map, 5.0, 40.0, 0.1), 0.01, 4).unwrap();
    let means: Vec<f64> = (0..rows.len()).map(|row| row as f64 % 7.0).collect();
    map.set_prior_means(rows.points_m(), &means);
    for (number, frame) in frames.iter().enumerate() {
        map.correct(rows.points_m(), frame.clone(), source(number as u32)).unwrap();
    }
    map.replay(10_000);
    let gap = |map: &MapEstimator| {
        let gaps = means.iter().enumerate().map(|(row, mean)| (map.stiffness(row) - mean).abs());
        gaps.fold(0.0, f64::max)
    };
    assert!(gap(&map) > 1.0);
    assert!((0..12).all(|sample| map.forget(source(sample))));
    assert!(gap(&map) < 1e-9, "{} N/m", gap(&map));
}

#[test]
fn a_saved_state_keeps_its_prior_means() {
    let (rows, _) = frames(3);
    let settings = config(EstimatorKind::Map, 5.0, 40.0, 0.1);
    let new = || MapEstimator::new(&settings, 0.01, 4).unwrap();
    let mut map = new();
    map.set_prior_means(rows.points_m(), &[1.0, 0.0, 3.0]);
    let state = map.state(3);
    assert_eq!((&state.mean[..], &state.counts[..]), (&[1.0, 0.0, 3.0][..], &[0, 0, 0][..]));
    let mut restored = new();
    restored.restore(&state, &rows.points_m()[..3], Vec::new()).unwrap();
    assert_eq!(restored.state(3), state);
}

/// A ball on a gantry.
fn arm() -> Arc<Arm> {
    scene::gantry("<sphere radius='0.06'/>", 0.01)
}

/// A box of springs beside the ball.
fn lattice() -> Lattice {
    Lattice::new([0.1, -0.1, -0.1], 0.02, [12; 3]).unwrap()
}

fn mapping(method: EstimatorKind) -> MapperConfig {
    let mut config = MapperConfig::of(method);
    config.lattice = lattice();
    (config.touch.gravity, config.touch.tare) = (Gravity::Removed, Tare::None);
    config.estimator.replays = 3;
    config.estimator.prior.mean_n_per_m = 0.5;
    config
}

/// The same stiffness expected of every cell, the last cell first.
fn everywhere(stiffness: f64) -> Vec<(CellId, f64)> {
    (0..lattice().n_cells() as u32).rev().map(|cell| (CellId(cell), stiffness)).collect()
}

/// The ball moves into the box and on along it.
fn motion() -> Vec<Sample> {
    let q = |t: f64| vec![0.25 * t, 0.05 * t, 0.02 * (9.0 * t).sin()];
    let tau = |t: f64| vec![-3.0 * t, -0.4 * t, 0.1 * (9.0 * t).sin()];
    let sample = |t: f64| Sample::new(None, q(t), tau(t));
    (0..40).map(|frame| sample(f64::from(frame) / 40.0)).collect()
}

/// Torques that a field predicts for the motion, and the contacts known to it.
fn predicted(field: &Field) -> (Vec<Vec<f64>>, usize) {
    let mut predictor = Predictor::new(arm(), field, field.touch.clone()).unwrap();
    predictor.begin_touch();
    let motion = motion();
    let frames = motion.iter().map(|sample| predictor.step(sample).unwrap().unwrap());
    let frames: Vec<_> = frames.collect();
    let known = frames.iter().map(|frame| frame.known).sum();
    (frames.iter().map(|frame| frame.predicted.as_slice().to_vec()).collect(), known)
}

#[test]
fn a_true_prior_predicts_torques_before_any_touch() {
    let field =
        Mapper::with_prior(arm(), mapping(EstimatorKind::Map), &everywhere(2.0)).unwrap().field();
    assert_eq!(field.cells.len() as u64, lattice().n_cells());
    assert!(field.cells.is_sorted() && field.counts.iter().all(|&count| count == 0));
    // The truth: a bed of 2 N/m everywhere.
    let truth = Field::new(lattice(), field.contact.clone(), field.touch.clone(), 2.0);
    let (torques, known) = predicted(&field);
    assert_eq!((&torques, known), (&predicted(&truth).0, 0));
    assert!(torques.iter().flatten().any(|tau| tau.abs() > 0.1), "the motion must have torques");

    // Nor does learning just these torques change anything.
    let mut mapper =
        Mapper::with_prior(arm(), mapping(EstimatorKind::Map), &everywhere(2.0)).unwrap();
    let measured =
        motion().into_iter().zip(torques).map(|(sample, tau)| Sample::new(None, sample.q, tau));
    learn(&mut mapper, &measured.collect::<Vec<_>>());
    let learnt = mapper.field();
    assert!(learnt.stiffness_n_per_m.iter().all(|k| (k - 2.0).abs() < 1e-12));
    let (_, known) = predicted(&learnt);
    assert!(known > 100, "{known} contacts with cells that were touched");
}

#[test]
fn prior_means_equal_to_the_prior_change_nothing() {
    for method in [EstimatorKind::Map, EstimatorKind::Ekf] {
        let settings = mapping(method);
        let (mean, _) = settings.estimator.prior.at_spacing(settings.lattice.spacing_m());
        let mut plain = Mapper::new(arm(), settings.clone()).unwrap();
        let mut expecting = Mapper::with_prior(arm(), settings, &everywhere(mean)).unwrap();
        for mapper in [&mut plain, &mut expecting] {
            learn(mapper, &motion());
        }
        let by_cell = |field: &Field| -> BTreeMap<CellId, [u64; 3]> {
            let numbers = |row: usize| {
                let [k, std] = [&field.stiffness_n_per_m, &field.std_n_per_m].map(|all| all[row]);
                [k.to_bits(), std.to_bits(), u64::from(field.counts[row])]
            };
            let touched = (0..field.cells.len()).filter(|&row| field.counts[row] > 0);
            touched.map(|row| (field.cells[row], numbers(row))).collect()
        };
        let (plain, expecting) = (plain.field(), expecting.field());
        assert!(plain.cells.len() > 100, "{} cells", plain.cells.len());
        assert_eq!(by_cell(&plain), by_cell(&expecting), "{method:?}");
    }
}

#[test]
fn the_prior_of_every_row_can_be_asked_for_afterwards() {
    let settings = mapping(EstimatorKind::Map);
    let (mean, _) = settings.estimator.prior.at_spacing(settings.lattice.spacing_m());
    assert_eq!(Mapper::new(arm(), settings.clone()).unwrap().prior_n_per_m(), None);
    let some = &everywhere(2.0)[..100]; // the far end of the box
    let mut mapper = Mapper::with_prior(arm(), settings, some).unwrap();
    learn(&mut mapper, &motion());
    let (prior, cells) = (mapper.prior_n_per_m().unwrap(), mapper.field().cells);
    assert!(cells.len() > 200 && prior.len() == cells.len());
    assert!(prior[..100].iter().all(|&k| k == 2.0) && prior[100..].iter().all(|&k| k == mean));
    let error =
        Mapper::with_prior(arm(), mapping(EstimatorKind::Map), &[some[0], some[0]]).err().unwrap();
    assert!(error.to_string().contains("comes twice"), "{error}");
}
