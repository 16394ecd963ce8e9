//! The true external torque stored beside simulated touches: for evaluation only, never an input.

use super::error::LogError;
use super::npy_folder::{Table, name_of};
use std::path::Path;

/// Reads `truth/<touch>_external.npy`, the true external torque of a touch: T rows of n, N·m.
///
/// `log` is the folder of the set, with `truth/` in it, or a file or single touch with `truth/`
/// beside it. `None` if there is no such file, as for any log of a real robot.
///
/// # Errors
///
/// If the file exists but is broken or holds a number that is not finite.
pub fn external_truth(log: &Path, touch: &str) -> Result<Option<Vec<Vec<f64>>>, LogError> {
    let log = log.canonicalize().map_err(|source| LogError::reading(log, source))?;
    let file = format!("truth/{touch}_external.npy");
    let inside = log.join(&file);
    let beside = log.parent().filter(|_| log.is_file() || name_of(&log) == touch);
    let Some(path) = [Some(inside), beside.map(|parent| parent.join(&file))]
        .into_iter()
        .flatten()
        .find(|path| path.is_file())
    else {
        return Ok(None);
    };
    let mut table = Table::open(path)?;
    table.check_shape()?;
    let mut rows = Vec::new();
    while let Some(row) = table.next_row()? {
        rows.push(row);
    }
    Ok(Some(rows))
}

/// Whether a log was simulated: there is a folder `truth/` in it or beside it. The folder is not
/// read.
pub fn is_simulated(log: &Path) -> bool {
    let Ok(log) = log.canonicalize() else { return false };
    let beside = log.parent().is_some_and(|parent| parent.join("truth").is_dir());
    log.join("truth").is_dir() || beside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy::write_header;
    use std::fs;

    #[test]
    fn truth_is_found_from_the_set_and_from_a_touch_and_may_be_absent() {
        let set = tempfile::tempdir().unwrap();
        for folder in ["truth", "seq_0", "seq_1"] {
            fs::create_dir(set.path().join(folder)).unwrap();
        }
        let mut bytes = Vec::new();
        write_header(&mut bytes, "<f8", &[1, 2]).unwrap();
        bytes.extend([0.5f64, -0.5].map(f64::to_le_bytes).concat());
        fs::write(set.path().join("truth/seq_0_external.npy"), bytes).unwrap();

        let wanted = Some(vec![vec![0.5, -0.5]]);
        assert_eq!(external_truth(set.path(), "seq_0").unwrap(), wanted);
        assert_eq!(external_truth(&set.path().join("seq_0/"), "seq_0").unwrap(), wanted);
        assert_eq!(external_truth(set.path(), "seq_1").unwrap(), None);
        assert_eq!(external_truth(&set.path().join("seq_1"), "seq_1").unwrap(), None);
    }
}
