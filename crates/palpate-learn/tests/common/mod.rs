//! Touches of the bundled set.
#![allow(clippy::unwrap_used)] // clippy takes only functions marked as tests for tests

use std::path::Path;
use std::sync::Arc;

use palpate::{Arm, Sample};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, load_arm};
use palpate_learn::tracked::TouchSamples;

/// Folder of the touches.
pub(crate) const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../data/plant_a");

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
