//! Learns touches with a mapper, and reports what it has learnt.

use std::path::PathBuf;
use std::time::Instant;

use palpate::{Mapper, Sample, StepReport};
use palpate_learn::torque_errors::ErrorSum;
use serde::Serialize;
use serde_json::json;

use crate::contact_counts::ContactCounts;
use crate::error::WorkError;
use crate::inspect::log::LogCheck;
use crate::prediction_report::ErrorFigures;
use crate::progress::Progress;
use crate::touches::{TouchEvent, Touches};

/// Counts of one touch.
#[derive(Debug, Clone, Serialize)]
pub struct TouchSummary {
    /// Name of the touch.
    pub name: String,
    /// The log with the touch.
    pub log: PathBuf,
    /// Frames in the log.
    pub frames: u64,
    /// Frames from which the tare was taken.
    pub tare_frames: u64,
    /// Frames in which the arm touched points of the lattice.
    pub frames_in_contact: u64,
}

/// Counts and errors of all touches.
#[derive(Debug, Default)]
pub struct LearningSummary {
    /// The touches in their order.
    pub touches: Vec<TouchSummary>,
    touched: ContactCounts,
    predicted: ErrorSum,
    /// Place in the logs where learning was stopped, if it was.
    pub interrupted: Option<String>,
}

/// Errors of the field, with those of predicting zero for comparison.
#[derive(Debug, Clone, Serialize)]
pub struct ErrorsAndZero {
    /// Errors of the field.
    #[serde(flatten)]
    pub errors: ErrorFigures,
    /// Errors of predicting zero on the same frames.
    pub zero: ErrorFigures,
}

impl LearningSummary {
    /// Counts a sample; if it was passed over, `report` is that of the sample before.
    fn add(&mut self, report: &StepReport, is_new: bool) {
        let touch = self.touches.last_mut().expect("samples come after the start of a touch");
        touch.frames += 1;
        touch.frames_in_contact += u64::from(report.contacts > 0);
        self.touched.add(report.contacts);
        match (&report.predicted, &report.external) {
            (Some(predicted), Some(external)) if is_new => {
                self.predicted.add(predicted.as_slice(), external.as_slice());
            }
            (Some(_), Some(_)) => {}
            _ => touch.tare_frames += 1,
        }
    }

    /// Sum of a count over all touches.
    pub fn total(&self, of: impl Fn(&TouchSummary) -> u64) -> u64 {
        self.touches.iter().map(of).sum()
    }

    /// Median number of touched points, over the frames with contact.
    pub fn contacts_median(&self) -> usize {
        self.touched.contacts_median()
    }

    /// All figures of a run as JSON; `mapper` is the mapper that has learnt.
    pub fn figures(&self, mapper: &Mapper) -> serde_json::Value {
        let (config, cells) = (mapper.config(), CellCounts::of(mapper));
        let (frames_remembered, bytes) = mapper.memory();
        json!({
            "robot": mapper.arm().robot.name(),
            "estimator": config.method,
            "touches": self.touches,
            "frames": self.total(|touch| touch.frames),
            "tare_frames": self.total(|touch| touch.tare_frames),
            "frames_in_contact": self.total(|touch| touch.frames_in_contact),
            "contacts_median": self.contacts_median(),
            "cells_touched": cells.touched,
            "cells_expected": cells.expected,
            "cells_expected_and_touched": cells.expected_and_touched,
            "cells_declared": config.lattice.n_cells(),
            "frames_remembered": frames_remembered,
            "memory_mib": bytes as f64 / f64::from(1 << 20),
            "before_learning": self.before_learning(),
        })
    }

    /// Errors of predicting every learnt frame just before it was learnt from.
    pub fn before_learning(&self) -> ErrorsAndZero {
        let [errors, zero] = [self.predicted.errors(), self.predicted.zero()];
        ErrorsAndZero { errors: errors.into(), zero: zero.into() }
    }
}

/// Numbers of touched cells, and of cells with a prior mean of their own.
#[derive(Debug, Clone, Copy)]
pub struct CellCounts {
    /// Touched cells.
    pub touched: usize,
    /// Cells with a prior mean of their own, touched or not.
    pub expected: usize,
    /// Cells with a prior mean of their own that were touched.
    pub expected_and_touched: usize,
}

impl CellCounts {
    /// Counts the cells of a mapper.
    pub fn of(mapper: &Mapper) -> Self {
        let (counts, expected) = (mapper.field().counts, mapper.prior_means_n_per_m().len());
        let touched = |counts: &[u32]| counts.iter().filter(|&&count| count > 0).count();
        let expected_and_touched = touched(&counts[..expected]); // the first rows
        Self { touched: touched(&counts), expected, expected_and_touched }
    }
}

/// Function that is called after every sample.
pub type AfterStep<'a> = &'a mut dyn FnMut(&mut Mapper, &StepReport, Instant);

/// Feeds all touches to the mapper, until the progress stops it.
///
/// `after_step` is called after every sample with the mapper, the report of the step and its start time. The samples of
/// every touch are appended to `record`.
///
/// # Errors
///
/// If a log is broken, or a sample cannot be used. The mapper has then learnt everything before it.
pub fn learn(
    mapper: &mut Mapper,
    touches: &mut Touches,
    after_step: AfterStep<'_>,
    record: Option<&mut Vec<Vec<Sample>>>,
    progress: &dyn Progress,
) -> Result<LearningSummary, WorkError> {
    let config = mapper.config();
    let place = (config.lattice.clone(), config.contact.clone());
    let mut check = touches.check(mapper.arm(), place, &config.touch);
    match learn_from(mapper, touches, (after_step, record), (&mut check, progress)) {
        Ok(tally) => {
            touches.report_warnings(progress);
            if tally.interrupted.is_none() {
                // A body may be learnt from a picture, without any log.
                if tally.touches.is_empty() && touches.has_logs() {
                    let log = touches.log().display();
                    return Err(WorkError::from(format!(
                        "`{log}`: no sample is left to learn from; with --split-idle the arm must stand still once \
                         before it moves"
                    )));
                }
                check.check(progress)?;
            }
            Ok(tally)
        }
        Err(error) => {
            check.explain(progress);
            Err(error)
        }
    }
}

fn learn_from(
    mapper: &mut Mapper,
    touches: &mut Touches,
    (after_step, mut record): (AfterStep<'_>, Option<&mut Vec<Vec<Sample>>>),
    (check, progress): (&mut LogCheck, &dyn Progress),
) -> Result<LearningSummary, WorkError> {
    let (mut tally, mut last) = (LearningSummary::default(), None::<StepReport>);
    let bar = progress.begin(touches.samples(), "frames", "learning");
    while let Some(event) = touches.advance()? {
        if progress.stopped() {
            tally.interrupted = Some(touches.place());
            return Ok(tally);
        }
        match event {
            TouchEvent::Touch(name) => {
                finish_touch(mapper, &tally, progress)?;
                check.begin(&name, touches, progress)?;
                mapper.begin_touch();
                mapper.name_touch(&name);
                bar.at(&name);
                let log = touches.log().to_owned();
                let touch =
                    TouchSummary { name, log, frames: 0, tare_frames: 0, frames_in_contact: 0 };
                tally.touches.push(touch);
                record.iter_mut().for_each(|touches| touches.push(Vec::new()));
            }
            TouchEvent::Sample(sample) => {
                let started = Instant::now();
                let step = mapper.step_if_learnt(&sample);
                let found = step.as_ref().map(|own| own.as_ref().or(last.as_ref()));
                check.add(&sample, found.ok().flatten().map_or(0, |report| report.contacts));
                let step = step.map_err(|error| touches.fault(error))?;
                let is_new = step.is_some();
                last = step.or(last);
                let report = last.as_ref().expect("the first sample of a touch is not passed over");
                after_step(mapper, report, started);
                tally.add(report, is_new);
                if let Some(touch) = record.as_mut().and_then(|touches| touches.last_mut()) {
                    touch.push(sample);
                }
                bar.step();
            }
        }
    }
    finish_touch(mapper, &tally, progress)?;
    Ok(tally)
}

/// Ends the present touch, if there is one, and warns if the field has learnt from the same samples before.
fn finish_touch(
    mapper: &mut Mapper,
    tally: &LearningSummary,
    progress: &dyn Progress,
) -> Result<(), WorkError> {
    let Some(touch) = tally.touches.last() else { return Ok(()) };
    if let Some(number) = mapper.repeated_touch() {
        let (log, name) = (touch.log.display(), &touch.name);
        progress.warn(&format!(
            "`{log}`: touch `{name}` has the same samples as touch #{number}, which the field has learned already, so \
             they count twice now; `palpate forget FIELD.npz --touch '#{number}' -o OTHER.npz` removes the earlier touch"
        ));
    }
    mapper
        .end_touch()
        .map_err(|source| WorkError::touch(&touch.log, format!("touch `{}`", touch.name), source))
}
