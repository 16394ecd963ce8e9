//! A stiffness field as a file: points and the spring of each.
//!
//! | array     | shape | type | unit | meaning                                              |
//! |-----------|-------|------|------|------------------------------------------------------|
//! | `points`  | N x 3 | f64  | m    | rest points, world frame                             |
//! | `K`       | N     | f64  | N/m  | stiffness, never negative                            |
//! | `K_std`   | N     | f64  | N/m  | its standard deviation (optional)                    |
//! | `N_obs`   | N     | u32  |      | frames that touched the point (optional)             |
//! | `K_prior` | N     | f64  | N/m  | what K would be, had nothing been touched (optional) |
//! | `lattice` | 7     | f64  | m    | origin x y z, spacing, cells in x y z (optional)     |
//! | `cells`   | N     | u32  |      | index of each point in the lattice (optional)        |
//!
//! The first four names are those of the OpenVSF library. It reads `points` and `K` of our files, and
//! looks for the other two in a pickle that the Python package adds (`palpate.openvsf`); its files
//! lack the rest. A point of which `N_obs` is 0 is only expected to have its stiffness. Other arrays
//! are left in [`npz::Arrays`] for the program that wrote them. How a cell's index follows from its
//! place is the lattice's business, not the file's.

mod elastic;
mod file;
pub mod npz;
pub mod obstacles;
mod saved;
mod vti;

pub use file::{FieldFile, FieldLattice};
pub use saved::{Saved, SavedError, from_bytes, load, save, to_bytes};
pub use vti::write_vti;
