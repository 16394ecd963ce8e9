//! One motion of the contact simulator against its share of the step.
//!
//! A step has 3 ms (and is to reach 1 ms); half of it is the simulator's. A ball of 12 cm goes to
//! and fro through a full lattice, 2 mm a motion, as an arm at 20 Hz does: contacts stick, slip,
//! let go and are entered. The same with other lattices around it: the cost follows the contacts.
#![allow(missing_docs, clippy::unwrap_used)] // criterion's macro generates undocumented functions

use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Isometry3, Point3};
use palpate::contact::{Config, Simulator};
use palpate::lattice::Lattice;
use palpate::robot::{Collision, Shape};
use palpate::sdf::{self, Solid};

fn ball() -> Arc<Vec<Option<sdf::Grid>>> {
    let shape = Shape::Sphere { radius_m: 0.12 };
    let mut solid = Solid::default();
    solid.primitives.push(Collision { link_from_shape: Isometry3::identity(), shape });
    Arc::new(vec![Some(sdf::bake(&solid, &sdf::Config::default()).unwrap().0)])
}

/// Where the ball is in motion `step`: to and fro over 12 cm.
fn pose(step: usize) -> [Isometry3<f64>; 1] {
    let phase = step % 120;
    let x = 0.002 * (if phase < 60 { phase } else { 120 - phase }) as f64;
    [Isometry3::translation(x, 0.3 * x, 0.0)]
}

fn advance(c: &mut Criterion) {
    let mut group = c.benchmark_group("contact/advance");
    let surfaces = ball();
    for side in [50, 200, 1000] {
        let half_m = 0.012 * f64::from(side - 1) / 2.0;
        let lattice = Lattice::new(Point3::from([-half_m; 3]).into(), 0.012, [side; 3]).unwrap();
        let config = Config { ..Config::default() };
        let mut simulator = Simulator::new(lattice, Arc::clone(&surfaces), config).unwrap();
        simulator.begin_touch(&pose(0));
        let contacts: usize = (1..=120).map(|step| simulator.advance(&pose(step)).len()).sum();
        group.throughput(Throughput::Elements(contacts as u64 / 120));
        let mut step = 0;
        group.bench_function(BenchmarkId::from_parameter(format!("{side}^3")), |b| {
            b.iter(|| {
                step += 1;
                simulator.advance(&pose(step))
            });
        });
    }
    group.finish();
}

criterion_group!(benches, advance);
criterion_main!(benches);
