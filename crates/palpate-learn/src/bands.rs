//! How often bands hold the measured torque of touches that were neither learnt nor calibrated on.

use nalgebra::DVector;
use palpate::Calibration;
use serde::{Deserialize, Serialize};

use crate::calibrate::Peaks;

/// The level of bands in tables and figures; a lower one where there are too few touches for it.
pub const LEVEL: f64 = 0.9;

/// What an estimator says of the torques of a fold's test touches, beside their most likely value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certainty {
    /// Standard deviation of the springs' torque: touches × frames × n_joints, N·m.
    pub torque_std: Vec<Vec<Vec<f64>>>,
    /// Found on the fold's training touches.
    pub calibration: Calibration,
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
pub const CLASSES: [&str; 3] = ["free air", "mostly met cells", "mostly new cells"];

/// How often the bands of a method held the measured torque, over all touches, each counting alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// The share that bands are to hold; the lowest of all touches.
    pub level: f64,
    /// Share of the joints' torques in a frame that were inside.
    pub frames: f64,
    /// The same at other levels: the level, and the share inside.
    pub by_level: Vec<[f64; 2]>,
    /// Share of the joints' largest torques in a touch that were inside of the bands for those.
    pub peaks: f64,
    /// Mean half-width, N·m.
    pub half_width_n_m: f64,
    /// Half-width of a band that is the same everywhere and holds as many, N·m.
    pub constant_half_width_n_m: f64,
    /// Share inside and mean half-width, N·m, by class ([`CLASSES`]); `None` without frames of it.
    pub classes: [Option<[f64; 2]>; 3],
}

impl Band {
    /// Of a touch, n_joints a frame: predicted, measured; `contacts` are the points touched in each frame and those of them that
    /// training touches met.
    pub fn of(
        calibration: &Calibration,
        (predicted, torque_std): (&[Vec<f64>], &[Vec<f64>]),
        measured: &[Vec<f64>],
        contacts: impl Iterator<Item = [u32; 2]>,
    ) -> Option<Self> {
        let level = LEVEL.min(calibration.highest_level());
        let q = calibration.at(level).filter(|_| !predicted.is_empty())?;
        let scales: Vec<DVector<f64>> = predicted
            .iter()
            .zip(torque_std)
            .map(|(torque, std)| calibration.scale(torque, std))
            .collect();
        let half_width: Vec<Vec<f64>> =
            scales.iter().map(|scale| (scale * q.frame).as_slice().to_vec()).collect();
        let mut classes = [Class::default(); 3];
        for (frame, [all, met]) in contacts.enumerate() {
            let class = &mut classes[match (all, 2 * met >= all) {
                (0, _) => 0,
                (_, true) => 1,
                (_, false) => 2,
            }];
            for (j, half_width) in half_width[frame].iter().enumerate() {
                let error = (measured[frame][j] - predicted[frame][j]).abs();
                class.torques += 1;
                class.inside += u32::from(error <= *half_width);
                class.half_width_n_m += half_width;
            }
        }
        let by_level = calibration.quantiles.iter().map(|quantiles| {
            let each = measured.iter().zip(predicted).zip(&scales).map(|((tau, of), scale)| {
                let joints = tau.iter().zip(of).zip(scale);
                joints
                    .filter(|((tau, of), s)| (**tau - **of).abs() <= quantiles.frame * **s)
                    .count()
            });
            let all = measured.len() * scales[0].len();
            [quantiles.level, each.sum::<usize>() as f64 / all as f64]
        });
        let by_level = by_level.collect();
        let vector = |of: &[f64]| DVector::from_column_slice(of);
        let frames: Vec<[DVector<f64>; 3]> = (predicted.iter().zip(torque_std).zip(measured))
            .map(|((torque, std), measured)| [vector(torque), vector(std), vector(measured)])
            .collect();
        let peaks = Peaks::of(&frames, &scales).0;
        let peaks_inside = peaks.iter().filter(|error| **error <= q.peak).count() as u32;
        Some(Self { level, half_width, classes, by_level, peaks_inside })
    }

    fn torques(&self) -> f64 {
        self.classes.iter().map(|class| f64::from(class.torques)).sum()
    }
}

impl Coverage {
    /// Of touches with their |errors|, N·m; `None` without any.
    pub fn of(touches: &[(&Band, &[f64])]) -> Option<Self> {
        let count = touches.len() as f64;
        let mean = |of: &dyn Fn(&Band) -> f64| {
            touches.iter().map(|(band, _)| of(band)).sum::<f64>() / count
        };
        let level = touches.iter().map(|(band, _)| band.level).reduce(f64::min)?;
        let inside = |band: &Band| {
            let inside: u32 = band.classes.iter().map(|class| class.inside).sum();
            f64::from(inside) / band.torques()
        };
        let width = |band: &Band| {
            band.classes.iter().map(|class| class.half_width_n_m).sum::<f64>() / band.torques()
        };
        let frames = mean(&inside);
        let mut errors: Vec<(f64, f64)> = (touches.iter())
            .flat_map(|(_, errors)| {
                let weight = 1.0 / errors.len() as f64;
                errors.iter().map(move |error| (*error, weight))
            })
            .collect();
        let class = |index: usize| {
            let own = || touches.iter().map(move |(band, _)| band.classes[index]);
            let torques: f64 = own().map(|class| f64::from(class.torques)).sum();
            let inside: f64 = own().map(|class| f64::from(class.inside)).sum();
            let width: f64 = own().map(|class| class.half_width_n_m).sum();
            (torques > 0.0).then_some([inside / torques, width / torques])
        };
        // Levels that all touches have.
        let fewest = touches.iter().map(|(band, _)| band.by_level.len()).min()?;
        let by_level = (0..fewest)
            .map(|k| [touches[0].0.by_level[k][0], mean(&|band: &Band| band.by_level[k][1])])
            .collect();
        Some(Self {
            level,
            frames,
            by_level,
            peaks: mean(&|band| f64::from(band.peaks_inside) / band.half_width[0].len() as f64),
            half_width_n_m: mean(&width),
            constant_half_width_n_m: crate::calibrate::quantile(&mut errors, frames),
            classes: [class(0), class(1), class(2)],
        })
    }
}
