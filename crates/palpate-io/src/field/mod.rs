//! Files of a stiffness field: points and the stiffness of each.
//!
//! | array     | shape | type | unit | meaning                                              |
//! |-----------|-------|------|------|------------------------------------------------------|
//! | `points`  | N x 3 | f64  | m    | rest points, world frame                             |
//! | `K`       | N     | f64  | N/m  | stiffness, never negative                            |
//! | `K_std`   | N     | f64  | N/m  | its standard deviation (optional)                    |
//! | `N_obs`   | N     | u32  |      | frames that touched the point (optional)             |
//! | `K_prior` | N     | f64  | N/m  | prior mean of K, before any touch (optional)         |
//! | `lattice` | 7     | f64  | m    | origin x y z, spacing, cells in x y z (optional)     |
//! | `cells`   | N     | u32  |      | index of each point in the lattice (optional)        |
//!
//! The first four names are those of the OpenVSF library. It reads `points` and `K` from our files,
//! and the other two from a pickle that the Python package adds (`palpate.openvsf`); its own files
//! have none of the other arrays. Where `N_obs` is 0, the stiffness is only the prior mean. Other
//! arrays are left in [`npz::Arrays`] for the program that wrote them. The order of the cell indices
//! is defined by the lattice, not by the file.

mod elastic;
mod file;
pub mod npz;
pub mod obstacles;
mod saved;
mod vti;

pub use file::{FieldFile, FieldLattice};
pub use saved::{SavedError, SavedField, from_bytes, load, save, to_bytes};
pub use vti::write_vti;
