//! Options for reading a log.

use serde::{Deserialize, Serialize};

/// Options for reading a log.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogOptions {
    /// Columns of a table to read; `None` recognises common spellings of their names.
    pub columns: Option<CsvColumns>,
    /// Unit of the logged joint positions; `None` means degrees where the name of a column says so, else radians.
    pub angle_unit: Option<AngleUnit>,
    /// Topic of a bag that holds the samples; `None` takes the only topic with a supported type.
    pub topic: Option<String>,
    /// Topic of a bag whose messages each start a touch.
    pub touch_topic: Option<String>,
    /// Joints of a bag to read, by name; `None` takes those of the message with the most joints.
    pub joints: Option<Vec<String>>,
    /// Largest time between two samples of one touch, s; a longer gap starts a new touch.
    pub split_gap_s: Option<f64>,
    /// Also reads planned motions: in a CSV without torques, all torques are zero.
    pub planned: bool,
    /// Reads a bag that breaks off up to the break, with a warning instead of an error.
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
    /// Converts logged positions to radians.
    pub fn into_rad(self, q: &mut [f64]) {
        if self == Self::Deg {
            q.iter_mut().for_each(|angle| *angle = angle.to_radians());
        }
    }
}

/// Names of the columns of a table that are read.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CsvColumns {
    /// Joint positions, from the base to the tip.
    pub q: Vec<String>,
    /// Joint torques in the same order.
    pub tau: Vec<String>,
    /// Names of the joints in the same order, to match them to the robot's joints.
    pub joints: Option<Vec<String>>,
    /// Time; its unit follows from the name or from the size of the first number. `a and b` names a column of seconds
    /// and a column of nanoseconds.
    pub time: Option<String>,
    /// Column whose value identifies the touch of each row.
    pub touch: Option<String>,
}
