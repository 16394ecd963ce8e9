//! Ripple torques of the gears, estimated from the residual of the rest of the model.
//!
//! All gears of an arm are assumed to be of one kind, so they share their orders: those that explain most, summed over
//! the joints. The joints whose ripple acts on a joint are chosen by forward selection on held-out motion. The
//! coefficients come from ridge regression.

use std::array::from_fn;

use nalgebra::{Complex, DMatrix, DVector};
use palpate::Ripple;
use palpate::unstable::RIPPLE_COEFFICIENTS;
use rayon::prelude::*;

use super::contact_samples::MEDIAN;
use super::rows::FOLDS;
use crate::upper_median::upper_median;

/// Orders that are tried, up to twice the number of a gear's teeth; lower orders belong to gravity and bias.
const ORDERS: std::ops::RangeInclusive<u32> = 20..=700;
/// Number of orders of an arm.
const MAX_ORDERS: usize = 2;
/// Most samples in the search for an order.
const MAX_SAMPLES: usize = 6_000;
/// With fewer samples (five for each coefficient of a joint's gears), no ripple is estimated.
const MIN_SAMPLES: usize = 5 * MAX_ORDERS * RIPPLE_COEFFICIENTS;
/// Added to the diagonal in the ridge regression, so that coefficients stay small that few samples determine.
const RIDGE: f64 = 3.0;
/// Samples with a residual torque above this many robust standard deviations are not used.
const FAR_OFF: f64 = 5.0;
/// The arm counts as moving from this fraction of its top speed on.
const MOVING: f64 = 0.1;
/// The fraction of the squared residual that the ripple of a further joint must explain on held-out motion.
const MIN_RIPPLE: f64 = 0.02;

/// A sample, and the residual of its external torques.
#[derive(Debug, Clone)]
pub(super) struct RippleSample {
    /// The fold in which the sample is held out.
    pub(super) fold: usize,
    /// By joint: positions, rad, speeds, rad/s, and torques, N·m.
    pub(super) q: Vec<f64>,
    pub(super) speed: Vec<f64>,
    pub(super) torque: Vec<f64>,
}

impl RippleSample {
    /// Removes ripple from the residual. Its motor torque is added, since the external torque is the measured torque
    /// plus the torque that the motors need.
    pub(super) fn take_off(&mut self, ripple: &[Vec<Ripple>]) {
        for (j, own) in ripple.iter().enumerate() {
            own.iter().for_each(|own| own.add_to(&mut self.torque, self.q[j], self.speed[j]));
        }
    }
}

/// Ripple of the gears of each joint: entry k is estimated without fold k, the last entry from all samples.
pub(super) fn find(samples: &[RippleSample]) -> [Vec<Vec<Ripple>>; FOLDS + 1] {
    let n = samples.first().map_or(0, |sample| sample.q.len());
    let samples = &usual(samples, n)[..];
    if samples.len() < MIN_SAMPLES {
        return from_fn(|_| vec![Vec::new(); n]);
    }
    let fits: Vec<Regression> =
        (0..=FOLDS).into_par_iter().map(|fold| Regression::of(samples, fold)).collect();
    let sources: Vec<Vec<usize>> = (0..n).map(|j| sources(&fits[..FOLDS], n, j)).collect();
    from_fn(|fold| fits[fold].ripples(&sources))
}

/// The samples without outliers in any joint, as where an arm jerks: a few of them would hide the ripple of all others.
/// The standard deviations are those of a moving arm, since there is no ripple at rest.
fn usual(samples: &[RippleSample], n: usize) -> Vec<RippleSample> {
    let speed = |own: &RippleSample| own.speed.iter().map(|speed| speed * speed).sum::<f64>();
    let top = samples.iter().map(speed).fold(0.0, f64::max);
    let most = |j: usize| {
        let moving = samples.iter().filter(|own| speed(own) >= MOVING * MOVING * top);
        let mut sizes: Vec<f64> = moving.map(|own| own.torque[j].abs()).collect();
        let median = upper_median(&mut sizes).filter(|median| *median > 0.0);
        median.map_or(f64::INFINITY, |median| FAR_OFF * median / MEDIAN)
    };
    let most: Vec<f64> = (0..n).map(most).collect();
    let is_usual =
        |own: &&RippleSample| own.torque.iter().zip(&most).all(|(own, most)| own.abs() <= *most);
    samples.iter().filter(is_usual).cloned().collect()
}

/// The joints whose ripple acts on a joint.
fn sources(folds: &[Regression], n: usize, j: usize) -> Vec<usize> {
    let left = |of: &[usize]| folds.iter().map(|fold| fold.squared_residual(of, j)).sum::<f64>();
    let before = left(&[]);
    let (mut found, mut least) = (Vec::new(), before);
    loop {
        let others = (0..n).filter(|other| !found.contains(other));
        let tried = others.map(|other| [&found[..], &[other]].concat());
        let best = tried.map(|of| (left(&of), of)).min_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((now, of)) if now < least - MIN_RIPPLE * before => (least, found) = (now, of),
            _ => return found,
        }
    }
}

/// Regression of the residual on the ripple of all joints.
struct Regression {
    orders: Vec<f64>,
    /// Sums over the learned samples, and over the held-out ones.
    learned: Sums,
    held: Sums,
}

/// Sums of the normal equations: products of columns, of columns with torques, and squared torques.
struct Sums {
    gram: DMatrix<f64>,
    right: DMatrix<f64>,
    squares: Vec<f64>,
}

impl Regression {
    /// Learned from all folds but `fold`, which is held out.
    fn of(samples: &[RippleSample], fold: usize) -> Self {
        let n = samples[0].q.len();
        let own: Vec<Vec<usize>> = (0..n).map(|j| vec![j]).collect();
        let learned: Vec<&RippleSample> =
            samples.iter().filter(|sample| sample.fold != fold).collect();
        let mut orders = Vec::with_capacity(MAX_ORDERS);
        let mut left: Vec<RippleSample> = (learned.iter())
            .step_by(learned.len().div_ceil(MAX_SAMPLES).max(1))
            .map(|sample| (*sample).clone())
            .collect();
        for _ in 0..MAX_ORDERS {
            let order = best_order(&left);
            orders.push(order);
            // The next order is searched in the residual after ripple of each joint's own gears.
            let learned = Sums::of(left.iter(), &[order], n);
            let held = Sums::new(0, 0);
            let fit = Self { orders: vec![order], learned, held }.ripples(&own);
            left.iter_mut().for_each(|sample| sample.take_off(&fit));
        }
        let held = samples.iter().filter(|sample| sample.fold == fold);
        Self {
            learned: Sums::of(learned.into_iter(), &orders, n),
            held: Sums::of(held, &orders, n),
            orders,
        }
    }

    /// Indices of the columns of some joints' gears.
    fn columns(&self, of: &[usize]) -> Vec<usize> {
        let each = RIPPLE_COEFFICIENTS * self.orders.len();
        of.iter().flat_map(|joint| each * joint..each * (joint + 1)).collect()
    }

    /// Coefficients of the ripple that the gears of the joints `of` cause in joint `j`.
    fn coefficients(&self, of: &[usize], j: usize) -> DVector<f64> {
        let columns = self.columns(of);
        let mut gram = self.learned.gram.select_rows(&columns).select_columns(&columns);
        gram.iter_mut().step_by(columns.len() + 1).for_each(|own| *own += RIDGE);
        let right = self.learned.right.select_rows(&columns).column(j).into_owned();
        gram.cholesky().map_or(DVector::zeros(columns.len()), |factor| factor.solve(&right))
    }

    /// Sum of squared residuals of joint `j` in the held-out samples, with ripple of the joints `of`.
    fn squared_residual(&self, of: &[usize], j: usize) -> f64 {
        let (columns, own) = (self.columns(of), self.coefficients(of, j));
        let gram = self.held.gram.select_rows(&columns).select_columns(&columns);
        let right = self.held.right.select_rows(&columns).column(j).into_owned();
        self.held.squares[j] - 2.0 * right.dot(&own) + own.dot(&(gram * &own))
    }

    /// The ripple of each joint's gears; `sources` are the joints whose ripple acts on each joint.
    fn ripples(&self, sources: &[Vec<usize>]) -> Vec<Vec<Ripple>> {
        let none =
            |order: &f64| Ripple { order: *order, coefficients: vec![vec![]; sources.len()] };
        let mut found: Vec<Vec<Ripple>> =
            sources.iter().map(|_| self.orders.iter().map(none).collect()).collect();
        for (j, of) in sources.iter().enumerate() {
            let own = self.coefficients(of, j);
            let parts = own.as_slice().chunks(RIPPLE_COEFFICIENTS);
            let gears = of.iter().flat_map(|joint| (0..self.orders.len()).map(|k| (*joint, k)));
            for ((joint, k), part) in gears.zip(parts) {
                found[joint][k].coefficients[j] = part.to_vec();
            }
        }
        let has_effect = |own: &Ripple| own.coefficients.iter().any(|own| !own.is_empty());
        found.iter_mut().for_each(|own| own.retain(has_effect));
        found
    }
}

impl Sums {
    fn new(columns: usize, joints: usize) -> Self {
        Self {
            gram: DMatrix::zeros(columns, columns),
            right: DMatrix::zeros(columns, joints),
            squares: vec![0.0; joints],
        }
    }

    fn of<'a>(samples: impl Iterator<Item = &'a RippleSample>, orders: &[f64], n: usize) -> Self {
        let mut sums = Self::new(n * orders.len() * RIPPLE_COEFFICIENTS, n);
        for sample in samples {
            let row: Vec<(usize, f64)> = (sample.q.iter().zip(&sample.speed))
                .flat_map(|(q, speed)| orders.iter().map(|order| (*order, *q, *speed)))
                .enumerate()
                .flat_map(|(block, (order, q, speed))| {
                    let factors = Ripple::factors(order, q, speed);
                    factors.map(|(k, factor)| (block * RIPPLE_COEFFICIENTS + k, factor))
                })
                .collect();
            for (a, own) in &row {
                row.iter().for_each(|(b, other)| sums.gram[(*a, *b)] += own * other);
                // Minus: the motor torque is the negative of the residual of the external torque.
                let torques = sample.torque.iter().enumerate();
                torques.for_each(|(j, torque)| sums.right[(*a, j)] -= own * torque);
            }
            for (square, torque) in sums.squares.iter_mut().zip(&sample.torque) {
                *square += torque * torque;
            }
        }
        sums
    }
}

/// The order that explains most of the residual, summed over the joints, each with its own gears.
fn best_order(samples: &[RippleSample]) -> f64 {
    let n = samples.first().map_or(0, |sample| sample.q.len());
    let mut explained = ORDERS.map(|order| (0.0, f64::from(order))).collect::<Vec<_>>();
    for j in 0..n {
        // From one order n to the next, the phase n·q of a sample increases by its position q.
        let turn = |times: f64| samples.iter().map(move |own| Complex::cis(times * own.q[j]));
        let steps: Vec<Complex<f64>> = turn(1.0).collect();
        let mut angles: Vec<Complex<f64>> = turn(f64::from(*ORDERS.start())).collect();
        for (explained, order) in &mut explained {
            // By knot: sum of products with the torque, and of squares.
            let mut sums = [(Complex::<f64>::ZERO, RIDGE); RIPPLE_COEFFICIENTS / 2];
            for ((angle, step), sample) in angles.iter_mut().zip(&steps).zip(samples) {
                for (knot, weight) in Ripple::knots(*order, sample.speed[j]) {
                    sums[knot].0 += *angle * (weight * sample.torque[j]);
                    // The square of a cosine or a sine is a half on average.
                    sums[knot].1 += 0.5 * weight * weight;
                }
                *angle *= step;
            }
            // Products between neighbouring knots are neglected.
            *explained += sums.iter().map(|(product, own)| product.norm_sqr() / own).sum::<f64>();
        }
    }
    explained.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, order)| order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ripple_of_one_joint_is_found_with_its_order_in_the_joints_on_which_it_acts() {
        let coefficients = |phase: f64| -> Vec<f64> {
            (0..RIPPLE_COEFFICIENTS).map(|k| 0.4 * (phase + 1.3 * k as f64).sin()).collect()
        };
        let orders = [240.0, 480.0];
        let made = orders.map(|order| Ripple {
            order,
            coefficients: vec![coefficients(0.01 * order), vec![], coefficients(1.0 + order)],
        });
        let sample = |k: usize| {
            let t = k as f64 * 0.01;
            let q =
                [(0.7, 0.8), (1.1, 0.3), (0.5, 0.9)].map(|(w, a): (f64, f64)| a * (w * t).sin());
            let speed = [(0.7, 0.8), (1.1, 0.3), (0.5, 0.9)]
                .map(|(w, a): (f64, f64)| a * w * (w * t).cos());
            let mut torques = [0.0; 3];
            made.iter().for_each(|own| own.add_to(&mut torques, q[0], speed[0]));
            RippleSample {
                fold: k / 1_000,
                q: q.to_vec(),
                speed: speed.to_vec(),
                torque: torques.iter().map(|torque| -torque).collect(),
            }
        };
        let samples: Vec<RippleSample> = (0..4_000).map(sample).collect();
        let found = find(&samples);
        for fold in &found {
            let mut own: Vec<f64> = fold[0].iter().map(|own| own.order).collect();
            own.sort_by(f64::total_cmp);
            assert_eq!(own, orders);
            assert!(fold[0].iter().all(|own| own.coefficients[1].is_empty()));
            assert!(fold[1].is_empty() && fold[2].is_empty());
        }
        let power = |of: &dyn Fn(&RippleSample) -> RippleSample| {
            samples.iter().flat_map(|own| of(own).torque).map(|own| own * own).sum::<f64>()
        };
        let left = |own: &RippleSample| {
            let mut own = own.clone();
            own.take_off(&found[own.fold]);
            own
        };
        let (before, after) = (power(&Clone::clone), power(&left));
        assert!(after < 0.01 * before, "{after} of {before}");

        // Samples in which the arm jerks do not hide the ripple.
        let mut jerky = samples.clone();
        for (k, sample) in jerky.iter_mut().enumerate().take(8) {
            sample.torque = vec![if k % 2 == 0 { 90.0 } else { -90.0 }; 3];
        }
        let still =
            RippleSample { speed: vec![0.0; 3], torque: vec![1e-3; 3], ..samples[0].clone() };
        jerky.extend(vec![still; 6_000]);
        let found = find(&jerky);
        let left = |own: &RippleSample| {
            let mut own = own.clone();
            own.take_off(&found[own.fold]);
            own
        };
        let after = power(&left);
        assert!(after < 0.01 * before, "{after} of {before} beside jerks");
    }
}
