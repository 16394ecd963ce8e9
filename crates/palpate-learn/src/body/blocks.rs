//! A body for a cushion, a bag, or a bush that is too dense to resolve: blocks of elastic material under the seen
//! surface, coupled to the ground and to each other.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use palpate::unstable::{Segment, SegmentKind};

use super::otsu::otsu;

/// Young's modulus of a soft cushion before any touch, Pa.
const FOAM_MODULUS_PA: f64 = 2e3;
/// Width of a block, m; it is larger if there were more than [`MAX_BLOCKS`].
const WIDTH_M: f64 = 0.04;
const MAX_BLOCKS: f64 = 400.0;
/// Fewest points of a block, as a share of the median number of points per block.
const FEWEST: f64 = 0.2;
/// The top of a block is fitted to its points above their 90th percentile of height minus this, m.
const TOP_M: f64 = 0.03;
/// Lower blocks count as ground, m.
const LOWEST_M: f64 = 0.02;
/// Steepest slope of a top.
const STEEPEST: f64 = 1.0;
/// Radius of the rounded edges, m.
const EDGE_M: f64 = 0.004;
/// There are two materials if two groups of colours explain this share of the variance of colours. A gradient,
/// as from light that falls from one side, cut in two explains 0.75.
const TWO_COLOURS: f64 = 0.85;
/// Least share of the blocks for each of two materials.
const MIN_OF_COLOUR: f64 = 0.1;

/// Blocks from the lowest seen height up; `branch` is the index of the material. None if nothing is above the ground.
pub(super) fn blocks(points: &[Point3<f64>], colours: &[[u8; 3]]) -> Vec<Segment> {
    let Some(first) = points.first() else { return Vec::new() };
    let (low, high) = points.iter().fold((first.coords, first.coords), |(low, high), point| {
        (low.inf(&point.coords), high.sup(&point.coords))
    });
    let area = (high.x - low.x) * (high.y - low.y);
    let width_m = f64::max(WIDTH_M, (area / MAX_BLOCKS).sqrt());
    let mut columns: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    for (number, point) in points.iter().enumerate() {
        let place = [point.x - low.x, point.y - low.y].map(|way| (way / width_m) as i64);
        columns.entry(place).or_default().push(number);
    }
    let mut counts: Vec<usize> = columns.values().map(Vec::len).collect();
    counts.sort_unstable();
    let fewest = f64::max(FEWEST * counts[counts.len() / 2] as f64, 4.0);
    columns.retain(|_, members| members.len() as f64 >= fewest);

    let half = 0.5 * width_m;
    let (mut blocks, mut shades) = (Vec::new(), Vec::new());
    for ([i, j], members) in columns {
        let [x, y] = [(i, low.x), (j, low.y)].map(|(at, low)| low + (at as f64 + 0.5) * width_m);
        let (height, [along, across]) = top(points, &members, [x, y]);
        if height - low.z < LOWEST_M {
            continue;
        }
        let colour = members.iter().map(|&number| Vector3::from(colours[number].map(f64::from)));
        let colour = colour.sum::<Vector3<f64>>();
        shades.push(colour / f64::max(colour.sum(), 1.0)); // without its brightness
        blocks.push(Segment {
            parent: None,
            kind: SegmentKind::Block,
            start_m: [x - half, y, height - half * along - EDGE_M],
            end_m: [x + half, y, height + half * along - EDGE_M],
            bare_m: 0.0,
            radius_m: EDGE_M,
            half_width_m: [0.0, half, half * across],
            joint_stiffness: FOAM_MODULUS_PA * width_m * width_m / (height - low.z),
            branch: 0,
        });
    }
    for (block, material) in blocks.iter_mut().zip(materials(&shades)) {
        block.branch = material;
    }
    blocks
}

/// Height of the top at the middle `[x, y]` of a column, m, and its slopes along x and y.
fn top(points: &[Point3<f64>], members: &[usize], [x, y]: [f64; 2]) -> (f64, [f64; 2]) {
    let mut heights: Vec<f64> = members.iter().map(|&number| points[number].z).collect();
    heights.sort_by(f64::total_cmp);
    let highest = heights[(heights.len() * 9) / 10];
    let upper = members.iter().map(|&number| points[number]).filter(|p| p.z > highest - TOP_M);
    // z = c + a x + b y by least squares; the slopes are slightly regularised towards 0.
    let (mut normal, mut right) =
        (Matrix3::from_diagonal(&Vector3::new(0.0, 1e-3, 1e-3)), Vector3::zeros());
    for point in upper {
        let row = Vector3::new(1.0, point.x - x, point.y - y);
        normal += row * row.transpose();
        right += row * point.z;
    }
    match normal.cholesky() {
        Some(held) => {
            let plane = held.solve(&right);
            (
                plane[0].min(heights[heights.len() - 1]),
                [plane[1], plane[2]].map(|slope| slope.clamp(-STEEPEST, STEEPEST)),
            )
        }
        None => (highest, [0.0; 2]),
    }
}

/// The material of each block: 0 or 1 if there are clearly two groups of colours, otherwise 0.
fn materials(shades: &[Vector3<f64>]) -> Vec<u32> {
    let one = vec![0; shades.len()];
    let n = shades.len().max(1) as f64;
    let mean = shades.iter().sum::<Vector3<f64>>() / n;
    let spread = shades
        .iter()
        .map(|shade| (shade - mean) * (shade - mean).transpose())
        .sum::<Matrix3<f64>>();
    let eigen = SymmetricEigen::new(spread);
    let axis = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let along: Vec<f64> = shades.iter().map(|shade| (shade - mean).dot(&axis)).collect();
    let threshold = otsu(&along);
    let classes: Vec<u32> = along.iter().map(|&along| u32::from(along > threshold)).collect();
    let (mut sums, mut counts) = ([0.0; 2], [0.0; 2]);
    for (&class, along) in classes.iter().zip(&along) {
        sums[class as usize] += along;
        counts[class as usize] += 1.0;
    }
    let total: f64 = along.iter().map(|along| along * along).sum();
    let between: f64 = [0, 1].map(|c| sums[c] * sums[c] / f64::max(counts[c], 1.0)).iter().sum();
    let are_two = between > TWO_COLOURS * total && counts.iter().all(|&c| c > MIN_OF_COLOUR * n);
    if are_two { classes } else { one }
}
