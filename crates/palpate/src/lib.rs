//! palpate maps where an object is stiff, from the joint torques of a robot arm that touches it.
//!
//! The method is that of Yao and Hauser, "Online Estimation of Point-based Volumetric Stiffness
//! Model Using Joint Torque Sensors"; section and equation numbers in these docs are the paper's.
//!
//! # Quick start
//!
//! A rod of 40 cm turns on a hinge and pushes into an object. The mapper learns a field of springs from the joint's
//! positions and torques; the field then predicts the torque of another motion.
//!
//! ```
//! use std::sync::Arc;
//! use palpate::{
//!     Arm, BakeConfig, EstimatorKind, Lattice, Mapper, MapperConfig, PathConfig, Robot, Sample,
//! };
//!
//! let robot = Robot::from_urdf(
//!     r#"<robot name="hinge"><link name="base"/><link name="rod"><collision>
//!          <origin xyz="0.2 0 0"/><geometry><box size="0.4 0.04 0.04"/></geometry>
//!        </collision></link>
//!        <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/>
//!        <axis xyz="0 0 1"/></joint></robot>"#,
//! )?;
//! // Signed distances of the links' shapes; palpate-io loads robots with meshes and caches them.
//! let no_mesh = |mesh: &str| Err(format!("found no mesh {mesh}").into());
//! let (arm, _) = Arm::bake(robot, &BakeConfig::default(), no_mesh)?;
//!
//! let mut config = MapperConfig::of(EstimatorKind::Map);
//! config.lattice = Lattice::filling([-0.5, -0.5, -0.1], [0.5, 0.5, 0.1], 0.02)?;
//! let mut mapper = Mapper::new(Arc::new(arm), config)?;
//!
//! // One touch: the arm stands still, which gives the tare, then pushes; the object resists with 10 N·m/rad.
//! mapper.begin_touch();
//! for step in 0..60 {
//!     let angle_rad = 0.005 * f64::from(u32::saturating_sub(step, 10));
//!     let torque_n_m = -10.0 * f64::max(0.0, angle_rad - 0.05);
//!     mapper.step(&Sample::new(None, vec![angle_rad], vec![torque_n_m]))?;
//! }
//! mapper.end_touch()?;
//!
//! // Predict the torque of the same push.
//! let path: Vec<[f64; 1]> = (0..=25).map(|step| [0.01 * f64::from(step)]).collect();
//! let prediction = mapper.path_predictor().ask(&path, &PathConfig::default())?;
//! let end = &prediction.points[25];
//! assert!((end.torque[0] + 2.0).abs() < 0.5, "2 N·m at 0.25 rad");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Overview
//!
//! | to                                       | use                                                                |
//! |------------------------------------------|--------------------------------------------------------------------|
//! | describe the robot                       | [`Robot`], with a [`Payload`]; [`Arm`] adds the signed distances of its links, baked with a [`BakeConfig`]; [`RobotError`], [`ArmError`] |
//! | place the field                          | [`Lattice`] of cells ([`CellId`]); [`LatticeError`]                |
//! | set the contact model                    | [`ContactConfig`]                                                  |
//! | set the convention of the logged torques | [`ExternalTorqueConfig`]: [`TorqueSign`], [`Gravity`], [`Tare`]    |
//! | subtract the arm's own torque            | [`TorqueModel`] of [`JointModel`]s with [`JointFriction`], [`Ripple`] and [`TorqueNoise`]: [`external_torques`] gives an [`ExternalTorque`] for each sample of a log, a [`TorqueStream`] for one sample after the other; a contact is detected where [`ExternalTorque::statistic`] exceeds the threshold of a [`FalseAlarmModel`] |
//! | choose the estimator                     | [`EstimatorKind`] with an [`EstimatorConfig`]: [`Prior`], [`MemoryLimits`] |
//! | learn from samples                       | [`Mapper`] with a [`MapperConfig`] and a [`ReplayPolicy`]; [`Sample`] in, [`StepReport`] out, [`Snapshot`] to save and continue; [`MapperError`], [`TrackerError`], [`EstimatorError`], [`SettingError`] |
//! | get prediction bands                     | [`Calibration`] of a [`Field`], with [`BandQuantiles`]             |
//! | read the result                          | [`Field`], a [`CellEstimate`] for each cell; the present [`Contacts`] |
//! | predict logged motions                   | [`Predictor`], a [`Prediction`] for each sample                    |
//! | predict planned motions                  | [`PathPredictor`] with a [`PathConfig`]: a [`PathPrediction`] of [`PathPoint`]s; [`PathError`] |
//!
//! [`unstable`] exports what the other crates of palpate use: contact simulators, observations, estimators. It may
//! change in any release, and so may fields and arguments of the types above whose own types are exported only there.
//!
//! This crate opens no file, socket or clock and prints nothing. The same samples, settings and seed give the same
//! field on any number of threads.
#![forbid(unsafe_code)]

mod arm;
mod calibration;
mod contact;
mod downsampling;
mod ekf;
mod elastic;
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
mod torque_model;
mod tracker;

pub use arm::{Arm, ArmError};
pub use calibration::{BandQuantiles, Calibration, LearntTorques};
pub use contact::{ContactConfig, Contacts};
pub use estimator::{CellEstimate, EstimatorConfig, EstimatorError, EstimatorKind, Prior};
pub use external_torque::{ExternalTorqueConfig, Gravity, MAX_TORQUE, TorqueSign};
pub use field::{Field, Prediction, Predictor};
pub use lattice::{CellId, Lattice, LatticeError};
pub use mapper::{Mapper, MapperConfig, MapperError, Snapshot, StepReport};
pub use path_predictor::{
    CLUSTER_WEIGHT, MAX_POINTS, PathConfig, PathError, PathPoint, PathPrediction, PathPredictor,
};
pub use replay::{MemoryLimits, ReplayPolicy};
pub use robot::{Payload, Robot, RobotError};
pub use sdf::BakeConfig;
pub use setting::SettingError;
pub use tare::{MIN_TARE_FRAMES, Tare};
pub use torque_model::{
    Causal, Differentiation, ExternalTorque, FalseAlarmModel, JointFriction, JointModel,
    LinkWrench, Ripple, TorqueModel, TorqueNoise, TorqueStream, external_torques,
};
pub use tracker::{Sample, TrackerError};

/// Items for the other crates of palpate. Not stable: any of them may change or be removed in any release.
pub mod unstable {
    pub use crate::arm::{LinkReport, MeshResult, solid};
    pub use crate::calibration::spring_variance;
    pub use crate::contact::{ContactSimulator, LinkContacts};
    pub use crate::downsampling::Downsampling;
    pub use crate::ekf::EkfEstimator;
    pub use crate::elastic::{
        BLOCK_STIFFNESS_SHARES, Convergence, ElasticBody, ElasticBodyError, ElasticContactConfig,
        ElasticModel, ElasticTorque, ElasticVariant, Equilibrium, Segment, SegmentKind, limit_norm,
    };
    pub use crate::estimator::{Estimator, EstimatorState, FrameId, RememberedFrame, Replayed};
    pub use crate::lattice::{CellRows, MAX_COORDINATE_M};
    pub use crate::map::MapEstimator;
    pub use crate::mapper::{LogPosition, LoggedTouch, NO_STD, TouchLog};
    pub use crate::path_predictor::{CheckedPath, PathChecker};
    pub use crate::pause_detector::{PauseConfig, PauseDetector};
    pub use crate::prior_means::PriorMeansError;
    pub use crate::replay::RngState;
    pub use crate::robot::{
        Collision, Joint, JointKind, Link, LinkId, N_INERTIAL_PARAMETERS, Poses, Shape,
        nests_deeper_than,
    };
    pub use crate::sdf::{
        BAKE_VERSION, BakeReport, DistanceGrid, SdfError, Solid, TriangleMesh, bake,
        signed_distance,
    };
    pub use crate::tare::is_contact_free;
    pub use crate::torque::{CellState, Observation, ObservationBuilder, StiffnessRule, lever};
    pub use crate::torque_model::{
        FrictionState, JointMotion, LocalPolynomial, ModelResidual, NoiseFactors, PolynomialFit,
        RIPPLE_COEFFICIENTS, TouchMotion, Window, model_residuals, with_read_times,
    };
    pub use crate::tracker::{TrackedSample, Tracker, torque_weights};
}
