//! Files of palpate: logs and pictures in, fields and clouds in and out, robots and their cache.
//!
//! Every format has a module. What a file holds is checked here, so that the core may rely on
//! numbers that are finite, on lengths that agree, and on nothing being larger than the file.
//!
//! | module              | reads                                    | writes                  |
//! |---------------------|------------------------------------------|-------------------------|
//! | [`log`]             | touches: npy folders, CSV, bags of ROS 2, Parquet | npy folders, CSV, MCAP |
//! | [`field`]           | a stiffness field: npz                   | the same, VTK images, MCAP |
//! | [`field::obstacles`] |                                         | boxes (URDF), springs (MuJoCo) |
//! | [`gltf`]            |                                          | meshes                  |
//! | [`robot_files`]     | URDF, STL, OBJ, DAE, cached grids        | cached grids            |
//! | [`cloud`]           | coloured clouds: PLY, PCD                | the same, with more columns |
//! | [`rgbd`]            | colour and depth images, cameras         |                         |
//! | [`body`]            | a body that bends: JSON                  | the same, MuJoCo XML    |
//! | [`torques`]         |                                          | external torques: CSV, Parquet, MCAP |
//! | [`input`]           | regular files, not pipes or devices      |                         |
//! | [`atomic`]          |                                          | any file, whole or not at all |
//!
//! Nothing of the method is computed here: [`field`] keeps the state of an estimator, and does not look into it.
#![forbid(unsafe_code)]

pub mod atomic;
pub mod body;
pub mod cloud;
pub mod field;
pub mod gltf;
pub mod input;
pub mod log;
mod npy;
mod panics;
pub mod rgbd;
pub mod robot_files;
pub mod torques;

pub use npy::NpyError;

/// What to do where a program was built without what is wanted of it, as a sentence without its full stop.
pub fn not_built(what: &str) -> String {
    format!(
        "this palpate was built without {what}; the Python package has all, and so has what `cargo install --locked \
         --path crates/palpate-cli --features full` builds"
    )
}
