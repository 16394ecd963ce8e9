//! What the user sets: flags over a TOML file over the shipped defaults.
//!
//! One tree of structs ([`sections`]) is the flags, the file's keys and the template that
//! `palpate settings` prints, so the three cannot drift apart. The defaults are the core's own:
//! `resolve.rs` lays the given values over them.

mod file;
mod layer;
mod parse;
mod resolve;
pub mod sections;
mod template;

use std::path::PathBuf;

use clap::Args;
use palpate::{MapperError, RobotError};
use serde::{Deserialize, Serialize};

pub use file::{Keys, of_table, read};
pub use parse::vector3;
pub use resolve::{corners, departures, first_difference, lattice_in_words, same_lattice};
use sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};

/// All that can be set; what was not given is `None`.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Which arm it was.
    #[command(flatten)]
    pub robot: RobotSettings,
    /// How logs are read.
    #[command(flatten)]
    pub log: LogSettings,
    /// What their torques mean.
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

/// What can be wrong with settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum SettingsError {
    /// The file cannot be read.
    #[error("the settings file `{}` cannot be read: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// Not TOML, or a value of the wrong kind.
    #[error("the settings file `{}` has an error\n{message}", path.display())]
    Toml { path: PathBuf, message: String },
    /// A key that means nothing.
    #[error("`{}`, line {line}: there is no setting `{key}`{remedy}", path.display())]
    UnknownKey { path: PathBuf, line: usize, key: String, remedy: String },
    /// A value outside its range.
    #[error("bad setting: {0}")]
    Value(Box<MapperError>),
    /// A value that would only cost hours or ruin the surface.
    #[error("bad setting: {key} is {found}; it must be at most {limit}: {reason}")]
    TooLarge { key: &'static str, found: f64, limit: f64, reason: &'static str },
    /// A box that is none.
    #[error("bad lattice: {0}")]
    Lattice(#[from] palpate::LatticeError),
    /// A payload that is none.
    #[error("bad payload: {0}")]
    Payload(#[from] RobotError),
    /// Settings that need or exclude each other.
    #[error("{0}")]
    Together(String),
}
