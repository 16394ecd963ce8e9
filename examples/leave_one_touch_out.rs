//! Prints, for any folder of touches, how well each estimator predicts touches it has not seen.
//!
//! ```text
//! cargo run --release -p palpate-learn --example leave_one_touch_out -- data/plant_a
//! ```
//!
//! Every touch is predicted from a field learnt on all the others with the shipped settings of
//! the robot `kinova_gen3`. Errors count from the tare on, against `truth/` where the folder has
//! it and against the measured external torque otherwise; the table gives their mean over the
//! touches. With `--each` every touch has its line.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use palpate::arm::Arm;
use palpate::estimator::Method;
use palpate::mapper::Config;
use palpate_io::log::{self, LogEvent, LogOptions};
use palpate_io::robot_files::{ArmOptions, load_arm};
use palpate_learn::errors::{ErrorSum, Errors};
use palpate_learn::evaluate::{Score, Touch, leave_one_touch_out};

fn main() -> Result<(), Box<dyn Error>> {
    let (flags, folders): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|argument| argument.starts_with("--"));
    if folders.is_empty() || flags.iter().any(|flag| flag != "--each") {
        return Err("usage: leave_one_touch_out [--each] FOLDER...".into());
    }
    let arm = Arc::new(load_arm("kinova_gen3", &ArmOptions::default())?.arm);
    println!("{:34} {:>10} {:>10} {:>10} {:>10}", "", "avg N·m", "max N·m", "avg rel", "max rel");
    for folder in &folders {
        let touches = read(Path::new(folder))?;
        let against = if touches[0].truth.is_some() { "truth" } else { "measured" };
        println!("{folder}: {} touches, against {against} torques", touches.len());
        for method in [Method::Map, Method::Ekf] {
            let scores = evaluate(&arm, method, &touches)?;
            print(&format!("{method:?}").to_lowercase(), &scores, |score| score.field);
            if flags.is_empty() {
                continue;
            }
            for score in &scores {
                print(&format!("  {}", score.name), std::slice::from_ref(score), |s| s.field);
            }
        }
        let scores = evaluate_zero(&arm, &touches)?;
        print("predicting zero", &scores, |score| score.zero);
    }
    Ok(())
}

fn evaluate(
    arm: &Arc<Arm>,
    method: Method,
    touches: &[Touch],
) -> Result<Vec<Score>, Box<dyn Error>> {
    Ok(leave_one_touch_out(arm, &Config::of(method), touches, || eprint!("."))?)
}

/// Predicting zero needs no learning: a field that knows nothing is scored on every touch.
fn evaluate_zero(arm: &Arc<Arm>, touches: &[Touch]) -> Result<Vec<Score>, Box<dyn Error>> {
    let config = Config::of(Method::Map);
    let field = palpate_learn::evaluate::learn(arm, &config, [])?.field();
    let score = |touch| palpate_learn::evaluate::score(arm, &config, &field, touch);
    Ok(touches.iter().map(score).collect::<Result<_, _>>()?)
}

/// Reads all touches of a folder, with the truth where it is there.
fn read(folder: &Path) -> Result<Vec<Touch>, Box<dyn Error>> {
    let mut touches: Vec<Touch> = Vec::new();
    for event in log::open(folder, &LogOptions::default())? {
        match event? {
            LogEvent::TouchStarts { name, .. } => {
                let truth = log::external_truth(folder, &name)?;
                touches.push(Touch { name, samples: Vec::new(), truth });
            }
            LogEvent::Sample(sample) => {
                let touch = touches.last_mut().ok_or("a sample came before its touch")?;
                touch.samples.push(sample);
            }
        }
    }
    Ok(touches)
}

/// A line of the table: means over the touches.
fn print(name: &str, scores: &[Score], pick: impl Fn(&Score) -> ErrorSum) {
    let all: Vec<Errors> = scores.iter().filter_map(|score| pick(score).errors()).collect();
    let mean = |value: &dyn Fn(&Errors) -> Option<f64>| {
        let values: Vec<f64> = all.iter().filter_map(value).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    eprint!("\r");
    println!(
        "  {name:32} {:10.3} {:10.3} {:10.3} {:10.3}",
        mean(&|errors| Some(errors.avg_error)),
        mean(&|errors| Some(errors.max_error)),
        mean(&|errors| errors.avg_relative),
        mean(&|errors| errors.max_relative),
    );
}
