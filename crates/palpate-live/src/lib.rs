//! Maps while the robot moves.
//!
//! Receives joint states over ROS 2 (DDS, in pure Rust), learns the field from them, and publishes
//! torques, contacts, the field near the contacts, and diagnostics.
//!
//! | module                     | what it does                                                   |
//! |----------------------------|----------------------------------------------------------------|
//! | [`session`]                | the mapper, sample by sample: pauses, tares, faults, the guard |
//! | `joints`                   | turns joint states into samples, or refuses them with a reason |
//! | [`ros`]                    | the ROS 2 network, in a separate process: receives, publishes  |
//! | [`guard`]                  | the stop flag: up unless moving on is known to be safe         |
//! | [`run`]                    | starts the threads                                             |
//! | `mapping`                  | the mapper's thread                                            |
//! | `threads`                  | the threads that receive and publish; state shared by all      |
//! | [`latest_queue`], `outbox` | bounded queue between threads; messages to be published        |
//! | [`message`]                | ROS 2 messages                                                 |
//! | `cloud`, `diagnostics`     | point clouds and diagnostic messages for ROS                   |
//! | [`QuerySocket`]            | the Unix socket that answers questions about planned motions   |
//! | `question`                 | JSON form of these questions and answers                       |
//! | [`LiveElasticBody`]        | the object as an elastic body: bends it, learns it             |
//! | `choose`                   | settings chosen during the session, by cross-validation        |
//! | `background`               | thread pools of low priority                                   |
//! | `services`                 | the thread for ROS services that take time                     |
//! | `wrench`                   | wrenches of the object on the links                            |
//! | [`checkpoint`]             | saves the field to a file at regular intervals                 |
//! | [`figures`]                | rates, latencies, losses and errors of the session             |
//! | [`view_feed`]              | frames for a viewer                                            |
//!
//! The crate uses no terminal and no settings file; the command `palpate live` is built on it.
#![deny(unsafe_code)] // except one line in `ros::loopback`

mod background;
mod body;
pub mod checkpoint;
mod choose;
mod cloud;
mod diagnostics;
pub mod figures;
#[doc(hidden)]
pub mod fuzz;
pub mod guard;
mod joints;
pub mod latest_queue;
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

pub use body::{BentBody, LiveElasticBody};
pub use figures::SessionEvent;
pub use query_server::QuerySocket;
pub use run::{LiveConfig, MappedSample, run};
