//! Why a path cannot be predicted.

use super::MAX_POINTS;
use crate::motion::MotionError;
use crate::robot::RobotError;
use crate::setting::SettingError;

/// Why a path cannot be predicted. Points are counted from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum PathError {
    /// A setting outside its range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A path without points.
    #[error("the path has no points; give at least one, of a position for each joint")]
    Empty,
    /// More points than one path may have.
    #[error("the path has {found} points, more than {MAX_POINTS}; divide it into shorter paths")]
    TooManyPoints { found: usize },
    /// Invalid joint positions.
    #[error("point {point} of the path: {reason}")]
    Point { point: usize, reason: RobotError },
    /// A motion that is too long between two points.
    #[error(
        "joint `{joint}` jumps from {from} to {to} on the way to point {point} of the path; a \
         motion this long cannot be followed: are points missing, or are the positions in another unit?"
    )]
    Jump { point: usize, joint: String, from: f64, to: f64 },
    /// More motion than one path may have.
    #[error(
        "up to point {point} the path has more than {most} stops or sub-steps; divide it into shorter \
         paths, or choose a coarser resolution"
    )]
    TooLong { point: usize, most: usize },
}

impl PathError {
    pub(super) fn at(point: usize, error: MotionError) -> Self {
        match error {
            MotionError::Robot(reason) => Self::Point { point, reason },
            MotionError::Jump { joint, from, to } => Self::Jump { point, joint, from, to },
        }
    }
}
