//! Entry points for fuzz tests of the parsers; not part of the public interface.

use crate::question::PathRequest;

/// Parses a line of the socket as [`crate::QuerySocket`] does; returns the number of points of the
/// path.
///
/// # Errors
///
/// If the line is not a question about a path with `n_joints` joints.
pub fn question(line: &[u8], n_joints: usize) -> Result<usize, String> {
    let mut question: PathRequest =
        serde_json::from_slice(line).map_err(|error| error.to_string())?;
    question.path(n_joints).map(|(path, _)| path.len())
}
