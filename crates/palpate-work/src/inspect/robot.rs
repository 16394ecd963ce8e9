//! Content of a robot description: tree, masses, shapes, and the baking of its meshes.
//!
//! The tree is described even if a mesh is missing, since only the surfaces need meshes.

use std::path::{Path, PathBuf};

use palpate::Robot;
use palpate::unstable::{BakeReport, Joint, JointKind, Link};
use palpate_io::input;
use palpate_io::robot_files::LoadedArm;
use serde::Serialize;

use super::finding::Finding;
use super::words::{counted, number};
use crate::error::WorkError;
use crate::settings::SettingsError;
use crate::settings::sections::RobotSettings;

/// Plausible range of the largest side of a link, m; outside of it, the unit is probably another.
const BELIEVABLE_M: [f64; 2] = [0.01, 10.0];
/// Largest share of a mesh's inside volume that is in doubt without a warning.
const DOUBTFUL: f64 = 0.02;

/// Facts about a robot.
#[derive(Debug, Serialize)]
pub struct RobotFacts {
    /// Name in the URDF.
    pub name: String,
    /// Mass of all links, kg.
    pub mass_kg: f64,
    /// Upper bound of the distance from the base to any part, m; `None` if there are no surfaces.
    pub reach_m: Option<f64>,
    /// Joints that move.
    pub joints: Vec<Joint>,
    /// All links.
    pub links: Vec<LinkFacts>,
}

/// A link.
#[derive(Debug, Serialize)]
pub struct LinkFacts {
    /// Name in the URDF.
    pub name: String,
    /// Whether a joint carries the link, so that its mass loads the joint.
    pub moves: bool,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Number of collision shapes.
    pub shapes: usize,
    /// The baked surface, if the link has one and could be loaded.
    pub skin: Option<SkinFacts>,
}

/// The baked surface of a link.
#[derive(Debug, Serialize)]
pub struct SkinFacts {
    /// Size along the axes of the link's frame, m.
    pub size_m: [f64; 3],
    /// Whether it was read from the cache.
    pub cached: bool,
    /// Files of the meshes.
    pub meshes: Vec<PathBuf>,
    /// Report of the baking.
    pub report: BakeReport,
}

/// Inspects a robot, with the payload of the settings.
///
/// # Errors
///
/// If the robot cannot carry the payload of the settings.
pub fn inspect(
    path: &Path,
    settings: &RobotSettings,
) -> Result<(Option<RobotFacts>, Vec<Finding>), WorkError> {
    let name = path.to_string_lossy().into_owned();
    let settings = RobotSettings { robot: Some(name), ..settings.clone() };
    match crate::robot::load_with_report(&settings) {
        Ok(loaded) => {
            let facts = RobotFacts::new(&loaded.arm.robot, Some(&loaded));
            let mut findings = facts.findings();
            let remedy = "the robot can be used; correct this if loading it is slow";
            findings.extend(
                loaded.warnings.iter().map(|what| Finding::warning("loading", what, remedy)),
            );
            Ok((Some(facts), findings))
        }
        Err(WorkError::Settings(error @ SettingsError::Payload(_))) => Err(error.into()),
        Err(error) => {
            let remedy = "correct what the message names; until then the robot cannot be used";
            let finding = Finding::error("robot", error.to_string(), remedy);
            let facts = tree(path).map(|robot| RobotFacts::new(&robot, None));
            let mut findings = vec![finding];
            findings.extend(facts.iter().flat_map(RobotFacts::findings));
            Ok((facts, findings))
        }
    }
}

/// The robot without surfaces, if its URDF can be read.
fn tree(path: &Path) -> Option<Robot> {
    Robot::from_urdf(&input::read_text(path, u64::MAX).ok()?).ok()
}

impl RobotFacts {
    fn new(robot: &Robot, loaded: Option<&LoadedArm>) -> Self {
        let mut moving: Vec<bool> = Vec::new();
        for (index, link) in robot.links().iter().enumerate() {
            let by_joint = robot.joints().iter().any(|joint| joint.child.index() == index);
            moving.push(by_joint || link.parent.is_some_and(|parent| moving[parent.index()]));
        }
        let links: Vec<LinkFacts> = (robot.links().iter().enumerate())
            .map(|(index, link)| LinkFacts::new((index, link), moving[index], loaded))
            .collect();
        Self {
            name: robot.name().to_owned(),
            mass_kg: robot.links().iter().map(|link| link.mass_kg).sum(),
            reach_m: loaded.and_then(reach_m),
            joints: robot.joints().to_vec(),
            links,
        }
    }

    fn findings(&self) -> Vec<Finding> {
        let of_all = [self.masses(), self.shapes(), self.open_shells(), self.sealed_voids()];
        let of_links = self.links.iter().map(LinkFacts::odd_size);
        of_all.into_iter().chain(of_links).flatten().collect()
    }

    /// A warning about moving links that are `odd`; `None` if there are none. The message ends with
    /// `is` and their names.
    fn moving_links(
        &self,
        odd: impl Fn(&LinkFacts) -> bool,
        (code, is, remedy): (&'static str, &str, &str),
    ) -> Option<Finding> {
        let odd = self.links.iter().filter(|link| link.moves && odd(link));
        let odd: Vec<_> = odd.map(|link| (link.name.as_str(), link.name.clone())).collect();
        let are = if odd.len() == 1 { "is" } else { "are" };
        let what = format!("{} {are} {is}", counted(odd.len(), "link"));
        Finding::of_parts(code, &odd, &what, remedy)
    }

    /// A warning about links without mass.
    fn masses(&self) -> Option<Finding> {
        if self.mass_kg == 0.0 {
            return Some(Finding::warning(
                "no_mass",
                "no link has a mass, so the torque of gravity counts as zero",
                "add <inertial> to the links, or use logs without gravity (--gravity removed)",
            ));
        }
        let remedy = "add their <inertial>, or too little gravity is subtracted; a gripper may also \
                      be given as payload (--payload-link, --payload-mass-kg)";
        let texts = ("link_without_mass", "with shapes but without mass", remedy);
        self.moving_links(|link| link.shapes > 0 && link.mass_kg == 0.0, texts)
    }

    /// A warning about links with mass but without a shape for contacts.
    fn shapes(&self) -> Option<Finding> {
        let remedy = "their contacts are not simulated; add <collision> to the links that may \
                      touch the object";
        let texts = ("link_without_shape", "without a collision shape", remedy);
        self.moving_links(|link| link.shapes == 0 && link.mass_kg > 0.0, texts)
    }

    /// A warning about meshes for which winding number and flood fill disagree about the inside;
    /// `part` is the share of the volume in doubt.
    fn doubtful(
        &self,
        part: fn(&BakeReport) -> f64,
        (code, are, remedy): (&'static str, &str, &str),
    ) -> Option<Finding> {
        let parts =
            self.links.iter().filter_map(|link| Some((link, part(&link.skin.as_ref()?.report))));
        let doubtful = parts.filter(|(_, part)| *part > DOUBTFUL);
        let parts = doubtful.map(|(link, part)| {
            (link.name.as_str(), format!("{} ({:.0} %)", link.name, 100.0 * part))
        });
        Finding::of_parts(code, &parts.collect::<Vec<_>>(), are, remedy)
    }

    fn open_shells(&self) -> Option<Finding> {
        let are = "open shells, whose inside can be reached through holes in the mesh";
        let remedy = "inside and outside are distinguished by winding number, which is usually right; \
                      if contacts look odd, close the meshes or use simple shapes";
        self.doubtful(|report| report.leaked_fraction, ("open_shell", are, remedy))
    }

    fn sealed_voids(&self) -> Option<Finding> {
        let are = "meshes with inner walls or turned triangles: by winding number, a part of their inside \
                   is empty, although no path from outside leads there";
        let remedy = "this part counts as filled, which is right for an arm; if a link is meant to be hollow, \
                      use simple shapes";
        self.doubtful(|report| report.sealed_fraction, ("sealed_void", are, remedy))
    }
}

impl LinkFacts {
    fn new((index, link): (usize, &Link), moves: bool, loaded: Option<&LoadedArm>) -> Self {
        let skin = loaded.and_then(|loaded| {
            let (low, high) = loaded.arm.surfaces[index].as_ref()?.bounds();
            let baked = loaded.links.iter().find(|baked| baked.name == link.name)?;
            let (cached, meshes, report) = (baked.cached, baked.meshes.clone(), baked.report);
            Some(SkinFacts { size_m: (high - low).into(), cached, meshes, report })
        });
        Self {
            name: link.name.clone(),
            moves,
            mass_kg: link.mass_kg,
            shapes: link.collision.len(),
            skin,
        }
    }

    fn odd_size(&self) -> Option<Finding> {
        let size_m = self.skin.as_ref()?.size_m;
        let largest = size_m.into_iter().fold(0.0, f64::max);
        let [least, most] = BELIEVABLE_M;
        let (is, remedy) = match largest {
            x if x > most => ("more than 10 m", "give the mesh scale=\"0.001 0.001 0.001\""),
            x if x < least => ("less than 1 cm", "remove the <scale>, or give sizes in metres"),
            _ => return None,
        };
        let what = format!(
            "the largest side of link `{}` is {} m, {is}: are millimetres and metres mixed up?",
            self.name,
            number(largest)
        );
        Some(Finding::warning("link_size", what, format!("if so, {remedy}")).at(&[&self.name]))
    }
}

/// An upper bound of the distance from the base to any part, m: all links stretched in a line.
fn reach_m(loaded: &LoadedArm) -> Option<f64> {
    let robot = &loaded.arm.robot;
    let poses = robot.forward(&vec![0.0; robot.n_joints()]).ok()?;
    let mut stretched_m: Vec<f64> = Vec::new();
    let mut reach: Option<f64> = None;
    for (index, link) in robot.links().iter().enumerate() {
        let origin = poses.world_from_link[index].translation.vector;
        let from_base_m = link.parent.map_or(0.0, |parent| {
            let hop = origin - poses.world_from_link[parent.index()].translation.vector;
            stretched_m[parent.index()] + hop.norm() + travel_m(robot, index)
        });
        stretched_m.push(from_base_m);
        if let Some(grid) = &loaded.arm.surfaces[index] {
            let (low, high) = grid.bounds();
            // The box's farthest corner from the link's origin.
            let farthest = low.coords.abs().sup(&high.coords.abs());
            let part_m = from_base_m + farthest.norm();
            reach = Some(reach.map_or(part_m, |reach| reach.max(part_m)));
        }
    }
    reach
}

/// Largest distance that a prismatic joint moves its link from the zero position, m; 0 for other links.
fn travel_m(robot: &Robot, link: usize) -> f64 {
    let carries =
        |joint: &&Joint| joint.child.index() == link && joint.kind == JointKind::Prismatic;
    let joint = robot.joints().iter().find(carries);
    let range = joint.and_then(|joint| joint.range).unwrap_or_default();
    range[0].abs().max(range[1].abs())
}
