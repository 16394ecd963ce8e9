//! Evaluation of stiffness fields: errors of predicted torques on held-out touches.
//!
//! | module                | what it does                                                    |
//! |-----------------------|-----------------------------------------------------------------|
//! | [`mod@tracked`]       | touches with their contacts, simulated once and used by all     |
//! | [`mod@folds`]         | which touches are learnt from, and which are predicted          |
//! | [`mod@method`]        | the methods that are compared                                   |
//! | [`mod@regression`]    | torque from joint angles alone: MLP, Gaussian process, k-NN     |
//! | [`mod@evaluate`]      | cross-validation: all methods on all folds                      |
//! | [`mod@evaluation`]    | the result of an evaluation                                     |
//! | [`mod@tune`]          | settings chosen by cross-validation on training touches         |
//! | [`mod@choose`]        | settings chosen for the touches at hand, with bands             |
//! | `thinning`            | fewer samples of long logs, for choosing settings               |
//! | [`mod@study`]         | settings compared over several objects                          |
//! | [`mod@change`]        | whether an object moved, or is softer or harder, since mapping  |
//! | [`mod@next_touch`]    | which motion reduces the variance of a task most                |
//! | [`mod@extrapolate`]   | stiffness of untouched cells, from a point cloud                |
//! | [`mod@torque_errors`] | the four error figures of Table I                               |
//! | [`mod@excite`]        | a motion that determines an arm's masses and friction           |
//! | [`mod@body`]          | an elastic body from a cloud: stems, tubes, radii               |
//! | [`mod@elastic`]       | the stiffness of an elastic body, learnt from touches           |
//! | [`mod@calibrate`]     | calibration of the bands around predicted torques               |
//! | [`mod@bands`]         | the bands of predicted touches, and their coverage              |
//! | [`mod@identify`]      | payload, friction, bias and delay of an arm, from free motion   |
//!
//! The crate uses the estimators of `palpate`; it reads and writes no files.
#![forbid(unsafe_code)]

pub mod bands;
pub mod body;
pub mod calibrate;
pub mod change;
pub mod choose;
pub mod elastic;
mod error;
pub mod evaluate;
pub mod evaluation;
pub mod excite;
pub mod extrapolate;
mod field_estimates;
pub mod folds;
pub mod identify;
pub mod method;
pub mod next_touch;
mod own_motion;
pub mod regression;
pub mod study;
mod thinning;
pub mod torque_errors;
pub mod tracked;
pub mod tune;
mod upper_median;

pub use error::{LearnError, Stop};
