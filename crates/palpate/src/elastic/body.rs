//! An elastic body at rest: segments that hang from each other on sprung joints.

use nalgebra::{Point3, Vector3};

use super::mobility::mobilities;

/// What a segment stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentKind {
    /// A piece of a stem, a branch or a twig: a round rod.
    Wood,
    /// A leaf: a light, flat plate.
    Leaf,
}

/// A stiff rod or plate that turns about its start, where a spring holds it.
///
/// Lengths in m, world frame, at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// The segment that carries it; none if it stands on the ground. Parents come first.
    pub parent: Option<u32>,
    /// Rod or plate.
    pub kind: SegmentKind,
    /// The joint, m.
    pub start_m: [f64; 3],
    /// The free end, m.
    pub end_m: [f64; 3],
    /// This much from the start on there is no surface: the stalk of a leaf, m.
    pub bare_m: f64,
    /// Of the rod; half the thickness of the plate, m.
    pub radius_m: f64,
    /// Half the width of a plate across start and end, m, world frame; zero for a rod.
    pub half_width_m: [f64; 3],
    /// Spring of the joint at a stiffness factor of one, N·m/rad.
    pub stiffness_n_m_per_rad: f64,
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
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticBody {
    segments: Vec<Segment>,
    mobilities: Vec<f64>,
    /// By segment, which of the trees it belongs to.
    trees: Vec<u32>,
}

/// What makes a body impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum BodyError {
    /// Nothing to bend.
    #[error("the body has no segments")]
    Empty,
    /// A segment before its parent, or one that carries itself.
    #[error("segment {segment} hangs from segment {parent}; wanted one that comes before it")]
    Parent { segment: usize, parent: u32 },
    /// A number that no segment can have.
    #[error("{thing} of segment {segment} is {found}, wanted {wanted}")]
    Number { segment: usize, thing: &'static str, found: f64, wanted: &'static str },
}

impl ElasticBody {
    /// A body of segments, each after the one that carries it.
    ///
    /// # Errors
    ///
    /// Names the first segment that cannot be.
    pub fn new(segments: Vec<Segment>) -> Result<Self, BodyError> {
        if segments.is_empty() {
            return Err(BodyError::Empty);
        }
        for (segment, part) in segments.iter().enumerate() {
            if let Some(parent) = part.parent.filter(|&parent| parent as usize >= segment) {
                return Err(BodyError::Parent { segment, parent });
            }
            let wanted = "a finite number above zero";
            let positive = |thing, found: f64| match found > 0.0 && found.is_finite() {
                true => Ok(()),
                false => Err(BodyError::Number { segment, thing, found, wanted }),
            };
            positive("radius_m", part.radius_m)?;
            positive("stiffness_n_m_per_rad", part.stiffness_n_m_per_rad)?;
            let coordinates =
                part.start_m.iter().chain(part.end_m.iter()).chain(part.half_width_m.iter());
            if let Some(&found) = coordinates.clone().find(|number| !number.is_finite()) {
                let (thing, wanted) = ("a coordinate", "a finite number");
                return Err(BodyError::Number { segment, thing, found, wanted });
            }
            positive("the length", part.axis().norm())?;
        }
        let mobilities = mobilities(&segments);
        let mut trees: Vec<u32> = Vec::with_capacity(segments.len());
        let mut roots = 0..;
        for segment in &segments {
            let above = segment.parent.map(|parent| trees[parent as usize]);
            trees.extend(above.or_else(|| roots.next()));
        }
        Ok(Self { segments, mobilities, trees })
    }

    /// The segments, each after the one that carries it.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// By segment, which tree it belongs to: those that stand on the ground are numbered in their order.
    pub fn trees(&self) -> &[u32] {
        &self.trees
    }

    /// How many trees there are; they do not touch each other.
    pub fn n_trees(&self) -> usize {
        self.trees.iter().max().map_or(0, |&last| last as usize + 1)
    }

    /// By segment, the acceleration of its middle under a unit force, 1/kg.
    pub(super) fn mobilities(&self) -> &[f64] {
        &self.mobilities
    }
}
