//! The Python package `palpate`: the crates of palpate with NumPy arrays as input and output.
//!
//! | module        | content                                                         |
//! |---------------|-----------------------------------------------------------------|
//! | `array`       | conversion between NumPy arrays and rows of numbers             |
//! | `error`       | conversion of errors to Python exceptions with the same text    |
//! | `data`        | conversion between plain Python data and JSON or TOML           |
//! | `watch`       | long calls with the GIL released, Ctrl-C and progress           |
//! | `shared`      | objects that Python threads use one at a time                   |
//! | `command`     | the command `palpate`, which the package installs too           |
//! | others        | one class or function each                                      |
//!
//! There is no logic here: functions that the command has too are in `palpate_work`. Shapes and
//! dtypes of arguments are checked once, here.
#![forbid(unsafe_code)]
#![allow(clippy::needless_pass_by_value)] // PyO3 creates the arguments for each call

mod array;
mod command;
mod data;
mod elastic;
mod error;
mod evaluate;
mod extrapolate;
mod field;
mod identify;
mod inspect;
mod lattice;
mod log;
mod mapper;
mod path_predictor;
mod robot;
mod settings;
mod shared;
mod tracked_logs;
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
        identify::{excite, external_torques, identify},
        inspect::inspect,
        lattice::Lattice,
        log::{Log, Touch, TouchIterator, open_log},
        mapper::{Mapper, StepReport},
        path_predictor::{Answer, PathPredictor},
        robot::Robot,
        settings::{default_settings, given_settings},
    };
}
