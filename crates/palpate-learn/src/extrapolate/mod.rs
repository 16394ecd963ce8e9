//! Extrapolation of stiffness from touched cells to cells that only a camera saw (Sec. III-B).
//!
//! A few touches and one coloured cloud give a stiffness for every seen point: points that look
//! alike are assumed to be equally stiff. There are three methods; the first is the default:
//!
//! | [`ExtrapolationMethod`] | regression of                                | on                          |
//! |-------------------------|----------------------------------------------|-----------------------------|
//! | `torque`                | stiffness over features, by Gaussian process | the torques themselves      |
//! | `cells`                 | the same                                     | stiffness of touched cells  |
//! | `knn`                   | the paper's: k nearest, RBF weights          | stiffness of touched points |
//!
//! All three return the stiffness of a cell of the [`palpate::Field`]'s lattice. So
//! [`Extrapolation::cells`] gives prior means for untouched cells. [`mod@compare`] evaluates such a
//! prior on held-out touches.

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
pub use config::{ExtrapolationConfig, ExtrapolationMethod, REACH_CELLS};
pub use error::ExtrapolateError;
pub use extrapolation::{Extrapolation, extrapolate};
pub use features::{Colour, Features};
pub use rank::{area_under_roc, spearman};
