//! The arm, what it touches and the field that it learns, for the [Rerun](https://rerun.io) viewer.
//!
//! [`view_model`] decides which cells and contacts are drawn, how large and in which colours; it needs
//! no Rerun. With the feature `rerun`, `Recording` sends it to a viewer or writes it to an `.rrd`
//! file, and `viewer` starts one with its usage statistics off. This is the only crate that knows
//! Rerun, and nobody has to build that who does not ask for it.
//!
//! It opens no log, no field and no robot: what it draws is handed in, sample by sample, by a
//! command that plays a log or listens to a robot. It learns and predicts nothing.

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
pub use recording::{Frame, Recording, Scene, Torque, ViewError};
