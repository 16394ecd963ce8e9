//! Detects that few samples have most of the residual, as when an arm jerks at its start or is touched briefly.

use serde::Serialize;

use super::held_out::{HeldOutSample, ResidualOf};

/// Largest share of the samples that counts as few.
const FEW: f64 = 0.01;
/// Smallest share of the sum of squared residuals that counts as most.
const MOST: f64 = 0.5;
/// Outliers are samples whose residual exceeds the median by this factor.
const FAR_OFF: f64 = 5.0;

/// Outliers: samples with a far larger residual than the median, if they are at most 1 % of all samples and have at
/// least half of the sum of squared residuals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ResidualOutliers {
    /// Number of outliers.
    pub samples: usize,
    /// Number of held-out samples.
    pub of: usize,
    /// Share of the outliers in the sum of squared residuals, 0 to 1.
    pub share: f64,
    /// Largest residual of an outlier, norm over the joints, N·m.
    pub largest: f64,
    /// Index of the touch whose outliers have the largest sum of squares.
    pub touch: usize,
    /// First and last outlier of that touch, as sample indices.
    pub rows: [usize; 2],
    /// Residual of all other samples, root mean square of the norm over the joints, N·m: after gravity of the URDF,
    /// and after the identified model.
    pub without: [f64; 2],
}

impl ResidualOutliers {
    /// From the residuals by touch; `None` if the residual is not concentrated in few samples.
    pub(super) fn of(left: &[Vec<HeldOutSample>]) -> Option<Self> {
        let square = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>();
        let each = left.iter().enumerate();
        let each = each.flat_map(|(touch, own)| own.iter().map(move |own| (touch, own)));
        let mut all: Vec<(f64, usize, &HeldOutSample)> =
            each.map(|(touch, own)| (square(&own.identified), touch, own)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let sum =
            |of: &[(f64, usize, &HeldOutSample)]| of.iter().map(|(square, ..)| square).sum::<f64>();
        let far_off = FAR_OFF * FAR_OFF * all.get(all.len() / 2)?.0;
        let samples = all.partition_point(|(square, ..)| *square > far_off);
        let share = sum(&all[..samples]) / sum(&all);
        if samples == 0 || samples as f64 > FEW * all.len() as f64 || share < MOST {
            return None;
        }
        let (few, others) = all.split_at(samples);
        let in_touch = |touch: usize| few.iter().filter(move |(_, own, _)| *own == touch);
        let has = |touch: &usize| in_touch(*touch).map(|(square, ..)| square).sum::<f64>();
        let touch = (0..left.len()).max_by(|a, b| has(a).total_cmp(&has(b)))?;
        let rows = || in_touch(touch).map(|(.., own)| own.row);
        let rms = |of: ResidualOf| {
            let squares = others.iter().map(|(.., own)| square(of(own))).sum::<f64>();
            (squares / others.len() as f64).sqrt()
        };
        Some(Self {
            samples,
            of: all.len(),
            share,
            largest: few[0].0.sqrt(),
            touch,
            rows: [rows().min()?, rows().max()?],
            without: [rms(|own| &own.gravity), rms(|own| &own.identified)],
        })
    }
}
