//! Coverage of the bands on touches that were used neither for learning nor for calibration.

use nalgebra::DVector;
use palpate::Calibration;
use serde::{Deserialize, Serialize};

use crate::calibrate::{PredictedFrame, peak_errors, quantile, scales};

/// Uncertainty of the torques that an estimator predicts for a fold's test touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// The spread s of [`Calibration::half_width`]: touches × frames × n_joints, N·m.
    pub spread: Vec<Vec<Vec<f64>>>,
    /// Calibrated on the fold's training touches; with too few of them, `others`.
    pub calibration: Calibration,
    /// The bands of [`Calibration::of_other_objects`].
    pub others: Option<Calibration>,
}

/// The band along a touch, and how many measured torques are inside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// The share of torques that should be inside.
    pub level: f64,
    /// Half-widths, frames × n_joints, N·m.
    pub half_width: Vec<Vec<f64>>,
    /// Counts by class of frames, in the order of [`CLASSES`].
    pub classes: [Class; 3],
    /// For each calibrated level: the level, and the share of torques inside of its band.
    pub by_level: Vec<[f64; 2]>,
    /// Number of joints whose largest torque is inside of the band for largest torques.
    pub peaks_inside: u32,
    /// |measured − predicted| of each joint in each frame, N·m.
    #[serde(skip)]
    pub errors_n_m: Vec<f64>,
}

/// Coverage of one class of frames. A *torque* here is that of one joint in one frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// Number of torques.
    pub torques: u32,
    /// Number of torques inside of the band.
    pub inside: u32,
    /// Sum of the half-widths, N·m.
    pub half_width_n_m: f64,
}

/// Names of the classes of frames, by how many of the touched cells are known.
pub const CLASSES: [&str; 3] = ["no contact", "mostly known cells", "mostly untouched cells"];

/// Coverage of the bands of a method. All touches have the same weight; in `classes`, all torques have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// The share of torques that should be inside.
    pub level: f64,
    /// The share of torques that are inside.
    pub torque_share: f64,
    /// For each calibrated level: the level, and the share of torques inside.
    pub by_level: Vec<[f64; 2]>,
    /// Share of the largest torques (one for each joint and touch) inside of the bands for largest torques.
    pub peak_share: f64,
    /// Mean half-width, N·m.
    pub half_width_n_m: f64,
    /// Half-width of a constant band that contains the same share of torques, N·m.
    pub constant_half_width_n_m: f64,
    /// Share inside and mean half-width, N·m, by class ([`CLASSES`]); `None` for a class without frames.
    pub classes: [Option<[f64; 2]>; 3],
}

impl Band {
    /// The band of a touch at a level; `None` if the touch has no frame or the calibration no such level.
    ///
    /// # Panics
    ///
    /// If the calibration is for another number of joints ([`Calibration::check`]).
    pub fn of((calibration, level): (&Calibration, f64), touch: &[PredictedFrame]) -> Option<Self> {
        let q = calibration.at(level).filter(|_| !touch.is_empty())?;
        let scales = scales(calibration, touch);
        let shapes: Vec<DVector<f64>> =
            scales.iter().map(|scale| calibration.shape(scale)).collect();
        let mut classes = [Class::default(); 3];
        for (frame, shape) in touch.iter().zip(&shapes) {
            let [all, met] = frame.contacts;
            let class = &mut classes[match (all, 2 * met >= all) {
                (0, _) => 0,
                (_, true) => 1,
                (_, false) => 2,
            }];
            for (error, shape) in frame.errors().zip(shape) {
                class.torques += 1;
                class.inside += u32::from(error <= q.frame * shape);
                class.half_width_n_m += q.frame * shape;
            }
        }
        let errors_n_m: Vec<f64> = touch.iter().flat_map(PredictedFrame::errors).collect();
        let inside = |q: f64| {
            let each = errors_n_m.iter().zip(shapes.iter().flatten());
            each.filter(|(error, shape)| **error <= q * **shape).count() as f64
        };
        let by_level = calibration.quantiles.iter();
        let by_level =
            by_level.map(|own| [own.level, inside(own.frame) / errors_n_m.len() as f64]).collect();
        let peaks = peak_errors(touch, &scales).into_iter();
        Some(Self {
            level,
            half_width: shapes.iter().map(|shape| (shape * q.frame).data.into()).collect(),
            classes,
            by_level,
            peaks_inside: peaks.filter(|error| *error <= q.peak).count() as u32,
            errors_n_m,
        })
    }

    fn torques(&self) -> f64 {
        self.classes.iter().map(|class| f64::from(class.torques)).sum()
    }
}

impl Coverage {
    /// The coverage over touches; `None` without touches.
    pub fn of(touches: &[&Band]) -> Option<Self> {
        let count = touches.len() as f64;
        let mean =
            |of: &dyn Fn(&Band) -> f64| touches.iter().map(|band| of(band)).sum::<f64>() / count;
        let level = touches.first()?.level;
        let inside = |band: &Band| {
            let inside: u32 = band.classes.iter().map(|class| class.inside).sum();
            f64::from(inside) / band.torques()
        };
        let width = |band: &Band| {
            band.classes.iter().map(|class| class.half_width_n_m).sum::<f64>() / band.torques()
        };
        let torque_share = mean(&inside);
        let mut errors: Vec<(f64, f64)> = (touches.iter())
            .flat_map(|band| {
                let weight = 1.0 / band.errors_n_m.len() as f64;
                band.errors_n_m.iter().map(move |error| (*error, weight))
            })
            .collect();
        let class = |index: usize| {
            let own = || touches.iter().map(move |band| band.classes[index]);
            let torques: f64 = own().map(|class| f64::from(class.torques)).sum();
            let inside: f64 = own().map(|class| f64::from(class.inside)).sum();
            let width: f64 = own().map(|class| class.half_width_n_m).sum();
            (torques > 0.0).then_some([inside / torques, width / torques])
        };
        // Only levels that all touches have.
        let fewest = touches.iter().map(|band| band.by_level.len()).min()?;
        let by_level = (0..fewest)
            .map(|k| [touches[0].by_level[k][0], mean(&|band: &Band| band.by_level[k][1])])
            .collect();
        Some(Self {
            level,
            torque_share,
            by_level,
            peak_share: mean(&|band| {
                f64::from(band.peaks_inside) / band.half_width[0].len() as f64
            }),
            half_width_n_m: mean(&width),
            constant_half_width_n_m: quantile(&mut errors, torque_share),
            classes: [class(0), class(1), class(2)],
        })
    }
}
