//! Every setting, once: its key in the settings file, its flag, its help, and the field of the core's
//! configuration that it sets.
//!
//! A key that is `None` was not given. Its doc comment is the help of the flag, and the comment of the key in the file
//! that `palpate settings` prints; a test compares the defaults in it with those of the core. Ranges are checked by the
//! modules of the core, not here, so that Python and the command refuse the same values.

use std::path::PathBuf;

use clap::Args;
use palpate::{
    ContactConfig, EstimatorConfig, EstimatorKind, ExternalTorqueConfig, Gravity, TorqueSign,
};
use palpate_io::log::{AngleUnit, CsvColumns, LogOptions, TimeUnit};
use palpate_io::robot_files::ArmOptions;
use serde::{Deserialize, Serialize};

use super::values::{
    HeldJoint, OrAuto, RenamedJoint, TareFrames, columns, counts3, from_word, named, vector3,
};

/// All settings; those that are not given are `None`.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// The robot and its payload.
    #[command(flatten)]
    pub robot: RobotSettings,
    /// How logs are read.
    #[command(flatten)]
    pub log: LogSettings,
    /// How logged torques become external torques.
    #[command(flatten)]
    pub touch: TouchSettings,
    /// The workspace box.
    #[command(flatten)]
    pub lattice: LatticeSettings,
    /// The contact model.
    #[command(flatten)]
    pub contact: ContactSettings,
    /// The estimator.
    #[command(flatten)]
    pub estimator: EstimatorSettings,
}

impl From<RobotSettings> for Settings {
    fn from(robot: RobotSettings) -> Self {
        Self { robot, ..Self::default() }
    }
}

impl From<LogSettings> for Settings {
    fn from(log: LogSettings) -> Self {
        Self { log, ..Self::default() }
    }
}

/// A section of the settings.
pub(crate) trait Section: Sized {
    /// The configuration of the core that some of the keys are fields of, if there is one.
    type Config;

    /// Every key as given here, or else as given in `lower`.
    fn or(self, lower: Self) -> Self;

    /// Sets the fields of `config` whose keys were given.
    fn set(&self, config: &mut Self::Config);

    /// Sets the keys that have a field in `config` to its value.
    fn take(&mut self, config: &Self::Config);
}

/// Declares a section: `pub KEY: TYPE => FIELD` is a key, with the field of the configuration (named
/// after `of`) that it sets.
macro_rules! section {
    (
        $(#[$about:meta])*
        pub struct $section:ident of $config:ty {
            $($(#[$help:meta])* pub $key:ident: $value:ty $(=> $($field:ident).+)?,)*
        }
    ) => {
        #[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        $(#[$about])*
        pub struct $section {
            $($(#[$help])* pub $key: Option<$value>,)*
        }

        #[allow(unused_variables)] // of sections without fields
        impl Section for $section {
            type Config = $config;

            fn or(self, lower: Self) -> Self {
                Self { $($key: self.$key.or(lower.$key),)* }
            }

            fn set(&self, config: &mut $config) {
                $($(if let Some(value) = &self.$key {
                    config.$($field).+ = value.clone().into();
                })?)*
            }

            fn take(&mut self, config: &$config) {
                $($(self.$key = config.$($field).+.clone().into();)?)*
            }
        }
    };
}

section! {
    /// The robot and its payload.
    #[command(next_help_heading = "Robot")]
    pub struct RobotSettings of ArmOptions {
        /// URDF file, or the name of a built-in robot [default: kinova_gen3]
        #[arg(long, value_name = "URDF|NAME")]
        pub robot: String,
        /// Folder of ROS packages for `package://` paths of meshes; may be given several times
        #[arg(long, value_name = "DIR")]
        pub package_path: Vec<PathBuf> => package_path,
        /// Folder that keeps baked meshes [default: palpate in the user's cache folder]
        #[arg(long, value_name = "DIR")]
        pub cache_dir: PathBuf,
        /// Bake meshes again and store nothing in the cache
        #[arg(
            long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
            require_equals = true
        )]
        pub no_cache: bool,
        /// Spacing of baked signed distances, m [default: 0.005]
        #[arg(long, value_name = "M")]
        pub bake_spacing_m: f64 => bake.spacing_m,
        /// Joints that are not in the logs and stand still, with their positions, rad or m
        /// [default: fingers that are missing in a log, in the middle of their range]
        #[arg(long, value_name = "JOINT=POSITION", value_delimiter = ',', value_parser = from_word::<HeldJoint>)]
        pub hold: Vec<HeldJoint>,
        /// Names of joints in the logs that differ from those in the URDF; results have the names of the logs
        #[arg(long, value_name = "LOG=URDF", value_delimiter = ',', value_parser = from_word::<RenamedJoint>)]
        pub rename: Vec<RenamedJoint>,
        /// File of the identified arm from `palpate identify`: the torques of its masses, friction and bias are
        /// subtracted from the logged torques, and torques count less where its noise is larger
        #[arg(long, value_name = "ARM.toml")]
        pub arm: PathBuf,
        /// Link that carries a payload which is not in the URDF: a gripper, a tool, a camera
        #[arg(long, value_name = "LINK")]
        pub payload_link: String,
        /// Mass of the payload, kg
        #[arg(long, value_name = "KG")]
        pub payload_mass_kg: f64,
        /// Centre of mass of the payload in its link's frame, m [default: 0,0,0]
        #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
        pub payload_com_m: [f64; 3],
    }
}

section! {
    /// How logs are read.
    #[command(next_help_heading = "Log")]
    pub struct LogSettings of LogOptions {
        /// Unit of logged joint positions; `auto` takes it from the names of columns, or else from the data
        /// [default: auto]
        #[arg(long, value_name = "UNIT", value_parser = named::<OrAuto<AngleUnit>>(&["auto", "rad", "deg"]))]
        pub angle_unit: OrAuto<AngleUnit>,
        /// Unit of logged times in tables and arrays; `auto` takes it from the name of the column, or else from the
        /// data [default: auto]
        #[arg(
            long, value_name = "UNIT",
            value_parser = named::<OrAuto<TimeUnit>>(&["auto", "s", "ms", "us", "ns"])
        )]
        pub time_unit: OrAuto<TimeUnit>,
        /// Columns of a CSV log, if their names do not say what they are: q=a,b;tau=c,d;time=t;touch=n (the
        /// last two if there are any); in a settings file columns = { q = ["a", "b"], tau = ["c", "d"],
        /// time = "t" }. In a log without a header, by column numbers from 1
        #[arg(long, value_name = "MAP", value_parser = columns)]
        pub columns: CsvColumns => columns,
        /// Topic with the joint states in a bag [default: the only such topic]
        #[arg(long, value_name = "TOPIC")]
        pub topic: String => topic,
        /// Topic of a bag on which each message starts a touch; text in it names the touch
        /// [default: /palpate/touch, if there is one]
        #[arg(long, value_name = "TOPIC")]
        pub touch_topic: String => touch_topic,
        /// Joints of a bag to read, by name; messages without them are left out
        /// [default: those of the message with most joints]
        #[arg(long, value_name = "NAMES", value_delimiter = ',')]
        pub joints: Vec<String> => joints,
        /// Read a truncated bag up to where it breaks off, as if it ended there
        #[arg(
            long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
            require_equals = true
        )]
        pub until_break: bool => until_break,
        /// End with an error, not with a warning, if a log looks wrong (see `palpate inspect`)
        #[arg(
            long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
            require_equals = true
        )]
        pub strict: bool,
        /// Start a new touch where two samples are farther apart than this, s
        #[arg(long, value_name = "S")]
        pub split_gap_s: f64 => split_gap_s,
        /// Start a new touch where the arm stands still for --idle-s and touches nothing
        #[arg(
            long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
            require_equals = true
        )]
        pub split_idle: bool,
        /// How long the arm must stand still for --split-idle, s; if samples have no times, for 25 samples
        /// [default: 0.5]
        #[arg(long, value_name = "S")]
        pub idle_s: f64,
    }
}

section! {
    /// How logged torques become external torques.
    #[command(next_help_heading = "Torques")]
    pub struct TouchSettings of ExternalTorqueConfig {
        /// Sign of logged torques: `plus` if they are what gravity and the object exert on the
        /// joints, `minus` if they are what the motors exert, `auto` to find out from the log [default: auto]
        #[arg(long, value_name = "SIGN", value_parser = named::<OrAuto<TorqueSign>>(&["auto", "plus", "minus"]))]
        pub torque_sign: OrAuto<TorqueSign>,
        /// Whether logged torques contain gravity; `auto` to find out from the log [default: auto]
        #[arg(
            long, value_name = "STATE",
            value_parser = named::<OrAuto<Gravity>>(&["auto", "included", "removed"])
        )]
        pub gravity: OrAuto<Gravity>,
        /// Number of frames at the start of each touch whose mean torque is subtracted, or `auto` to find the
        /// contact-free start [default: auto]
        #[arg(long, value_name = "N|auto")]
        pub tare_frames: TareFrames,
        /// Subtract no tare: the torques are external torques already
        #[arg(
            long, value_name = "BOOL", num_args = 0..=1, default_missing_value = "true",
            require_equals = true, conflicts_with = "tare_frames"
        )]
        pub no_tare: bool,
        /// How far a joint may move and still count as standing still, rad (m for a prismatic joint) [default: 0.002]
        #[arg(long, value_name = "RAD")]
        pub still_rad: f64 => still_rad,
    }
}

section! {
    /// The workspace box and its points.
    #[command(next_help_heading = "Lattice")]
    pub struct LatticeSettings of () {
        /// Distance between neighbouring points, m [default: 0.012]
        #[arg(long, value_name = "M")]
        pub spacing_m: f64,
        /// Low corner of the workspace box in the robot's base frame, m [default: -1.2,-1.2,-1.2]
        #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
        pub box_low_m: [f64; 3],
        /// High corner of the workspace box in the robot's base frame, m [default: 1.2,1.2,1.2]
        #[arg(long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true)]
        pub box_high_m: [f64; 3],
        /// First point of the lattice, m; in place of the box, with --shape or its default
        #[arg(
            long, value_name = "X,Y,Z", value_parser = vector3, allow_hyphen_values = true,
            conflicts_with_all = ["box_low_m", "box_high_m"]
        )]
        pub origin_m: [f64; 3],
        /// Points along x, y and z; in place of the box, with --origin-m or its default
        #[arg(
            long, value_name = "NX,NY,NZ", value_parser = counts3,
            conflicts_with_all = ["box_low_m", "box_high_m"]
        )]
        pub shape: [u32; 3],
    }
}

section! {
    /// The contact model.
    #[command(next_help_heading = "Contact")]
    pub struct ContactSettings of ContactConfig {
        /// Distance from the surface of a link at which it begins to push a point, m [default: 0.024]
        #[arg(long, value_name = "M")]
        pub contact_distance_m: f64 => contact_distance_m,
        /// Tangential over normal displacement at which a point begins to slip [default: 0.3]
        #[arg(long, value_name = "MU")]
        pub friction: f64 => friction,
        /// Coefficient of Coulomb friction: tangential over normal force, against the motion of the link. With 0, the
        /// tangential force is that of the spring [default: 0.0]
        #[arg(long, value_name = "MU")]
        pub coulomb_friction: f64 => coulomb_friction,
        /// Farthest that a point slips in one iteration, m [default: 0.006]
        #[arg(long, value_name = "M")]
        pub slip_step_m: f64 => slip_step_m,
        /// Slip iterations of one sub-step; 0 makes all points stick [default: 10]
        #[arg(long, value_name = "N")]
        pub slip_iterations: u32 => slip_iterations,
        /// Farthest that a link moves in one sub-step, in cells [default: 0.5]
        #[arg(long, value_name = "CELLS")]
        pub substep_cells: f64 => substep_cells,
        /// Whether points nearer to the arm than the contact distance at the start of a touch are empty space [default: true]
        #[arg(long, value_name = "BOOL")]
        pub known_empty: bool => known_empty,
    }
}

section! {
    /// The estimator, its prior and its memory.
    #[command(next_help_heading = "Estimator")]
    pub struct EstimatorSettings of EstimatorConfig {
        /// `map`, the exact maximum a posteriori; `ekf`, the paper's filter; or `elastic`, an elastic
        /// body from a --cloud, and map for the torque that it does not explain. Each has its own defaults
        /// for the keys below [default: map]
        #[arg(
            long, value_name = "NAME",
            value_parser = named::<EstimatorKind>(&EstimatorKind::ALL.map(EstimatorKind::name))
        )]
        pub estimator: EstimatorKind,
        /// Expected stiffness of an untouched cell of 1 cm, N/m; scales with the spacing to the power 3
        /// [default: 0.0 for map, 0.006 for ekf]
        #[arg(long, value_name = "N_PER_M")]
        pub prior_mean: f64 => prior.mean_n_per_m,
        /// Standard deviation of the stiffness of an untouched cell of 1 cm, N/m; scales with the spacing to the
        /// power 1.5 [default: 0.76]
        #[arg(long, value_name = "N_PER_M")]
        pub prior_std: f64 => prior.std_n_per_m,
        /// Torque that the model may leave unexplained, N·m: one value, or one for each joint
        /// [default: 0.2 for map, 1.5 for ekf]
        #[arg(long, value_name = "N_M", value_delimiter = ',', allow_hyphen_values = true)]
        pub torque_std: Vec<f64> => torque_std,
        /// How much the stiffness of a cell of 1 cm may change in one step, N/m (standard deviation); `ekf` only
        /// [default: 0.0]
        #[arg(long, value_name = "N_PER_M")]
        pub drift_std: f64 => drift_std_n_per_m,
        /// Factor on the stiffness in results and predictions, from 0 to 1; `map` only [default: 1.0]
        #[arg(long, value_name = "SCALE")]
        pub stiffness_scale: f64 => stiffness_scale,
        /// Number of remembered frames that are used again after each new frame [default: 20]
        #[arg(long, value_name = "N")]
        pub replays: u32 => replays,
        /// Largest number of remembered frames [default: 20000]
        #[arg(long, value_name = "N")]
        pub memory_frames: usize => memory.frames,
        /// Largest memory of the remembered frames, MiB [default: 256]
        #[arg(long, value_name = "MIB")]
        pub memory_mib: usize,
        /// Seed of the random draws from memory [default: 0]
        #[arg(long, value_name = "N")]
        pub seed: u64 => seed,
    }
}
