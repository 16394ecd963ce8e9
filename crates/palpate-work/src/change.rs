//! Whether touches of logs contradict a field, and what has changed.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, ExternalTorqueConfig, Field, MapperConfig};
use palpate_learn::change::{self, Comparison};
use palpate_learn::tracked::Tracked;
use serde::Serialize;

use crate::error::WorkError;
use crate::evaluate::{as_touches, fault};
use crate::progress::Progress;
use crate::touches::Touches;

/// What `palpate compare --json` prints.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// One by one.
    pub touches: Vec<OfTouch>,
    /// All of them.
    pub together: Comparison,
}

/// A touch beside the field.
#[derive(Debug, Clone, Serialize)]
pub struct OfTouch {
    /// Its name.
    pub name: String,
    /// The log that it is in.
    pub log: PathBuf,
    /// How it compares.
    #[serde(flatten)]
    pub comparison: Comparison,
}

/// Compares the touches of logs with a field; `touch` says what their torques mean.
///
/// # Errors
///
/// If a log is broken, a sample cannot be used, the field has no bands, or the progress stops it.
pub fn compare(
    arm: &Arc<Arm>,
    field: &Field,
    touch: ExternalTorqueConfig,
    mut touches: Touches,
    progress: &dyn Progress,
) -> Result<Report, WorkError> {
    if field.elastic.is_some() {
        progress.note("the field's springs are compared, not its elastic body");
    }
    let mut config = MapperConfig::of(palpate::EstimatorKind::Map);
    (config.lattice, config.contact) = (field.lattice.clone(), field.contact.clone());
    config.touch = touch;
    let place = (config.lattice.clone(), config.contact.clone());
    let recorded = touches.read(None)?;
    touches.tell_warnings(progress);
    touches.check(arm, place, &config.touch).of(&recorded).look(progress)?;
    let named = as_touches(&recorded, false)?;
    let stop = || progress.stopped();
    let _bar = progress.begin(None, "touches", "comparing");
    let compared = Tracked::new(arm, &config, &named, &stop)
        .and_then(|tracked| change::compare(&tracked, field, &stop));
    let (each, together) = compared.map_err(|error| fault(&recorded, error, String::new()))?;
    let touches = recorded.into_iter().zip(each);
    let touches = touches
        .map(|(touch, comparison)| OfTouch { name: touch.name, log: touch.log, comparison })
        .collect();
    Ok(Report { touches, together })
}
