//! One whole step at 200³ cells, against the real-time budget.
//!
//! The paper makes 17 steps per second. The median time of a step (contacts, prediction, update, 20
//! replays) on the bundled touches must be below 3 ms; the goal is 1 ms. All touches but the last
//! are learnt before the measurement, so that the memory is as full as in use. Only samples after
//! the tare are timed.
#![allow(missing_docs, clippy::unwrap_used)] // criterion's macro generates undocumented functions

use std::sync::Arc;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use palpate::{EstimatorKind, Mapper, MapperConfig, Sample};
use palpate_io::robot_files::{ArmOptions, load_arm};

#[path = "../tests/common/mod.rs"]
mod common;

/// A mapper that learns the same touches repeatedly.
struct Running {
    mapper: Mapper,
    touches: Vec<Vec<Sample>>,
    at: (usize, usize),
    steps: Vec<(Duration, usize)>,
}

impl Running {
    fn new(method: EstimatorKind) -> Self {
        let arm = load_arm("kinova_gen3", &ArmOptions::default()).unwrap().arm;
        let mapper = Mapper::new(Arc::new(arm), MapperConfig::of(method)).unwrap();
        let touches = common::touches(&common::plant());
        let touches = touches.into_iter().map(|(_, samples)| samples).collect();
        let mut running = Self { mapper, touches, at: (0, 0), steps: Vec::new() };
        let last = running.touches.len() - 1;
        while running.at.0 < last {
            running.step();
        }
        running.steps.clear();
        running
    }

    /// Steps to the next sample after a tare, and returns the time of that step.
    fn step(&mut self) -> Duration {
        loop {
            let (touch, sample) = self.at;
            if sample == 0 {
                self.mapper.begin_touch();
            }
            let start = Instant::now();
            let report = self.mapper.step(&self.touches[touch][sample]).unwrap();
            let took = start.elapsed();
            self.at = match sample + 1 {
                next if next < self.touches[touch].len() => (touch, next),
                _ => ((touch + 1) % self.touches.len(), 0),
            };
            if report.external.is_some() {
                self.steps.push((took, report.contacts));
                return took;
            }
        }
    }
}

fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("step");
    for (name, method) in [("map", EstimatorKind::Map), ("ekf", EstimatorKind::Ekf)] {
        let mut running = Running::new(method);
        group.sample_size(20);
        group.bench_function(name, |b| {
            b.iter_custom(|steps| (0..steps).map(|_| running.step()).sum());
        });
        let mut steps = running.steps;
        steps.sort();
        let part = |share: f64| steps[((steps.len() - 1) as f64 * share) as usize].0;
        let contacts: usize = steps.iter().map(|step| step.1).sum();
        println!(
            "step/{name}: median {:.3?}, p99 {:.3?}, {} contacts on average, {} steps",
            part(0.5),
            part(0.99),
            contacts / steps.len(),
            steps.len()
        );
    }
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
