//! One motion of the contact simulator against its share of the step.
//!
//! A step has 3 ms (and is to reach 1 ms); half of it is the simulator's. A ball of 12 cm goes to
//! and fro through a full lattice, 2 mm a motion, as an arm at 20 Hz does: contacts stick, slip,
//! let go and are entered. The same with other lattices around it: the cost follows the contacts.
#![allow(missing_docs)] // criterion's macro generates undocumented functions

mod scene;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};

use scene::Ball;

fn advance(c: &mut Criterion) {
    let mut group = c.benchmark_group("contact/advance");
    for side in [50, 200, 1000] {
        let mut ball = Ball::new(side);
        let contacts: usize = (0..Ball::PERIOD).map(|_| ball.advance().len()).sum();
        group.throughput(Throughput::Elements((contacts / Ball::PERIOD) as u64));
        group.bench_function(BenchmarkId::from_parameter(format!("{side}^3")), |b| {
            b.iter(|| ball.advance());
        });
    }
    group.finish();
}

criterion_group!(benches, advance);
criterion_main!(benches);
