//! What the command and the Python package of palpate share.
//!
//! | module                 | content                                                            |
//! |------------------------|--------------------------------------------------------------------|
//! | [`mod@settings`]       | settings from a TOML file and from flags, over the defaults        |
//! | [`mod@field_arrays`]   | a field from arrays of another program                             |
//! | [`mod@robot`]          | loading the robot that the settings name, with its payload         |
//! | [`mod@touches`]        | reading logs one after another, with joints in the robot's order   |
//! | `pauses`               | splitting a log into touches where the arm pauses without contact  |
//! | [`mod@prior`]          | a new mapper, with prior means from a field if one is given        |
//! | [`mod@resume`]         | a mapper that continues from a saved field                         |
//! | [`mod@learn`]          | learning touches with a mapper, and a summary of the result        |
//! | [`mod@predict`]        | predicted and measured torque of every frame, and the error        |
//! | [`mod@change`]         | whether touches contradict a field, and what has changed           |
//! | [`mod@forget`]         | removing touches from a field by learning the others again         |
//! | [`mod@next`]           | ranking motions by how much they would teach                       |
//! | [`mod@prediction_report`] | errors of a saved field on touches, as `predict` reports them   |
//! | [`mod@held_joints`]    | joints that are not in a log and stand still                       |
//! | [`mod@elastic`]        | elastic bodies from a cloud and touches                            |
//! | [`mod@evaluate`]       | methods compared on held-out touches                               |
//! | [`mod@extrapolate`]    | stiffness of untouched cells that a camera saw                     |
//! | [`mod@tune`]           | settings chosen by cross-validation                                |
//! | [`mod@study`]          | settings compared over several objects                             |
//! | [`mod@identify`]       | payload, friction, bias and delay of an arm, from free motion      |
//! | [`mod@arm_file`]       | the file of an identified arm                                      |
//! | [`mod@inspect`]        | content of a log, a robot or a field, and what looks wrong with it |
//! | [`mod@torque`]         | external torques with standard deviations, and contact intervals   |
//! | [`mod@excite`]         | a motion for identification, and its files                         |
//! | [`mod@csv`]            | tables as CSV                                                      |
//! | [`mod@contact_counts`] | counts of displaced points and cells                               |
//! | [`mod@quantile`]       | quantiles, extremes and bounding boxes                             |
//!
//! The caller passes a [`Progress`], which receives messages and can stop the work. Nothing here
//! depends on a terminal, a report page or Python.
#![forbid(unsafe_code)]

pub mod arm_file;
pub mod change;
pub mod contact_counts;
mod conventions;
pub mod csv;
pub mod elastic;
pub mod error;
pub mod evaluate;
pub mod excite;
pub mod extrapolate;
pub mod field_arrays;
pub mod forget;
pub mod held_joints;
pub mod identify;
pub mod inspect;
pub mod learn;
pub mod next;
mod pauses;
pub mod predict;
pub mod prediction_report;
pub mod prior;
mod progress;
pub mod quantile;
pub mod resume;
pub mod robot;
pub mod settings;
pub mod study;
pub mod torque;
pub mod touches;
pub mod tune;

pub use error::WorkError;
pub use progress::{Bar, Progress};
