//! Bodies that bend: a link that pushes a branch at five points meets one branch, not five springs.
//!
//! A plant is a tree of stiff segments on sprung ball joints ([`ElasticBody`]). For every position of the
//! arm the body is brought to rest against the links ([`Equilibrium`]): large rotations, contacts with
//! friction, the state of the sample before as the start. The forces at rest are wrenches on the links,
//! and so joint torques, as those of springs by point are in [`crate::torque`].
//!
//! | file          | says                                                                        |
//! |---------------|-----------------------------------------------------------------------------|
//! | `body`        | segments at rest                                                             |
//! | `blocks`      | the springs of blocks, of which cushions are made                            |
//! | `mobility`    | how easily a segment is set in motion                                        |
//! | `pose`        | where the segments are, for given turns of the joints                        |
//! | `tree`        | Newton's equations of a tree, solved in time linear in its segments          |
//! | `contact`     | what resists where a point of the body is in a link                          |
//! | `model`       | a body that was learnt from touches, and its torque along a motion           |
//! | `equilibrium` | the search for the position of rest, and the torque there                    |
//!
//! Nothing here takes time, but for contacts that creep ([`ElasticContactConfig::creep_s`]): gravity is in
//! the shape that the body has at rest, and a branch that snaps free is at rest in the next sample. The
//! module knows no cloud, and not what was measured.

mod blocks;
mod body;
mod contact;
mod equilibrium;
mod mobility;
mod model;
mod pose;
mod tree;

pub use blocks::BLOCK_STIFFNESS_SHARES;
pub use body::{BodyError, ElasticBody, Segment, SegmentKind};
pub use contact::ElasticContactConfig;
pub use equilibrium::{Equilibrium, Settled};
pub use model::{ElasticModel, ElasticTorque, ElasticVariant, limit_norm};
