//! Distance queries against their share of a step.
//!
//! A step of one millisecond asks for some 20,000 distances: what is in reach is searched, what is
//! touched is projected. At 20 ns each that is 0.4 ms; `distance` must stay under it, and
//! `distance_and_normal` under twice that. Forward kinematics is asked for once a sub-step: 3 µs.
#![allow(missing_docs)] // criterion's macro generates an undocumented function

mod scene;

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Vector3;

fn queries(c: &mut Criterion) {
    let grid = scene::boxed_link();
    let points = scene::scattered_points(4_096);

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
    let robot = scene::gen3();
    let q = vec![0.3; robot.n_joints()];
    c.bench_function("robot/forward", |b| b.iter(|| robot.forward(black_box(&q))));
}

criterion_group!(benches, queries, forward);
criterion_main!(benches);
