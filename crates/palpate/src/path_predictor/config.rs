//! Settings of a path, and how long it may be.

use serde::{Deserialize, Serialize};

use super::PathError;
use crate::setting::SettingError;

/// How closely a path is evaluated, and where it starts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct PathConfig {
    /// The farthest that a point of the arm goes from one stop to the next, in cells; 0 stops at
    /// every point.
    pub resolution_cells: f64,
    /// The farthest that a point of the arm may be from where it was in the last sample of a touch
    /// for the path to go on from there, in cells.
    pub start_cells: f64,
    /// Whether what the links cover at the first point of a path that does not go on counts as pushed out to the
    /// nearest surface, without friction; otherwise the contact model says what it is, mostly empty space.
    pub inside: bool,
}

impl PathConfig {
    /// Stops every `resolution_cells`; goes on from where the arm is if no farther than `start_cells`.
    pub const fn new(resolution_cells: f64, start_cells: f64) -> Self {
        Self { resolution_cells, start_cells, inside: false }
    }

    /// Checks every setting.
    pub(super) fn check(&self) -> Result<(), PathError> {
        let settings =
            [("resolution_cells", self.resolution_cells), ("start_cells", self.start_cells)];
        match settings.into_iter().find(|(_, found)| !(0.0..=1e3).contains(found)) {
            Some((setting, found)) => {
                Err(SettingError::new(setting, found, "from 0 to 1000 cells").into())
            }
            None => Ok(()),
        }
    }
}

impl Default for PathConfig {
    fn default() -> Self {
        Self::new(1.0, 1.0)
    }
}

/// Points of a path at most.
pub const MAX_POINTS: usize = 100_000;

/// Stops and sub-steps of a path at most, each: a few seconds.
pub const MAX_MOTIONS: usize = 10_000;

/// Waypoints (stops and sub-steps together) at most of a path that bends an elastic body: some ten seconds.
pub const MAX_BODY_MOTIONS: usize = 2_000;
