//! palpate: where an object is stiff, from what a robot arm's joints feel while it touches it.
//!
//! The method is that of Yao and Hauser, "Online Estimation of Point-based Volumetric Stiffness
//! Model Using Joint Torque Sensors"; section and equation numbers in these docs are the paper's.
//! [`mapper::Mapper`] learns a field from samples, [`field::Predictor`] asks it about a motion.
//!
//! | module                | says                                                                |
//! |-----------------------|---------------------------------------------------------------------|
//! | [`lattice`]           | cells and points; storage that follows what is touched              |
//! | [`robot`]             | URDF to tree; poses, Jacobians, gravity                             |
//! | [`sdf`]               | distance from a link, and which way is out                          |
//! | [`arm`]               | a robot with the distance field of each link                        |
//! | [`contact`]           | what the arm displaces, and how far                                 |
//! | [`torque`]            | levers (Eq. 2) and predicted torques (Eq. 5)                        |
//! | [`touch`]             | samples to contacts and external torques: gravity, tare             |
//! | [`idle`]              | where a stream without marks pauses between two touches             |
//! | [`estimator`]         | what the two estimators share                                       |
//! | [`expected`]          | a prior by cell: what is expected where nothing was touched         |
//! | [`map`], [`ekf`]      | the exact maximum a posteriori; the paper's filter (Eqs. 3, 4, 6)   |
//! | [`replay`]            | the bounded memory of both                                          |
//! | [`mapper`], [`field`] | the loop, and what it learnt                                        |
//! | [`outlook`]           | what torque a motion would meet, asked while mapping goes on        |
//!
//! No file, socket or clock is opened here, nothing is printed, and the same samples, settings and
//! seed give the same field, on one thread or many.
#![forbid(unsafe_code)]

pub mod arm;
pub mod contact;
pub mod ekf;
pub mod estimator;
pub mod expected;
pub mod field;
mod follow;
pub mod idle;
pub mod lattice;
pub mod map;
pub mod mapper;
pub mod outlook;
pub mod replay;
mod replayer;
pub mod robot;
pub mod sdf;
pub mod torque;
pub mod touch;
