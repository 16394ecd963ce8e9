//! Touches into a mapper, and what is told of it.

use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::DVector;
use palpate::mapper::{Mapper, StepReport};
use palpate_learn::errors::{ErrorSum, Errors};
use serde::Serialize;

use crate::error::CliError;
use crate::interrupt;
use crate::output::Output;
use crate::pace::Pace;
use crate::touches::{Moment, Touches};

/// What one touch gave.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct TouchTally {
    /// Its name.
    pub name: String,
    /// The log that it is in.
    pub log: PathBuf,
    /// Frames in the log.
    pub frames: u64,
    /// Frames that its tare was taken from.
    pub tare_frames: u64,
    /// Frames in which the arm touched points of the lattice.
    pub frames_in_contact: u64,
}

/// What all touches gave.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub touches: Vec<TouchTally>,
    contacts: Vec<usize>,
    predicted: ErrorSum,
    zero: ErrorSum,
    /// Where Ctrl-C stopped it.
    pub interrupted: Option<String>,
}

/// Errors beside those of predicting zero.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Beside {
    #[serde(flatten)]
    pub errors: Option<Errors>,
    pub zero: Option<Errors>,
}

impl TouchTally {
    fn new(name: String, log: &Path) -> Self {
        let log = log.to_owned();
        Self { name, log, frames: 0, tare_frames: 0, frames_in_contact: 0 }
    }
}

impl Tally {
    fn add(&mut self, report: &StepReport) {
        let touch = self.touches.last_mut().expect("samples come after the start of a touch");
        touch.frames += 1;
        touch.frames_in_contact += u64::from(report.contacts > 0);
        if report.contacts > 0 {
            self.contacts.push(report.contacts);
        }
        match (&report.predicted, &report.external) {
            (Some(predicted), Some(external)) => {
                self.predicted.add(predicted, external);
                self.zero.add(&DVector::zeros(external.len()), external);
            }
            _ => touch.tare_frames += 1,
        }
    }

    /// A sum over touches.
    pub(crate) fn total(&self, of: impl Fn(&TouchTally) -> u64) -> u64 {
        self.touches.iter().map(of).sum()
    }

    /// Median points touched, over the frames that touched any.
    pub(crate) fn contacts_median(&self) -> usize {
        let mut contacts = self.contacts.clone();
        let middle = contacts.len() / 2;
        if contacts.is_empty() { 0 } else { *contacts.select_nth_unstable(middle).1 }
    }

    /// Errors of predicting every frame just before it was learnt from.
    pub(crate) fn before_learning(&self) -> Beside {
        Beside { errors: self.predicted.errors(), zero: self.zero.errors() }
    }
}

/// Feeds all touches to the mapper, at a pace if there is one, until Ctrl-C.
pub(crate) fn learn(
    mapper: &mut Mapper,
    touches: &mut Touches,
    pace: Option<&mut Pace>,
    output: &Output,
) -> Result<Tally, CliError> {
    let tally = feed(mapper, touches, pace, output)?;
    if tally.interrupted.is_none() {
        touches.tell_warnings(output);
        tell_oddities(&tally, output);
    }
    Ok(tally)
}

/// The loop over all samples, which calls [`Mapper::step`] in a row.
fn feed(
    mapper: &mut Mapper,
    touches: &mut Touches,
    mut pace: Option<&mut Pace>,
    output: &Output,
) -> Result<Tally, CliError> {
    let mut tally = Tally::default();
    let bar = output.progress(touches.samples(), "learning");
    while let Some(moment) = touches.advance()? {
        if interrupt::pressed() {
            tally.interrupted = Some(touches.place());
            bar.finish_and_clear();
            return Ok(tally);
        }
        match moment {
            Moment::Touch(name) => {
                finish_touch(mapper, &tally)?;
                mapper.begin_touch();
                bar.set_message(name.clone());
                tally.touches.push(TouchTally::new(name, touches.log()));
            }
            Moment::Sample(sample) => {
                let started = Instant::now();
                let report = mapper.step(&sample).map_err(|error| touches.fault(error))?;
                if let Some(pace) = &mut pace {
                    pace.fill(mapper, &report, started);
                }
                tally.add(&report);
                bar.inc(1);
            }
        }
    }
    finish_touch(mapper, &tally)?;
    bar.finish_and_clear();
    Ok(tally)
}

/// Ends the touch that was begun last, if any was.
fn finish_touch(mapper: &mut Mapper, tally: &Tally) -> Result<(), CliError> {
    match tally.touches.last() {
        Some(touch) => mapper.end_touch().map_err(|source| CliError::Touch {
            log: touch.log.clone(),
            place: format!("touch `{}`", touch.name),
            source: Box::new(source),
        }),
        None => Ok(()),
    }
}

fn tell_oddities(tally: &Tally, output: &Output) {
    for touch in &tally.touches {
        let name = &touch.name;
        if touch.frames_in_contact == 0 {
            output.note(&format!(
                "touch `{name}` touches no point of the lattice and taught nothing; check \
                 --robot, the joints' unit and the workspace box"
            ));
        } else if touch.tare_frames == touch.frames {
            output.note(&format!(
                "touch `{name}` never leaves its contact-free start and taught nothing; is the \
                 arm moving in it?"
            ));
        }
    }
}
