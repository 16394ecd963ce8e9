//! The curves and the scene as the JSON that `report.js` draws.
//!
//! Numbers have the formats of `packed`. A number that is not finite becomes `null`, a gap in its
//! curve.

use palpate_learn::evaluation::{Evaluation, HeldOutTouch};
use plotters::style::RGBColor;
use serde::Serialize;

use crate::picture::{colour, counted};

use super::frames::{drawn, frames_per_touch, stride};
use super::packed::PER_ONE;
use super::scene::Scene;

/// Torques are integers, in thousandths of N·m.
const PER_TORQUE: f64 = 1e3;

/// Everything that is drawn.
#[derive(Serialize)]
pub(super) struct Data<'a> {
    joints: &'a [String],
    against: &'a str,
    methods: Vec<&'a str>,
    /// Colour of each method, as in the pictures.
    colours: Vec<String>,
    /// Number of the method that is selected at first.
    subject: usize,
    per_torque: f64,
    per_one: f64,
    /// By method, if it has bands: their level.
    level: Vec<Option<f64>>,
    /// By method, if it has bands: pairs of a level and the share of torques within bands of this
    /// level.
    by_level: Vec<Option<&'a [[f64; 2]]>>,
    touches: Vec<Touch<'a>>,
    scene: Option<&'a Scene>,
}

#[derive(Serialize)]
struct Touch<'a> {
    name: &'a str,
    /// Number of frames of the touch.
    frames: usize,
    /// Every n-th frame is drawn.
    every: usize,
    /// Whether `time` is the frame number, because the log has no clock.
    counted: bool,
    time: Vec<f64>,
    contacts: Vec<u32>,
    /// By joint and frame.
    external: Vec<Vec<Option<i64>>>,
    /// By method, joint and frame.
    predicted: Vec<Vec<Vec<Option<i64>>>>,
    /// Half-widths of bands by method, joint and frame; `None` for a method without bands.
    half_width: Vec<Option<Vec<Vec<Option<i64>>>>>,
}

impl<'a> Data<'a> {
    pub(super) fn of(evaluation: &'a Evaluation, scene: Option<&'a Scene>) -> Self {
        let per_touch = frames_per_touch(evaluation);
        let coverage = || evaluation.methods.iter().map(|method| method.coverage.as_ref());
        Self {
            joints: &evaluation.joint_names,
            against: &evaluation.against,
            methods: evaluation.methods.iter().map(|method| method.name.as_str()).collect(),
            colours: evaluation.methods.iter().map(|method| hex(&method.name)).collect(),
            subject: evaluation.subject().unwrap_or(0),
            per_torque: PER_TORQUE,
            per_one: PER_ONE,
            level: coverage().map(|own| Some(own?.level)).collect(),
            by_level: coverage().map(|own| Some(&own?.by_level[..])).collect(),
            touches: evaluation.touches.iter().map(|touch| curves(touch, per_touch)).collect(),
            scene,
        }
    }
}

fn curves(touch: &HeldOutTouch, per_touch: usize) -> Touch<'_> {
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
        half_width: (touch.predictions.iter())
            .map(|method| Some(by_joint(&method.band.as_ref()?.half_width)))
            .collect(),
    }
}

/// The colour of a method, as CSS has it.
fn hex(method: &str) -> String {
    let RGBColor(red, green, blue) = colour(method);
    format!("#{red:02x}{green:02x}{blue:02x}")
}

fn whole(number: f64) -> Option<i64> {
    number.is_finite().then(|| number.round() as i64)
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::example;

    fn json(evaluation: &Evaluation) -> String {
        askama::filters::json(Data::of(evaluation, None)).unwrap().to_string()
    }

    #[test]
    fn no_name_ends_the_script() {
        let evaluation = example::evaluation();
        let text = json(&evaluation);
        assert!(!text.contains('<'));
        let data: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(data["touches"][2]["name"], "third </script>");
        let tau = evaluation.touches[0].external[100][3];
        let packed = data["touches"][0]["external"][3][100].as_i64().unwrap();
        assert_eq!(packed, (tau * 1000.0).round() as i64);
    }

    #[test]
    fn a_prediction_that_is_not_finite_is_a_gap() {
        let mut evaluation = example::evaluation();
        evaluation.touches[0].predictions[1].predicted[5][0] = f64::NAN;
        let data: Value = serde_json::from_str(&json(&evaluation)).unwrap();
        assert!(data["touches"][0]["predicted"][1][0][5].is_null());
        assert!(data["touches"][0]["predicted"][1][1][5].is_i64());
    }
}
