//! The robot: a tree of links, their poses, and the joint torques of gravity and contacts.
//!
//! A URDF goes in; poses, Jacobians and gravity torques come out. The world frame is the frame of the URDF's root link,
//! z up, gravity (0, 0, −9.81) m/s². Parents come before children in every list.
//!
//! **Joint order.** A joint vector `q` has one number (rad, or m where prismatic) for every *independent* moving joint,
//! in depth-first order from the root, with branches in the order in which the file declares their joints. For an arm
//! that is from base to tip, whatever the order in the file; for two arms first all of one, then all of the other.
//! Fixed joints have no entry, and neither have mimic joints: a mimic joint follows another joint, and its torque is
//! added to that joint's (principle of virtual work).
//!
//! | file         | contents                                                 |
//! |--------------|----------------------------------------------------------|
//! | `urdf`       | XML → checked tree                                       |
//! | `kinematics` | poses, Jacobians, gravity torque                         |
//! | `dynamics`   | inverse dynamics, linear in the inertial parameters      |
//! | `error`      | errors of robot descriptions                             |
//!
//! Link shapes are only described here: [`crate::sdf`] turns them into distances, and mesh files
//! are read elsewhere, since the core opens no file.

mod dynamics;
mod error;
mod interpolate;
mod kinematics;
mod urdf;
mod xml;

pub use dynamics::N_INERTIAL_PARAMETERS;
pub use error::RobotError;
pub use kinematics::Poses;
pub use xml::nests_deeper_than;

use kinematics::Mover;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Robots that are compiled in: name and URDF. This is the only place to add one.
const BUILT_IN: [(&str, &str); 1] = [("kinova_gen3", include_str!("kinova_gen3.urdf"))];

/// Number of a link: its index in [`Robot::links`].
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct LinkId(pub u16);

impl LinkId {
    /// The number as an index into a slice with one entry for each link.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// A tree of links and the joints that move them.
#[derive(Debug, Clone)]
pub struct Robot {
    name: String,
    links: Vec<Link>,
    joints: Vec<Joint>,
    /// One per link: how it hangs from its parent.
    mounts: Vec<Mount>,
    /// Every joint that moves, mimic joints too, parents first.
    movers: Vec<Mover>,
}

/// How a link hangs from its parent.
#[derive(Debug, Clone)]
struct Mount {
    /// Pose of the link in its parent at joint position zero; identity for the root.
    parent_from_link: Isometry3<f64>,
    /// The mover that carries the link, if its joint is not fixed.
    mover: Option<usize>,
    /// All movers between the root and the link, root first: the columns of its Jacobians.
    carriers: Vec<u16>,
}

/// A rigid body of the robot.
#[derive(Debug, Clone)]
pub struct Link {
    /// Name in the URDF.
    pub name: String,
    /// The link it hangs from; `None` for the root.
    pub parent: Option<LinkId>,
    /// Collision geometry of the URDF; may be empty.
    pub collision: Vec<Collision>,
    /// Mass; zero where the URDF has no `<inertial>`.
    pub mass_kg: f64,
    /// Centre of mass in the link frame.
    pub com_link_m: Point3<f64>,
    /// Inertia about the centre of mass, axes of the link frame.
    pub inertia_com_kg_m2: Matrix3<f64>,
}

/// One shape of a link.
#[derive(Debug, Clone, PartialEq)]
pub struct Collision {
    /// Pose of the shape in the link frame.
    pub link_from_shape: Isometry3<f64>,
    /// Its geometry.
    pub shape: Shape,
}

/// Geometry as in URDF, centred at its own origin; axes of revolution are z.
#[derive(Debug, Clone, PartialEq)]
pub enum Shape {
    /// A cuboid.
    Box {
        /// Full edge lengths.
        size_m: Vector3<f64>,
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius.
        radius_m: f64,
        /// Length from end to end.
        length_m: f64,
    },
    /// A ball.
    Sphere {
        /// Radius.
        radius_m: f64,
    },
    /// A cylinder along z with a hemisphere at both ends.
    Capsule {
        /// Radius of cylinder and hemispheres.
        radius_m: f64,
        /// Length of the cylindrical part; the total length is `length_m + 2 radius_m`.
        length_m: f64,
    },
    /// Triangles in a file.
    Mesh {
        /// As written in the URDF: `package://…`, `file://…` or relative to the URDF.
        filename: String,
        /// Factor from the file's coordinates to metres, per axis; negative mirrors.
        scale: Vector3<f64>,
    },
}

/// An independent moving joint: one entry of a joint vector.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Joint {
    /// Name in the URDF.
    pub name: String,
    /// What its position means.
    pub kind: JointKind,
    /// The link it carries.
    #[serde(skip)]
    pub child: LinkId,
    /// Lowest and highest position, rad or m; `None` if unlimited or unknown.
    pub range: Option<[f64; 2]>,
    /// Largest torque or force, N·m or N; `None` if unknown.
    pub effort: Option<f64>,
    /// Largest speed, rad/s or m/s; `None` if unknown.
    pub velocity: Option<f64>,
}

impl Joint {
    /// Default position: the middle of its range, or 0 without a finite range; rad or m.
    pub fn middle(&self) -> f64 {
        let range = self.range.filter(|range| range.iter().all(|end| end.is_finite()));
        range.map_or(0.0, |[low, high]| f64::midpoint(low, high))
    }
}

/// What the position of a joint means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// An angle between limits, rad.
    Revolute,
    /// An angle without limits, rad.
    Continuous,
    /// A length, m.
    Prismatic,
}

/// A load that the URDF does not contain: a gripper, a tool, a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Payload {
    /// The link that carries it.
    pub link: String,
    /// Mass.
    pub mass_kg: f64,
    /// Its centre of mass in that link's frame.
    pub com_link_m: [f64; 3],
}

impl Payload {
    /// A mass, kg, on a link, with its centre in the link's frame, m.
    pub fn new(link: impl Into<String>, mass_kg: f64, com_link_m: [f64; 3]) -> Self {
        Self { link: link.into(), mass_kg, com_link_m }
    }
}

impl Robot {
    /// The built-in robot with this name, if there is one.
    ///
    /// # Panics
    ///
    /// Never: the tests parse every one.
    pub fn built_in(name: &str) -> Option<Robot> {
        let xml = Self::built_in_urdf(name)?;
        Some(Robot::from_urdf(xml).expect("built-in robots are parsed by the tests"))
    }

    /// URDF text of the built-in robot with this name, if there is one.
    pub fn built_in_urdf(name: &str) -> Option<&'static str> {
        BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, xml)| *xml)
    }

    /// Names of the built-in robots.
    pub fn built_in_names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// Name in the URDF; may be empty.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Length of a joint vector: moving joints that mimic no other.
    pub fn n_joints(&self) -> usize {
        self.joints.len()
    }

    /// Names in the order of a joint vector.
    pub fn joint_names(&self) -> impl Iterator<Item = &str> {
        self.joints.iter().map(|joint| joint.name.as_str())
    }

    /// The independent moving joints in the order of a joint vector.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// All links, parents before children; the first is the root.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// The link of this name.
    pub fn link_id(&self, name: &str) -> Option<LinkId> {
        let index = self.links.iter().position(|link| link.name == name)?;
        Some(LinkId(u16::try_from(index).expect("from_urdf refuses more links")))
    }

    /// All numbers that determine poses and gravity, for fingerprints.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = f64> {
        let links = self.links.iter().zip(&self.mounts).flat_map(|(link, mount)| {
            let parent = link.parent.map_or(-1.0, |parent| f64::from(parent.0));
            let pose = mount.parent_from_link.to_matrix();
            let com = link.com_link_m;
            [parent, link.mass_kg, com.x, com.y, com.z].into_iter().chain(pose.data.0.concat())
        });
        let movers = self.movers.iter().flat_map(|mover| {
            let axis = mover.axis_link;
            let kind = f64::from(u8::from(mover.prismatic));
            let (source, child) = (mover.source as f64, mover.child as f64);
            [child, kind, axis.x, axis.y, axis.z, source, mover.multiplier, mover.offset]
        });
        links.chain(movers)
    }

    /// Fixes a joint at a position, rad or m: joint vectors are then an entry shorter, and joints that mimic it are
    /// fixed as well.
    ///
    /// # Errors
    ///
    /// An unknown joint, the only moving joint, or a position that is not finite.
    pub fn with_fixed_joint(mut self, joint: &str, position: f64) -> Result<Robot, RobotError> {
        let place = self.joints.iter().position(|own| own.name == joint);
        let held = place.ok_or_else(|| RobotError::Undeclared {
            user: "the name".into(),
            wanted: format!("joint `{joint}`"),
        })?;
        if self.joints.len() == 1 {
            let thing = format!("number of moving joints besides `{joint}`");
            return Err(RobotError::number(thing, 0, "at least 1"));
        }
        urdf::check_finite(&format!("position of joint `{joint}`"), &[position])?;
        let mut q = vec![0.0; self.joints.len()];
        q[held] = position;
        let mut now: Vec<Option<usize>> = Vec::with_capacity(self.movers.len());
        let mut movers = Vec::with_capacity(self.movers.len());
        for mover in std::mem::take(&mut self.movers) {
            let stands = mover.source == held;
            now.push((!stands).then_some(movers.len()));
            if stands {
                self.mounts[mover.child].parent_from_link *= mover.motion(&q);
            } else {
                let source = mover.source - usize::from(mover.source > held);
                movers.push(Mover { source, ..mover });
            }
        }
        for mount in &mut self.mounts {
            mount.mover = mount.mover.and_then(|mover| now[mover]);
            let carriers = mount.carriers.iter().filter_map(|carrier| now[usize::from(*carrier)]);
            mount.carriers = carriers.map(|carrier| carrier as u16).collect(); // none is larger
        }
        self.movers = movers;
        self.joints.remove(held);
        Ok(self)
    }

    /// Renames joints, all at once; `names` are pairs `(joint, name in logs)`.
    ///
    /// # Errors
    ///
    /// An unknown joint, or a name that two joints would have.
    pub fn with_renamed_joints(mut self, names: &[(&str, &str)]) -> Result<Robot, RobotError> {
        for (joint, name) in names {
            if !self.joints.iter().any(|own| own.name == *joint) {
                return Err(RobotError::Undeclared {
                    user: format!("the new name `{name}`"),
                    wanted: format!("joint `{joint}`"),
                });
            }
        }
        for own in &mut self.joints {
            if let Some((_, name)) = names.iter().find(|(joint, _)| own.name == *joint) {
                (*name).clone_into(&mut own.name);
            }
        }
        let names: Vec<&str> = self.joint_names().collect();
        let twice = names.iter().enumerate().find(|(at, name)| names[..*at].contains(name));
        match twice {
            Some((_, name)) => Err(RobotError::Duplicate { thing: format!("joint `{name}`") }),
            None => Ok(self),
        }
    }

    /// Whether a joint moves a link: the joint's child is the link or one of its ancestors.
    pub fn carries(&self, joint: &Joint, mut link: LinkId) -> bool {
        loop {
            if link == joint.child {
                return true;
            }
            match self.links[link.index()].parent {
                Some(parent) => link = parent,
                None => return false,
            }
        }
    }

    /// Adds `payload`, a point mass, to the robot; may be called again for another one.
    ///
    /// # Errors
    ///
    /// An unknown link, a negative or non-finite mass, a non-finite centre of mass.
    pub fn with_payload(mut self, payload: &Payload) -> Result<Robot, RobotError> {
        let id = self.link_id(&payload.link).ok_or_else(|| RobotError::Undeclared {
            user: "the payload".into(),
            wanted: format!("link `{}`", payload.link),
        })?;
        urdf::check_mass("mass of the payload [kg]", payload.mass_kg)?;
        urdf::check_length("centre of mass of the payload [m]", &payload.com_link_m)?;

        let link = &mut self.links[id.index()];
        let mass_kg = link.mass_kg + payload.mass_kg;
        if mass_kg > 0.0 {
            let (own, added) = (link.com_link_m.coords, Vector3::from(payload.com_link_m));
            let com = (link.mass_kg * own + payload.mass_kg * added) / mass_kg;
            link.inertia_com_kg_m2 += link.mass_kg * dynamics::about(&(own - com))
                + payload.mass_kg * dynamics::about(&(added - com));
            link.com_link_m = Point3::from(com);
            link.mass_kg = mass_kg;
        }
        Ok(self)
    }
}
