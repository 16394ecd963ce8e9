//! Few samples that have most of what is left over: an arm that jerks as it starts, or that is touched for a moment.

use serde::Serialize;

use super::held_out::{Left, Of};

/// The part of all samples that is a few, and the part of the squares that is most.
const FEW: f64 = 0.01;
const MOST: f64 = 0.5;

/// A hundredth of the samples that has at least half of what is left over, in squares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Few {
    /// How many there are, and of how many.
    pub samples: usize,
    /// See `samples`.
    pub of: usize,
    /// What they have of the sum of squares, 0 to 1.
    pub part: f64,
    /// The largest that is left over in one, norm over the joints, N·m.
    pub largest: f64,
    /// The touch that most of them are in, by its number, and their first and last time there, s.
    pub touch: usize,
    /// See `touch`.
    pub time_s: [f64; 2],
    /// What is left over of all other samples, root mean square over all joints, N·m: after gravity as the URDF says
    /// it, and after the identified model.
    pub without: [f64; 2],
}

impl Few {
    /// `None` if no few samples have most.
    pub(super) fn of(left: &[Vec<Left>]) -> Option<Self> {
        let square = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>();
        let each = left
            .iter()
            .enumerate()
            .flat_map(|(touch, own)| own.iter().map(move |own| (touch, own)));
        let mut all: Vec<(usize, &Left)> = each.collect();
        all.sort_by(|(_, a), (_, b)| square(&b.identified).total_cmp(&square(&a.identified)));
        let (few, others) = all.split_at((FEW * all.len() as f64) as usize);
        let sum =
            |of: &[(usize, &Left)]| of.iter().map(|(_, own)| square(&own.identified)).sum::<f64>();
        let part = sum(few) / sum(&all);
        let (_, farthest) = few.first()?;
        let in_touch = |touch: usize| few.iter().filter(move |(own, _)| *own == touch);
        let touch = (0..left.len()).max_by_key(|touch| in_touch(*touch).count())?;
        let times = || in_touch(touch).map(|(_, own)| own.time_s);
        let rms = |of: Of| {
            (others.iter().map(|(_, own)| square(of(own))).sum::<f64>() / others.len() as f64)
                .sqrt()
        };
        (part >= MOST).then(|| Self {
            samples: few.len(),
            of: all.len(),
            part,
            largest: square(&farthest.identified).sqrt(),
            touch,
            time_s: [
                times().fold(f64::INFINITY, f64::min),
                times().fold(f64::NEG_INFINITY, f64::max),
            ],
            without: [rms(|own| &own.gravity), rms(|own| &own.identified)],
        })
    }
}
