//! Small worlds whose answers are known: a gantry, a hinged arm, and random frames on them.
#![allow(dead_code, unreachable_pub)] // every test file uses its own part
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it

use nalgebra::DVector;
use palpate::unstable::{CellRows, CellState, LinkContacts, LinkId, Observation, StiffnessRule};
use palpate::{Contacts, EstimatorConfig, EstimatorKind, Lattice, MemoryLimits, Prior, Robot};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

/// Three prismatic joints along x, y and z that carry one link of the given shape: the torques
/// (forces, N) of a contact are its displacement times its stiffness.
pub fn gantry_urdf(collision: &str) -> String {
    let axis = |n: usize, axis: &str| {
        format!(
            "<joint name='slide{n}' type='prismatic'><parent link='l{n}'/><child link='l{}'/>\
             <axis xyz='{axis}'/><limit lower='-2' upper='2' effort='9' velocity='1'/></joint>",
            n + 1
        )
    };
    format!(
        "<robot name='gantry'><link name='l0'/><link name='l1'/><link name='l2'/>\
         <link name='l3'>{collision}</link>{}{}{}</robot>",
        axis(0, "1 0 0"),
        axis(1, "0 1 0"),
        axis(2, "0 0 1"),
    )
}

/// A link's collision element, with the shape at the link's origin.
pub fn collision(geometry: &str) -> String {
    format!("<collision><geometry>{geometry}</geometry></collision>")
}

/// One revolute joint about z at the origin.
pub fn hinge() -> Robot {
    Robot::from_urdf(
        "<robot name='hinge'><link name='base'/><link name='arm'/><joint name='hinge' \
         type='continuous'><parent link='base'/><child link='arm'/><axis xyz='0 0 1'/></joint>\
         </robot>",
    )
    .unwrap()
}

/// Four joints with crossed axes and a sliding one, three of whose links can touch.
pub fn crooked_arm() -> Robot {
    let joint = |n: usize, kind: &str, axis: &str, xyz: &str| {
        format!(
            "<joint name='j{n}' type='{kind}'><origin xyz='{xyz}' rpy='0.3 -0.2 0.5'/><parent \
             link='l{n}'/><child link='l{}'/><axis xyz='{axis}'/><limit lower='-3' upper='3' \
             effort='1' velocity='1'/></joint>",
            n + 1
        )
    };
    let links: String = (0..5).map(|n| format!("<link name='l{n}'/>")).collect();
    Robot::from_urdf(&format!(
        "<robot name='crooked'>{links}{}{}{}{}</robot>",
        joint(0, "revolute", "0 0 1", "0 0 0.2"),
        joint(1, "continuous", "0 1 0", "0.1 0 0.3"),
        joint(2, "prismatic", "1 0 0", "0.2 0.1 0"),
        joint(3, "revolute", "0 0.6 0.8", "0.1 0 0.1"),
    ))
    .unwrap()
}

/// A lattice of 1 cm cells, at which priors hold as stated.
pub fn centimetre_lattice() -> Lattice {
    Lattice::new([-0.5; 3], 0.01, [100; 3]).unwrap()
}

/// A uniform number between two bounds.
pub fn uniform(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * f64::from(rng.next_u32()) / f64::from(u32::MAX)
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
