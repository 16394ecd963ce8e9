//! Touches of the bundled set, and fields of known stiffness.
#![allow(dead_code)] // every test file uses its own part
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

use std::path::Path;
use std::sync::Arc;

use palpate::unstable::{CellState, StiffnessRule};
use palpate::{Arm, EstimatorKind, Field, MapperConfig, Sample};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, load_arm};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};

/// Folder of the touches.
pub(crate) const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../data/plant_a");

/// Never stops what is tested.
pub(crate) const NEVER: &(dyn Fn() -> bool + Sync) = &|| false;

/// The arm of the touches.
pub(crate) fn arm() -> Arc<Arm> {
    Arc::new(load_arm("kinova_gen3", &ArmOptions::default()).unwrap().arm)
}

/// The touches with these numbers.
pub(crate) fn touches(numbers: &[usize]) -> Vec<TouchSamples> {
    let read = |number: &usize| {
        let name = format!("seq_{number:03}");
        let log = log::open(&Path::new(DATA).join(&name), &LogOptions::default());
        let samples: Vec<Sample> = (log.unwrap())
            .filter_map(|event| match event.unwrap() {
                LogEvent::Sample(sample) => Some(sample),
                LogEvent::TouchStarts { .. } => None,
            })
            .collect();
        TouchSamples { name, samples, truth: None }
    };
    numbers.iter().map(read).collect()
}

/// Some of the touches, every `every`th frame kept.
pub(crate) fn tracked(numbers: &[usize], every: usize) -> TrackedTouches {
    let config = MapperConfig::of(EstimatorKind::Map);
    TrackedTouches::new(&arm(), &config, &touches(numbers), NEVER).unwrap().thinned(every)
}

/// A field of all touched cells with the stiffness `k` by row, N/m.
pub(crate) fn field(tracked: &TrackedTouches, k: impl Fn(usize) -> f64) -> Field {
    let n = tracked.cells.len();
    let config = MapperConfig::of(EstimatorKind::Map);
    let mut field = Field::new(tracked.lattice.clone(), config.contact, config.touch, 0.0);
    field.cells.clone_from(&tracked.cells);
    field.stiffness_n_per_m = (0..n).map(k).collect();
    (field.std_n_per_m, field.counts) = (vec![1.0; n], vec![30; n]);
    field
}

/// Gives every frame the torque of a stiffness by row, N/m.
pub(crate) fn with_torques_of(
    mut tracked: TrackedTouches,
    k: impl Fn(usize) -> f64,
) -> TrackedTouches {
    let cell = |(row, &point): (usize, &[f64; 3])| CellState::new(point, k(row));
    let cells: Vec<CellState> = tracked.points_m.iter().enumerate().map(cell).collect();
    for frame in tracked.touches.iter_mut().flat_map(|touch| &mut touch.frames) {
        let tau = frame.observation.predict(&cells, StiffnessRule::Positive);
        frame.observation = frame.observation.clone().with_tau(&tau);
    }
    tracked
}
