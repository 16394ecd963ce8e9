//! True values of the points of a simulated cloud, for evaluation only.

use super::error::CloudError;
use crate::input;
use crate::npy::Rows;
use std::path::Path;

/// True values of every point of a cloud, in its order.
#[derive(Debug, Clone, PartialEq)]
pub struct PointTruth {
    /// Stiffness, N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// Number of the part that the point belongs to, as numbered by the simulation.
    pub class: Vec<u32>,
}

/// Reads `point_stiffness.npy` and `truth_labels.npy` of a folder, one number for each of `points`.
///
/// # Errors
///
/// If one of the files is missing, is not an array of `points` numbers, or holds a number that is
/// negative or not finite.
pub fn read_point_truth(folder: &Path, points: usize) -> Result<PointTruth, CloudError> {
    let class = numbers(&folder.join("truth_labels.npy"), points)?;
    Ok(PointTruth {
        stiffness_n_per_m: numbers(&folder.join("point_stiffness.npy"), points)?,
        class: class.into_iter().map(|class| class as u32).collect(),
    })
}

fn numbers(path: &Path, points: usize) -> Result<Vec<f64>, CloudError> {
    let odd = |found: String, wanted| {
        let place = "the array".to_owned();
        CloudError::Value { path: path.to_owned(), place, found, wanted }
    };
    let file = input::open(path);
    let file = file.map_err(|source| CloudError::Io { path: path.to_owned(), source })?;
    let broken = |source| CloudError::Npy { path: path.to_owned(), source };
    let rows = Rows::open(file).map_err(broken)?;
    if *rows.shape() != [points as u64] {
        let found = format!("of shape {:?} for {points} points", rows.shape());
        return Err(odd(found, "one number for each point of the cloud, in its order"));
    }
    let numbers = rows.all().map_err(broken)?;
    match numbers.iter().find(|number| !number.is_finite() || **number < 0.0) {
        Some(found) => {
            Err(odd(format!("not usable: it holds {found}"), "finite numbers from 0 on"))
        }
        None => Ok(numbers),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::npy::write_header;

    #[test]
    fn truth_of_another_cloud_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["truth_labels.npy", "point_stiffness.npy"] {
            let mut bytes = Vec::new();
            write_header(&mut bytes, "<f4", &[3]).unwrap();
            bytes.extend([0.0_f32, 1.0, 2.0].map(f32::to_le_bytes).concat());
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let truth = read_point_truth(folder.path(), 3).unwrap();
        assert_eq!((truth.class, truth.stiffness_n_per_m[2]), (vec![0, 1, 2], 2.0));
        let error = read_point_truth(folder.path(), 4).unwrap_err().to_string();
        assert!(error.contains("shape [3] for 4 points"), "{error}");

        std::fs::write(folder.path().join("truth_labels.npy"), "0 1 2").unwrap();
        let error = read_point_truth(folder.path(), 3).unwrap_err().to_string();
        assert!(error.contains("truth_labels.npy` is not an npy file"), "{error}");
    }
}
