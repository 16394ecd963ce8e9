//! Laws of the contact simulator, each on a case with an answer on paper.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use std::collections::HashSet;
use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::{CellRows, ContactSimulator, LinkId, Observation, StiffnessRule, Tracker};
use palpate::{
    Arm, BakeConfig, CellId, ContactConfig, Contacts, ExternalTorqueConfig, Lattice, Sample, Tare,
    TrackerError,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::{HOME, arm, cells_with, collision, gantry, gantry_urdf, joint, uniform};

/// Spacing of the baked distances, m.
const FINE_M: f64 = 0.003;

/// A block of 20 cm a side, whose front face stands at x = 0.1 m when the gantry is at home.
const BLOCK: &str = "<box size='0.2 0.2 0.2'/>";

/// 1 cm cells in a column in front of the block's face, far from its edges.
fn column() -> Lattice {
    Lattice::new([0.107, -0.045, -0.045], 0.01, [40, 10, 10]).unwrap()
}

struct World {
    arm: Arc<Arm>,
    simulator: ContactSimulator,
}

impl World {
    fn new(arm: &Arc<Arm>, lattice: Lattice, config: &ContactConfig, start: [f64; 3]) -> Self {
        let mut simulator =
            ContactSimulator::new(lattice, Arc::clone(&arm.surfaces), config).unwrap();
        simulator.begin_touch(&arm.robot.forward(&start).unwrap().world_from_link);
        Self { arm: Arc::clone(arm), simulator }
    }

    /// Moves the gantry in small steps along a line.
    fn go(&mut self, from: [f64; 3], to: [f64; 3]) -> Contacts {
        let steps = 40;
        let mut contacts = Contacts::default();
        for step in 1..=steps {
            let part = f64::from(step) / f64::from(steps);
            let q: [f64; 3] = std::array::from_fn(|i| from[i] + part * (to[i] - from[i]));
            contacts = self.simulator.advance(&self.arm.robot.forward(&q).unwrap().world_from_link);
        }
        contacts
    }
}

/// The contact model of these tests with settings of a test's own.
fn with(change: impl FnOnce(&mut ContactConfig)) -> ContactConfig {
    let mut config = ContactConfig::default();
    config.contact_distance_m = 0.005;
    change(&mut config);
    config
}

fn config() -> ContactConfig {
    with(|_| ())
}

fn sticky() -> ContactConfig {
    with(|config| config.slip_iterations = 0)
}

#[test]
fn a_pressed_face_displaces_each_point_by_how_far_it_was_overrun() {
    let arm = gantry(BLOCK, FINE_M);
    let mut world = World::new(&arm, column(), &config(), [0.0; 3]);
    // δ = 5 mm: the inflated face goes from 0.105 to 0.145 m, over the points at 0.107, 0.117,
    // 0.127 and 0.137 m, with 10 x 10 points in a layer.
    let contacts = world.go([0.0; 3], [0.0401, 0.0, 0.0]);
    let lattice = column();
    assert_eq!((contacts.links.len(), contacts.links[0].link), (1, LinkId(3)));
    let deepest = contacts.links[0].displacements_m.iter().map(|u| u[0]).fold(0.0, f32::max);
    assert!((f64::from(deepest) - 0.0381).abs() < 2e-4, "{deepest}");
    for (cell, u) in contacts.links[0].cells.iter().zip(&contacts.links[0].displacements_m) {
        let expected = 0.1451 - lattice.point(*cell).x;
        assert!((f64::from(u[0]) - expected).abs() < 2e-4, "{expected} {u:?}");
        assert!(u[1].abs() < 1e-5 && u[2].abs() < 1e-5, "{u:?}");
    }
    assert_eq!(contacts.len(), 400);
}

#[test]
fn points_inside_the_links_at_the_start_are_never_contacts_of_that_touch() {
    let arm = gantry(BLOCK, FINE_M);
    // The block starts half in the column: 10 layers lie inside it.
    let start = [0.1, 0.0, 0.0];
    let mut world = World::new(&arm, column(), &config(), start);
    assert!(world.go(start, start).is_empty());
    let pressed = world.go(start, [0.12, 0.0, 0.0]);
    let first = pressed.links[0].cells.iter().map(|cell| column().point(*cell).x);
    assert!(first.fold(f64::INFINITY, f64::min) > 0.2, "known-empty points were touched");
    // It leaves them all, and comes back: they are as empty as before.
    assert!(world.go([0.12, 0.0, 0.0], [-0.05, 0.0, 0.0]).is_empty());
    assert!(world.go([-0.05, 0.0, 0.0], start).is_empty());
    // In a touch that begins elsewhere they are not empty.
    let away = [-0.05, 0.0, 0.0];
    world.simulator.begin_touch(&arm.robot.forward(&away).unwrap().world_from_link);
    let back = world.go(away, start);
    assert!(back.len() > 900, "{}", back.len());

    let bold = with(|config| config.known_empty = false);
    let mut world = World::new(&arm, column(), &bold, start);
    assert!(world.go(start, start).len() > 900);
}

#[test]
fn friction_is_a_share_of_the_normal_force_and_turns_round_with_the_link() {
    let (arm, coefficient) = (gantry(BLOCK, FINE_M), 0.5);
    let config =
        with(|config| (config.friction, config.coulomb_friction) = (0.0, f64::from(coefficient)));
    let mut world = World::new(&arm, column(), &config, [0.0; 3]);
    let mut across = |from: [f64; 3], to: [f64; 3]| -> Vec<[f32; 3]> {
        world.go(from, to).links[0].displacements_m.clone()
    };
    let is_near = |a: f32, b: f32| (a - b).abs() < 2e-5;
    // Pressed straight in, there is no friction.
    let pressed = across([0.0; 3], [0.03, 0.0, 0.0]);
    assert!(pressed.iter().all(|u| u[1].abs() < 1e-5 && u[2].abs() < 1e-5));
    // Slid far enough, friction pulls every point along by its share.
    let slid = across([0.03, 0.0, 0.0], [0.03, 0.02, 0.0]);
    assert!(slid.iter().all(|u| is_near(u[1], coefficient * u[0])), "{slid:?}");
    // On the way back it fades by three times the way, and then pulls back.
    let back = across([0.03, 0.02, 0.0], [0.03, 0.019, 0.0]);
    assert!(
        back.iter().all(|u| is_near(u[1], (coefficient * u[0] - 0.003).max(-coefficient * u[0]))),
        "{back:?}"
    );
    let back = across([0.03, 0.019, 0.0], [0.03, 0.0, 0.0]);
    assert!(back.iter().all(|u| is_near(u[1], -coefficient * u[0])), "{back:?}");
    // Diagonally, it has the direction of the motion, and no larger a force.
    let aside = across([0.03, 0.0, 0.0], [0.03, 0.02, 0.02]);
    for u in aside {
        assert!(is_near(u[1].hypot(u[2]), coefficient * u[0]) && u[1] > 0.9 * u[2], "{u:?}");
    }
}

#[test]
fn a_point_slips_until_the_friction_cone_holds_it() {
    let arm = gantry(BLOCK, FINE_M);
    for friction in [0.0, 0.3, 0.8] {
        let config = with(|config| (config.friction, config.slip_iterations) = (friction, 50));
        let mut world = World::new(&arm, column(), &config, [0.0; 3]);
        world.go([0.0; 3], [0.03, 0.0, 0.0]);
        let slid = world.go([0.03, 0.0, 0.0], [0.03, 0.04, 0.0]);
        for u in &slid.links[0].displacements_m {
            let (normal, tangential) = (u[0], u[1].hypot(u[2]));
            let held = friction as f32 * normal;
            assert!(tangential <= held + 2e-5, "μ = {friction}: {u:?}");
            assert!((tangential - held.min(0.04)).abs() < 1e-4, "μ = {friction}: {u:?}");
        }
    }
    // Without iterations it sticks for good.
    let mut world = World::new(&arm, column(), &sticky(), [0.0; 3]);
    world.go([0.0; 3], [0.03, 0.0, 0.0]);
    let stuck = world.go([0.03, 0.0, 0.0], [0.03, 0.04, 0.0]);
    assert!(stuck.links[0].displacements_m.iter().all(|u| (u[1] - 0.04).abs() < 1e-5));
}

#[test]
fn a_point_is_released_where_its_spring_would_pull() {
    let arm = gantry(BLOCK, FINE_M);
    let mut world = World::new(&arm, column(), &config(), [0.0; 3]);
    let pressed = world.go([0.0; 3], [0.0401, 0.0, 0.0]);
    // Back by 2 cm: the layers at 0.137 and 0.127 have been overtaken by the face's retreat.
    let half = world.go([0.0401, 0.0, 0.0], [0.0201, 0.0, 0.0]);
    assert_eq!((pressed.len(), half.len()), (400, 200));
    assert!(half.links[0].displacements_m.iter().all(|u| u[0] > 0.0));
    assert!(world.go([0.0201, 0.0, 0.0], [-0.01, 0.0, 0.0]).is_empty());
    // And it is touched anew like any other point.
    assert_eq!(world.go([-0.01, 0.0, 0.0], [0.0401, 0.0, 0.0]).len(), pressed.len());
}

#[test]
fn a_cylinder_swept_through_an_elastic_bed_meets_the_force_of_the_integral() {
    // A cylinder of radius R along z, sticking to what it meets, is pushed by D through a bed of
    // stiffness k a volume. A point at distance s behind the advancing front is displaced by s,
    // so the force is k L ∫dy ∫₀ᴰ s ds = k L (2R') D²/2 with R' = R + δ.
    let (radius, travel, spacing) = (0.05, 0.06, 0.004);
    let arm = gantry("<cylinder radius='0.05' length='0.4'/>", FINE_M);
    let lattice = Lattice::new([-0.2, -0.15, -0.05], spacing, [100, 75, 25]).unwrap();
    let delta = 0.002;
    let config = with(|config| (config.slip_iterations, config.contact_distance_m) = (0, delta));
    let mut world = World::new(&arm, lattice.clone(), &config, [0.0; 3]);
    let contacts = world.go([0.0; 3], [travel, 0.0, 0.0]);

    let poses = arm.robot.forward(&[travel, 0.0, 0.0]).unwrap();
    let mut rows = CellRows::new(lattice);
    let frame = Observation::new(&arm.robot, &poses, &contacts, &mut rows, &DVector::zeros(3));
    let k_volume = 1e6; // N/m per m³
    let cell = k_volume * spacing.powi(3);
    let force = frame.predict(&cells_with(&rows, |_| cell), StiffnessRule::Positive);

    let length = 25.0 * spacing;
    let expected = -k_volume * length * (radius + delta) * travel * travel;
    assert!((force[0] / expected - 1.0).abs() < 0.02, "{} N against {expected} N", force[0]);
    assert!(force[1].abs() < 0.02 * expected.abs() && force[2].abs() < 1e-6 * expected.abs());
}

/// A forearm that turns about its elbow, on an upper arm that turns and slides.
fn elbow() -> Arc<Arm> {
    let link = |name: &str, geometry: &str, x: f64| {
        format!(
            "<link name='{name}'><collision><origin xyz='{x} 0 0'/><geometry>{geometry}</geometry>\
             </collision></link>"
        )
    };
    let urdf = format!(
        "<robot name='elbow'><link name='base'/><link name='slide'/>{}{}{}{}{}</robot>",
        link("upper", "<box size='0.3 0.06 0.06'/>", 0.15),
        link("fore", "<cylinder radius='0.03' length='0.2'/>", 0.05),
        joint("j0", "prismatic", ["base", "slide"], HOME, "0 0 1", 3.0),
        joint("j1", "continuous", ["slide", "upper"], HOME, "0 0 1", 3.0),
        joint("j2", "revolute", ["upper", "fore"], "xyz='0.3 0 0'", "0 1 0", 3.0),
    );
    arm(&urdf, &BakeConfig::default())
}

#[test]
fn no_point_that_a_link_covers_is_ever_free() {
    // What is looked at only when a link may have reached it is found as if it always were.
    let arm = elbow();
    let lattice = Lattice::new([-0.4, -0.4, -0.2], 0.02, [40, 40, 20]).unwrap();
    let config = with(|config| (config.known_empty, config.contact_distance_m) = (false, 0.01));
    let mut simulator =
        ContactSimulator::new(lattice.clone(), Arc::clone(&arm.surfaces), &config).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut q, mut speed) = ([0.0; 3], [0.0; 3]);
    simulator.begin_touch(&arm.robot.forward(&q).unwrap().world_from_link);
    let (mut entered, mut left, mut last) = (0, 0, HashSet::new());
    for motion in 0..400 {
        if motion % 20 == 0 {
            speed = [0.008, 0.02, 0.04].map(|most| uniform(&mut rng, -most, most));
        }
        q = std::array::from_fn(|joint| q[joint] + speed[joint]);
        q[0] = f64::clamp(q[0], -0.1, 0.1);
        let poses = arm.robot.forward(&q).unwrap().world_from_link;
        let contacts = simulator.advance(&poses);
        let touched: HashSet<CellId> =
            contacts.links.iter().flat_map(|link| link.cells.iter().copied()).collect();
        for cell in (0..lattice.n_cells() as u32).map(CellId) {
            let point = lattice.point(cell);
            let covered = arm.surfaces.iter().zip(&poses).any(|(surface, pose)| {
                let surface = surface.as_ref();
                surface.is_some_and(|s| s.distance(&pose.inverse_transform_point(&point)) < 0.01)
            });
            assert!(!covered || touched.contains(&cell), "motion {motion}: {point}");
        }
        entered += touched.difference(&last).count();
        left += last.difference(&touched).count();
        last = touched;
    }
    assert!(entered > 2000 && left > 1000, "{entered} entered, {left} left");
}

#[test]
fn a_long_motion_asks_for_substeps_so_that_nothing_tunnels() {
    let arm = gantry(BLOCK, FINE_M);
    let world = World::new(&arm, column(), &config(), [0.0; 3]);
    let poses = |x: f64| arm.robot.forward(&[x, 0.0, 0.0]).unwrap().world_from_link;
    let substeps = |x: f64| world.simulator.substeps(&poses(0.0), &poses(x));
    assert_eq!((substeps(0.0), substeps(0.004), substeps(0.021)), (1, 1, 5)); // half a cell each
}

/// Contacts after a tracker was fed these joint positions, one sample each; what is met sticks, so
/// that every place the arm passed shows.
fn tracked(urdf: &str, lattice: &Lattice, samples: &[&[f64]]) -> Result<Contacts, TrackerError> {
    let mut touch = ExternalTorqueConfig::default();
    touch.tare = Tare::None;
    let arm = arm(urdf, &BakeConfig::default());
    let mut tracker = Tracker::new(arm, lattice.clone(), &sticky(), touch).unwrap();
    tracker.begin_touch();
    let mut contacts = Contacts::default();
    for q in samples {
        let sample = Sample::new(None, q.to_vec(), vec![0.0; q.len()]);
        contacts = tracker.feed(&sample)?.contacts;
    }
    Ok(contacts)
}

/// A ball of 5 cm at the end of an arm of 40 cm that turns about z.
fn turning_ball(kind: &str) -> String {
    format!(
        "<robot name='turning'><link name='base'/><link name='ball'><collision><origin \
         xyz='0.4 0 0'/><geometry><sphere radius='0.05'/></geometry></collision></link>{}</robot>",
        joint("turn", kind, ["base", "ball"], HOME, "0 0 1", 7.0)
    )
}

#[test]
fn a_turn_in_one_sample_touches_what_it_touches_in_many() {
    let lattice = Lattice::new([-0.6; 3], 0.02, [61; 3]).unwrap();
    let urdf = turning_ball("revolute");
    let fine: Vec<[f64; 1]> = (0..=3000).map(|step| [f64::from(step) * 0.001]).collect();
    let fine: Vec<&[f64]> = fine.iter().map(|q| &q[..]).collect();
    let slow = tracked(&urdf, &lattice, &fine).unwrap();
    let fast = tracked(&urdf, &lattice, &[&[0.0], &[3.0]]).unwrap();
    assert!(slow.len() > 100, "{}", slow.len());
    let share = fast.len() as f64 / slow.len() as f64;
    assert!((0.9..1.1).contains(&share), "{} in one sample, {} in many", fast.len(), slow.len());
}

#[test]
fn joints_that_end_where_they_began_have_still_moved_the_links_between() {
    // Shoulder and elbow turn so that the ball at the end comes back to its place: the ends of
    // the motion are alike, and between them it sweeps the workspace.
    let urdf = format!(
        "<robot name='elbow'><link name='base'/><link name='upper'/><link name='ball'><collision>\
         <origin xyz='0.3 0 0'/><geometry><sphere radius='0.05'/></geometry></collision></link>\
         {}{}</robot>",
        joint("shoulder", "continuous", ["base", "upper"], HOME, "0 0 1", 3.0),
        joint("elbow", "continuous", ["upper", "ball"], "xyz='0.3 0 0'", "0 0 1", 3.0)
    );
    // From (-0.7, 1.4) to (0.7, -1.4) the ball goes out along x from 0.46 to 0.6 m, and back.
    let lattice = Lattice::new([-0.7; 3], 0.02, [71; 3]).unwrap();
    let many: Vec<[f64; 2]> =
        (0..=2000).map(|step| 0.7 - f64::from(step) * 0.0007).map(|a| [-a, 2.0 * a]).collect();
    let many: Vec<&[f64]> = many.iter().map(|q| &q[..]).collect();
    let slow = tracked(&urdf, &lattice, &many).unwrap();
    let fast = tracked(&urdf, &lattice, &[many[0], many[2000]]).unwrap();
    assert!(slow.len() > 20, "{}", slow.len());
    let share = fast.len() as f64 / slow.len() as f64;
    assert!((0.9..1.1).contains(&share), "{} in one sample, {} in many", fast.len(), slow.len());
}

#[test]
fn angles_that_wrap_are_the_same_motion_and_impossible_jumps_are_refused() {
    let lattice = Lattice::new([-0.6; 3], 0.02, [61; 3]).unwrap();
    let turn = std::f64::consts::TAU;
    for kind in ["revolute", "continuous"] {
        let urdf = turning_ball(kind);
        let plain = tracked(&urdf, &lattice, &[&[-0.2], &[0.0], &[0.3]]).unwrap();
        let wrapped = tracked(&urdf, &lattice, &[&[turn - 0.2], &[0.0], &[0.3]]).unwrap();
        assert!(plain.len() > 20);
        assert_eq!(plain.len(), wrapped.len(), "{kind}");
    }
    let slide = gantry_urdf(&collision(BLOCK));
    for far in [13.0, 1e12] {
        let error = tracked(&slide, &lattice, &[&[0.0; 3], &[0.0, far, 0.0]]).unwrap_err();
        assert!(matches!(&error, TrackerError::Jump { joint, .. } if joint == "slide1"), "{error}");
    }
}

#[test]
fn a_point_that_one_link_lets_go_is_taken_by_another_that_stands_still_over_it() {
    // Two balls on rails along x: the first presses in, the second follows to the same place and
    // stops there, the first retreats. What it lets go, the second must take without moving.
    let balls = ["ball1", "ball2"].map(|ball| {
        let shape = collision("<sphere radius='0.05'/>");
        let rail = joint(ball, "prismatic", ["base", ball], HOME, "1 0 0", 2.0);
        format!("<link name='{ball}'>{shape}</link>{rail}")
    });
    let urdf = format!("<robot name='two'><link name='base'/>{}</robot>", balls.concat());
    let lattice = Lattice::new([0.0, -0.1, -0.1], 0.01, [40, 20, 20]).unwrap();
    let path: [&[f64]; 4] = [&[-0.2, -0.2], &[0.1, -0.2], &[0.1, 0.1], &[-0.2, 0.1]];
    let held = tracked(&urdf, &lattice, &path).unwrap();
    let nudged = [&path[..], &[&[-0.2, 0.1 + 1e-9]]].concat();
    assert!(held.len() > 500, "{}", held.len());
    assert_eq!(held.len(), tracked(&urdf, &lattice, &nudged).unwrap().len());
}
