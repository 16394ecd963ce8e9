//! The Python package `palpate`: NumPy in and out over the crates of palpate.
//!
//! | module        | says                                                            |
//! |---------------|-----------------------------------------------------------------|
//! | `array`       | NumPy arrays from and to rows of numbers                        |
//! | `error`       | every error as a Python exception with the same text            |
//! | `data`        | plain Python data from and to JSON and TOML                     |
//! | `watch`       | long work with the GIL released, Ctrl-C and progress            |
//! | `shared`      | what several Python threads may use, one at a time              |
//! | `command`     | the command `palpate`, which the package installs as well       |
//! | others        | one class or question each                                      |
//!
//! There is no logic here: what the command does as well is `palpate_work`'s. Shapes and dtypes are
//! checked once, at this door.
#![forbid(unsafe_code)]
#![allow(clippy::needless_pass_by_value)] // arguments are made for each call

mod array;
mod command;
mod data;
mod elastic;
mod error;
mod evaluate;
mod extrapolate;
mod field;
mod followed;
mod identify;
mod inspect;
mod lattice;
mod log;
mod mapper;
mod path_predictor;
mod robot;
mod settings;
mod shared;
mod watch;

use pyo3::prelude::*;

/// The compiled part of `palpate`.
#[pymodule]
mod _palpate {
    #[pymodule_export]
    use crate::{
        command::{command, cpus, threads},
        elastic::map_elastic,
        error::{FileError, LogError, PalpateError, PalpateWarning, SettingsError, TouchError},
        evaluate::{evaluate, summarised, tune},
        extrapolate::{Extrapolation, extrapolate},
        field::{Field, unpickled_field},
        identify::external_torques,
        identify::identify,
        inspect::inspect,
        lattice::Lattice,
        log::{Log, Touch, TouchIterator, open_log},
        mapper::{Mapper, StepReport},
        path_predictor::{Answer, PathPredictor},
        robot::Robot,
        settings::{default_settings, given_settings},
    };
}
