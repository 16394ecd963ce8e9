//! How this process was started: as the program `palpate`, or by Python with the package.

use std::ffi::OsString;
use std::path::PathBuf;
#[cfg(feature = "full")]
use std::process::Command;
use std::sync::OnceLock;

/// How to start this program again, and the file that contains its code.
#[derive(Debug)]
pub struct Program {
    /// The program and the arguments that precede the subcommand.
    pub call: Vec<OsString>,
    /// The file that contains the code, which a new build replaces.
    pub file: Option<PathBuf>,
}

impl Default for Program {
    /// The executable of this process.
    fn default() -> Self {
        let file = std::env::current_exe().ok().filter(|path| path.is_file());
        // If the file was replaced or deleted, `/proc/self/exe` still starts this version.
        let call = file.clone().unwrap_or_else(|| "/proc/self/exe".into());
        Self { call: vec![call.into_os_string()], file }
    }
}

static RUNNING: OnceLock<Program> = OnceLock::new();

impl Program {
    /// Sets the program that [`again`] and [`file`] use, once for the whole process.
    pub(crate) fn begin(self) {
        let _ = RUNNING.set(self);
    }
}

fn running() -> &'static Program {
    RUNNING.get_or_init(Program::default)
}

/// The file that contains the running code, if known.
pub(crate) fn file() -> Option<&'static PathBuf> {
    running().file.as_ref()
}

/// A command that starts this program again; the caller adds the subcommand.
#[cfg(feature = "full")]
pub(crate) fn again() -> Command {
    let call = &running().call;
    let mut command = Command::new(&call[0]);
    command.args(&call[1..]);
    command
}
