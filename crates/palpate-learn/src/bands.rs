//! How often bands hold the measured torque of touches that were neither learnt nor calibrated on.

use nalgebra::DVector;
use palpate::Calibration;
use serde::{Deserialize, Serialize};

use crate::calibrate::{PredictedFrame, peak_errors, quantile, scales};

/// How sure an estimator is of the torques of a fold's test touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Uncertainty {
    /// s of [`Calibration::half_width`]: touches × frames × n_joints, N·m.
    pub spread: Vec<Vec<Vec<f64>>>,
    /// Found on the fold's training touches, or `others` if they are too few.
    pub calibration: Calibration,
    /// As other objects have them.
    pub others: Option<Calibration>,
}

/// A band along a touch, and how often it held the measured torque.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// The share of torques that it is to hold.
    pub level: f64,
    /// Half-widths, frames × n_joints, N·m.
    pub half_width: Vec<Vec<f64>>,
    /// By class: frames and joints, those of them inside, and the sum of half-widths, N·m.
    pub classes: [Class; 3],
    /// Of all levels that there are bands for: the level, and the share of torques that they held.
    pub by_level: Vec<[f64; 2]>,
    /// Of the joints' largest torques, how many were inside of the band for those.
    pub peaks_inside: u32,
    /// |measured − predicted|, a frame and joint each, N·m.
    #[serde(skip)]
    pub errors_n_m: Vec<f64>,
}

/// Torques of one class of frames, a frame and joint each.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// How many there are.
    pub torques: u32,
    /// How many of them the band held.
    pub inside: u32,
    /// Sum of the half-widths, N·m.
    pub half_width_n_m: f64,
}

/// The classes, in their order.
pub const CLASSES: [&str; 3] = ["no contact", "mostly known cells", "mostly unseen cells"];

/// How often the bands of a method contained the measured torque. All touches count alike, but in `classes`, where all
/// torques do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// The share that bands are to contain.
    pub level: f64,
    /// Share of the torques, of a joint in a frame each, that were inside.
    pub torque_share: f64,
    /// The same at other levels: the level, and the share inside.
    pub by_level: Vec<[f64; 2]>,
    /// Share of the joints' largest torques in a touch that were inside of the bands for those.
    pub peak_share: f64,
    /// Mean half-width, N·m.
    pub half_width_n_m: f64,
    /// Half-width of a band that is the same everywhere and holds as many, N·m.
    pub constant_half_width_n_m: f64,
    /// Share inside and mean half-width, N·m, by class ([`CLASSES`]); `None` without frames of it.
    pub classes: [Option<[f64; 2]>; 3],
}

impl Band {
    /// Of a touch, at a level; `None` without a frame, or a band of that level.
    ///
    /// # Panics
    ///
    /// If the calibration is of another number of joints ([`Calibration::check`]).
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
    /// Of touches; `None` without any.
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
        // Levels that all touches have.
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
