//! The error for a setting outside its range, used by all modules.

use std::ops::RangeInclusive;

/// A setting outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{setting} is {found}; it must be {wanted}")]
#[non_exhaustive]
pub struct SettingError {
    /// The setting's name.
    pub setting: &'static str,
    /// Its value.
    pub found: f64,
    /// The allowed range, with its unit.
    pub wanted: &'static str,
}

impl SettingError {
    /// Checks that a setting is in its range; NaN is in none.
    pub(crate) fn check(
        setting: &'static str,
        found: f64,
        range: RangeInclusive<f64>,
        wanted: &'static str,
    ) -> Result<(), Self> {
        if range.contains(&found) { Ok(()) } else { Err(Self { setting, found, wanted }) }
    }
}
