//! The work behind palpate's doors: what the command and the Python package do alike.
//!
//! | module            | says                                                              |
//! |-------------------|-------------------------------------------------------------------|
//! | [`mod@settings`]  | what can be set, in a TOML file or by flags, over the defaults    |
//! | [`mod@field_arrays`] | a field from arrays that another program made                     |
//! | [`mod@robot`]     | the robot that the settings name, loaded and loaded upon          |
//! | [`mod@touches`]   | logs one after another, with their joints in the robot's order    |
//! | `pauses`          | a log parted into touches where the arm pauses in the air         |
//! | [`mod@prior`]     | a mapper that starts anew, from what a field expects if one is given |
//! | [`mod@resume`]    | a mapper that goes on from a saved field                          |
//! | [`mod@learn`]     | touches into a mapper, and a summary of what was learned          |
//! | [`mod@predict`]   | predicted and measured torque of every frame, and the error       |
//! | [`mod@change`]    | whether touches contradict a field, and what has changed          |
//! | [`mod@forget`]    | a field as if some of its touches had never been                  |
//! | [`mod@next`]      | which motions would teach most                                    |
//! | [`mod@scored`]    | the four figures of predicted touches                             |
//! | [`mod@held_joints`] | joints that are not in a log, and stand still                   |
//! | [`mod@elastic`]   | bodies that bend, from a cloud and touches                        |
//! | [`mod@evaluate`]  | methods compared on touches that they have not seen               |
//! | [`mod@extrapolate`] | from touched cells to cells that only a camera saw              |
//! | [`mod@tune`]      | settings chosen by cross-validation                               |
//! | [`mod@study`]     | settings compared over several objects                            |
//! | [`mod@identify`]  | payload, friction, bias and delay of an arm, from free motion     |
//! | [`mod@arm_file`]  | the file of an identified arm                                     |
//! | [`mod@inspect`]   | what a log, a robot or a field holds, and what looks wrong with it |
//! | [`mod@torque`]    | external torques with standard deviations, and contacts           |
//! | [`mod@touched`]   | what touches displace of the lattice                              |
//! | [`mod@quantile`]  | medians and the like                                              |
//!
//! Whoever asks for work is its [`Progress`]: hears of it, and may stop it. Nothing here knows a
//! terminal, a page or Python.
#![forbid(unsafe_code)]

pub mod arm_file;
pub mod change;
mod conventions;
pub mod elastic;
pub mod error;
pub mod evaluate;
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
pub mod prior;
mod progress;
pub mod quantile;
mod recorded;
pub mod resume;
pub mod robot;
pub mod scored;
pub mod settings;
pub mod study;
pub mod torque;
pub mod touched;
pub mod touches;
pub mod tune;

pub use error::WorkError;
pub use progress::{Bar, Progress};
