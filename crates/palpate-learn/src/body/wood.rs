//! Wood against leaf: by colour, and by shape where a stem has the colour of leaves.

use nalgebra::Point3;

use super::graph::Graph;
use super::skeleton::direction;

/// Points of a stem hang together across gaps of this, m.
const JOINED_M: f64 = 0.006;
/// A piece that is spread by as much as this along it, m (a rod of 17 cm),
const LONG_M: f64 = 0.05;
/// and by less than this share of it in any direction across is a rod, whatever its colour.
const THIN: f64 = 0.12;

/// Whether each point is wood.
pub(super) fn is_wood(points: &[Point3<f64>], colours: &[[u8; 3]]) -> Vec<bool> {
    let mut is_wood = is_redder(colours);
    let leaves: Vec<u32> =
        (0..points.len() as u32).filter(|&point| !is_wood[point as usize]).collect();
    let graph = Graph::new(points, JOINED_M, |a, b| is_wood[a] == is_wood[b]);
    for piece in graph.pieces(&leaves) {
        let (_, [along_m, across_m]) = direction(points, &piece);
        if along_m > LONG_M && across_m < THIN * along_m {
            piece.iter().for_each(|&point| is_wood[point as usize] = true);
        }
    }
    is_wood
}

/// Whether each colour is redder than it is green, by the threshold that parts the two best (Otsu).
fn is_redder(colours: &[[u8; 3]]) -> Vec<bool> {
    let redness: Vec<f64> = colours
        .iter()
        .map(|[red, green, _]| {
            let share = |byte: &u8| f64::from(*byte) / 255.0 + 0.02;
            (share(red) / share(green)).ln()
        })
        .collect();
    let threshold = otsu(&redness);
    redness.iter().map(|redness| *redness > threshold).collect()
}

/// The threshold that leaves most of the variance between the two classes.
pub(super) fn otsu(values: &[f64]) -> f64 {
    const BINS: usize = 256;
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let width = (high - low) / BINS as f64;
    if width.is_nan() || width <= 0.0 {
        return low - 1.0;
    }
    let mut counts = [0.0; BINS];
    for value in values {
        counts[(((value - low) / width) as usize).min(BINS - 1)] += 1.0;
    }
    let middle = |bin: usize| low + (bin as f64 + 0.5) * width;
    let total = values.len() as f64;
    let mean = counts.iter().enumerate().map(|(bin, n)| n * middle(bin)).sum::<f64>();
    let (mut below, mut sum, mut best) = (0.0, 0.0, (f64::NEG_INFINITY, low));
    for (bin, count) in counts.iter().enumerate() {
        below += count;
        sum += count * middle(bin);
        let between = (mean * below / total - sum).powi(2) / (below * (total - below)).max(1.0);
        if between > best.0 {
            best = (between, middle(bin));
        }
    }
    best.1
}
