//! Ripple of the gears, out of what the rest of the model leaves over: the orders that explain most, one after the
//! other, with coefficients by least squares.

use nalgebra::{DMatrix, DVector};
use palpate::Ripple;
use palpate::unstable::RIPPLE_COEFFICIENTS;

/// Orders that are tried: a gear's teeth, times two at most; slower ones are gravity's and the bias's.
const ORDERS: std::ops::RangeInclusive<u32> = 20..=700;
/// Orders of a joint.
const MOST_ORDERS: usize = 2;
/// Samples that the search for an order looks at.
const MOST_SAMPLES: usize = 6_000;
/// Of the least squares: coefficients that few samples tell stay small.
const RIDGE: f64 = 3.0;

/// Position, rad, speed, rad/s, and the external torque that is left over, N·m.
pub(super) type RippleSample = (f64, f64, f64);

/// The ripple of a joint; empty if it has too few samples.
pub(super) fn fit(samples: &[RippleSample]) -> Vec<Ripple> {
    if samples.len() < 20 * RIPPLE_COEFFICIENTS {
        return Vec::new();
    }
    let mut orders = Vec::new();
    let mut found = Vec::new();
    for _ in 0..MOST_ORDERS {
        orders.push(best_order(samples, &found));
        found = coefficients(samples, &orders);
    }
    found
}

/// What ripple leaves over.
pub(super) fn left_over(ripple: &[Ripple], (q, speed, torque): RippleSample) -> f64 {
    // External torque is what is measured plus what the motor needs.
    torque + ripple.iter().map(|ripple| ripple.torque(q, speed)).sum::<f64>()
}

/// The order that explains most of what the others leave over.
fn best_order(samples: &[RippleSample], found: &[Ripple]) -> f64 {
    let every = samples.len().div_ceil(MOST_SAMPLES);
    let left: Vec<RippleSample> = (samples.iter().step_by(every))
        .map(|sample| (sample.0, sample.1, left_over(found, *sample)))
        .collect();
    let explained = |order: f64| {
        // By both directions, each with cosine and sine, which hardly correlate.
        let mut sums = [[0.0; 2]; 2];
        for (q, speed, torque) in &left {
            let (sin, cos) = (order * q).sin_cos();
            let way = &mut sums[usize::from(*speed < 0.0)];
            way[0] += cos * torque;
            way[1] += sin * torque;
        }
        sums.iter().flatten().map(|sum| sum * sum).sum::<f64>()
    };
    let orders = ORDERS.map(|order| (explained(f64::from(order)), f64::from(order)));
    orders.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, order)| order)
}

fn coefficients(samples: &[RippleSample], orders: &[f64]) -> Vec<Ripple> {
    let size = RIPPLE_COEFFICIENTS * orders.len();
    let (mut gram, mut right) = (DMatrix::identity(size, size) * RIDGE, DVector::zeros(size));
    for (q, speed, torque) in samples {
        let row: Vec<f64> =
            orders.iter().flat_map(|order| Ripple::factors(*order, *q, *speed)).collect();
        for (a, own) in row.iter().enumerate() {
            right[a] -= own * torque;
            for (b, other) in row.iter().enumerate().take(a + 1) {
                gram[(a, b)] += own * other;
            }
        }
    }
    let Some(factor) = gram.cholesky() else { return Vec::new() };
    let solved = factor.solve(&right);
    let each = orders.iter().zip(solved.as_slice().chunks(RIPPLE_COEFFICIENTS));
    each.map(|(order, own)| Ripple { order: *order, coefficients: own.to_vec() }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_and_size_of_a_ripple_are_found() {
        let ripple = Ripple {
            order: 240.0,
            coefficients: vec![0.3, -0.2, 0.1, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        };
        let sample = |k: usize| {
            let t = k as f64 * 0.01;
            let (q, speed) = (0.8 * (0.7 * t).sin(), 0.56 * (0.7 * t).cos());
            (q, speed, -ripple.torque(q, speed))
        };
        let samples: Vec<RippleSample> = (0..3_000).map(sample).collect();
        let found = fit(&samples);
        assert_eq!(found[0].order, 240.0);
        let power = |left: &dyn Fn(RippleSample) -> f64| {
            samples.iter().map(|own| left(*own).powi(2)).sum::<f64>()
        };
        let (before, after) = (power(&|own| own.2), power(&|own| left_over(&found, own)));
        assert!(after < 0.01 * before, "{after} of {before}");
    }
}
