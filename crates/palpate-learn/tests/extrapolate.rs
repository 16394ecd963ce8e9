//! Stiffness is extrapolated to untouched points, from torques, colours and positions.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use common::{NEVER, field, tracked, with_torques_of};
use nalgebra::Point3;
use palpate::{EstimatorKind as Estimator, MapperConfig};
use palpate_io::cloud;
use palpate_learn::extrapolate::compare::{CompareError, ComparisonPlan};
use palpate_learn::extrapolate::{
    ExtrapolateError, ExtrapolationConfig, ExtrapolationMethod, SeenCloud, area_under_roc,
    extrapolate, spearman,
};

fn object() -> SeenCloud {
    let reading = cloud::read(&std::path::Path::new(common::DATA).join("object.ply")).unwrap();
    SeenCloud::new(reading.cloud.points(), reading.cloud.colours().unwrap()).unwrap()
}

fn is_brown([red, green, _]: [u8; 3]) -> bool {
    red > green
}

#[test]
fn two_colours_of_two_stiffnesses_are_distinguished_by_torque_alone() {
    let (seen, tracked) = (object(), tracked(&[2, 8], 4));
    // These torques have no noise.
    let config = ExtrapolationConfig { torque_std: 0.01, ..ExtrapolationConfig::default() };
    let at = seen.at(&tracked.points_m, config.reach_m(&tracked.lattice));
    let made = |scale: f64| {
        let k = |row: usize| match at[row] {
            Some(point) if is_brown(seen.colours()[point as usize]) => 3.0 * scale,
            Some(_) => 0.2 * scale,
            None => 0.0,
        };
        // The stiffness of the field's cells does not matter.
        let tracked = with_torques_of(tracked.clone(), k);
        extrapolate(&seen, &field(&tracked, |_| 0.0), Some(&tracked), &config).unwrap()
    };
    let [once, thrice] = [made(1.0), made(3.0)];
    let brown: Vec<bool> = seen.colours().iter().map(|colour| is_brown(*colour)).collect();
    let auc = area_under_roc(&once.stiffness_n_per_m, &brown).unwrap();
    assert!(auc > 0.99, "{auc}");
    let mean = |of: bool| {
        let k = once.stiffness_n_per_m.iter().zip(&brown).filter(|(_, brown)| **brown == of);
        let k: Vec<f64> = k.map(|(k, _)| *k).collect();
        k.iter().sum::<f64>() / k.len() as f64
    };
    let [soft, stiff] = [mean(false), mean(true)];
    assert!((0.1..0.4).contains(&soft) && (2.0..4.0).contains(&stiff), "{soft} {stiff}");
    // Three times the torque gives three times the stiffness and the standard deviation.
    for point in (0..seen.len()).step_by(997) {
        for (one, three) in [
            (once.stiffness_n_per_m[point], thrice.stiffness_n_per_m[point]),
            (once.std_n_per_m[point], thrice.std_n_per_m[point]),
        ] {
            assert!((three - 3.0 * one).abs() <= 1e-6 * three.abs().max(1e-6), "{one} {three}");
        }
    }
}

#[test]
fn how_often_a_log_was_sampled_hardly_matters() {
    let seen = object();
    let config = ExtrapolationConfig::default();
    let of = |every: usize| {
        let tracked = tracked(&[2, 8], every);
        extrapolate(&seen, &field(&tracked, |_| 0.0), Some(&tracked), &config)
            .unwrap()
            .stiffness_n_per_m
    };
    let rho = spearman(&of(1), &of(5)).unwrap();
    assert!(rho > 0.98, "{rho}");
}

#[test]
fn wood_is_distinguished_from_leaf_on_the_bundled_touches() {
    let (seen, tracked) = (object(), tracked(&(0..11).collect::<Vec<_>>(), 2));
    let found = extrapolate(
        &seen,
        &field(&tracked, |_| 0.0),
        Some(&tracked),
        &ExtrapolationConfig::default(),
    )
    .unwrap();
    let truth = std::path::Path::new(common::DATA).join("truth");
    let truth = cloud::read_point_truth(&truth, seen.len()).unwrap();
    let untouched: Vec<usize> = (0..seen.len()).filter(|&point| !found.touched[point]).collect();
    assert!(untouched.len() > seen.len() / 2, "{}", untouched.len());
    let k: Vec<f64> = untouched.iter().map(|&at| found.stiffness_n_per_m[at]).collect();
    let wood: Vec<bool> = untouched.iter().map(|&at| truth.class[at] > 0).collect();
    let real: Vec<f64> = untouched.iter().map(|&at| truth.stiffness_n_per_m[at]).collect();
    let (auc, rho) = (area_under_roc(&k, &wood).unwrap(), spearman(&k, &real).unwrap());
    assert!(auc >= 0.95, "area under the ROC curve {auc}");
    assert!(rho >= 0.5, "Spearman's correlation {rho}");
}

#[test]
fn regressions_on_cells_carry_a_colour_over() {
    let (seen, tracked) = (object(), tracked(&[2, 8], 20));
    let at = seen.at(&tracked.points_m, 0.015);
    let k = |row: usize| {
        let brown = |point: u32| is_brown(seen.colours()[point as usize]);
        if at[row].is_some_and(brown) { 3.0 } else { 0.2 }
    };
    let brown: Vec<bool> = seen.colours().iter().map(|colour| is_brown(*colour)).collect();
    for method in [ExtrapolationMethod::Cells, ExtrapolationMethod::Knn] {
        let config = ExtrapolationConfig { method, ..ExtrapolationConfig::default() };
        let found = extrapolate(&seen, &field(&tracked, k), None, &config).unwrap();
        let auc = area_under_roc(&found.stiffness_n_per_m, &brown).unwrap();
        assert!(auc > 0.99, "{method:?}: {auc}");
        assert!(found.std_n_per_m.iter().all(|std| std.is_finite() && *std >= 0.0));
    }
}

#[test]
fn cells_at_seen_points_take_their_stiffness_and_no_others_do() {
    let (seen, tracked) = (object(), tracked(&[2], 20));
    let config =
        ExtrapolationConfig { method: ExtrapolationMethod::Knn, ..ExtrapolationConfig::default() };
    let field = field(&tracked, |row| (row % 7) as f64);
    let found = extrapolate(&seen, &field, None, &config).unwrap();
    let cells = found.cells(&seen, &field.lattice, &config);
    assert!(cells.array_windows().all(|[a, b]| a.0 < b.0), "in the lattice's order, each once");
    for (cell, k) in &cells {
        let (point, distance_m) = seen.nearest(&field.lattice.point(*cell).into());
        assert!(distance_m <= 0.015 && found.stiffness_n_per_m[point] == *k);
    }
    let expected = |point: &[f64; 3]| {
        let cell = field.lattice.nearest(&(*point).into()).unwrap();
        cells.binary_search_by_key(&cell, |(cell, _)| *cell).is_ok()
    };
    assert!(seen.points_m().iter().step_by(37).all(expected), "every seen point has its cell");
}

#[test]
fn what_cannot_be_extrapolated_is_refused_with_the_reason() {
    let (seen, tracked) = (object(), tracked(&[2], 20));
    let field = field(&tracked, |_| 1.0);
    let config = ExtrapolationConfig::default();
    let none = extrapolate(&seen, &field, None, &config);
    assert!(matches!(none, Err(ExtrapolateError::NoTorques)));
    let shifted = |by: [f64; 3]| {
        let points: Vec<Point3<f64>> = seen
            .points_m()
            .iter()
            .map(|p| Point3::from(*p) + nalgebra::Vector3::from(by))
            .collect();
        SeenCloud::new(&points, seen.colours()).unwrap()
    };
    let apart =
        extrapolate(&shifted([0.0, 5.0, 0.0]), &field, Some(&tracked), &config).unwrap_err();
    let ExtrapolateError::Apart { gap_m, apart_m, .. } = &apart else { panic!("{apart}") };
    assert!(*gap_m > 3.0 && apart_m[0] == 0.0 && apart_m[1] > 3.0, "{apart}");
    assert!(apart.to_string().contains("touched cells are"), "{apart}");
    // One point inside the box of the touched cells, but near none of them.
    let corner = tracked.points_m.iter().fold([f64::INFINITY; 3], |low, point| {
        std::array::from_fn(|axis| low[axis].min(point[axis]))
    });
    let alone = SeenCloud::new(&[Point3::from(corner)], &[[0, 0, 0]]).unwrap();
    let error = extrapolate(&alone, &field, Some(&tracked), &config).unwrap_err();
    assert!(matches!(error, ExtrapolateError::NoneTouched { .. }), "{error}");
    let config = ExtrapolationConfig { length_scale: 0.0, ..config };
    let error = extrapolate(&seen, &field, Some(&tracked), &config).unwrap_err();
    assert!(error.to_string().contains("`length_scale` is 0"), "{error}");
}

#[test]
fn halves_are_compared_with_and_without_the_prior() {
    let (seen, four) = (object(), tracked(&[1, 2, 5, 8], 8));
    let plan = ComparisonPlan { halves: 2, ..ComparisonPlan::of(&ExtrapolationConfig::default()) };
    let mapper = MapperConfig::of(Estimator::Map);
    let rows = plan.run(&four, &seen, &mapper, NEVER, &|| {}).unwrap();
    assert_eq!(rows.len(), plan.variants.len() + 3);
    assert_eq!(rows[0].means().0, Some(1.0), "predicting zero");
    assert!(rows.iter().all(|row| row.avg_error.len() == 2));
    let one = tracked(&[2], 20);
    let error = plan.run(&one, &seen, &mapper, NEVER, &|| {}).unwrap_err();
    assert!(matches!(error, CompareError::TooFew { touches: 1 }));
}
