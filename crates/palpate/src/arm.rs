//! A robot with the grid of signed distances of each of its links.
//!
//! The contact simulator moves this arm through the lattice. Meshes and cached grids are passed in; this module does
//! not load them.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::contact::travel_m;
use crate::robot::{Collision, Link, LinkId, Robot, Shape};
use crate::sdf::{self, BakeConfig, BakeReport, DistanceGrid, SdfError, Solid, TriangleMesh};

/// A robot and the surface of each of its links.
#[derive(Debug, Clone)]
pub struct Arm {
    /// Link tree and kinematics.
    pub robot: Robot,
    /// Grid of each link, in the order of [`Robot::links`]; `None` for a link without shapes.
    ///
    /// Shared, since they are large and never change.
    pub surfaces: Arc<Vec<Option<DistanceGrid>>>,
}

/// Report on the baking of one link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkReport {
    /// The link.
    pub link: LinkId,
    /// Its volume, and the parts of it where inside or outside is doubtful.
    pub report: BakeReport,
}

/// Why the surfaces of a robot cannot be baked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ArmError {
    /// The caller could not provide a mesh.
    #[error("mesh `{filename}` of link `{link}`: {reason}")]
    Mesh { link: String, filename: String, reason: Box<dyn std::error::Error + Send + Sync> },
    /// A shape that cannot be baked.
    #[error("link `{link}`: {reason}")]
    Shape { link: String, reason: SdfError },
    /// A robot without any collision shape.
    #[error("none of the {links} links of robot `{robot}` has a collision shape")]
    Shapeless { robot: String, links: usize },
}

/// Result of loading a mesh: its triangles in the file's coordinates.
pub type MeshResult = Result<TriangleMesh, Box<dyn std::error::Error + Send + Sync>>;

impl Arm {
    /// Upper bound of the straight-line distance that a point of the arm moves between two sets of link poses, m.
    pub fn travel_m(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> f64 {
        travel_m(&self.surfaces, from, to)
    }

    /// Bakes the surfaces of all links.
    ///
    /// `load` gets the filename of a mesh as written in the URDF; it is called once for each use of a mesh. To cache
    /// baked links, call [`solid`] and [`sdf::bake`] link by link.
    ///
    /// # Errors
    ///
    /// An error of `load`, a shape that cannot be baked, or a robot without any shape.
    pub fn bake(
        robot: Robot,
        config: &BakeConfig,
        mut load: impl FnMut(&str) -> MeshResult,
    ) -> Result<(Arm, Vec<LinkReport>), ArmError> {
        let (mut surfaces, mut reports) = (Vec::new(), Vec::new());
        for (index, link) in robot.links().iter().enumerate() {
            let Some(solid) = solid(link, &mut load)? else {
                surfaces.push(None);
                continue;
            };
            let (grid, report) = sdf::bake(&solid, config)
                .map_err(|reason| ArmError::Shape { link: link.name.clone(), reason })?;
            let id = u16::try_from(index).expect("a robot has no more links than LinkId counts");
            reports.push(LinkReport { link: LinkId(id), report });
            surfaces.push(Some(grid));
        }
        Ok((Arm::new(robot, surfaces)?, reports))
    }

    /// An arm from a robot and surfaces that were baked before.
    ///
    /// # Errors
    ///
    /// If no link has a surface.
    ///
    /// # Panics
    ///
    /// If `surfaces` does not have one entry for each link.
    pub fn new(robot: Robot, surfaces: Vec<Option<DistanceGrid>>) -> Result<Arm, ArmError> {
        assert_eq!(surfaces.len(), robot.links().len(), "one surface, or none, for each link");
        if surfaces.iter().all(Option::is_none) {
            let (robot, links) = (robot.name().to_owned(), surfaces.len());
            return Err(ArmError::Shapeless { robot, links });
        }
        Ok(Arm { robot, surfaces: Arc::new(surfaces) })
    }

    /// A hash of the links, joints, masses and surfaces, which identifies this arm.
    ///
    /// Lengths are rounded to a micrometre and masses to a milligram, so that rounding errors do not change the hash.
    /// Cost: about 1 ms.
    pub fn fingerprint(&self) -> u64 {
        let rounded = |number: f64| ((number * 1e6).round() as i64).to_le_bytes();
        let kinematics = self.robot.numbers().flat_map(rounded);
        let names = (self.robot.links().iter())
            .map(|link| link.name.as_str())
            .chain(self.robot.joint_names())
            .flat_map(|name| name.bytes().chain([0]));
        let surfaces = (self.surfaces.iter())
            .flat_map(|grid| grid.iter().flat_map(DistanceGrid::numbers).chain([f64::NAN]))
            .flat_map(rounded);
        sdf::checksum(names.chain(kinematics).chain(surfaces))
    }
}

/// The shapes of a link, with its meshes loaded and moved into its frame; `None` if it has no shape.
///
/// # Errors
///
/// [`ArmError::Mesh`] with the error of `load`.
pub fn solid(
    link: &Link,
    mut load: impl FnMut(&str) -> MeshResult,
) -> Result<Option<Solid>, ArmError> {
    if link.collision.is_empty() {
        return Ok(None);
    }
    let mut solid = Solid::default();
    for part in &link.collision {
        match &part.shape {
            Shape::Mesh { filename, scale } => {
                let mesh = load(filename).map_err(|reason| ArmError::Mesh {
                    link: link.name.clone(),
                    filename: filename.clone(),
                    reason,
                })?;
                solid.meshes.push(mesh.into_link(&part.link_from_shape, scale));
            }
            _ => solid.primitives.push(Collision::clone(part)),
        }
    }
    Ok(Some(solid))
}
