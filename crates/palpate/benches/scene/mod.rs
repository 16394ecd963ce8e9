//! What the benches measure: the same scenes for wall time (criterion) and for instruction counts.
//!
//! Everything is seeded and serial, so that a scene is the same on every run and machine.
#![allow(dead_code)] // every bench is a program of its own and needs only some of the scenes
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use std::sync::Arc;

use nalgebra::{DVector, Isometry3, Point3, vector};
use palpate::unstable::{
    CellRows, Collision, ContactSimulator, DistanceGrid, EkfEstimator, Estimator, FrameId,
    LinkContacts, LinkId, MapEstimator, Observation, Shape, Solid, bake,
};
use palpate::{
    BakeConfig, CellId, ContactConfig, Contacts, EstimatorConfig, EstimatorKind, Lattice, Robot,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

fn baked(shape: Shape) -> DistanceGrid {
    let part = Collision { link_from_shape: Isometry3::identity(), shape };
    let solid = Solid { primitives: vec![part], meshes: vec![] };
    bake(&solid, &BakeConfig::default()).unwrap().0
}

/// The skin of a forearm.
pub(crate) fn boxed_link() -> DistanceGrid {
    baked(Shape::Box { size_m: vector![0.09, 0.09, 0.3] })
}

/// Points around [`boxed_link`] as a contact search visits them: scattered, within the grid.
pub(crate) fn scattered_points(n: usize) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut uniform =
        |half: f64| (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half;
    (0..n).map(|_| Point3::new(uniform(0.07), uniform(0.07), uniform(0.17))).collect()
}

/// A ball of 12 cm that goes to and fro through a full lattice, 2 mm a motion.
pub(crate) struct Ball {
    simulator: ContactSimulator,
    step: usize,
}

impl Ball {
    /// Motions until the ball is back where it was.
    pub(crate) const PERIOD: usize = 120;

    /// A ball in the middle of `side`³ points, 1.2 cm apart.
    pub(crate) fn new(side: u32) -> Self {
        let half_m = 0.012 * f64::from(side - 1) / 2.0;
        let lattice = Lattice::new([-half_m; 3], 0.012, [side; 3]).unwrap();
        let surfaces = Arc::new(vec![Some(baked(Shape::Sphere { radius_m: 0.12 }))]);
        let config = ContactConfig::default();
        let mut simulator = ContactSimulator::new(lattice, surfaces, &config).unwrap();
        simulator.begin_touch(&Self::pose(0));
        Self { simulator, step: 0 }
    }

    /// Makes the next motion.
    pub(crate) fn advance(&mut self) -> Contacts {
        self.step += 1;
        self.simulator.advance(&Self::pose(self.step))
    }

    /// Where the ball is in motion `step`: to and fro over 12 cm.
    fn pose(step: usize) -> [Isometry3<f64>; 1] {
        let phase = step % Self::PERIOD;
        let x = 0.002 * phase.min(Self::PERIOD - phase) as f64;
        [Isometry3::translation(x, 0.3 * x, 0.0)]
    }
}

/// An estimator that learns the same frames over and over, each with 20 replays.
///
/// Frames hold random cells out of 25,000, the worst that caches can meet.
pub(crate) struct Learner {
    estimator: Box<dyn Estimator>,
    rows: CellRows,
    frames: Vec<Observation>,
    sample: u32,
}

impl Learner {
    /// An estimator that has learnt each of `n_frames` frames of `n_contacts` once.
    pub(crate) fn new(method: EstimatorKind, n_contacts: usize, n_frames: usize) -> Self {
        let robot = gen3();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut rows = CellRows::new(Lattice::new([-0.3; 3], 0.012, [50; 3]).unwrap());
        let config = EstimatorConfig::of(method);
        let estimator: Box<dyn Estimator> = match method {
            EstimatorKind::Map | EstimatorKind::Elastic => {
                Box::new(MapEstimator::new(&config, 0.012, 7).unwrap())
            }
            EstimatorKind::Ekf => Box::new(EkfEstimator::new(&config, 0.012, 7).unwrap()),
        };
        let mut random_frame = |_| frame(&robot, &mut rows, &mut rng, n_contacts);
        let frames = (0..n_frames).map(&mut random_frame).collect();
        let mut learner = Self { estimator, rows, frames, sample: 0 };
        (0..n_frames).for_each(|_| learner.learn());
        learner
    }

    /// Learns the next frame.
    pub(crate) fn learn(&mut self) {
        let frame = self.frames[self.sample as usize % self.frames.len()].clone();
        let source = FrameId { touch: 0, sample: self.sample };
        self.estimator.correct(self.rows.points_m(), frame, source).unwrap();
        self.estimator.replay(20);
        self.sample += 1;
    }
}

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
    Observation::new(robot, &poses, &contacts, rows, &tau)
}

/// The built-in arm of seven joints.
pub(crate) fn gen3() -> Robot {
    Robot::built_in("kinova_gen3").unwrap()
}
