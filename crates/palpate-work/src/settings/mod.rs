//! Settings: flags win over a TOML file, which wins over the defaults.
//!
//! [`sections`] declares every setting once; flags, keys of the file, and the template that
//! `palpate settings` prints come from there. The defaults are the core's own: `resolve.rs` lays
//! the given values over them.

mod error;
mod file;
mod lattice;
mod layer;
mod resolve;
pub mod sections;
mod template;
mod values;

pub use error::SettingsError;
pub use file::{of_table, read};
pub use lattice::corners;
pub(crate) use lattice::{lattice_in_words, same_lattice};
pub(crate) use resolve::{departures, first_difference};
pub use sections::Settings;
pub use values::{HeldJoint, OrAuto, RenamedJoint, TareFrames, named, pair, vector3};
