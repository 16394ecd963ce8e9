//! Small worlds whose answers are known: a gantry, a hinged arm, and random frames on them.
#![allow(dead_code, unreachable_pub)] // every test file uses its own part
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it

use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::{
    CellRows, CellState, FrameId, LinkContacts, LinkId, Observation, StiffnessRule,
};
use palpate::{
    Arm, BakeConfig, Contacts, EstimatorConfig, EstimatorKind, Lattice, Mapper, MemoryLimits,
    Prior, Robot, Sample,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

/// Three prismatic joints along x, y and z that carry one link of the given shape: the torques
/// (forces, N) of a contact are its displacement times its stiffness.
pub fn gantry_urdf(collision: &str) -> String {
    format!(
        "<robot name='gantry'><link name='l0'/><link name='l1'/><link name='l2'/>\
         <link name='l3'>{collision}</link>{}{}{}</robot>",
        joint("slide0", "prismatic", ["l0", "l1"], HOME, "1 0 0", 2.0),
        joint("slide1", "prismatic", ["l1", "l2"], HOME, "0 1 0", 2.0),
        joint("slide2", "prismatic", ["l2", "l3"], HOME, "0 0 1", 2.0),
    )
}

/// A gantry that carries one shape, baked.
pub fn gantry(geometry: &str, spacing_m: f64) -> Arc<Arm> {
    arm(&gantry_urdf(&collision(geometry)), &BakeConfig::new(spacing_m, 0.04))
}

/// An arm of primitive shapes, baked.
pub fn arm(urdf: &str, bake: &BakeConfig) -> Arc<Arm> {
    let robot = Robot::from_urdf(urdf).unwrap();
    Arc::new(Arm::bake(robot, bake, |_| unreachable!("primitives only")).unwrap().0)
}

/// The origin of a joint at its parent link.
pub const HOME: &str = "xyz='0 0 0'";

/// The URDF of a joint between a parent and a child link; its position is limited to ±`limit`, rad or m.
pub fn joint(
    name: &str,
    kind: &str,
    [parent, child]: [&str; 2],
    origin: &str,
    axis: &str,
    limit: f64,
) -> String {
    format!(
        "<joint name='{name}' type='{kind}'><origin {origin}/><parent link='{parent}'/><child \
         link='{child}'/><axis xyz='{axis}'/><limit lower='-{limit}' upper='{limit}' effort='1' \
         velocity='1'/></joint>"
    )
}

/// A link's collision element, with the shape at the link's origin.
pub fn collision(geometry: &str) -> String {
    format!("<collision><geometry>{geometry}</geometry></collision>")
}

/// One revolute joint about z at the origin.
pub fn hinge() -> Robot {
    Robot::from_urdf(&format!(
        "<robot name='hinge'><link name='base'/><link name='arm'/>{}</robot>",
        joint("hinge", "continuous", ["base", "arm"], HOME, "0 0 1", 3.0)
    ))
    .unwrap()
}

/// Four joints with crossed axes and a sliding one, three of whose links can touch.
pub fn crooked_arm() -> Robot {
    let links: String = (0..5).map(|n| format!("<link name='l{n}'/>")).collect();
    let turned = |xyz: &str| format!("xyz='{xyz}' rpy='0.3 -0.2 0.5'");
    Robot::from_urdf(&format!(
        "<robot name='crooked'>{links}{}{}{}{}</robot>",
        joint("j0", "revolute", ["l0", "l1"], &turned("0 0 0.2"), "0 0 1", 3.0),
        joint("j1", "continuous", ["l1", "l2"], &turned("0.1 0 0.3"), "0 1 0", 3.0),
        joint("j2", "prismatic", ["l2", "l3"], &turned("0.2 0.1 0"), "1 0 0", 3.0),
        joint("j3", "revolute", ["l3", "l4"], &turned("0.1 0 0.1"), "0 0.6 0.8", 3.0),
    ))
    .unwrap()
}

/// An arm like Franka's: seven joints, a fixed hand, two fingers of which one mimics the other.
pub const PANDA_LIKE: &str = include_str!("../../testdata/panda_like.urdf");
/// A rail that carries two arms of two joints, one of them on a lifting column.
pub const TWO_ARMS: &str = include_str!("../../testdata/two_arms.urdf");

/// Robots of several makers' shapes, by name.
pub fn robots() -> Vec<(&'static str, Robot)> {
    let of = |xml| Robot::from_urdf(xml).unwrap();
    vec![
        ("panda", of(PANDA_LIKE)),
        ("two arms", of(TWO_ARMS)),
        ("gen3", Robot::built_in("kinova_gen3").unwrap()),
    ]
}

/// A lattice of 1 cm cells, at which priors hold as stated.
pub fn centimetre_lattice() -> Lattice {
    Lattice::new([-0.5; 3], 0.01, [100; 3]).unwrap()
}

/// A uniform number between two bounds.
pub fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * f64::from(rng.next_u32()) / f64::from(u32::MAX)
}

/// Random joint positions (rad or m), or speeds and accelerations, within ±`half`.
pub fn random_q(rng: &mut ChaCha8Rng, n_joints: usize, half: f64) -> Vec<f64> {
    (0..n_joints).map(|_| uniform(rng, -half, half)).collect()
}

/// A frame of the first touch.
pub fn source(sample: u32) -> FrameId {
    FrameId { touch: 0, sample }
}

/// Learns a touch.
pub fn learn(mapper: &mut Mapper, samples: &[Sample]) {
    mapper.begin_touch();
    samples.iter().for_each(|sample| drop(mapper.step(sample).unwrap()));
    mapper.end_touch().unwrap();
}

/// One frame of a hinge about z that holds the point (0.5, 0, 0) at (0.5, -0.04, 0): the spring turns it
/// forward. Its reading of 3 N·m at a lever of 0.02 m² makes 150 N/m.
pub fn spring_frame() -> (CellRows, Observation) {
    let robot = hinge();
    let mut rows = CellRows::new(Lattice::new([0.0; 3], 0.01, [80; 3]).unwrap());
    let touched = contacts(rows.lattice(), 1, &[([50, 0, 0], [0.0, -0.04, 0.0])]);
    let (poses, tau) = (robot.forward(&[0.0]).unwrap(), DVector::from_element(1, 3.0));
    let frame = Observation::new(&robot, &poses, &touched, &mut rows, &tau);
    (rows, frame)
}

/// Settings with exactly known numbers: no replays unless asked for.
pub fn config(method: EstimatorKind, mean: f64, std: f64, torque_std: f64) -> EstimatorConfig {
    let mut config = EstimatorConfig::of(method);
    config.prior = Prior { mean_n_per_m: mean, std_n_per_m: std };
    config.torque_std = vec![torque_std];
    (config.replays, config.drift_std_n_per_m) = (0, 0.0);
    config.memory = MemoryLimits { frames: 1000, bytes: 1 << 30 };
    config
}

/// Cells by row with the given unknowns.
pub fn cells_with(rows: &CellRows, unknown: impl Fn(usize) -> f64) -> Vec<CellState> {
    let points = rows.points_m().iter().enumerate();
    points.map(|(row, &point)| CellState::new(point, unknown(row))).collect()
}

/// Contacts of one link: places in cells with displacements, m.
pub fn contacts(lattice: &Lattice, link: u16, touched: &[([u32; 3], [f32; 3])]) -> Contacts {
    Contacts {
        links: vec![LinkContacts {
            link: LinkId(link),
            cells: touched.iter().map(|(place, _)| lattice.cell(*place)).collect(),
            displacements_m: touched.iter().map(|(_, displacement)| *displacement).collect(),
        }],
    }
}

/// A frame of the crooked arm: two links, random cells out of a few, random displacements and
/// the torque of the given stiffness (by place along x) plus an error.
pub fn random_frame(
    rng: &mut ChaCha8Rng,
    robot: &Robot,
    rows: &mut CellRows,
    stiffness: &[f64],
    error: f64,
) -> Observation {
    let lattice = rows.lattice().clone();
    let q: Vec<f64> = (0..robot.n_joints()).map(|_| uniform(rng, -1.0, 1.0)).collect();
    let poses = robot.forward(&q).unwrap();
    let mut all = Contacts::default();
    for (link, parity) in [(3, 0), (4, 1)] {
        let mut touched = Vec::new();
        for place in (parity..stiffness.len() as u32).step_by(2) {
            if uniform(rng, 0.0, 1.0) < 0.5 {
                let displacement = [(); 3].map(|()| uniform(rng, -0.05, 0.05) as f32);
                touched.push(([place, 40, 60], displacement));
            }
        }
        if !touched.is_empty() {
            all.links.extend(contacts(&lattice, link, &touched).links);
        }
    }
    let n_joints = robot.n_joints();
    let frame = Observation::new(robot, &poses, &all, rows, &DVector::zeros(n_joints));
    let cells = rows.cells();
    let truth = |row: usize| stiffness[lattice.place(cells[row])[0] as usize];
    let tau = frame.predict(&cells_with(rows, truth), StiffnessRule::Positive)
        + DVector::from_fn(n_joints, |_, _| uniform(rng, -error, error));
    frame.with_tau(&tau)
}
