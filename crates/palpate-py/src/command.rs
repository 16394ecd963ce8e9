//! The command `palpate`, called by the script of the Python package; numbers of CPUs and threads.

use std::ffi::OsString;

use palpate_cli::Program;
use pyo3::prelude::*;

/// Runs the command `palpate` in this process, and returns its exit code.
///
/// `arguments`: the command's name and its arguments. `call`: the command line that starts this process
/// again, without the arguments of the command.
#[pyfunction]
pub(crate) fn command(
    py: Python<'_>,
    arguments: Vec<OsString>,
    call: Vec<OsString>,
) -> PyResult<u8> {
    let file = py.import("palpate._palpate")?.getattr("__file__")?.extract()?;
    Ok(py.detach(|| palpate_cli::command(arguments, Program { call, file: Some(file) })))
}

/// Number of CPUs that this process may use, by its affinity and its control group.
#[pyfunction]
pub(crate) fn cpus() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Number of threads of long calls in this process: RAYON_NUM_THREADS at the time of the first one.
#[pyfunction]
pub(crate) fn threads() -> usize {
    rayon::current_num_threads()
}
