//! Gaussian process and k-NN against scikit-learn, on what `scripts/regression_fixture.py` wrote.
#![allow(clippy::unwrap_used)] // helpers are not `#[test]` functions

use nalgebra::DMatrix;
use palpate_learn::regression::{Frames, Gp, Kernel, Knn, Regressor};
use serde_json::Value;

fn fixture() -> Value {
    serde_json::from_str(include_str!("data/regression.json")).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(number).collect()
}

/// A matrix of the file; frames are rows there, and columns here.
fn matrix(value: &Value) -> DMatrix<f64> {
    let frames: Vec<Vec<f64>> = value.as_array().unwrap().iter().map(numbers).collect();
    DMatrix::from_fn(frames[0].len(), frames.len(), |row, frame| frames[frame][row])
}

fn frames(fixture: &Value) -> Frames {
    let q = matrix(&fixture["q"]);
    let touch = vec![0; q.ncols()];
    Frames { q, tau: matrix(&fixture["tau"]), touch }
}

#[test]
fn a_gaussian_process_predicts_as_scikit_learn_does() {
    let fixture = fixture();
    let wanted = &fixture["gp"];
    let kernel = Kernel {
        signal_variance: number(&wanted["signal_variance"]),
        noise_variance: number(&wanted["noise_variance"]),
        length_scales: numbers(&wanted["length_scales"]),
    };
    let gp = Gp::with_kernel(&frames(&fixture), kernel).unwrap();
    let predicted = gp.predict(&matrix(&fixture["queries"]));
    assert!((predicted - matrix(&wanted["predicted"])).amax() < 1e-6);
    assert!((gp.log_likelihood() - number(&wanted["log_likelihood"])).abs() < 1e-6);
}

#[test]
fn nearest_neighbours_predict_as_scikit_learn_does() {
    let fixture = fixture();
    let wanted = &fixture["knn"];
    let neighbours = wanted["neighbours"].as_u64().unwrap() as usize;
    let length_scale = number(&wanted["length_scale"]);
    let knn = Knn::with_length_scale(&frames(&fixture), neighbours, length_scale).unwrap();
    let predicted = knn.predict(&matrix(&fixture["queries"]));
    assert!((predicted - matrix(&wanted["predicted"])).amax() < 1e-6);
}
