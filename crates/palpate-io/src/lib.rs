//! Files of palpate: logs in, fields in and out, robot descriptions and their cache.
//!
//! One file a format. What a file holds is checked at this door: the core may trust that numbers
//! are finite, that lengths agree and that nothing is larger than the bytes that came.
//!
//! | door                | reads                                    | writes                  |
//! |---------------------|------------------------------------------|-------------------------|
//! | [`log`]             | touches: npy folders, CSV                |                         |
//! | [`field`]           | a stiffness field: npz                   | the same                |
//! | [`robot_files`]     | URDF, STL, OBJ, DAE, cached grids        | cached grids            |
//! | [`atomic`]          |                                          | any file, whole or not at all |
//!
//! Nothing here knows the method: no contact, no estimator, no gravity.
#![forbid(unsafe_code)]

pub mod atomic;
pub mod field;
pub mod log;
mod npy;
pub mod robot_files;

pub use npy::NpyError;
