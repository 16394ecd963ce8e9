//! The exit code that says how a command ended.

use std::io;

pub(crate) use palpate_work::WorkError as CliError;

/// The exit code: 1 for data and files, 2 for usage, 130 for Ctrl-C, and 0 if the reader of the
/// output, such as `head`, has closed the pipe.
pub(crate) fn exit_code(error: &CliError) -> u8 {
    match error {
        CliError::Usage(_) | CliError::Settings(_) => 2,
        CliError::Interrupted { .. } => 130,
        CliError::Write { source, .. } if source.kind() == io::ErrorKind::BrokenPipe => 0,
        _ => 1,
    }
}
