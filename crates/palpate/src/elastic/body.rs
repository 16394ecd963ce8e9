//! An elastic body at rest: segments that hang from each other on sprung joints, or blocks side by side.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::blocks::Blocks;
use super::effective_mass::inverse_effective_masses;
use crate::lattice::MAX_COORDINATE_M;

/// Largest number of segments of a body.
const MAX_SEGMENTS: usize = 5_000;
/// Largest total length of the segments of a body, m.
const LONGEST_M: f64 = 200.0;

/// What a segment represents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SegmentKind {
    /// A piece of a stem, a branch or a twig: a round rod.
    Wood,
    /// A leaf: a light, flat plate.
    Leaf,
    /// A piece of a cushion: a column that slides, and does not turn. Start, end and half width are those of its top.
    /// Blocks with the same `branch` are of one material.
    Block,
}

/// A rigid rod or plate on a sprung joint at its start.
///
/// Lengths in m, world frame, at rest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Segment {
    /// The segment that carries it; none if it stands on the ground. Parents come first.
    pub parent: Option<u32>,
    /// Kind of the segment.
    pub kind: SegmentKind,
    /// Position of the joint, m.
    pub start_m: [f64; 3],
    /// The free end, m.
    pub end_m: [f64; 3],
    /// Length without surface from the start on (the stalk of a leaf), m.
    pub bare_m: f64,
    /// Radius of the rod, or half the thickness of the plate, m.
    pub radius_m: f64,
    /// Half the width of a plate across start and end, m, world frame; zero for a rod.
    pub half_width_m: [f64; 3],
    /// Stiffness of the joint at a stiffness factor of one, N·m/rad; for a block, stiffness along z, N/m.
    #[serde(alias = "stiffness_n_m_per_rad")] // as older files call it
    pub joint_stiffness: f64,
    /// Which stem, branch or twig it is a piece of.
    pub branch: u32,
}

impl Segment {
    /// The joint at rest, m.
    pub fn start(&self) -> Point3<f64> {
        self.start_m.into()
    }

    /// From start to end at rest, m.
    pub fn axis(&self) -> Vector3<f64> {
        Point3::from(self.end_m) - self.start()
    }

    /// Half the width of a plate at rest, m.
    pub fn half_width(&self) -> Vector3<f64> {
        self.half_width_m.into()
    }
}

/// A body of segments: one tree or several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Segment>", into = "Vec<Segment>")]
pub struct ElasticBody {
    segments: Vec<Segment>,
    inverse_effective_masses: Vec<f64>,
    /// By segment, which of the trees it belongs to.
    trees: Vec<u32>,
    blocks: Blocks,
}

/// What can be wrong with an elastic body or its model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ElasticBodyError {
    /// A body without segments.
    #[error("the body has no segments")]
    Empty,
    /// A segment before its parent, or one that carries itself.
    #[error("the parent of segment {segment} is segment {parent}; wanted one that comes before it")]
    Parent { segment: usize, parent: u32 },
    /// A block that is carried, or carries something.
    #[error(
        "the parent of segment {segment} is segment {parent}, and one of them is a block; \
         wanted blocks without parent and without children"
    )]
    Block { segment: usize, parent: u32 },
    /// A number of a segment out of its range.
    #[error("{thing} of segment {segment} is {found}, wanted {wanted}")]
    Number { segment: usize, thing: &'static str, found: f64, wanted: &'static str },
    /// More segments than can be computed in the time of a sample.
    #[error("the body has {found} segments; wanted at most {MAX_SEGMENTS}")]
    Many { found: usize },
    /// A number of the learnt model out of its range.
    #[error("{thing} of the elastic model is {found}, wanted {wanted}")]
    Model { thing: &'static str, found: f64, wanted: &'static str },
}

impl TryFrom<Vec<Segment>> for ElasticBody {
    type Error = ElasticBodyError;

    fn try_from(segments: Vec<Segment>) -> Result<Self, ElasticBodyError> {
        Self::new(segments)
    }
}

impl From<ElasticBody> for Vec<Segment> {
    fn from(body: ElasticBody) -> Self {
        body.segments
    }
}

impl ElasticBody {
    /// A body of segments, each after the one that carries it.
    ///
    /// # Errors
    ///
    /// Names the first invalid segment.
    pub fn new(segments: Vec<Segment>) -> Result<Self, ElasticBodyError> {
        if segments.is_empty() {
            return Err(ElasticBodyError::Empty);
        }
        if segments.len() > MAX_SEGMENTS {
            return Err(ElasticBodyError::Many { found: segments.len() });
        }
        let mut total_m = 0.0;
        for (segment, part) in segments.iter().enumerate() {
            if let Some(parent) = part.parent.filter(|&parent| parent as usize >= segment) {
                return Err(ElasticBodyError::Parent { segment, parent });
            }
            let is_block = |segment: &Segment| segment.kind == SegmentKind::Block;
            if let Some(parent) = part.parent
                && (is_block(part) || is_block(&segments[parent as usize]))
            {
                return Err(ElasticBodyError::Block { segment, parent });
            }
            let check = |thing, found: f64, [low, high]: [f64; 2], wanted| {
                let fits = (low..=high).contains(&found);
                if fits {
                    Ok(())
                } else {
                    Err(ElasticBodyError::Number { segment, thing, found, wanted })
                }
            };
            check("radius_m", part.radius_m, [1e-6, 10.0], "a number from 1e-6 to 10")?;
            let stiffness = ("joint_stiffness", part.joint_stiffness);
            check(stiffness.0, stiffness.1, [1e-12, 1e12], "a number from 1e-12 to 1e12")?;
            check("bare_m", part.bare_m, [0.0, 10.0], "a number from 0 to 10")?;
            let coordinates = part.start_m.iter().chain(&part.end_m).chain(&part.half_width_m);
            for &coordinate in coordinates {
                let far = [-MAX_COORDINATE_M, MAX_COORDINATE_M];
                check("a coordinate", coordinate, far, "a number from -1000 to 1000")?;
            }
            total_m += part.axis().norm();
            check("the total length up to the end", total_m, [0.0, LONGEST_M], "at most 200 m")?;
            check("the length", part.axis().norm(), [1e-6, 10.0], "a length from 1e-6 to 10 m")?;
        }
        let inverse_effective_masses = inverse_effective_masses(&segments);
        let mut trees: Vec<u32> = Vec::with_capacity(segments.len());
        let mut materials: BTreeMap<u32, u32> = BTreeMap::new();
        let mut roots = 0..;
        for segment in &segments {
            let above = match (segment.kind, segment.parent) {
                (SegmentKind::Block, _) => materials.get(&segment.branch).copied(),
                (_, parent) => parent.map(|parent| trees[parent as usize]),
            };
            let tree = above.or_else(|| roots.next()).expect("there are enough numbers");
            if segment.kind == SegmentKind::Block {
                materials.insert(segment.branch, tree);
            }
            trees.push(tree);
        }
        let blocks = Blocks::new(&segments);
        Ok(Self { segments, inverse_effective_masses, trees, blocks })
    }

    /// The segments, each after the one that carries it.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// By segment, the number of its tree: trees are numbered in the order of their roots on the ground. All blocks of
    /// one material count as one tree.
    pub fn trees(&self) -> &[u32] {
        &self.trees
    }

    /// Number of trees; trees do not touch each other.
    pub fn n_trees(&self) -> usize {
        self.trees.iter().max().map_or(0, |&last| last as usize + 1)
    }

    /// Whether it is made of blocks.
    pub fn has_blocks(&self) -> bool {
        self.segments.iter().any(|segment| segment.kind == SegmentKind::Block)
    }

    /// The springs between blocks side by side: both, and the stiffness at a factor of one, N/m.
    pub fn springs_between_blocks(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        self.blocks.between()
    }

    /// The springs of its blocks.
    pub(super) fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// By segment, the acceleration of its centre under a unit force, 1/kg.
    pub(super) fn inverse_effective_masses(&self) -> &[f64] {
        &self.inverse_effective_masses
    }
}
