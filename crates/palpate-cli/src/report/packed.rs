//! Numbers of the pages as JSON: integers of a small unit, which take half the bytes of decimal
//! fractions, and decimals of four digits where the range is wide.

use nalgebra::{Isometry3, Point3};
use serde::Serialize;

use crate::error::CliError;

use super::scene::Scene;

/// Units of the integers: tenths of a millimetre, ten-thousandths.
pub(super) const PER_METRE: f64 = 1e4;
pub(super) const PER_ONE: f64 = 1e4;

#[derive(Serialize)]
pub(super) struct View<'a> {
    /// x, y, z in turn.
    points: Vec<i64>,
    /// N/m, softest first.
    stiffness: Vec<f64>,
    cells: usize,
    spacing: f64,
    hulls: Vec<HullView<'a>>,
    /// By touch and drawn frame; of each hull seven numbers: x, y, z, then i, j, k, w of the
    /// quaternion.
    poses: Vec<Vec<Vec<i64>>>,
}

#[derive(Serialize)]
struct HullView<'a> {
    link: &'a str,
    vertices: Vec<i64>,
    triangles: &'a [[u32; 3]],
}

/// What a page draws, as JSON that may stand in a script element.
pub(super) fn script(data: &impl Serialize) -> Result<String, CliError> {
    let text = serde_json::to_string(data).map_err(CliError::file)?;
    Ok(text.replace('<', "\\u003c")) // Else a touch named `</script>` would end the script.
}

/// A number's first four digits.
pub(super) fn four_digits(number: f64) -> f64 {
    let unit = 10_f64.powf(number.max(1e-9).log10().floor() - 3.0);
    // A division by a whole number, where there is one, leaves the shortest decimal.
    if unit < 1.0 {
        (number * unit.recip().round()).round() / unit.recip().round()
    } else {
        (number / unit).round() * unit
    }
}

/// A scene, packed.
pub(super) fn view(scene: &Scene) -> View<'_> {
    View {
        points: scene.points_m.iter().flat_map(tenths).collect(),
        stiffness: scene.stiffness_n_per_m.iter().copied().map(four_digits).collect(),
        cells: scene.cells,
        spacing: scene.spacing_m,
        hulls: (scene.hulls.iter())
            .map(|hull| HullView {
                link: &hull.link,
                vertices: hull.vertices_m.iter().flat_map(tenths).collect(),
                triangles: &hull.triangles,
            })
            .collect(),
        poses: (scene.poses.iter())
            .map(|touch| touch.iter().map(|frame| frame.iter().flat_map(seven).collect()).collect())
            .collect(),
    }
}

/// A point, in tenths of a millimetre.
pub(super) fn tenths(point: &Point3<f64>) -> [i64; 3] {
    [0, 1, 2].map(|axis| (point[axis] * PER_METRE).round() as i64)
}

/// A pose in seven numbers, which is 5 less than a matrix has.
fn seven(pose: &Isometry3<f64>) -> [i64; 7] {
    let [x, y, z] = tenths(&pose.translation.vector.into());
    let turn = pose.rotation.coords.map(|part| (part * PER_ONE).round() as i64);
    [x, y, z, turn.x, turn.y, turn.z, turn.w]
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    #[test]
    fn stiffness_keeps_four_digits_and_poses_turn_as_they_did() {
        let field = example::field();
        let scene = Scene::new(&example::arm(), &field, &example::evaluation()).unwrap();
        let view = view(&scene);
        for (packed, k) in view.stiffness.iter().zip(&scene.stiffness_n_per_m) {
            assert!((packed / k - 1.0).abs() < 6e-4, "{packed} for {k}");
        }
        assert!(serde_json::to_string(&view.stiffness).unwrap().len() < 8 * view.stiffness.len());
        let seven = &view.poses[1][100][7..14];
        let squares: f64 = seven[3..].iter().map(|&part| (part as f64 / PER_ONE).powi(2)).sum();
        assert!((squares - 1.0).abs() < 4e-4);
    }
}
