//! One new frame with 20 replays, against its share of the step.
//!
//! A step has 3 ms (and is to reach 1 ms); half of it is the estimator's. With 20 replays a frame
//! makes 21 visits, so a visit of one contact must stay under 15 ns at 3,000 contacts; 5 ns is
//! the aim. Frames hold random cells out of 25,000, the worst that caches can meet.
#![allow(missing_docs, clippy::unwrap_used)] // criterion's macro generates undocumented functions

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::DVector;
use palpate::contact::{Contacts, LinkContacts};
use palpate::ekf::EkfEstimator;
use palpate::estimator::{Estimator, EstimatorConfig, Method, Source};
use palpate::lattice::{CellId, CellRows, Lattice};
use palpate::map::MapEstimator;
use palpate::robot::{LinkId, Robot};
use palpate::torque::Observation;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A frame of the Gen3 whose last four links touch random cells.
fn frame(robot: &Robot, rows: &mut CellRows, rng: &mut ChaCha8Rng, n: usize) -> Observation {
    let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX) - 0.5;
    let q: Vec<f64> = (0..robot.n_joints()).map(|_| 2.0 * uniform()).collect();
    let poses = robot.forward(&q).unwrap();
    let n_links = 4;
    let links = (0..n_links).map(|link| {
        let stride = 25_000 / n as u32;
        let offset = rng.next_u32() % stride;
        let cells =
            (0..n as u32).filter(|i| i % n_links == link).map(|i| CellId(i * stride + offset));
        let cells: Vec<CellId> = cells.collect();
        let displacement =
            |_: &CellId| [(); 3].map(|()| 0.02 * (rng.next_u32() as f32 / u32::MAX as f32));
        let displacements_m = cells.iter().map(displacement).collect();
        LinkContacts { link: LinkId(4 + link as u16), cells, displacements_m }
    });
    let contacts = Contacts { links: links.collect() };
    let tau = DVector::from_element(robot.n_joints(), 0.3);
    Observation::new(robot, &poses, &contacts, rows, tau)
}

fn correct(c: &mut Criterion) {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    for (name, method) in [("map", Method::Map), ("ekf", Method::Ekf)] {
        let mut group = c.benchmark_group(format!("estimator/{name}"));
        for n in [300, 3_000] {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let mut rows = CellRows::new(Lattice::new([-0.3; 3], 0.012, [50; 3]).unwrap());
            let config = EstimatorConfig::of(method);
            let mut estimator: Box<dyn Estimator> = match method {
                Method::Map => Box::new(MapEstimator::new(&config, 0.012, 7).unwrap()),
                Method::Ekf => Box::new(EkfEstimator::new(&config, 0.012, 7).unwrap()),
            };
            let frames: Vec<_> = (0..400).map(|_| frame(&robot, &mut rows, &mut rng, n)).collect();
            let mut sample = 0;
            let mut learn = |estimator: &mut Box<dyn Estimator>| {
                let source = Source { touch: 0, sample };
                let frame = frames[sample as usize % frames.len()].clone();
                estimator.correct(rows.points_m(), frame, source).unwrap();
                estimator.replay(20);
                sample += 1;
            };
            (0..400).for_each(|_| learn(&mut estimator));
            group.throughput(Throughput::Elements(21 * n as u64)); // visits of one contact
            group.bench_function(BenchmarkId::from_parameter(n), |b| {
                b.iter(|| learn(&mut estimator));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, correct);
criterion_main!(benches);
