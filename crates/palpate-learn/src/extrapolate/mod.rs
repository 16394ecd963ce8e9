//! From touched cells to cells that only a camera saw (Sec. III-B).
//!
//! A few touches and one coloured cloud give a stiffness for every seen point: what looks alike is
//! taken to be alike. Three ways, of which the first is the default:
//!
//! | [`Method`] | regression of                                | on                              |
//! |------------|----------------------------------------------|---------------------------------|
//! | `torque`   | stiffness over features, by Gaussian process | the torques themselves          |
//! | `cells`    | the same                                     | stiffness of touched cells      |
//! | `knn`      | the paper's: k nearest, RBF weights          | stiffness of touched points     |
//!
//! All three give back a spring as [`palpate::Field`] has it: of a cell of its lattice. So
//! [`Extrapolation::cells`] is a prior for cells that no touch has reached. [`mod@compare`] says what
//! such a prior is worth on touches that nothing has learnt from.

mod basis;
mod cells;
mod cloud;
pub mod compare;
mod config;
mod error;
mod extrapolation;
mod features;
mod knn;
mod process;
mod rank;
mod torque_evidence;

pub use cloud::SeenCloud;
pub use config::{Config, Method, REACH_CELLS};
pub use error::ExtrapolateError;
pub use extrapolation::{Extrapolation, extrapolate};
pub use features::{Colour, Features};
pub use rank::{area_under_roc, spearman};
