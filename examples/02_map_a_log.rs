//! From a log to a field: maps touches of a Kinova Gen3 and saves the field.
//!
//! Usage: `02_map_a_log [LOG [FIELD.npz]]`; without a log, run it from the root of the project, whose
//! bundled touches are simulated. Of any log it takes the first three touches to be quick.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{EstimatorKind, Mapper, MapperConfig};
use palpate_io::field::{SavedField, save};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, load_arm};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let log = arguments.next().unwrap_or("data/plant_a".into());
    let output = arguments.next().unwrap_or(std::env::temp_dir().join("palpate_example_field.npz"));

    // An arm is a robot with the distance field of each link; the settings are the shipped ones.
    let arm = Arc::new(load_arm("kinova_gen3", &ArmOptions::default())?.arm);
    let mut mapper = Mapper::new(Arc::clone(&arm), MapperConfig::of(EstimatorKind::Map))?;

    // One sample in, one report out. The first still frames of a touch are its tare.
    let (mut touches, mut frames) = (0, 0);
    for event in log::open(&log, &LogOptions::default())? {
        match event? {
            LogEvent::TouchStarts { .. } if touches == 3 => break,
            LogEvent::TouchStarts { name, .. } => {
                println!("touch {name}");
                mapper.begin_touch();
                touches += 1;
            }
            LogEvent::Sample(sample) => {
                let report = mapper.step(&sample)?;
                if let (Some(measured), Some(expected)) = (report.external, report.predicted) {
                    frames += 1;
                    if frames % 100 == 0 {
                        let error = (expected - &measured).norm();
                        let contacts = report.contacts;
                        let measured = measured.norm();
                        println!(
                            "  {contacts:5} contacts, {measured:.2} N·m measured, {error:.2} off"
                        );
                    }
                }
            }
        }
    }
    mapper.end_touch()?;

    let field = mapper.field();
    let stiffest = field.stiffness_n_per_m.iter().copied().fold(0.0, f64::max);
    println!("{} cells touched, the stiffest {stiffest:.1} N/m", field.cells.len());
    save(&output, &SavedField::of_mapper(&mapper))?;
    println!("saved to {}", output.display());
    Ok(())
}
