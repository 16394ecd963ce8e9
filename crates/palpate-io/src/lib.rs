//! Files of palpate: reads logs, images and robots; reads and writes fields and clouds; caches baked links.
//!
//! Every format has a module. The content of files is checked here, so that the core may rely on
//! finite numbers, on lengths that agree, and on no array being larger than its file.
//!
//! | module               | reads                                             | writes                               |
//! |----------------------|---------------------------------------------------|--------------------------------------|
//! | [`log`]              | touches: npy folders, CSV, bags of ROS 2, Parquet | npy folders, CSV, MCAP               |
//! | [`field`]            | a stiffness field: npz                            | the same, VTK images, MCAP           |
//! | [`field::obstacles`] |                                                   | boxes (URDF), springs (MuJoCo)       |
//! | [`gltf`]             |                                                   | meshes                               |
//! | [`robot_files`]      | URDF, STL, OBJ, DAE, cached grids                 | cached grids                         |
//! | [`cloud`]            | coloured clouds: PLY, PCD                         | the same, with more columns          |
//! | [`rgbd`]             | colour and depth images, cameras                  |                                      |
//! | [`body`]             | a body that bends: JSON                           | the same, MuJoCo XML                 |
//! | [`torques`]          |                                                   | external torques: CSV, Parquet, MCAP |
//! | [`input`]            | regular files, not pipes or devices               |                                      |
//! | [`atomic`]           |                                                   | any file, whole or not at all        |
//!
//! Many functions return an error that is "the end of a message": a text that continues a sentence which begins with the
//! name of the file, as in "`arm.stl` is truncated". The caller, which knows the name, puts both together.
//!
//! Nothing of the method is computed here: [`field`] saves the state of an estimator without interpreting it.
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

/// Error message for a part (`what`) that this program was built without: how to get it. One sentence, no full stop.
pub fn not_built(what: &str) -> String {
    format!(
        "this palpate was built without {what}; the Python package has everything, and so has the program of \
         `cargo install --locked --path crates/palpate-cli --features full`"
    )
}
