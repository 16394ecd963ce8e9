//! Whether touches of logs contradict a field, and what has changed.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::unstable::LoggedTouch;
use palpate::{Arm, ExternalTorqueConfig, MapperConfig, Snapshot};
use palpate_io::field::SavedField;
use palpate_learn::LearnError;
use palpate_learn::calibrate::PredictedFrame;
use palpate_learn::change::{self, Comparison};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use serde::Serialize;

use crate::elastic::predicted_with_body;
use crate::error::WorkError;
use crate::evaluate::{fault, touch_samples};
use crate::forget;
use crate::progress::Progress;
use crate::touches::Touches;

/// Result of [`compare`], printed by `palpate compare --json`.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonReport {
    /// Result of each touch.
    pub touches: Vec<TouchComparison>,
    /// Result of all touches together.
    pub together: Comparison,
}

/// A touch, compared with the field.
#[derive(Debug, Clone, Serialize)]
pub struct TouchComparison {
    /// Name of the touch.
    pub name: String,
    /// The log with the touch.
    pub log: PathBuf,
    /// Result of the comparison.
    #[serde(flatten)]
    pub comparison: Comparison,
}

/// The touches in a field's memory, tracked again under `config`, but with the field's own torque convention.
fn learnt(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    snapshot: &Snapshot,
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<TrackedTouches, LearnError> {
    let mut config = config.clone();
    config.touch = snapshot.config.touch.clone();
    let whole = snapshot.sample_log.iter().filter(|touch| !touch.lost && !touch.q.is_empty());
    let touch = |logged: &LoggedTouch| TouchSamples {
        name: forget::name(logged),
        samples: logged.samples(snapshot.n_joints).collect(),
        truth: None,
    };
    TrackedTouches::new(arm, &config, &whole.map(touch).collect::<Vec<_>>(), stop)
}

/// The predictions for the tracked frames in contact, by touch, from those for all samples.
fn in_contact(
    tracked: &TrackedTouches,
    mut samples: Vec<Vec<Option<PredictedFrame>>>,
) -> Vec<Vec<PredictedFrame>> {
    let frames = tracked.touches.iter().zip(&mut samples).map(|(touch, samples)| {
        touch.in_contact().filter_map(|frame| samples[frame.sample as usize].take()).collect()
    });
    frames.collect()
}

/// Compares the touches of logs with a field; `touch` is the convention of their torques. Touches that repeat a touch
/// of the field's memory are compared with that touch, too.
///
/// # Errors
///
/// If a log is broken, a sample cannot be used, the field has no bands, or the progress stops it.
pub fn compare(
    arm: &Arc<Arm>,
    SavedField { field, snapshot, .. }: &SavedField,
    touch: ExternalTorqueConfig,
    mut touches: Touches,
    progress: &dyn Progress,
) -> Result<ComparisonReport, WorkError> {
    let mut config = MapperConfig::of(palpate::EstimatorKind::Map);
    (config.lattice, config.contact) = (field.lattice.clone(), field.contact.clone());
    config.touch = touch;
    let place = (config.lattice.clone(), config.contact.clone());
    let recorded = touches.read(None)?;
    touches.report_warnings(progress);
    touches.check(arm, place, &config.touch).of(&recorded).check(progress)?;
    let named = touch_samples(&recorded, false)?;
    let stop = || progress.stopped();
    let _bar = progress.begin(None, "touches", "comparing");
    let learnt = snapshot.as_ref().map(|snapshot| learnt(arm, &config, snapshot, &stop));
    let learnt = match learnt {
        Some(Ok(learnt)) => Some(learnt),
        Some(Err(LearnError::Stopped)) => {
            return Err(WorkError::Interrupted { kept: String::new() });
        }
        Some(Err(error)) => {
            progress
                .note(&format!("the touches that the field remembers are not compared: {error}"));
            None
        }
        None => None,
    };
    let fault = |error| fault(&recorded, error, String::new());
    change::comparable(field, arm.robot.n_joints()).map_err(fault)?;
    let tracked = TrackedTouches::new(arm, &config, &named, &stop).map_err(fault)?;
    let with_body = match field.elastic {
        Some(_) => {
            let given = (arm, field);
            let samples = predicted_with_body(given, &config.touch, &named, (&stop, &|| ()));
            Some(in_contact(&tracked, samples.map_err(fault)?))
        }
        None => None,
    };
    let compared = change::compare((arm, &tracked), (field, with_body), learnt.as_ref(), &stop);
    let (each, together) = compared.map_err(fault)?;
    let touches = recorded.into_iter().zip(each);
    let touches = touches
        .map(|(touch, comparison)| TouchComparison { name: touch.name, log: touch.log, comparison })
        .collect();
    Ok(ComparisonReport { touches, together })
}
