//! palpate beside a running robot.
//!
//! Joint states come in over ROS 2 (DDS, in pure Rust), and torques, contacts, the field near them
//! and diagnostics go out; meanwhile the mapper learns.
//!
//! | module          | says                                                            |
//! |-----------------|-----------------------------------------------------------------|
//! | [`session`]     | the mapper, sample by sample: pauses, tares, faults, the guard  |
//! | [`joints`]      | which joint states are samples                                  |
//! | [`ros`]         | the network: topics, what is heard, what is said                |
//! | [`run`]         | the threads between them                                        |
//! | [`AskSocket`]   | questions about motions that are not made yet                   |
//! | [`checkpoint`]  | what is on disk if the power goes                               |
//! | [`figures`]     | how it goes                                                     |
//! | [`view_feed`]   | frames for a viewer                                             |
//!
//! The crate knows no terminal and no settings file; `palpate live` is made of it.
#![forbid(unsafe_code)]

pub mod checkpoint;
pub mod cloud;
pub mod diagnostics;
pub mod figures;
pub mod guard;
pub mod inbox;
pub mod joints;
pub mod message;
mod query_server;
pub mod ros;
mod run;
pub mod session;
pub mod view_feed;

pub use query_server::AskSocket;
pub use run::{LiveConfig, News, run};
