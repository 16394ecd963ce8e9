//! A run of this program in a process of its own.

use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::error::CliError;
use crate::interrupt;

/// How often the process is looked at.
const LOOK: Duration = Duration::from_millis(50);
/// How long it may take to end by itself after Ctrl-C, which a terminal tells it too.
const GRACE: Duration = Duration::from_secs(1);

/// Runs a command to its end and returns what it printed.
///
/// `waiting` is called now and then. After Ctrl-C the process is ended, however it is told.
///
/// What the process prints stays in the pipe until its end: it must be little, as figures and
/// errors are.
pub(super) fn run(
    command: &mut Command,
    name: &str,
    waiting: &dyn Fn(),
) -> Result<Vec<u8>, CliError> {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let failed = |error: std::io::Error| CliError::from(format!("{name} cannot be run: {error}"));
    let mut child = command.spawn().map_err(failed)?;
    let status = wait(&mut child, waiting);
    if status.is_err() || interrupt::pressed() {
        let _ = child.kill(); // it may have ended by itself
        let _ = child.wait();
    }
    let status = status.map_err(failed)?;
    if interrupt::pressed() {
        return Err(CliError::Interrupted { kept: format!(" in {name}; nothing was printed") });
    }
    let told = child.wait_with_output().map_err(failed)?;
    match status {
        Some(status) if status.success() => Ok(told.stdout),
        _ => {
            let error = String::from_utf8_lossy(&told.stderr);
            let error = error.trim().trim_start_matches("error: ");
            Err(CliError::from(format!("{name} failed: {error}")))
        }
    }
}

/// Waits for a process to end; `None` if it has not, well after Ctrl-C.
fn wait(child: &mut Child, waiting: &dyn Fn()) -> std::io::Result<Option<ExitStatus>> {
    let mut pressed: Option<Instant> = None;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if interrupt::pressed() && pressed.get_or_insert_with(Instant::now).elapsed() > GRACE {
            return Ok(None);
        }
        waiting();
        sleep(LOOK);
    }
}
