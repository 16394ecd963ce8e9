//! Touches held in memory, and the passes through them.
//!
//! Reading files is not measured: the touches are read once before. They are not simulated, sorted
//! or changed in any way.

use std::time::Duration;

use clap::builder::RangedI64ValueParser;
use palpate::{MapperError, Sample};
use palpate_work::Progress;
use palpate_work::touches::RecordedTouch;

use crate::error::CliError;
use crate::output::Output;

/// How often the touches are learnt.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(super) struct Passes {
    /// Passes through the log before the clock starts
    #[arg(long = "warm-passes", value_name = "N", default_value_t = 1)]
    pub warm: u32,
    /// Passes through the log with the clock running
    #[arg(long = "passes", value_name = "N", default_value_t = 1, value_parser = at_least_one())]
    pub timed: u32,
}

/// A parser of numbers of passes or touches.
pub(super) fn at_least_one() -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..)
}

/// Learns touches, and measures its own time.
pub(super) trait Learner {
    /// A touch starts.
    fn begin_touch(&mut self);

    /// A sample follows; `timed` says whether the clock runs.
    fn step(&mut self, sample: &Sample, timed: bool) -> Result<(), MapperError>;

    /// The touch ends.
    fn end_touch(&mut self) -> Result<(), MapperError>;
}

/// Feeds the touches of all passes to a learner, until Ctrl-C.
pub(super) fn play(
    touches: &[RecordedTouch],
    passes: Passes,
    learner: &mut impl Learner,
    output: &Output,
    doing: &str,
) -> Result<(), CliError> {
    let samples: usize = touches.iter().map(|touch| touch.samples.len()).sum();
    let all = u64::from(passes.warm) + u64::from(passes.timed);
    let bar = output.begin(Some(samples as u64 * all), "frames", doing);
    for pass in 0..all {
        let timed = pass >= u64::from(passes.warm);
        for touch in touches {
            bar.at(&touch.name);
            learner.begin_touch();
            for (number, sample) in touch.samples.iter().enumerate() {
                if output.stopped() {
                    return Err(cut_short());
                }
                let place = || format!("touch `{}`, sample {number} (from 0)", touch.name);
                learner.step(sample, timed).map_err(|error| touch.fault(place(), error))?;
                bar.step();
            }
            let place = || format!("touch `{}`", touch.name);
            learner.end_touch().map_err(|error| touch.fault(place(), error))?;
        }
    }
    Ok(())
}

/// The error if Ctrl-C ends a measurement.
pub(super) fn cut_short() -> CliError {
    CliError::Interrupted { kept: "; an incomplete measurement is not printed".to_owned() }
}

/// A duration as a number, ms.
pub(super) fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
