//! Bodies that bend: a link that touches a branch at five points pushes one branch, not five independent springs.
//!
//! A plant is a tree of stiff segments on sprung ball joints ([`ElasticBody`]). For every position of the arm, the
//! static equilibrium of the body against the links is computed ([`Equilibrium`]), with large rotations and with
//! friction, starting from the state at the previous sample. The contact forces are wrenches on the links, and so joint
//! torques, as for the springs of single points in [`crate::torque`].
//!
//! | file             | contents                                                             |
//! |------------------|----------------------------------------------------------------------|
//! | `body`           | segments at rest                                                     |
//! | `blocks`         | the springs of blocks, of which cushions are made                    |
//! | `effective_mass` | inverse effective mass: acceleration of a segment under a unit force |
//! | `pose`           | positions of the segments, for given rotations of the joints         |
//! | `tree`           | Newton's equations of a tree, solved in time linear in its segments  |
//! | `contact`        | contact forces at a point of the body inside a link                  |
//! | `model`          | a body that was learnt from touches, and its torque along a motion   |
//! | `equilibrium`    | the search for the static equilibrium, and the torque there          |
//!
//! The model is static, except for contacts that creep ([`ElasticContactConfig::creep_s`]): gravity is part of the
//! shape at rest, and a branch that is released is at rest in the next sample. The module uses neither point clouds nor
//! measured torques.

mod blocks;
mod body;
mod contact;
mod effective_mass;
mod equilibrium;
mod model;
mod pose;
mod tree;

pub use blocks::BLOCK_STIFFNESS_SHARES;
pub use body::{ElasticBody, ElasticBodyError, Segment, SegmentKind};
pub use contact::ElasticContactConfig;
pub use equilibrium::{Convergence, Equilibrium};
pub use model::{ElasticModel, ElasticTorque, ElasticVariant, limit_norm};
