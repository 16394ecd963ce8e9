//! What URDF files are read, and what is said about those that are not.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use palpate::unstable::{JointKind, Shape};
use palpate::{Payload, Robot, RobotError};

/// A robot of the given elements.
fn robot(elements: &str) -> String {
    format!("<?xml version=\"1.0\"?><robot name=\"test\">{elements}</robot>")
}

fn link(name: &str) -> String {
    format!("<link name=\"{name}\"/>")
}

/// A joint with room for more elements.
fn joint(name: &str, kind: &str, parent: &str, child: &str, more: &str) -> String {
    format!(
        "<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/>\
         <child link=\"{child}\"/>{more}</joint>"
    )
}

/// One link on one joint, with something inside each.
fn arm(in_link: &str, in_joint: &str) -> String {
    robot(&format!(
        "<link name=\"base\"/><link name=\"tip\">{in_link}</link>{}",
        joint("turn", "continuous", "base", "tip", in_joint)
    ))
}

fn error(xml: &str) -> RobotError {
    Robot::from_urdf(xml).expect_err("this must not be read")
}

fn inertial(mass: &str, xyz: &str) -> String {
    format!(
        "<inertial><origin xyz=\"{xyz}\" rpy=\"0.1 0.2 0.3\"/><mass value=\"{mass}\"/>\
         <inertia ixx=\"1\" ixy=\"0\" ixz=\"0\" iyy=\"1\" iyz=\"0\" izz=\"1\"/></inertial>"
    )
}

fn collision(geometry: &str) -> String {
    format!("<collision><geometry>{geometry}</geometry></collision>")
}

#[test]
fn every_built_in_robot_is_read() {
    for name in Robot::built_in_names() {
        let robot = Robot::built_in(name).unwrap();
        assert_eq!(robot.name(), name);
    }
    let gen3 = Robot::built_in("kinova_gen3").unwrap();
    let names: Vec<String> = (1..=7).map(|i| format!("Actuator{i}")).collect();
    assert_eq!(gen3.joint_names().collect::<Vec<_>>(), names);
    assert!(Robot::built_in("kinova_gen4").is_none());
}

#[test]
fn joints_are_ordered_along_the_tree_not_along_the_file() {
    let two_arms = Robot::from_urdf(include_str!("../testdata/two_arms.urdf")).unwrap();
    let order = ["lift", "left_shoulder", "left_elbow", "right_shoulder", "right_elbow"];
    assert_eq!(two_arms.joint_names().collect::<Vec<_>>(), order);
    for link in two_arms.links() {
        let own = two_arms.link_id(&link.name).unwrap();
        assert!(link.parent.is_none_or(|parent| parent < own), "{} before its parent", link.name);
    }
}

#[test]
fn fixed_and_mimic_joints_are_not_counted() {
    let panda = Robot::from_urdf(include_str!("../testdata/panda_like.urdf")).unwrap();
    assert_eq!(panda.n_joints(), 8);
    let finger = &panda.joints()[7];
    assert_eq!((finger.name.as_str(), finger.kind), ("finger_joint1", JointKind::Prismatic));
    assert_eq!((finger.range, finger.effort), (Some([0.0, 0.04]), Some(20.0)));
}

#[test]
fn a_mimic_of_a_mimic_follows_the_joint_at_the_end_of_the_chain() {
    let slide = "<axis xyz=\"1 0 0\"/>";
    let mimic = |of: &str, a: f64, b: f64| {
        format!("{slide}<mimic joint=\"{of}\" multiplier=\"{a}\" offset=\"{b}\"/>")
    };
    // The chain is declared from its end: c follows b follows a.
    let xml = robot(
        &[
            link("base") + &link("a") + &link("b") + &link("c"),
            joint("jc", "prismatic", "base", "c", &mimic("jb", -2.0, 0.5)),
            joint("jb", "prismatic", "base", "b", &mimic("ja", 3.0, 0.25)),
            joint("ja", "prismatic", "base", "a", slide),
        ]
        .concat(),
    );
    let robot = Robot::from_urdf(&xml).unwrap();
    assert_eq!(robot.n_joints(), 1);

    let poses = robot.forward(&[0.1]).unwrap();
    let x = |name: &str| {
        poses.world_from_link[robot.link_id(name).unwrap().index()].translation.vector.x
    };
    assert!((x("a") - 0.1).abs() < 1e-15);
    assert!((x("b") - (3.0 * 0.1 + 0.25)).abs() < 1e-15);
    assert!((x("c") - (-2.0 * (3.0 * 0.1 + 0.25) + 0.5)).abs() < 1e-15);
}

#[test]
fn roll_pitch_yaw_turn_about_fixed_axes_in_that_order() {
    // After rolling by 90° about x, y points up; a yaw of 90° about the fixed z leaves it there.
    let xml = arm("", "<origin xyz=\"1 2 3\" rpy=\"1.5707963267948966 0 1.5707963267948966\"/>");
    let robot = Robot::from_urdf(&xml).unwrap();
    let pose = robot.forward(&[0.0]).unwrap().world_from_link[1];
    let y = pose * nalgebra::Vector3::y();
    let x = pose * nalgebra::Vector3::x();
    assert!((y - nalgebra::Vector3::z()).norm() < 1e-12, "{y}");
    assert!((x - nalgebra::Vector3::y()).norm() < 1e-12, "{x}");
}

#[test]
fn missing_attributes_have_the_defaults_of_urdf() {
    // No axis: x. No limit: none known. No inertial: no mass. No origin: none.
    let robot = Robot::from_urdf(&arm("", "")).unwrap();
    let jacobian =
        robot.spatial_jacobian(&robot.forward(&[0.3]).unwrap(), robot.link_id("tip").unwrap());
    assert_eq!(jacobian.column(0).as_slice(), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    assert_eq!((robot.joints()[0].range, robot.joints()[0].effort), (None, None));
    assert_eq!(robot.links()[1].mass_kg, 0.0);
}

#[test]
fn unknown_urdf_elements_are_ignored() {
    let xml = arm("<klampt/><visual><geometry><mesh filename=\"x.dae\"/></geometry></visual>", "")
        .replace(
            "</robot>",
            "<klampt use_vis_geom=\"1\"><a><b/></a></klampt><gazebo reference=\"tip\"/>\
             <transmission name=\"t\"><joint name=\"turn\"/><actuator name=\"m\"/></transmission>\
             <!-- <link name=\"base\"> > < --></robot>",
        );
    let robot = Robot::from_urdf(&xml).unwrap();
    assert_eq!(robot.links().len(), 2);
    assert!(robot.links()[1].collision.is_empty(), "visual shapes are not touched with");
}

#[test]
fn all_shapes_are_read_with_their_sizes() {
    let shapes = [
        "<box size=\"1 2 3\"/>",
        "<cylinder radius=\"0.1\" length=\"0.4\"/>",
        "<sphere radius=\"0.2\"/>",
        "<capsule radius=\"0.1\" length=\"0.4\"/>",
        "<mesh filename=\"package://a/b.stl\" scale=\"0.001 -0.001 0.001\"/>",
        "<mesh filename=\"b.obj\"/>",
    ];
    let xml = arm(&shapes.map(collision).concat(), "");
    let robot = Robot::from_urdf(&xml).unwrap();
    let read: Vec<Shape> =
        robot.links()[1].collision.iter().map(|part| part.shape.clone()).collect();
    let mesh = |filename: &str, scale: [f64; 3]| Shape::Mesh {
        filename: filename.into(),
        scale: scale.into(),
    };
    let expected = [
        Shape::Box { size_m: [1.0, 2.0, 3.0].into() },
        Shape::Cylinder { radius_m: 0.1, length_m: 0.4 },
        Shape::Sphere { radius_m: 0.2 },
        Shape::Capsule { radius_m: 0.1, length_m: 0.4 },
        mesh("package://a/b.stl", [0.001, -0.001, 0.001]),
        mesh("b.obj", [1.0; 3]),
    ];
    assert_eq!(read, expected);
}

#[test]
fn links_that_form_no_tree_are_refused_by_name() {
    let three = link("a") + &link("b") + &link("c");
    let cases = [
        (
            joint("1", "fixed", "a", "b", "") + &joint("2", "fixed", "c", "b", ""),
            "`b` is the child of two joints, `1` and `2`",
        ),
        (
            joint("1", "fixed", "b", "c", "") + &joint("2", "fixed", "c", "b", ""),
            "loop through `b`",
        ),
        (joint("1", "continuous", "a", "b", ""), "2 root links (a, c)"),
        (joint("1", "continuous", "a", "d", ""), "joint `1` refers to link `d`, which"),
        (joint("1", "fixed", "a", "b", "") + &joint("1", "fixed", "b", "c", ""), "joint `1` twice"),
        (link("a"), "link `a` twice"),
        (
            joint("1", "fixed", "a", "b", "") + &joint("2", "fixed", "b", "c", ""),
            "none of the 2 joints",
        ),
        (
            joint("1", "floating", "a", "b", "") + &joint("2", "fixed", "b", "c", ""),
            "joint `1` is floating",
        ),
        (
            joint("1", "planar", "a", "b", "") + &joint("2", "fixed", "b", "c", ""),
            "joint `1` is planar",
        ),
    ];
    for (joints, expected) in cases {
        let message = error(&robot(&format!("{three}{joints}"))).to_string();
        assert!(message.contains(expected), "{message}\n  should say: {expected}");
    }
    let circle = joint("1", "fixed", "a", "b", "") + &joint("2", "fixed", "b", "a", "");
    let all_round = robot(&(link("a") + &link("b") + &circle));
    assert!(matches!(error(&all_round), RobotError::Loop { .. }));
    assert!(matches!(error(&robot("")), RobotError::Roots { .. }));
}

#[test]
fn mimics_of_unknown_joints_and_cycles_are_refused() {
    let links = link("a") + &link("b") + &link("c");
    let with = |of_1: &str, of_2: &str| {
        let mimic = |of: &str| format!("<mimic joint=\"{of}\"/>");
        robot(
            &[
                links.clone(),
                joint("1", "continuous", "a", "b", &mimic(of_1)),
                joint("2", "continuous", "b", "c", &mimic(of_2)),
            ]
            .concat(),
        )
    };
    for (of_1, of_2) in [("2", "1"), ("1", "1")] {
        assert!(matches!(error(&with(of_1, of_2)), RobotError::Loop { .. }), "{of_1} {of_2}");
    }
    let message = error(&with("9", "1")).to_string();
    assert!(message.contains("joint `9`"), "{message}");
}

#[test]
fn impossible_numbers_are_refused_with_their_place() {
    let mesh = |scale: &str| collision(&format!("<mesh filename=\"m.stl\" scale=\"{scale}\"/>"));
    let cases = [
        (arm("", "<axis xyz=\"0 0 0\"/>"), "axis of joint `turn` is 0 0 0"),
        (arm("", "<axis xyz=\"0 NaN 1\"/>"), "axis of joint `turn` is NaN"),
        (arm("", "<origin xyz=\"0 inf 0\"/>"), "origin xyz of joint `turn` [m] is inf"),
        (arm("", "<origin rpy=\"0 nan 0\"/>"), "origin rpy of joint `turn` [rad] is NaN"),
        (arm(&inertial("-1", "0 0 0"), ""), "mass of link `tip` [kg] is -1"),
        (arm(&inertial("inf", "0 0 0"), ""), "mass of link `tip` [kg] is inf"),
        (arm(&inertial("1", "0 0 nan"), ""), "centre of mass of link `tip` [m] is NaN"),
        (arm(&collision("<box size=\"1 -2 1\"/>"), ""), "link `tip` [m] is -2"),
        (arm(&collision("<sphere radius=\"0\"/>"), ""), "link `tip` [m] is 0"),
        (arm(&collision("<cylinder radius=\"1\" length=\"nan\"/>"), ""), "link `tip` [m] is NaN"),
        (arm(&collision("<capsule radius=\"inf\" length=\"1\"/>"), ""), "link `tip` [m] is inf"),
        (arm(&mesh("1 0 1"), ""), "scale of the mesh"),
        (arm(&mesh("1 nan 1"), ""), "scale of the mesh"),
        (arm("", "<limit lower=\"2\" upper=\"1\" effort=\"1\" velocity=\"1\"/>"), "lower ≤ upper"),
    ];
    for (xml, expected) in cases {
        let found = error(&xml);
        assert!(matches!(found, RobotError::Number { .. }), "{found:?}");
        assert!(found.to_string().contains(expected), "{found}\n  should say: {expected}");
    }
}

#[test]
fn text_that_is_not_urdf_is_refused_without_a_panic() {
    let deep = "<a>".repeat(100_000);
    let broken = arm("", "").replace("</robot>", "");
    for xml in ["", "hello", "<robot", "<html/>", &robot("<link/>"), &deep, &broken] {
        assert!(Robot::from_urdf(xml).is_err(), "{:.40}", xml);
    }
}

#[test]
fn joint_vectors_of_the_wrong_kind_are_refused() {
    let robot = Robot::from_urdf(&arm("", "")).unwrap();
    let count = RobotError::JointCount { expected: 1, got: 2 };
    assert_eq!(robot.forward(&[0.0, 0.0]).unwrap_err(), count);
    assert_eq!(count.to_string(), "got 2 joint angles, the robot has 1 moving joints");
    for bad in [f64::NAN, f64::INFINITY] {
        let message = robot.forward(&[bad]).unwrap_err().to_string();
        assert!(message.starts_with("position of joint `turn` is"), "{message}");
    }
}

#[test]
fn impossible_payloads_are_refused() {
    let robot = Robot::from_urdf(&arm("", "")).unwrap();
    let payload = |link: &str, mass_kg, x| {
        let payload = Payload::new(link, mass_kg, [x, 0.0, 0.0]);
        robot.clone().with_payload(&payload)
    };
    assert!(matches!(payload("hand", 1.0, 0.0), Err(RobotError::Undeclared { .. })));
    for (mass_kg, x) in [(-1.0, 0.0), (f64::NAN, 0.0), (1.0, f64::INFINITY)] {
        assert!(matches!(payload("tip", mass_kg, x), Err(RobotError::Number { .. })));
    }
    assert_eq!(payload("tip", 0.0, 1.0).unwrap().links()[1].com_link_m.x, 0.0);
}
