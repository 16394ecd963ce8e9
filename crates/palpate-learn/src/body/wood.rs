//! Separates wood from leaves: by colour, and by shape if a stem has the colour of leaves.

use nalgebra::Point3;

use super::graph::Graph;
use super::otsu::otsu;
use super::skeleton::principal_axes;

/// Largest gap between points of one piece, m.
const JOINED_M: f64 = 0.006;
/// A piece is wood, whatever its colour, if it is long and thin. It is long if the standard deviation of its points along
/// it is larger than this, m: a rod of 17 cm.
const LONG_M: f64 = 0.05;
/// A piece is thin if their standard deviation in every direction across is less than this share of that along it.
const THIN: f64 = 0.12;

/// Whether each point is wood.
pub(super) fn is_wood(points: &[Point3<f64>], colours: &[[u8; 3]]) -> Vec<bool> {
    let mut is_wood = is_redder(colours);
    let leaves: Vec<u32> =
        (0..points.len() as u32).filter(|&point| !is_wood[point as usize]).collect();
    let graph = Graph::new(points, JOINED_M, |a, b| is_wood[a] == is_wood[b]);
    for piece in graph.pieces(&leaves) {
        let places = piece.iter().map(|&at| points[at as usize]);
        let (_, _, [along_m, across_m, _]) = principal_axes(places);
        if along_m > LONG_M && across_m < THIN * along_m {
            piece.iter().for_each(|&point| is_wood[point as usize] = true);
        }
    }
    is_wood
}

/// Whether the ratio of red to green of each colour is above the threshold that separates two
/// classes best (Otsu).
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
