//! palpate: where an object is stiff, from what a robot arm's joints feel while it touches it.
//!
//! The method is that of Yao and Hauser, "Online Estimation of Point-based Volumetric Stiffness
//! Model Using Joint Torque Sensors"; section and equation numbers in these docs are the paper's.
#![forbid(unsafe_code)]

mod arm;
mod contact;
mod ekf;
mod estimator;
mod external_torque;
mod field;
mod lattice;
mod map;
mod mapper;
mod motion;
mod path_predictor;
mod pause_detector;
mod prior_means;
mod replay;
mod robot;
mod sdf;
mod setting;
mod tare;
mod torque;
mod tracker;

pub use arm::{Arm, ArmError};
pub use contact::{ContactConfig, Contacts};
pub use estimator::{CellEstimate, EstimatorConfig, EstimatorError, EstimatorKind, Prior};
pub use external_torque::{ExternalTorqueConfig, Gravity, MAX_TORQUE, TorqueSign};
pub use field::{Field, Prediction, Predictor};
pub use lattice::{CellId, Lattice, LatticeError};
pub use mapper::{Mapper, MapperConfig, MapperError, Snapshot, StepReport};
pub use path_predictor::{
    CLUSTER_WEIGHT, MAX_MOTIONS, MAX_POINTS, PathConfig, PathError, PathPoint, PathPrediction,
    PathPredictor,
};
pub use pause_detector::{MAX_HELD, PauseConfig, PauseDetector};
pub use prior_means::PriorMeansError;
pub use replay::{MemoryLimits, ReplayPolicy};
pub use robot::{Payload, Robot, RobotError};
pub use sdf::{BakeConfig, SdfError};
pub use setting::SettingError;
pub use tare::{MIN_TARE_FRAMES, Tare};
pub use tracker::{Sample, TrackerError};

/// What palpate's own crates build on. Nothing here is stable: any of it may change or go in any
/// release.
pub mod unstable {
    pub use crate::arm::{LinkReport, MeshResult, solid};
    pub use crate::contact::{ContactSimulator, LinkContacts};
    pub use crate::ekf::EkfEstimator;
    pub use crate::estimator::{Estimator, EstimatorState, FrameId, RememberedFrame, Replayed};
    pub use crate::lattice::{
        BRICK_CELLS, BRICK_EDGE, BrickBits, Bricks, CellRows, CellSet, RowsOfRuns,
    };
    pub use crate::map::MapEstimator;
    pub use crate::mapper::LoggedTouch;
    pub use crate::path_predictor::{CheckedPath, PathChecker};
    pub use crate::replay::{ReplayMemory, RngState};
    pub use crate::robot::{
        Collision, Joint, JointKind, Link, LinkId, Poses, Shape, nests_deeper_than,
    };
    pub use crate::sdf::{
        BAKE_VERSION, BakeReport, DistanceGrid, Solid, TriangleMesh, bake, bake_serial,
        signed_distance,
    };
    pub use crate::torque::{Cell, Observation, ObservationBuilder, Prefetch, Stiffness, lever};
    pub use crate::tracker::{TrackedSample, Tracker};
}
