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
    /// Unit of the logged times of tables and arrays, whatever the name of their column says; `None` takes it from
    /// the name, else from the size of the times and their steps. Bags, dates and a time in two columns, of seconds
    /// and nanoseconds, have a known unit.
    pub time_unit: Option<TimeUnit>,
    /// Topic of a bag that holds the samples; `None` takes the only topic with a supported type.
    pub topic: Option<String>,
    /// Topic of a bag whose messages each start a touch.
    pub touch_topic: Option<String>,
    /// Joints of a bag to read, by name; `None` takes those of the message with the most joints.
    pub joints: Option<Vec<String>>,
    /// Largest time between two samples of one touch, s; a longer gap starts a new touch.
    pub split_gap_s: Option<f64>,
    /// Reads measured torques, with gravity, from messages of a bag that hold external torques as well.
    pub measured_torques: bool,
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

/// Unit of logged times.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// Units per second.
    pub fn per_s(self) -> f64 {
        match self {
            Self::S => 1.0,
            Self::Ms => 1e3,
            Self::Us => 1e6,
            Self::Ns => 1e9,
        }
    }
}

impl std::fmt::Display for TimeUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::S => "s",
            Self::Ms => "ms",
            Self::Us => "us",
            Self::Ns => "ns",
        })
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
