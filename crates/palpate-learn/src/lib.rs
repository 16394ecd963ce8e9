//! How good a map is: errors of predicted torques on touches that it has not seen.
//!
//! [`mod@errors`] has the four figures of Table I, [`mod@evaluate`] leave-one-touch-out,
//! [`mod@regression`] the paper's three baselines, which know joint angles and no geometry.
//!
//! The crate knows the mapper and the predictor of the core, but no file.
#![forbid(unsafe_code)]

pub mod errors;
pub mod evaluate;
pub mod evaluation;
pub mod regression;
