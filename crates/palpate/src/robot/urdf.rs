//! URDF → robot: reads the XML and checks that it is a tree of links with valid numbers.
//!
//! `urdf-rs` reads the XML and ignores elements that it does not know (`<klampt>`, `<gazebo>`,
//! `<transmission>`). It does not check the contents: names, the shape of the tree, mimic chains
//! and every number are checked here. `rpy` is roll, pitch, yaw about the fixed axes x, y, z; a
//! missing `<axis>` is x. Inertia is rotated into the axes of its link.

use std::collections::HashMap;

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use urdf_rs::{Geometry, JointType};

use super::kinematics::Mover;
use super::xml::nests_deeper_than;
use super::{Collision, Joint, JointKind, Link, LinkId, Mount, Robot, RobotError, Shape};
use crate::lattice::MAX_COORDINATE_M;

/// Largest number of links: more would not fit [`LinkId`].
const MAX_LINKS: usize = u16::MAX as usize;

/// Largest nesting depth: no robot file is deeper, and the XML parser recurses once for each level.
const MAX_XML_DEPTH: usize = 64;

impl Robot {
    /// Reads the text of a URDF.
    ///
    /// Mesh files are not opened. Only collision geometry is used, visual geometry is ignored.
    /// Joints and links are ordered with parents before children.
    ///
    /// # Errors
    ///
    /// Anything that is not a tree of links with at least one moving joint, joints of more than
    /// one degree of freedom, and invalid numbers: see [`RobotError`].
    pub fn from_urdf(xml: &str) -> Result<Robot, RobotError> {
        if nests_deeper_than(xml, MAX_XML_DEPTH) {
            let reason = format!("elements nested deeper than {MAX_XML_DEPTH}");
            return Err(RobotError::Xml { reason });
        }
        let urdf = urdf_rs::read_from_string(xml)
            .map_err(|error| RobotError::Xml { reason: error.to_string() })?;
        if urdf.links.len() > MAX_LINKS {
            let thing = "number of links".to_owned();
            return Err(RobotError::number(thing, urdf.links.len(), "at most 65535"));
        }
        let tree = Tree::of(&urdf)?;
        let sources = independent_joints(&urdf, &tree)?;
        let robot = build(&urdf, &tree, &sources)?;
        if robot.joints.is_empty() {
            return Err(RobotError::Immobile { robot: urdf.name, joints: urdf.joints.len() });
        }
        Ok(robot)
    }
}

/// The links of a URDF in tree order.
struct Tree {
    /// URDF link indices, parents first, depth first, branches in the order of their joints.
    order: Vec<usize>,
    /// For each URDF link, the URDF joint that carries it.
    joint_of: Vec<Option<usize>>,
    /// For each URDF joint, the URDF link that it hangs from.
    parent_of: Vec<usize>,
}

impl Tree {
    fn of(urdf: &urdf_rs::Robot) -> Result<Tree, RobotError> {
        let links = unique("link", urdf.links.iter().map(|link| link.name.as_str()))?;
        unique("joint", urdf.joints.iter().map(|joint| joint.name.as_str()))?;

        let mut joint_of: Vec<Option<usize>> = vec![None; urdf.links.len()];
        let mut parent_of = Vec::with_capacity(urdf.joints.len());
        let mut children: Vec<Vec<usize>> = vec![Vec::new(); urdf.links.len()];
        for (index, joint) in urdf.joints.iter().enumerate() {
            let find = |name: &str| {
                links.get(name).copied().ok_or_else(|| RobotError::Undeclared {
                    user: format!("joint `{}`", joint.name),
                    wanted: format!("link `{name}`"),
                })
            };
            let (parent, child) = (find(&joint.parent.link)?, find(&joint.child.link)?);
            if let Some(other) = joint_of[child].replace(index) {
                return Err(RobotError::TwoParents {
                    link: urdf.links[child].name.clone(),
                    first: urdf.joints[other].name.clone(),
                    second: joint.name.clone(),
                });
            }
            parent_of.push(parent);
            children[parent].push(child);
        }

        let order = depth_first(only_root(urdf, &joint_of)?, &children);
        if order.len() < urdf.links.len() {
            // Each link has one parent at most, so links that the root does not reach form a loop.
            let mut reached = vec![false; urdf.links.len()];
            order.iter().for_each(|&link| reached[link] = true);
            return Err(link_loop(urdf, reached.iter().position(|reached| !reached)));
        }
        Ok(Tree { order, joint_of, parent_of })
    }
}

/// Indices of the names; an error if a name comes twice.
fn unique<'a>(
    what: &str,
    names: impl Iterator<Item = &'a str>,
) -> Result<HashMap<&'a str, usize>, RobotError> {
    let mut indices = HashMap::new();
    for (index, name) in names.enumerate() {
        if indices.insert(name, index).is_some() {
            return Err(RobotError::Duplicate { thing: format!("{what} `{name}`") });
        }
    }
    Ok(indices)
}

fn link_loop(urdf: &urdf_rs::Robot, link: Option<usize>) -> RobotError {
    let through = link.map_or(String::new(), |link| format!("`{}`", urdf.links[link].name));
    RobotError::Loop { things: "links", through }
}

/// The one link that hangs from no joint.
fn only_root(urdf: &urdf_rs::Robot, joint_of: &[Option<usize>]) -> Result<usize, RobotError> {
    let roots: Vec<usize> = (0..joint_of.len()).filter(|&link| joint_of[link].is_none()).collect();
    match roots[..] {
        [root] => Ok(root),
        [] if !urdf.links.is_empty() => Err(link_loop(urdf, Some(0))),
        _ => Err(RobotError::Roots {
            roots: roots.iter().map(|&link| urdf.links[link].name.clone()).collect(),
        }),
    }
}

fn depth_first(root: usize, children: &[Vec<usize>]) -> Vec<usize> {
    let (mut order, mut waiting) = (Vec::new(), vec![root]);
    while let Some(link) = waiting.pop() {
        order.push(link);
        waiting.extend(children[link].iter().rev());
    }
    order
}

/// What drives a URDF joint: `position = multiplier · q[source] + offset`.
struct Source {
    source: usize,
    multiplier: f64,
    offset: f64,
}

/// For each URDF joint that moves, the entry of the joint vector that drives it.
fn independent_joints(
    urdf: &urdf_rs::Robot,
    tree: &Tree,
) -> Result<Vec<Option<Source>>, RobotError> {
    let mut own_entry: Vec<Option<usize>> = vec![None; urdf.joints.len()];
    let mut n_joints = 0;
    for joint in tree.order.iter().filter_map(|&link| tree.joint_of[link]) {
        if moves(&urdf.joints[joint]) && urdf.joints[joint].mimic.is_none() {
            own_entry[joint] = Some(n_joints);
            n_joints += 1;
        }
    }
    (0..urdf.joints.len())
        .map(|joint| {
            moves(&urdf.joints[joint]).then(|| follow(urdf, &own_entry, joint)).transpose()
        })
        .collect()
}

fn moves(joint: &urdf_rs::Joint) -> bool {
    joint.joint_type != JointType::Fixed
}

/// Follows a chain of mimic joints to the independent joint.
fn follow(
    urdf: &urdf_rs::Robot,
    own_entry: &[Option<usize>],
    start: usize,
) -> Result<Source, RobotError> {
    let (mut joint, mut multiplier, mut offset) = (start, 1.0, 0.0);
    for _ in 0..=urdf.joints.len() {
        if let Some(source) = own_entry[joint] {
            return Ok(Source { source, multiplier, offset });
        }
        let user = format!("mimic joint `{}`", urdf.joints[joint].name);
        let Some(mimic) = &urdf.joints[joint].mimic else {
            // Only a fixed joint has neither an entry nor a joint to follow.
            let (thing, found) = (format!("joint `{}`", urdf.joints[joint].name), "fixed");
            return Err(RobotError::number(thing, found, "a moving one, since others mimic it"));
        };
        let (a, b) = (mimic.multiplier.unwrap_or(1.0), mimic.offset.unwrap_or(0.0));
        check_finite(&format!("multiplier and offset of {user}"), &[a, b])?;
        // position = multiplier · (a · next + b) + offset
        offset += multiplier * b;
        multiplier *= a;
        joint =
            (urdf.joints.iter().position(|other| other.name == mimic.joint)).ok_or_else(|| {
                RobotError::Undeclared { user, wanted: format!("joint `{}`", mimic.joint) }
            })?;
    }
    let through = format!("`{}`", urdf.joints[start].name);
    Err(RobotError::Loop { things: "mimic joints", through })
}

/// Builds the robot, in tree order.
fn build(
    urdf: &urdf_rs::Robot,
    tree: &Tree,
    sources: &[Option<Source>],
) -> Result<Robot, RobotError> {
    let mut id_of = vec![0_usize; urdf.links.len()];
    let mut robot = Robot {
        name: urdf.name.clone(),
        links: Vec::with_capacity(urdf.links.len()),
        joints: Vec::new(),
        mounts: Vec::with_capacity(urdf.links.len()),
        movers: Vec::new(),
    };
    for (id, &link) in tree.order.iter().enumerate() {
        id_of[link] = id;
        let mut mount =
            Mount { parent_from_link: Isometry3::identity(), mover: None, carriers: vec![] };
        let mut parent = None;
        if let Some(index) = tree.joint_of[link] {
            let joint = &urdf.joints[index];
            let parent_id = id_of[tree.parent_of[index]];
            parent = Some(LinkId(to_u16(parent_id)));
            mount.parent_from_link = pose(&format!("joint `{}`", joint.name), &joint.origin)?;
            mount.carriers = robot.mounts[parent_id].carriers.clone();
            if let Some(source) = &sources[index] {
                mount.mover = Some(robot.movers.len());
                mount.carriers.push(to_u16(robot.movers.len()));
                robot.movers.push(mover(joint, id, source)?);
                if joint.mimic.is_none() {
                    robot.joints.push(self::joint(joint, LinkId(to_u16(id)))?);
                }
            }
        }
        robot.links.push(self::link(&urdf.links[link], parent)?);
        robot.mounts.push(mount);
    }
    Ok(robot)
}

fn to_u16(index: usize) -> u16 {
    u16::try_from(index).expect("there are no more links than MAX_LINKS, nor joints than links")
}

fn mover(joint: &urdf_rs::Joint, child: usize, source: &Source) -> Result<Mover, RobotError> {
    let thing = format!("axis of joint `{}`", joint.name);
    check_finite(&thing, &*joint.axis.xyz)?;
    let axis_link = Unit::try_new(Vector3::from(*joint.axis.xyz), 1e-9)
        .ok_or_else(|| RobotError::number(thing, "0 0 0", "a direction"))?;
    let prismatic = joint_kind(joint)? == JointKind::Prismatic;
    let &Source { source, multiplier, offset } = source;
    Ok(Mover { child, axis_link, prismatic, source, multiplier, offset })
}

fn joint_kind(joint: &urdf_rs::Joint) -> Result<JointKind, RobotError> {
    let kind = match joint.joint_type {
        JointType::Revolute => return Ok(JointKind::Revolute),
        JointType::Continuous => return Ok(JointKind::Continuous),
        JointType::Prismatic => return Ok(JointKind::Prismatic),
        JointType::Floating => "floating",
        JointType::Planar => "planar",
        JointType::Spherical => "spherical",
        JointType::Fixed => unreachable!("only moving joints get here"),
    };
    Err(RobotError::JointKind { joint: joint.name.clone(), kind })
}

fn joint(joint: &urdf_rs::Joint, child: LinkId) -> Result<Joint, RobotError> {
    let kind = joint_kind(joint)?;
    let limit = &joint.limit;
    let thing = || format!("limit of joint `{}`", joint.name);
    let numbers = [limit.lower, limit.upper, limit.effort, limit.velocity];
    if let Some(bad) = numbers.iter().find(|number| number.is_nan()) {
        return Err(RobotError::number(thing(), bad, "a number of rad, m, N·m or N"));
    }
    if limit.lower > limit.upper {
        let found = format!("from {} to {}", limit.lower, limit.upper);
        return Err(RobotError::number(thing(), found, "lower ≤ upper"));
    }
    // Without <limit>, urdf-rs reports zeros; zero effort is also how exporters say "unknown".
    let known = |value: f64| (value > 0.0 && value.is_finite()).then_some(value);
    let limited = kind != JointKind::Continuous
        && limit.lower < limit.upper
        && (limit.lower.is_finite() || limit.upper.is_finite());
    Ok(Joint {
        name: joint.name.clone(),
        kind,
        child,
        range: limited.then_some([limit.lower, limit.upper]),
        effort: known(limit.effort),
        velocity: known(limit.velocity),
    })
}

fn link(link: &urdf_rs::Link, parent: Option<LinkId>) -> Result<Link, RobotError> {
    let name = link.name.clone();
    check_mass(&format!("mass of link `{name}` [kg]"), link.inertial.mass.value)?;
    let com = link.inertial.origin.xyz;
    check_length(&format!("centre of mass of link `{name}` [m]"), &*com)?;
    let collision = (link.collision.iter())
        .map(|collision| {
            let thing = format!("collision shape of link `{name}`");
            let link_from_shape = pose(&thing, &collision.origin)?;
            Ok(Collision { link_from_shape, shape: shape(&thing, &collision.geometry)? })
        })
        .collect::<Result<_, RobotError>>()?;
    let inertia_com_kg_m2 = inertia(&name, &link.inertial)?;
    let (mass_kg, com_link_m) = (link.inertial.mass.value, Point3::from(*com));
    Ok(Link { name, parent, collision, mass_kg, com_link_m, inertia_com_kg_m2 })
}

/// Inertia about the centre of mass in the axes of the link.
fn inertia(link: &str, inertial: &urdf_rs::Inertial) -> Result<Matrix3<f64>, RobotError> {
    let tensor = &inertial.inertia;
    let (xx, xy, xz) = (tensor.ixx, tensor.ixy, tensor.ixz);
    let (yy, yz, zz) = (tensor.iyy, tensor.iyz, tensor.izz);
    check_finite(&format!("inertia of link `{link}` [kg·m²]"), &[xx, xy, xz, yy, yz, zz])?;
    let frame = pose(&format!("inertia of link `{link}`"), &inertial.origin)?;
    let rotation = frame.rotation.to_rotation_matrix();
    Ok(rotation * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * rotation.transpose())
}

fn shape(thing: &str, geometry: &Geometry) -> Result<Shape, RobotError> {
    let positive = |sizes: &[f64]| match sizes.iter().find(|size| size.is_nan() || **size <= 0.0) {
        Some(bad) => Err(RobotError::number(format!("size of a {thing} [m]"), bad, "above zero")),
        None => check_length(&format!("size of a {thing} [m]"), sizes),
    };
    Ok(match geometry {
        Geometry::Box { size } => {
            positive(&size.0)?;
            Shape::Box { size_m: Vector3::from(size.0) }
        }
        &Geometry::Cylinder { radius, length } => {
            positive(&[radius, length])?;
            Shape::Cylinder { radius_m: radius, length_m: length }
        }
        &Geometry::Capsule { radius, length } => {
            positive(&[radius, length])?;
            Shape::Capsule { radius_m: radius, length_m: length }
        }
        &Geometry::Sphere { radius } => {
            positive(&[radius])?;
            Shape::Sphere { radius_m: radius }
        }
        Geometry::Mesh { filename, scale } => {
            let scale = scale.map_or([1.0; 3], |scale| scale.0);
            check_finite(&format!("scale of the mesh of a {thing}"), &scale)?;
            if scale.contains(&0.0) {
                let thing = format!("scale of the mesh of a {thing}");
                return Err(RobotError::number(thing, 0.0, "a number that is not zero"));
            }
            Shape::Mesh { filename: filename.clone(), scale: Vector3::from(scale) }
        }
    })
}

fn pose(thing: &str, origin: &urdf_rs::Pose) -> Result<Isometry3<f64>, RobotError> {
    check_length(&format!("origin xyz of {thing} [m]"), &*origin.xyz)?;
    check_finite(&format!("origin rpy of {thing} [rad]"), &*origin.rpy)?;
    let [roll, pitch, yaw] = *origin.rpy;
    let rotation = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    Ok(Isometry3::from_parts(Translation3::from(*origin.xyz), rotation))
}

pub(super) fn check_mass(thing: &str, mass_kg: f64) -> Result<(), RobotError> {
    if mass_kg >= 0.0 && mass_kg.is_finite() {
        return Ok(());
    }
    Err(RobotError::number(thing.to_owned(), mass_kg, "a finite mass of at least zero"))
}

/// Lengths, m: none is beyond [`MAX_COORDINATE_M`].
pub(super) fn check_length(thing: &str, values_m: &[f64]) -> Result<(), RobotError> {
    check_finite(thing, values_m)?;
    match values_m.iter().find(|value_m| value_m.abs() > MAX_COORDINATE_M) {
        Some(bad) => {
            let wanted = "at most 1000 m; is it in millimetres?";
            Err(RobotError::number(thing.to_owned(), bad, wanted))
        }
        None => Ok(()),
    }
}

pub(super) fn check_finite(thing: &str, values: &[f64]) -> Result<(), RobotError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(bad) => Err(RobotError::number(thing.to_owned(), bad, "a finite number")),
        None => Ok(()),
    }
}
