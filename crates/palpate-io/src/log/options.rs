//! How a log is to be read.

use serde::{Deserialize, Serialize};

/// How to read a log.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogOptions {
    /// Which columns of a table to read; `None` recognises common spellings.
    pub columns: Option<CsvColumns>,
    /// Unit of the logged joint positions; `None` takes degrees where the name of a column says so, else radians.
    pub angle_unit: Option<AngleUnit>,
    /// Topic of a bag that holds the samples; `None` takes the only one that can be read.
    pub topic: Option<String>,
    /// Topic of a bag whose messages each start a touch.
    pub touch_topic: Option<String>,
    /// Joints of a bag to read, by name; `None` takes those of the message that has most.
    pub joints: Option<Vec<String>>,
    /// Starts a new touch where two samples lie further apart than this, s.
    pub split_gap_s: Option<f64>,
    /// Motions that are only planned are read, too: a CSV without torques has those of zero.
    pub planned: bool,
    /// Reads a bag that breaks off up to there, as if it ended.
    pub until_break: bool,
}

/// Unit of logged joint positions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngleUnit {
    /// Radians; prismatic joints in metres.
    #[default]
    Rad,
    /// Degrees, for every joint: a log of a robot with a prismatic joint must be in radians.
    Deg,
}

impl AngleUnit {
    /// Turns logged positions into radians.
    pub fn into_rad(self, q: &mut [f64]) {
        if self == Self::Deg {
            q.iter_mut().for_each(|angle| *angle = angle.to_radians());
        }
    }
}

/// Names of the columns of a table. Columns that it does not name are not read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CsvColumns {
    /// Joint positions, from the base to the tip.
    pub q: Vec<String>,
    /// Joint torques in the same order.
    pub tau: Vec<String>,
    /// Names of the joints in the same order, if they shall be matched to the robot's.
    pub joints: Option<Vec<String>>,
    /// Time, in the unit that follows from its name or the size of its first number; `a and b` for a column of seconds
    /// and one of nanoseconds.
    pub time: Option<String>,
    /// What changes from one touch to the next.
    pub touch: Option<String>,
}
