//! The four error figures of Table I for predicted touches, per touch and over all frames.

use std::path::PathBuf;

use palpate::Field;
use palpate_learn::bands::{Band, Coverage};
use palpate_learn::torque_errors::{ErrorSum, TorqueErrors};
use serde::Serialize;

use crate::forget::listed;
use crate::predict::{FrameResult, ReferenceTorque, TouchResult};
use crate::progress::Progress;

/// The figures of each touch and of all together; printed by `palpate predict --json`.
#[derive(Debug, Clone, Serialize)]
pub struct PredictionReport {
    /// The figures of each touch.
    pub touches: Vec<TouchErrors>,
    /// The figures of the frames of all touches together.
    pub overall: TouchErrors,
    /// The torques with which predictions were compared.
    pub against: ReferenceTorque,
    /// How often the bands contained the measured torque; `None` if the field has no bands, or predictions were
    /// compared with the truth.
    pub bands: Option<Coverage>,
}

/// Figures of one touch, or of all touches.
#[derive(Debug, Clone, Serialize)]
pub struct TouchErrors {
    /// Name of the touch; `None` for all touches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The log with the touch; `None` for all touches.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<PathBuf>,
    /// Whether these are the samples of a touch that the field remembers; of all touches, whether those of any are.
    /// False also if the field has forgotten the samples, or has no memory.
    pub learnt: bool,
    /// Number of scored frames.
    pub frames: u64,
    /// Number of frames in the log.
    pub frames_in_log: u64,
    /// Frames that are not scored, since the tare was taken from them.
    pub tare_frames: u64,
    /// Scored frames of at least 1 N·m, which have a relative error.
    pub relative_frames: u64,
    /// Scored frames in which the arm touched points of the lattice.
    pub frames_in_contact: u64,
    /// Scored frames in which the arm touched points that the field knows.
    pub frames_on_known: u64,
    /// Errors of the field.
    #[serde(flatten)]
    pub errors: ErrorFigures,
    /// Errors of predicting zero.
    pub zero: ErrorFigures,
}

/// The four figures; null where there are none.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ErrorFigures {
    /// Mean error, N·m.
    pub avg_error: Option<f64>,
    /// Largest error, N·m.
    pub max_error: Option<f64>,
    /// Mean relative error.
    pub avg_relative: Option<f64>,
    /// Largest relative error.
    pub max_relative: Option<f64>,
}

impl From<Option<TorqueErrors>> for ErrorFigures {
    fn from(errors: Option<TorqueErrors>) -> Self {
        Self {
            avg_error: errors.map(|e| e.avg_error),
            max_error: errors.map(|e| e.max_error),
            avg_relative: errors.and_then(|e| e.avg_relative),
            max_relative: errors.and_then(|e| e.max_relative),
        }
    }
}

impl TouchErrors {
    fn of(touches: &[TouchResult], one: Option<&TouchResult>) -> Self {
        let count = |are: fn(&FrameResult) -> bool| touches.iter().map(|t| t.count(are)).sum();
        let frames_in_log: u64 = touches.iter().map(|touch| touch.frames_in_log).sum();
        let mut field = ErrorSum::default();
        touches.iter().for_each(|touch| field.merge(&touch.errors()));
        Self {
            name: one.map(|touch| touch.name.clone()),
            log: one.map(|touch| touch.log.clone()),
            learnt: touches.iter().any(|touch| touch.learnt_as.is_some()),
            frames: field.frames(),
            frames_in_log,
            tare_frames: frames_in_log - field.frames(),
            relative_frames: field.relative_frames(),
            frames_in_contact: count(|frame| frame.contacts > 0),
            frames_on_known: count(|frame| frame.known > 0),
            errors: field.errors().into(),
            zero: field.zero().into(),
        }
    }
}

impl PredictionReport {
    /// The figures of all touches.
    pub fn new(results: &[TouchResult], (field, against): (&Field, ReferenceTorque)) -> Self {
        let touch = |touch| TouchErrors::of(std::slice::from_ref(touch), Some(touch));
        let touches = results.iter().map(touch).collect();
        let overall = TouchErrors::of(results, None);
        // Bands are for measured torques.
        let results = if against == ReferenceTorque::Measured { results } else { &[] };
        let bands: Vec<Band> = results.iter().filter_map(|touch| touch.band(field)).collect();
        let bands = Coverage::of(&bands.iter().collect::<Vec<_>>());
        Self { touches, overall, against, bands }
    }
}

/// Warns of touches whose errors say little, or are worse than those of predicting zero. With an elastic body, torques
/// are predicted even where no known point is touched.
pub fn report_oddities(results: &[TouchResult], field: &Field, progress: &dyn Progress) {
    let has_body = field.elastic.as_ref().is_some_and(|model| model.share > 0.0);
    let meets_known = |touch: &TouchResult| has_body || touch.count(|frame| frame.known > 0) > 0;
    if !results.iter().any(meets_known) {
        progress.warn(
            "no touch reaches a cell that is in the field: all predictions are those for untouched \
             cells; check that field, robot and log belong together",
        );
        return;
    }
    warn_of_learnt(results, progress);
    for touch in results {
        let sum = touch.errors();
        let worse = |(field, zero): (TorqueErrors, TorqueErrors)| field.avg_error > zero.avg_error;
        let odd = if touch.frames.is_empty() {
            " never leaves its contact-free start: nothing was scored"
        } else if touch.count(|frame| frame.contacts > 0) == 0 {
            " reaches no cell of the field's lattice"
        } else if !meets_known(touch) {
            " reaches no cell that is in the field"
        } else if sum.errors().zip(sum.zero()).is_some_and(worse) {
            ": the field is worse than predicting zero"
        } else {
            continue;
        };
        progress.warn(&format!("touch `{}`{odd}", touch.name));
    }
}

/// Warns of touches that the field has learnt: their errors are smaller than those of new touches.
fn warn_of_learnt(results: &[TouchResult], progress: &dyn Progress) {
    let learnt = |touch: &TouchResult| {
        let learnt_as = touch.learnt_as.as_ref()?;
        Some(format!("`{}` ({learnt_as})", touch.name))
    };
    let learnt: Vec<String> = results.iter().filter_map(learnt).collect();
    if !learnt.is_empty() {
        progress.warn(&format!(
            "the field has learned these touches, so their errors do not show how well it predicts new ones: {}",
            listed(&learnt)
        ));
    }
}
