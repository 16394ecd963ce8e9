//! palpate beside a running robot.
//!
//! Joint states come in over ROS 2 (DDS, in pure Rust), and torques, contacts, the field near them
//! and diagnostics go out; meanwhile the mapper learns.
//!
//! | module           | what it does                                                    |
//! |------------------|-----------------------------------------------------------------|
//! | [`session`]      | the mapper, sample by sample: pauses, tares, faults, the guard  |
//! | `joints`         | which joint states are samples                                  |
//! | [`ros`]          | the network, in a process of its own: what comes, what goes out |
//! | [`guard`]        | a flag to stop, up until it is known to be safe                 |
//! | [`run`]          | starts the threads                                              |
//! | `mapping`        | the thread that maps                                            |
//! | `threads`        | the threads that listen and publish, and what all share         |
//! | `outbox`, [`inbox`] | what waits to be published, and to be mapped                 |
//! | [`message`]      | messages of ROS, as bytes                                       |
//! | `cloud`, `diagnostics` | the field as a point cloud; how it goes, for ROS          |
//! | [`AskSocket`]    | questions about planned motions                                 |
//! | `question`       | their form, and that of the answers                             |
//! | [`LiveBody`]     | the object as an elastic body, bent and learnt                  |
//! | `services`       | requests of ROS that take time                                  |
//! | `wrench`         | what the object exerts on the links                             |
//! | [`checkpoint`]   | the field on disk, now and then                                 |
//! | [`figures`]      | how it goes                                                     |
//! | [`view_feed`]    | frames for a viewer                                             |
//!
//! The crate knows no terminal and no settings file; `palpate live` is made of it.
#![deny(unsafe_code)] // but for a line in `ros::loopback`

mod body;
pub mod checkpoint;
mod cloud;
mod diagnostics;
pub mod figures;
#[doc(hidden)]
pub mod fuzz;
pub mod guard;
pub mod inbox;
mod joints;
mod mapping;
pub mod message;
mod outbox;
mod query_server;
mod question;
pub mod ros;
mod run;
mod services;
pub mod session;
mod threads;
mod timer;
pub mod view_feed;
mod wrench;

pub use body::{BentBody, LiveBody};
pub use figures::News;
pub use query_server::AskSocket;
pub use run::{LiveConfig, Mapped, run};
