//! Asks a field what torque a motion will meet, before it is made.
//!
//! Learns two bundled touches, then predicts a third that it has not seen, frame by frame, and
//! compares with the measured torque and with predicting zero. The data is simulated.
//!
//! Run it from the root of the project, where `data/plant_a` is.

use std::path::Path;
use std::sync::Arc;

use palpate::{EstimatorKind, Mapper, MapperConfig, Predictor, Sample};
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, load_arm};
use palpate_learn::torque_errors::{ErrorSum, TorqueErrors};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = Path::new("data/plant_a");
    let arm = Arc::new(load_arm("kinova_gen3", &ArmOptions::default())?.arm);
    let config = MapperConfig::of(EstimatorKind::Map);

    let mut mapper = Mapper::new(Arc::clone(&arm), config.clone())?;
    for touch in ["seq_002", "seq_008"] {
        mapper.begin_touch();
        for sample in samples(&data.join(touch))? {
            mapper.step(&sample)?;
        }
        mapper.end_touch()?;
    }

    // A predictor sees the same contacts as the mapper and changes nothing. Only the joint
    // positions matter for the prediction; the torques serve to see how good it is.
    let mut predictor = Predictor::new(arm, &mapper.field(), config.touch)?;
    predictor.begin_touch();
    let mut sum = ErrorSum::default();
    println!("frame  measured  predicted  (N·m, norm over the joints)");
    for (number, sample) in samples(&data.join("seq_003"))?.iter().enumerate() {
        let Some(said) = predictor.step(sample)? else { continue };
        sum.add(said.predicted.as_slice(), said.external.as_slice());
        if number % 40 == 0 {
            println!("{number:5} {:9.2} {:10.2}", said.external.norm(), said.predicted.norm());
        }
    }
    let relative =
        |errors: Option<TorqueErrors>| errors.and_then(|e| e.avg_relative).unwrap_or(f64::NAN);
    let (field, zero) = (relative(sum.errors()), relative(sum.zero()));
    println!("average relative error {field:.2}, of predicting zero {zero:.2}");
    assert!(field < zero, "a map must be better than no map");
    Ok(())
}

fn samples(touch: &Path) -> Result<Vec<Sample>, Box<dyn std::error::Error>> {
    let mut samples = Vec::new();
    for event in log::open(touch, &LogOptions::default())? {
        if let LogEvent::Sample(sample) = event? {
            samples.push(sample);
        }
    }
    Ok(samples)
}
