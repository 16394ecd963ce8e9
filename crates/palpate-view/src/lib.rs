//! Shows the arm, its contacts and the learnt field in the [Rerun](https://rerun.io) viewer.
//!
//! [`view_model`] decides which cells and contacts are drawn, in which size and colour, without
//! Rerun. With the feature `rerun`, `Recording` sends them to a viewer or writes them to an `.rrd`
//! file, and `viewer` starts a viewer with its usage statistics off. This is the only crate that
//! depends on Rerun, and only with that feature.
//!
//! It opens no log, field or robot: a command that plays a log or maps a robot hands in the data,
//! sample by sample. It learns and predicts nothing.

#![forbid(unsafe_code)]

pub mod view_model;

#[cfg(feature = "rerun")]
mod blueprint;
#[cfg(feature = "rerun")]
mod camera;
#[cfg(feature = "rerun")]
#[doc(hidden)]
pub mod contents;
#[cfg(feature = "rerun")]
mod recording;
#[cfg(feature = "rerun")]
mod rrd;
#[cfg(feature = "rerun")]
pub mod viewer;

#[cfg(feature = "rerun")]
pub use recording::{DrawnSample, Recording, SampleTorque, Scene, ViewError};
