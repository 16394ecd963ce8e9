//! One new frame with 20 replays, against its share of the step.
//!
//! A step has 3 ms (and is to reach 1 ms); half of it is the estimator's. With 20 replays a frame
//! makes 21 visits, so a visit of one contact must stay under 15 ns at 3,000 contacts; 5 ns is
//! the aim. Frames hold random cells out of 25,000, the worst that caches can meet.
#![allow(missing_docs)] // criterion's macro generates undocumented functions

mod scene;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use palpate::EstimatorKind;

use scene::Learner;

fn correct(c: &mut Criterion) {
    for (name, method) in [("map", EstimatorKind::Map), ("ekf", EstimatorKind::Ekf)] {
        let mut group = c.benchmark_group(format!("estimator/{name}"));
        for n_contacts in [300, 3_000] {
            let mut learner = Learner::new(method, n_contacts, 400);
            group.throughput(Throughput::Elements(21 * n_contacts as u64)); // visits of a contact
            group.bench_function(BenchmarkId::from_parameter(n_contacts), |b| {
                b.iter(|| learner.learn());
            });
        }
        group.finish();
    }
}

criterion_group!(benches, correct);
criterion_main!(benches);
