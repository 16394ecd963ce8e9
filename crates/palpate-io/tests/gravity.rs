//! Gravity of the built-in Gen3 against recorded torques: at rest, the residual is the
//! sensors' noise and bias, as the data's own description gives them.
//!
//! Runs on the bundled set, and on every set of the folder in `PALPATE_DATA` if that is given.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod common;

use std::path::Path;

use nalgebra::DVector;
use palpate::{Robot, Sample};
use serde::Deserialize;

#[derive(Deserialize)]
struct Meta {
    conventions: Conventions,
    touches: Vec<TouchMeta>,
}

#[derive(Deserialize)]
struct Conventions {
    contact_free_start_frames: usize,
}

#[derive(Deserialize)]
#[allow(non_snake_case)] // the spelling of the file
struct TouchMeta {
    noise_sigma_Nm: f64,
    bias_Nm: Vec<f64>,
}

/// Measured torque minus gravity torque in the first frames of every touch, N·m.
fn at_rest(robot: &Robot, set: &Path, frames: usize) -> Vec<Vec<DVector<f64>>> {
    let less_gravity = |sample: Sample| {
        let gravity = robot.gravity_torque(&robot.forward(&sample.q).unwrap());
        DVector::from_vec(sample.tau) - gravity
    };
    let touches = common::touches(set).into_iter();
    touches
        .map(|(_, samples)| samples.into_iter().take(frames).map(less_gravity).collect())
        .collect()
}

#[test]
fn at_rest_measured_less_gravity_is_the_noise_and_bias_of_the_sensors() {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    for set in common::sets("meta.json") {
        let meta = std::fs::read_to_string(set.join("meta.json")).unwrap();
        let meta: Meta = serde_json::from_str(&meta).unwrap();
        let still = meta.conventions.contact_free_start_frames;
        let touches = at_rest(&robot, &set, still);
        assert_eq!(touches.len(), meta.touches.len());
        let (mut worst_noise, mut worst_bias) = (0.0_f64, 0.0_f64);
        for (touch, said) in touches.iter().zip(&meta.touches) {
            let mean = touch.iter().sum::<DVector<f64>>() / still as f64;
            let squares: f64 = touch.iter().map(|frame| (frame - &mean).norm_squared()).sum();
            let noise = (squares / ((still - 1) * robot.n_joints()) as f64).sqrt();
            worst_noise = worst_noise.max((noise / said.noise_sigma_Nm - 1.0).abs());
            let bias = DVector::from_column_slice(&said.bias_Nm);
            worst_bias = worst_bias.max((mean - bias).amax());
        }
        println!(
            "{}: {} touches, noise off by at most {:.1} %, bias by at most {worst_bias:.4} N·m",
            set.file_name().unwrap().display(),
            touches.len(),
            100.0 * worst_noise
        );
        assert!(worst_noise < 0.2 && worst_bias < 0.05, "{}", set.display());
    }
}
