//! A log held in memory, and the passes through it.
//!
//! Reading files is no part of what is measured, so the touches are read once before. They are
//! not simulated, sorted or changed in any way.

use palpate::{MapperError, Sample};

use crate::error::CliError;
use crate::interrupt;
use crate::output::Output;
use crate::touches::{RecordedTouch, Touches};

/// The touches of a log, in its order.
pub(super) struct Recording {
    touches: Vec<RecordedTouch>,
}

/// How often a recording is learnt.
#[derive(Debug, Clone, Copy)]
pub(super) struct Passes {
    /// Before the clock starts.
    pub warm: u32,
    /// With the clock running.
    pub timed: u32,
}

/// What learns a recording and takes its own time.
pub(super) trait Learner {
    /// A touch starts.
    fn begin_touch(&mut self);

    /// A sample follows; `timed` says whether the clock runs.
    fn step(&mut self, sample: &Sample, timed: bool) -> Result<(), MapperError>;

    /// The touch ends.
    fn end_touch(&mut self) -> Result<(), MapperError>;
}

impl Recording {
    /// Reads all touches, or the first so many.
    pub(super) fn read(log: &mut Touches, most: Option<u32>) -> Result<Self, CliError> {
        let touches = log.read(most)?;
        Ok(Self { touches })
    }

    /// Its touches in order.
    pub(super) fn each(&self) -> &[RecordedTouch] {
        &self.touches
    }

    /// How many touches it holds.
    pub(super) fn touches(&self) -> usize {
        self.touches.len()
    }

    /// Lets a learner have all passes, until Ctrl-C.
    pub(super) fn play(
        &self,
        passes: Passes,
        learner: &mut impl Learner,
        output: &Output,
        doing: &str,
    ) -> Result<(), CliError> {
        let samples: usize = self.touches.iter().map(|touch| touch.samples.len()).sum();
        let all = u64::from(passes.warm) + u64::from(passes.timed);
        let bar = output.progress(Some(samples as u64 * all), doing);
        for pass in 0..all {
            let timed = pass >= u64::from(passes.warm);
            for touch in &self.touches {
                bar.set_message(touch.name.clone());
                learner.begin_touch();
                for (number, sample) in touch.samples.iter().enumerate() {
                    if interrupt::pressed() {
                        bar.finish_and_clear();
                        let kept = "; a measurement cut short says nothing".to_owned();
                        return Err(CliError::Interrupted { kept });
                    }
                    let place = || format!("touch `{}`, sample {number} (from 0)", touch.name);
                    learner.step(sample, timed).map_err(|error| touch.fault(place(), error))?;
                    bar.inc(1);
                }
                let place = || format!("touch `{}`", touch.name);
                learner.end_touch().map_err(|error| touch.fault(place(), error))?;
            }
        }
        bar.finish_and_clear();
        Ok(())
    }
}
