//! A robot with a skin: its links and the baked distance of each.
//!
//! This is what the contact simulator moves through the lattice. It knows neither where meshes nor
//! where caches come from: both are handed in.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::contact::travel_m;
use crate::robot::{Collision, Link, LinkId, Robot, Shape};
use crate::sdf::{self, BakeConfig, BakeReport, DistanceGrid, SdfError, Solid, TriangleMesh};

/// A robot and the surface of each of its links.
#[derive(Debug, Clone)]
pub struct Arm {
    /// Tree and kinematics.
    pub robot: Robot,
    /// One per link, in the order of [`Robot::links`]; `None` for a link without shapes.
    ///
    /// Shared, since they are large and never change.
    pub surfaces: Arc<Vec<Option<DistanceGrid>>>,
}

/// What baking one link found out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkReport {
    /// Which link.
    pub link: LinkId,
    /// Volume, and where the sign of its meshes is doubtful.
    pub report: BakeReport,
}

/// Why a robot cannot be given a skin.
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
    /// An arm that can touch nothing.
    #[error("none of the {links} links of robot `{robot}` has a collision shape")]
    Shapeless { robot: String, links: usize },
}

/// What the lookup of a mesh gives: its triangles in the file's coordinates.
pub type MeshResult = Result<TriangleMesh, Box<dyn std::error::Error + Send + Sync>>;

impl Arm {
    /// How far the fastest point of the arm goes in a straight line when its links go from these poses to those,
    /// m.
    pub fn travel_m(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> f64 {
        travel_m(&self.surfaces, from, to)
    }

    /// Bakes the surfaces of all links.
    ///
    /// `load` is given the filename of a mesh as the URDF spells it, once for each time that it
    /// is used. To keep baked links in a cache, go link by link: [`solid`], [`sdf::bake`].
    ///
    /// # Errors
    ///
    /// Whatever `load` says, a shape that cannot be baked, or a robot without any shape.
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

    /// A robot with surfaces that are baked already.
    ///
    /// # Errors
    ///
    /// If no link has a surface.
    ///
    /// # Panics
    ///
    /// If there is not one entry a link.
    pub fn new(robot: Robot, surfaces: Vec<Option<DistanceGrid>>) -> Result<Arm, ArmError> {
        assert_eq!(surfaces.len(), robot.links().len(), "one surface, or none, for each link");
        if surfaces.iter().all(Option::is_none) {
            let (robot, links) = (robot.name().to_owned(), surfaces.len());
            return Err(ArmError::Shapeless { robot, links });
        }
        Ok(Arm { robot, surfaces: Arc::new(surfaces) })
    }

    /// A number that distinguishes this arm from others: its links, joints, masses and surfaces.
    ///
    /// Lengths are rounded to a micrometre and masses to a milligram, so that the last bits of a
    /// machine's arithmetic do not make another arm. Cost: a millisecond.
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

/// The shapes of a link, meshes loaded and moved into its frame; `None` if it has none.
///
/// # Errors
///
/// [`ArmError::Mesh`] with whatever `load` says.
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
