//! The springs of blocks: a thick elastic layer, cut into columns.
//!
//! Each block is held at its place by a spring along z, and by stiffer ones along x and y, where neighbours are in the
//! way. Neighbouring blocks are connected by shear springs (Pasternak's foundation).

use nalgebra::Vector3;

use super::body::{Segment, SegmentKind};

/// Stiffness of a block along x, y, z, relative to its stiffness along z.
///
/// A block that moves sideways presses its two neighbours together. With a displacement that grows linearly
/// over the height h, that is `2/3 (h/w)²` of the stiffness `E w²/h` along z: 5 for blocks of 4 cm in a layer
/// of 11 cm, less where they are wider.
pub const BLOCK_STIFFNESS_SHARES: [f64; 3] = [4.0, 4.0, 1.0];
/// Stiffness of the spring between neighbours along z, relative to the mean stiffness of the two: `G h / 3` over
/// `E w²/h`, 1 for the same blocks.
const SHEAR: f64 = 1.0;
/// Largest distance between the centres of neighbours, in widths.
const BESIDE: f64 = 1.2;

/// The springs of a body's blocks.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Blocks {
    /// Stiffness along z by segment, N/m; 0 if it is not a block.
    own: Vec<f64>,
    /// By segment, its neighbours and the springs to them, N/m.
    beside: Vec<Vec<(u32, f64)>>,
}

impl Blocks {
    pub(super) fn new(segments: &[Segment]) -> Self {
        let is_block = |segment: &Segment| segment.kind == SegmentKind::Block;
        if !segments.iter().any(is_block) {
            return Self::default();
        }
        let stiffness = |segment: &Segment| match is_block(segment) {
            true => segment.joint_stiffness,
            false => 0.0,
        };
        let own: Vec<f64> = segments.iter().map(stiffness).collect();
        let middle = |segment: &Segment| (segment.start() + 0.5 * segment.axis()).xy();
        let mut beside = vec![Vec::new(); segments.len()];
        for (a, one) in segments.iter().enumerate().filter(|(_, segment)| is_block(segment)) {
            for (b, other) in segments.iter().enumerate().filter(|(_, segment)| is_block(segment)) {
                let apart_m = (middle(one) - middle(other)).norm();
                let width_m = f64::min(one.axis().xy().norm(), other.axis().xy().norm());
                if a != b && apart_m < BESIDE * width_m {
                    beside[a].push((b as u32, SHEAR * 0.5 * (own[a] + own[b])));
                }
            }
        }
        Self { own, beside }
    }

    /// Both blocks and the stiffness, N/m, of each spring between neighbours.
    pub(super) fn between(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        self.beside.iter().enumerate().flat_map(|(a, beside)| {
            let later = beside.iter().map(move |&(b, k)| (a, b as usize, k));
            later.filter(|(a, b, _)| a < b)
        })
    }

    /// Energy of all springs, J; `slid_m` by segment.
    pub(super) fn energy(&self, slid_m: &[Vector3<f64>]) -> f64 {
        let held = self.own.iter().zip(slid_m).map(|(&own, slid)| {
            own * slid.component_mul(slid).dot(&Vector3::from(BLOCK_STIFFNESS_SHARES))
        });
        let sheared = self.beside.iter().zip(slid_m).flat_map(|(beside, slid)| {
            // Each spring comes twice.
            beside.iter().map(|&(other, k)| 0.5 * k * (slid.z - slid_m[other as usize].z).powi(2))
        });
        0.5 * (held.sum::<f64>() + sheared.sum::<f64>())
    }

    /// Gradient of the energy with respect to the position of a block, N.
    pub(super) fn slope(&self, block: usize, slid_m: &[Vector3<f64>]) -> Vector3<f64> {
        let slid = slid_m[block];
        let own = self.own[block] * slid.component_mul(&Vector3::from(BLOCK_STIFFNESS_SHARES));
        let apart = |&(other, k): &(u32, f64)| k * (slid.z - slid_m[other as usize].z);
        own + Vector3::z() * self.beside[block].iter().map(apart).sum::<f64>()
    }

    /// Curvature of the energy in the position of a block, with fixed neighbours, by axis, N/m.
    pub(super) fn stiffness(&self, block: usize) -> Vector3<f64> {
        let beside: f64 = self.beside[block].iter().map(|(_, k)| k).sum();
        self.own[block] * Vector3::from(BLOCK_STIFFNESS_SHARES) + beside * Vector3::z()
    }
}
