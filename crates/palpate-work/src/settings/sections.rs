//! The settings, section by section: every field is a key of the settings file and a flag.
//!
//! A field that is `None` was not given. Its help is the flag's, and the comment of the key in
//! what `palpate settings` prints. Ranges are not checked here: each is checked by the module of
//! the core that it belongs to, so that Python and the command refuse the same values.

use std::path::PathBuf;

use clap::Args;
use palpate::{EstimatorKind, Gravity, TorqueSign};
use palpate_io::log::{AngleUnit, CsvColumns};
use serde::{Deserialize, Serialize};

use super::parse::{TareFrames, columns, counts3, named, vector3};

/// Which arm it was, and what it carried.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Robot")]
pub struct RobotSettings {
    /// URDF file, or the name of a built-in robot [default: kinova_gen3]
    #[arg(long, value_name = "URDF|NAME")]
    pub robot: Option<String>,
    /// Folder of ROS packages for `package://` paths of meshes; may be given several times
    #[arg(long, value_name = "DIR")]
    pub package_path: Option<Vec<PathBuf>>,
    /// Folder that keeps baked meshes [default: palpate in the user's cache folder]
    #[arg(long, value_name = "DIR")]
    pub cache_dir: Option<PathBuf>,
    /// Bake meshes afresh and keep nothing
    #[arg(
        long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
        require_equals = true
    )]
    pub no_cache: Option<bool>,
    /// Spacing of baked signed distances, m [default: 0.005]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub bake_spacing_m: Option<f64>,
    /// Link that carries a payload the URDF does not know of: a gripper, a tool, a camera
    #[arg(long, value_name = "LINK")]
    pub payload_link: Option<String>,
    /// Mass of the payload, kg
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub payload_mass_kg: Option<f64>,
    /// Centre of mass of the payload in its link's frame, m [default: 0,0,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
    pub payload_com_m: Option<[f64; 3]>,
}

/// How logs are read.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Log")]
pub struct LogSettings {
    /// Unit of logged joint positions [default: rad]
    #[arg(long, value_name = "UNIT", value_parser = named::<AngleUnit>(&["rad", "deg"]))]
    pub angle_unit: Option<AngleUnit>,
    /// Columns of a CSV log, where their names do not tell: q=a,b;tau=c,d;time=t;touch=n (the last
    /// two if there are any); in a file columns = { q = ["a", "b"], tau = ["c", "d"], time = "t" }
    #[arg(long, value_name = "MAP", value_parser = columns)]
    pub columns: Option<CsvColumns>,
    /// Topic of a bag that holds the joints [default: the only one that does]
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Topic of a bag on which each message starts a touch; text in it names the touch [default:
    /// /palpate/touch, if there is one]
    #[arg(long, value_name = "TOPIC")]
    pub touch_topic: Option<String>,
    /// Joints of a bag to read, by name; messages without them are left out [default: those of the
    /// message that has most]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub joints: Option<Vec<String>>,
    /// Read a bag that breaks off up to there, as if it ended
    #[arg(
        long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
        require_equals = true
    )]
    pub until_break: Option<bool>,
    /// Start a new touch wherever two samples lie further apart than this, s
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub split_gap_s: Option<f64>,
    /// Start a new touch whenever the arm has stood still for a while and touches nothing
    #[arg(
        long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
        require_equals = true
    )]
    pub split_idle: Option<bool>,
    /// How long the arm must stand still for that, s; where samples have no time, 25 of them
    /// [default: 0.5]
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub idle_s: Option<f64>,
}

/// How logged torques become external ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Torques")]
pub struct TouchSettings {
    /// Sign of logged torques: `plus` if they are what gravity and the object exert on the
    /// joints, `minus` if they are what the motors exert [default: plus]
    #[arg(long, value_name = "SIGN", value_parser = named::<TorqueSign>(&["plus", "minus"]))]
    pub torque_sign: Option<TorqueSign>,
    /// Whether logged torques still hold gravity [default: included]
    #[arg(long, value_name = "STATE", value_parser = named::<Gravity>(&["included", "removed"]))]
    pub gravity: Option<Gravity>,
    /// Frames at the start of each touch whose mean torque is taken off, or `auto` to find the
    /// contact-free start [default: auto]
    #[arg(long, value_name = "N|auto")]
    pub tare_frames: Option<TareFrames>,
    /// Take off no tare: the torques are external ones already
    #[arg(
        long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
        require_equals = true, conflicts_with = "tare_frames"
    )]
    pub no_tare: Option<bool>,
    /// Farthest that a joint moves and still counts as standing still, rad (m for a prismatic
    /// joint) [default: 0.002]
    #[arg(long, value_name = "RAD", allow_negative_numbers = true)]
    pub still_rad: Option<f64>,
}

/// The workspace box and its points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Lattice")]
pub struct LatticeSettings {
    /// Distance between neighbouring points, m [default: 0.012]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub spacing_m: Option<f64>,
    /// Low corner of the workspace box in the robot's base frame, m [default: -1.2,-1.2,-1.2]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
    pub box_low_m: Option<[f64; 3]>,
    /// High corner of the workspace box in the robot's base frame, m [default: 1.2,1.2,1.2]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
    pub box_high_m: Option<[f64; 3]>,
    /// First point of the lattice, m; with `shape`, in place of the box
    #[arg(
        long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true,
        conflicts_with_all = ["box_low_m", "box_high_m"]
    )]
    pub origin_m: Option<[f64; 3]>,
    /// Points along x, y and z; with `origin_m`, in place of the box
    #[arg(
        long, value_name = "NX,NY,NZ", value_parser = counts3,
        conflicts_with_all = ["box_low_m", "box_high_m"]
    )]
    pub shape: Option<[u32; 3]>,
}

/// The contact model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Contact")]
pub struct ContactSettings {
    /// How far from its surface a link takes hold of a point, m [default: 0.024]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub contact_distance_m: Option<f64>,
    /// Tangential over normal displacement at which a point begins to slip [default: 0.3]
    #[arg(long, value_name = "MU", allow_negative_numbers = true)]
    pub friction: Option<f64>,
    /// Farthest that a point slips in one iteration, m [default: 0.006]
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub slip_step_m: Option<f64>,
    /// Slip iterations of one motion; 0 makes points stick [default: 10]
    #[arg(long, value_name = "N")]
    pub slip_iterations: Option<u32>,
    /// Farthest that a link moves in one sub-step, in cells [default: 0.5]
    #[arg(long, value_name = "CELLS", allow_negative_numbers = true)]
    pub substep_cells: Option<f64>,
    /// Whether points inside the arm at the start of a touch are empty space [default: true]
    #[arg(long, value_name = "BOOL")]
    pub known_empty: Option<bool>,
}

/// The estimator, its prior and its memory.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[command(next_help_heading = "Estimator")]
pub struct EstimatorSettings {
    /// `map`, the exact maximum a posteriori, or `ekf`, the paper's filter; each has its own
    /// defaults for the keys below [default: map]
    #[arg(long, value_name = "NAME", value_parser = named::<EstimatorKind>(&EstimatorKind::ALL.map(EstimatorKind::name)))]
    pub estimator: Option<EstimatorKind>,
    /// Stiffness of an untouched cell of 1 cm, N/m; scales with the spacing cubed
    /// [default: 0.0 for map, 0.006 for ekf]
    #[arg(long, value_name = "N_PER_M", allow_negative_numbers = true)]
    pub prior_mean: Option<f64>,
    /// Standard deviation of an untouched cell of 1 cm, N/m; scales with the spacing to the 1.5
    /// [default: 0.76]
    #[arg(long, value_name = "N_PER_M", allow_negative_numbers = true)]
    pub prior_std: Option<f64>,
    /// Torque that the model may leave unexplained, N·m: one value, or one for each joint
    /// [default: 0.2 for map, 1.5 for ekf]
    #[arg(long, value_name = "N_M", value_delimiter = ',', allow_hyphen_values = true)]
    pub torque_std: Option<Vec<f64>>,
    /// How much a cell of 1 cm may change in a step, N/m; `ekf` only [default: 0.0]
    #[arg(long, value_name = "N_PER_M", allow_negative_numbers = true)]
    pub drift_std: Option<f64>,
    /// Remembered frames visited again after each new one [default: 20]
    #[arg(long, value_name = "N")]
    pub replays: Option<u32>,
    /// Frames remembered at most [default: 20000]
    #[arg(long, value_name = "N")]
    pub memory_frames: Option<usize>,
    /// Memory of the remembered frames at most, MiB [default: 256]
    #[arg(long, value_name = "MIB")]
    pub memory_mib: Option<usize>,
    /// Seed of the draws from memory [default: 0]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
}
