//! Distance queries against their share of a step.
//!
//! A step of one millisecond asks for some 20,000 distances: what is in reach is searched, what is
//! touched is projected. At 20 ns each that is 0.4 ms; `distance` must stay under it, and
//! `distance_and_normal` under twice that. Forward kinematics is asked for once a sub-step: 3 µs.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers
#![allow(missing_docs)] // criterion's macro generates an undocumented function

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Isometry3, Point3, Vector3, vector};
use palpate::robot::{Collision, Robot, Shape};
use palpate::sdf::{Config, Solid, bake};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Points of a shell as a contact search visits them: scattered, within the grid.
fn points(n: usize) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut uniform =
        |half: f64| (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half;
    (0..n).map(|_| Point3::new(uniform(0.07), uniform(0.07), uniform(0.17))).collect()
}

fn queries(c: &mut Criterion) {
    let shape = Shape::Box { size_m: vector![0.09, 0.09, 0.3] };
    let part = Collision { link_from_shape: Isometry3::identity(), shape };
    let solid = Solid { primitives: vec![part], meshes: vec![] };
    let (grid, _) = bake(&solid, &Config::default()).expect("a box can be baked");
    let points = points(4_096);

    let mut group = c.benchmark_group("sdf");
    group.throughput(Throughput::Elements(points.len() as u64));
    group.bench_function("distance", |b| {
        b.iter(|| points.iter().map(|point| grid.distance(black_box(point))).sum::<f64>());
    });
    group.bench_function("distance_and_normal", |b| {
        b.iter(|| {
            points.iter().fold((0.0, Vector3::zeros()), |(distances, normals), point| {
                let (distance, normal) = grid.distance_and_normal(black_box(point));
                (distances + distance, normals + normal)
            })
        });
    });
    group.finish();
}

fn forward(c: &mut Criterion) {
    let robot = Robot::built_in("kinova_gen3").expect("it is built in");
    let q = vec![0.3; robot.n_joints()];
    c.bench_function("robot/forward", |b| b.iter(|| robot.forward(black_box(&q))));
}

criterion_group!(benches, queries, forward);
criterion_main!(benches);
