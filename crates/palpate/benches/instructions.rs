//! Instructions of each hot loop against their pins: a slowdown of more than 5 % fails.
//!
//! Instructions are not time. But unlike time they hardly differ between runs and between x86-64
//! machines, so that `.ci/run --all` can watch them. The pins stand in `instructions.txt`; `./counts` builds
//! what counting needs, counts, and says which pins are out of date. Only the body of a function
//! below is counted: its argument is made before, and what it returns is dropped after.
#![allow(missing_docs)] // gungraun's macros generate undocumented functions
#![allow(clippy::disallowed_macros)] // and they print, as a bench may, though the core may not

mod scene;

use std::hint::black_box;

use gungraun::prelude::*;
use gungraun::{Callgrind, EventKind};
use nalgebra::{DVector, Point3, Vector3};
use palpate::unstable::DistanceGrid;
use palpate::{Contacts, EstimatorKind, Robot};

use scene::{Ball, Learner};

/// No more than 5 % above the pin.
fn pinned(name: &str) -> LibraryBenchmarkConfig {
    let pins = include_str!("instructions.txt").lines();
    let pin = pins.filter_map(|line| line.split_once(' ')).find(|(pinned, _)| *pinned == name);
    let (_, pin) = pin.unwrap_or_else(|| panic!("instructions.txt has no line `{name} <number>`"));
    let pin: u64 = pin.trim().parse().expect("a pin is a whole number");
    let limit = pin + pin / 20;
    LibraryBenchmarkConfig::default()
        .tool(Callgrind::with_args(["cache-sim=no"]).hard_limits([(EventKind::Ir, limit)]))
        .env("RAYON_NUM_THREADS", "1") // as many as on any other machine
        .clone()
}

/// A ball that has gone to and fro once.
fn moving_ball() -> Ball {
    let mut ball = Ball::new(50);
    (0..Ball::PERIOD).for_each(|_| drop(ball.advance()));
    ball
}

#[library_benchmark(config = pinned("contact"))]
#[bench::motions_40(moving_ball())]
fn contact(mut ball: Ball) -> (Ball, Option<Contacts>) {
    let last = (0..40).map(|_| ball.advance()).last();
    (ball, last)
}

#[library_benchmark(config = pinned("map"))]
#[bench::contacts_3000(Learner::new(EstimatorKind::Map, 3_000, 50))]
fn map(mut learner: Learner) -> Learner {
    learner.learn();
    learner
}

#[library_benchmark(config = pinned("ekf"))]
#[bench::contacts_3000(Learner::new(EstimatorKind::Ekf, 3_000, 50))]
fn ekf(mut learner: Learner) -> Learner {
    learner.learn();
    learner
}

fn queries() -> (DistanceGrid, Vec<Point3<f64>>) {
    (scene::boxed_link(), scene::scattered_points(4_096))
}

#[library_benchmark(config = pinned("distance"))]
#[bench::queries_4096(queries())]
fn distance(
    (grid, points): (DistanceGrid, Vec<Point3<f64>>),
) -> (f64, DistanceGrid, Vec<Point3<f64>>) {
    let sum = points.iter().map(|point| grid.distance(black_box(point))).sum();
    (sum, grid, points)
}

#[library_benchmark(config = pinned("distance_and_normal"))]
#[bench::queries_4096(queries())]
fn distance_and_normal(
    (grid, points): (DistanceGrid, Vec<Point3<f64>>),
) -> (f64, Vector3<f64>, DistanceGrid, Vec<Point3<f64>>) {
    let mut sums = (0.0, Vector3::zeros());
    for point in &points {
        let (distance, normal) = grid.distance_and_normal(black_box(point));
        sums = (sums.0 + distance, sums.1 + normal);
    }
    (sums.0, sums.1, grid, points)
}

#[library_benchmark(config = pinned("forward"))]
#[bench::postures_100(scene::gen3())]
fn forward(robot: Robot) -> (DVector<f64>, Robot) {
    let mut sum = DVector::zeros(robot.n_joints());
    for posture in 0..100 {
        let poses = robot.forward(&[0.01 * f64::from(posture); 7]).expect("seven finite angles");
        sum += robot.gravity_torque(&poses);
    }
    (sum, robot)
}

library_benchmark_group!(
    name = hot_loops,
    benchmarks = [contact, map, ekf, distance, distance_and_normal, forward]
);

fn main() {
    if option_env!("GUNGRAUN_RUNNER").is_none() {
        println!("instructions: built without what counts them; ./counts brings it");
        return;
    }
    gungraun::main!(library_benchmark_groups = hot_loops); // defines a main, inside this one
    main();
}
