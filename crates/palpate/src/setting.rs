//! The error for a setting outside its range, used by all modules.

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
    /// The error for one setting.
    pub(crate) fn new(setting: &'static str, found: f64, wanted: &'static str) -> Self {
        Self { setting, found, wanted }
    }
}
