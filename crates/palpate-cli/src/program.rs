//! What runs: the program `palpate`, or Python with the package.

use std::ffi::OsString;
use std::path::PathBuf;
#[cfg(feature = "full")]
use std::process::Command;
use std::sync::OnceLock;

/// How this program is called again, and which file it was built as.
#[derive(Debug)]
pub struct Program {
    /// The program and the arguments before a subcommand.
    pub call: Vec<OsString>,
    /// The file that a new build replaces.
    pub file: Option<PathBuf>,
}

impl Default for Program {
    /// The program that the process was started as.
    fn default() -> Self {
        let file = std::env::current_exe().ok().filter(|path| path.is_file());
        // The file may have been replaced by another version, or be gone.
        let call = file.clone().unwrap_or_else(|| "/proc/self/exe".into());
        Self { call: vec![call.into_os_string()], file }
    }
}

static RUNNING: OnceLock<Program> = OnceLock::new();

impl Program {
    /// Makes it the one that [`again`] and [`file`] speak of, for good.
    pub(crate) fn begin(self) {
        let _ = RUNNING.set(self);
    }
}

fn running() -> &'static Program {
    RUNNING.get_or_init(Program::default)
}

/// The file that was built, if that is known.
pub(crate) fn file() -> Option<&'static PathBuf> {
    running().file.as_ref()
}

/// This program again, to be given a subcommand.
#[cfg(feature = "full")]
pub(crate) fn again() -> Command {
    let call = &running().call;
    let mut command = Command::new(&call[0]);
    command.args(&call[1..]);
    command
}
