//! Settings of a path, and how long it may be.

use serde::{Deserialize, Serialize};

use super::PathError;
use crate::setting::SettingError;

/// How closely a path is evaluated, and where it starts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct PathConfig {
    /// Largest motion of a point of the arm from one stop to the next, in cells; with 0, every point is a stop.
    pub resolution_cells: f64,
    /// Largest distance, in cells, between the first point of the path and the position of the arm in the last sample
    /// of a touch, for the path to continue from the contacts there.
    pub start_cells: f64,
    /// Whether points that the links cover at the start of a path count as pushed out to the nearest surface, without
    /// friction, if the path does not continue from the contacts of the arm. Otherwise
    /// [`crate::ContactConfig::known_empty`] applies: by default they are empty space.
    pub inside: bool,
}

impl PathConfig {
    /// Settings with these values, with `inside` false.
    pub const fn new(resolution_cells: f64, start_cells: f64) -> Self {
        Self { resolution_cells, start_cells, inside: false }
    }

    /// Checks every setting.
    pub(super) fn check(&self) -> Result<(), PathError> {
        let (check, wanted) = (SettingError::check, "from 0 to 1000 cells");
        check("resolution_cells", self.resolution_cells, 0.0..=1e3, wanted)?;
        Ok(check("start_cells", self.start_cells, 0.0..=1e3, wanted)?)
    }
}

impl Default for PathConfig {
    fn default() -> Self {
        Self::new(1.0, 1.0)
    }
}

/// Largest number of points of a path.
pub const MAX_POINTS: usize = 100_000;

/// Largest number of stops, and of sub-steps, of a path; they take a few seconds.
pub(super) const MAX_STOPS: usize = 10_000;

/// Largest number of waypoints (stops and sub-steps together) of a path that bends an elastic body; they take some ten
/// seconds.
pub(super) const MAX_BODY_STOPS: usize = 2_000;
