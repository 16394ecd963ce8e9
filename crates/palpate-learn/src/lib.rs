//! How good a map is: errors of predicted torques on touches that it has not seen.
//!
//! | module              | what it does                                                    |
//! |---------------------|-----------------------------------------------------------------|
//! | [`mod@tracked`]     | touches with their contacts, simulated once for all             |
//! | [`mod@folds`]       | which touches are learnt from, and which are predicted          |
//! | [`mod@method`]      | the methods that are compared                                   |
//! | [`mod@regression`]  | torque from joint angles alone: MLP, Gaussian process, k-NN     |
//! | [`mod@evaluate`]    | all methods on all folds                                        |
//! | [`mod@evaluation`]  | its result                                                      |
//! | [`mod@tune`]        | settings from training touches alone                            |
//! | [`mod@study`]       | settings over several objects                                   |
//! | [`mod@change`]      | whether touches contradict a field: it moved, is softer, or another |
//! | [`mod@next_touch`]  | which motion would teach most                                   |
//! | [`mod@extrapolate`] | from touched cells to cells that only a camera saw              |
//! | [`mod@errors`]      | the four figures of Table I                                     |
//! | [`mod@excite`]      | a motion that determines an arm's masses and friction           |
//! | [`mod@body`]        | an elastic body from a cloud: stems, tubes, radii               |
//! | [`mod@elastic`]     | its stiffness, learnt from touches                              |
//! | [`mod@calibrate`]   | how wide bands around predicted torques are                     |
//! | [`mod@bands`]       | the bands of predicted touches, and whether they hold           |
//! | [`mod@identify`]    | payload, friction, bias and delay of an arm in free motion      |
//!
//! The crate knows the estimators of the core, but no file.
#![forbid(unsafe_code)]

pub mod bands;
pub mod body;
pub mod calibrate;
pub mod change;
pub mod elastic;
mod error;
pub mod errors;
pub mod evaluate;
pub mod evaluation;
pub mod excite;
pub mod extrapolate;
mod field_rows;
pub mod folds;
pub mod identify;
pub mod method;
pub mod next_touch;
pub mod regression;
pub mod study;
pub mod tracked;
pub mod tune;
mod upper_median;

pub use error::{LearnError, Stop};
