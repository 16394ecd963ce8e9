//! Few samples that have most of the residual: an arm that jerks as it starts, or that is touched for a moment.

use serde::Serialize;

use super::held_out::{Left, Of};

/// Share of the samples that is few.
const FEW: f64 = 0.01;
/// Share of the squares that is most.
const MOST: f64 = 0.5;
/// A sample is far off if its residual is more than so many times the median of all.
const FAR_OFF: f64 = 5.0;

/// Samples with a far larger residual than usual, if they are at most a hundredth of all and have at least half of the
/// sum of squared residuals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Few {
    /// How many there are.
    pub samples: usize,
    /// How many samples were held out.
    pub of: usize,
    /// Their share of the sum of squares, 0 to 1.
    pub share: f64,
    /// The largest residual of one, norm over the joints, N·m.
    pub largest: f64,
    /// Number of the touch in which they have most.
    pub touch: usize,
    /// First and last of them in that touch, by number, from 0.
    pub rows: [usize; 2],
    /// Residual of all other samples, root mean square over all joints, N·m: after gravity as the URDF says it, and
    /// after the identified model.
    pub without: [f64; 2],
}

impl Few {
    /// `None` if no few samples have most.
    pub(super) fn of(left: &[Vec<Left>]) -> Option<Self> {
        let square = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>();
        let each = left.iter().enumerate();
        let each = each.flat_map(|(touch, own)| own.iter().map(move |own| (touch, own)));
        let mut all: Vec<(f64, usize, &Left)> =
            each.map(|(touch, own)| (square(&own.identified), touch, own)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0));
        let sum = |of: &[(f64, usize, &Left)]| of.iter().map(|(square, ..)| square).sum::<f64>();
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
        let rms = |of: Of| {
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
