//! palpate: where an object is stiff, from what a robot arm's joints feel while it touches it.
#![forbid(unsafe_code)]

pub mod arm;
pub mod robot;
pub mod sdf;
