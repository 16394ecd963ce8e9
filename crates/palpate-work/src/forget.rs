//! Removes touches from a field: the others are learnt again.

use std::sync::Arc;

use palpate::unstable::LoggedTouch;
use palpate::{Arm, Field, Mapper, Predictor};
use palpate_io::field::SavedField;

use crate::contact_counts::low_and_high;
use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::SettingsError;

/// Which touches are forgotten: each that meets at least one of the conditions.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TouchSelection {
    /// Touches with one of these names, or one of these numbers from 0, such as `#3`.
    pub names: Vec<String>,
    /// All but this many of the newest remembered touches.
    pub older_than: Option<usize>,
    /// Touches that displaced a point in this box, even one without stiffness: two opposite corners, m, world frame.
    pub touched_box_m: Option<[[f64; 3]; 2]>,
}

/// Names in one line; of more than 20, the first ten, the last and their number.
pub fn listed(names: &[String]) -> String {
    match names {
        [] => "none".to_owned(),
        [first @ .., last] if names.len() > 20 => {
            format!("{} … {last} ({} touches)", first[..10].join(", "), names.len())
        }
        _ => names.join(", "),
    }
}

/// Number and name of a touch of a field, such as `#3 push`.
pub(crate) fn name(touch: &LoggedTouch) -> String {
    format!("{} {}", number(touch), touch.name).trim_end().to_owned()
}

fn number(touch: &LoggedTouch) -> String {
    format!("#{}", touch.touch)
}

/// A mapper that has learnt only the other touches of a field, and the names of the forgotten ones. `field_name` is the
/// name of the field in errors.
///
/// # Errors
///
/// If there are no such touches, or not all others can be learnt again, or the progress stops it.
pub fn forget(
    arm: &Arc<Arm>,
    (saved, field_name): (&SavedField, &str),
    which: &TouchSelection,
    progress: &dyn Progress,
) -> Result<(Mapper, Vec<String>), WorkError> {
    let field = &saved.field;
    if field.elastic.is_some() {
        return Err(WorkError::Usage(format!(
            "`{field_name}` holds an elastic body, which cannot forget; map the remaining logs again with \
             --estimator elastic"
        )));
    }
    let Some(snapshot) = &saved.snapshot else {
        return Err(WorkError::Usage(format!(
            "`{field_name}` was saved without its memory, so it cannot forget; map the remaining logs again"
        )));
    };
    let cannot = |error: &dyn std::fmt::Display| {
        WorkError::from(format!("`{field_name}` cannot forget: {error}"))
    };
    let log = &snapshot.sample_log;
    let mut forgotten = vec![false; log.len()];
    for wanted in &which.names {
        let mut any = false;
        for (touch, forgotten) in log.iter().zip(&mut forgotten) {
            let is_meant = touch.name == *wanted || number(touch) == *wanted;
            *forgotten |= is_meant;
            any |= is_meant;
        }
        if !any {
            let names: Vec<String> = log.iter().map(name).collect();
            return Err(WorkError::Usage(format!(
                "`{field_name}` remembers no touch `{wanted}`; it remembers {}",
                listed(&names)
            )));
        }
    }
    if let Some(newest) = which.older_than {
        let older = log.len().saturating_sub(newest);
        forgotten[..older].fill(true);
    }
    if let Some(corners) = which.touched_box_m.map(low_and_high) {
        for (touch, forgotten) in log.iter().zip(&mut forgotten) {
            *forgotten = *forgotten || touches(arm, field, (touch, snapshot.n_joints), corners)?;
        }
    }
    let meant = || log.iter().zip(&forgotten).filter(|(_, forgotten)| **forgotten).map(|own| own.0);
    let names: Vec<String> = meant().map(name).collect();
    if names.is_empty() && which.older_than.is_none() {
        return Err(WorkError::Usage(format!("`{field_name}` remembers no such touch")));
    }
    let numbers: Vec<u32> = meant().map(|touch| touch.touch).collect();
    let kept = log.iter().zip(&forgotten).filter(|(_, forgotten)| !**forgotten);
    let samples: usize = kept.map(|(touch, _)| touch.q.len() / snapshot.n_joints.max(1)).sum();
    let bar = progress.begin(Some(samples as u64), "frames", "learning the other touches again");
    let step = || {
        bar.step();
        !progress.stopped()
    };
    let mapper = Mapper::without(Arc::clone(arm), snapshot, &numbers, step);
    match mapper.map_err(|error| cannot(&error))? {
        Some(mapper) => Ok((mapper, names)),
        None => Err(WorkError::Interrupted { kept: "; nothing was written".to_owned() }),
    }
}

/// Whether a touch displaced a point in a box.
fn touches(
    arm: &Arc<Arm>,
    field: &Field,
    (touch, n_joints): (&LoggedTouch, usize),
    [low, high]: [[f64; 3]; 2],
) -> Result<bool, WorkError> {
    let mut predictor = Predictor::new(Arc::clone(arm), field, field.touch.clone())
        .map_err(SettingsError::value)?;
    predictor.begin_touch();
    for sample in touch.samples(n_joints) {
        let step = predictor.step(&sample);
        step.map_err(|error| WorkError::from(format!("touch `{}`: {error}", name(touch))))?;
        let contacts = predictor.contacts();
        let mut cells = contacts.links.iter().flat_map(|link| link.cells.iter());
        let is_inside = |cell: &palpate::CellId| {
            let point = field.lattice.point(*cell);
            (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
        };
        if cells.any(is_inside) {
            return Ok(true);
        }
    }
    Ok(false)
}
