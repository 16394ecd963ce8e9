//! The curves and the scene as the JSON that `report.js` draws.
//!
//! Numbers travel as integers of a small unit, which takes half the bytes of decimal fractions;
//! long touches lose frames, evenly, since a screen has no room for more. What is not finite
//! becomes `null`, a gap in its curve.

use nalgebra::{Isometry3, Point3};
use palpate_learn::evaluation::{Evaluation, LeftOut};
use serde::Serialize;

use crate::error::CliError;
use crate::picture::counted;

use super::scene::Scene;
use super::table::subject;

/// Frames drawn of a touch, and of all touches together.
const FRAMES: usize = 400;
const FRAMES_IN_ALL: usize = 5_000;
/// However many touches there are, a touch keeps these.
const FRAMES_AT_LEAST: usize = 40;

/// Units of the integers: thousandths of N·m, tenths of a millimetre, ten-thousandths.
const PER_TORQUE: f64 = 1e3;
const PER_METRE: f64 = 1e4;
const PER_ONE: f64 = 1e4;

#[derive(Serialize)]
struct Data<'a> {
    joints: &'a [String],
    against: &'a str,
    methods: Vec<&'a str>,
    /// The method that is chosen at first.
    subject: usize,
    per_torque: f64,
    per_metre: f64,
    per_one: f64,
    touches: Vec<Touch<'a>>,
    scene: Option<View<'a>>,
}

#[derive(Serialize)]
struct Touch<'a> {
    name: &'a str,
    /// Frames of the touch, and which of them are drawn: every so many.
    frames: usize,
    every: usize,
    /// Whether its time is a frame number, for want of a clock.
    counted: bool,
    time: Vec<f64>,
    contacts: Vec<u32>,
    /// By joint.
    external: Vec<Vec<Option<i64>>>,
    /// By method and joint.
    predicted: Vec<Vec<Vec<Option<i64>>>>,
}

#[derive(Serialize)]
struct View<'a> {
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

/// Everything that is drawn, as JSON that may stand in a script element.
pub(super) fn json(evaluation: &Evaluation, scene: Option<&Scene>) -> Result<String, CliError> {
    let per_touch = frames_per_touch(evaluation);
    let data = Data {
        joints: &evaluation.joint_names,
        against: &evaluation.against,
        methods: evaluation.methods.iter().map(|method| method.name.as_str()).collect(),
        subject: subject(evaluation).unwrap_or(0),
        per_torque: PER_TORQUE,
        per_metre: PER_METRE,
        per_one: PER_ONE,
        touches: evaluation.touches.iter().map(|touch| packed(touch, per_touch)).collect(),
        scene: scene.map(view),
    };
    let text = serde_json::to_string(&data).map_err(CliError::file)?;
    Ok(text.replace('<', "\\u003c")) // Else a touch named `</script>` would end the script.
}

/// How many frames of each touch are drawn at most.
pub(super) fn frames_per_touch(evaluation: &Evaluation) -> usize {
    (FRAMES_IN_ALL / evaluation.touches.len().max(1)).clamp(FRAMES_AT_LEAST, FRAMES)
}

/// The frames drawn of a touch that has `frames`.
pub(super) fn drawn(frames: usize, at_most: usize) -> impl Iterator<Item = usize> {
    (0..frames).step_by(stride(frames, at_most))
}

fn stride(frames: usize, at_most: usize) -> usize {
    frames.div_ceil(at_most).max(1)
}

fn packed(touch: &LeftOut, per_touch: usize) -> Touch<'_> {
    let frames = touch.time_s.len();
    let by_joint = |torques: &[Vec<f64>]| -> Vec<Vec<Option<i64>>> {
        let joints = torques.first().map_or(0, Vec::len);
        let joint = |joint: usize| {
            drawn(frames, per_touch).map(move |frame| whole(torques[frame][joint] * PER_TORQUE))
        };
        (0..joints).map(|at| joint(at).collect()).collect()
    };
    let time = |frame: usize| (touch.time_s[frame] * 1e4).round() / 1e4;
    Touch {
        name: &touch.name,
        frames,
        every: stride(frames, per_touch),
        counted: counted(touch),
        time: drawn(frames, per_touch).map(time).collect(),
        contacts: drawn(frames, per_touch).map(|frame| touch.contacts[frame]).collect(),
        external: by_joint(&touch.external),
        predicted: touch.predictions.iter().map(|method| by_joint(&method.predicted)).collect(),
    }
}

fn whole(number: f64) -> Option<i64> {
    number.is_finite().then(|| number.round() as i64)
}

fn view(scene: &Scene) -> View<'_> {
    let digits = |stiffness: f64| {
        let unit = 10_f64.powf(stiffness.max(1e-9).log10().floor() - 3.0);
        // A division by a whole number, where there is one, leaves the shortest decimal.
        if unit < 1.0 {
            (stiffness * unit.recip().round()).round() / unit.recip().round()
        } else {
            (stiffness / unit).round() * unit
        }
    };
    View {
        points: scene.points_m.iter().flat_map(tenths).collect(),
        stiffness: scene.stiffness_n_per_m.iter().copied().map(digits).collect(),
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
fn tenths(point: &Point3<f64>) -> [i64; 3] {
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
    use serde_json::Value;

    use super::super::example;
    use super::*;

    #[test]
    fn no_name_ends_the_script() {
        let evaluation = example::evaluation();
        let text = json(&evaluation, None).unwrap();
        assert!(!text.contains('<'));
        let data: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(data["touches"][2]["name"], "third </script>");
        let tau = evaluation.touches[0].external[100][3];
        let packed = data["touches"][0]["external"][3][100].as_i64().unwrap();
        assert_eq!(packed, (tau * 1000.0).round() as i64);
    }

    #[test]
    fn long_touches_are_thinned_and_short_ones_are_not() {
        assert_eq!(drawn(400, 400).count(), 400);
        assert_eq!(drawn(1000, 400).collect::<Vec<_>>()[..3], [0, 3, 6]);
        assert!(drawn(1000, 400).count() <= 400);
        assert_eq!(drawn(0, 400).count(), 0);
        let mut evaluation = example::evaluation();
        evaluation.touches = evaluation.touches.iter().cycle().take(30).cloned().collect();
        assert!(30 * frames_per_touch(&evaluation) <= FRAMES_IN_ALL);
    }

    #[test]
    fn a_prediction_that_is_not_finite_is_a_gap() {
        let mut evaluation = example::evaluation();
        evaluation.touches[0].predictions[1].predicted[5][0] = f64::NAN;
        let data: Value = serde_json::from_str(&json(&evaluation, None).unwrap()).unwrap();
        assert!(data["touches"][0]["predicted"][1][0][5].is_null());
        assert!(data["touches"][0]["predicted"][1][1][5].is_i64());
    }

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
