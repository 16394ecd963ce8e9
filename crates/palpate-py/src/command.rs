//! The command `palpate`, as the script of the Python package calls it, and what the machine gives to it.

use std::ffi::OsString;

use palpate_cli::Program;
use pyo3::prelude::*;

/// Runs the command `palpate` in this process, and returns its exit code.
///
/// `arguments`: the command's name and its arguments. `call`: how this process is started again,
/// without the arguments of the command.
#[pyfunction]
pub(crate) fn command(
    py: Python<'_>,
    arguments: Vec<OsString>,
    call: Vec<OsString>,
) -> PyResult<u8> {
    let file = py.import("palpate._palpate")?.getattr("__file__")?.extract()?;
    Ok(py.detach(|| palpate_cli::command(arguments, Program { call, file: Some(file) })))
}

/// CPUs that this process may use, by its affinity and by its control group.
#[pyfunction]
pub(crate) fn cpus() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Threads of long calls in this process: those of RAYON_NUM_THREADS when the first was made.
#[pyfunction]
pub(crate) fn threads() -> usize {
    rayon::current_num_threads()
}
