//! palpate: where an object is stiff, from what a robot arm's joints feel while it touches it.
#![forbid(unsafe_code)]

pub mod arm;
pub mod contact;
pub mod ekf;
pub mod estimator;
pub mod field;
pub mod lattice;
pub mod map;
pub mod mapper;
pub mod replay;
pub mod robot;
pub mod sdf;
pub mod torque;
pub mod touch;
