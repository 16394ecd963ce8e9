//! The facts of a robot description, as text.

use palpate::unstable::{Joint, JointKind};
use palpate_work::inspect::robot::{LinkFacts, RobotFacts, SkinFacts};
use palpate_work::inspect::{counted, number, word};

use super::page::{fact, table};

/// The facts of a robot.
pub(super) fn text(robot: &RobotFacts) -> String {
    let mut text = fact("name", if robot.name.is_empty() { "none" } else { &robot.name });
    text += &fact("mass", &format!("{:.3} kg", robot.mass_kg));
    if let Some(reach_m) = robot.reach_m {
        text += &fact("reach", &format!("at most {reach_m:.2} m from the base"));
    }
    text += &fact("skin", &skin(robot));
    let columns = ["joint", "kind", "from", "to", "effort", "speed"];
    let joints = counted(robot.joints.len(), "moving joint");
    text += &table(&joints, &columns, robot.joints.iter().map(joint_row));
    let columns =
        ["link", "mass kg", "shapes", "size m", "triangles", "leaks %", "sealed %", "cached"];
    let links = counted(robot.links.len(), "link");
    text + &table(&links, &columns, robot.links.iter().map(link_row))
}

fn skin(robot: &RobotFacts) -> String {
    let skins: Vec<&SkinFacts> = robot.links.iter().filter_map(|link| link.skin.as_ref()).collect();
    let cached = skins.iter().filter(|skin| skin.cached).count();
    match skins.len() {
        0 => "not baked".to_owned(),
        n => format!("{} baked, {cached} of them from the cache", counted(n, "link")),
    }
}

fn joint_row(joint: &Joint) -> Vec<String> {
    let [position, torque] = match joint.kind {
        JointKind::Revolute | JointKind::Continuous => ["rad", "N·m"],
        JointKind::Prismatic => ["m", "N"],
    };
    let shown = |value: Option<f64>, unit: &str| match value {
        Some(value) => format!("{} {unit}", number(value)),
        None => "-".to_owned(),
    };
    vec![
        joint.name.clone(),
        word(joint.kind),
        shown(joint.range.map(|range| range[0]), position),
        shown(joint.range.map(|range| range[1]), position),
        shown(joint.effort, torque),
        shown(joint.velocity, &format!("{position}/s")),
    ]
}

fn link_row(link: &LinkFacts) -> Vec<String> {
    let mut row = vec![link.name.clone(), format!("{:.3}", link.mass_kg), link.shapes.to_string()];
    if let Some(skin) = &link.skin {
        let [x, y, z] = skin.size_m;
        row.push(format!("{x:.3} x {y:.3} x {z:.3}"));
        row.push(skin.report.triangles.to_string());
        row.push(format!("{:.1}", 100.0 * skin.report.leaked_fraction));
        row.push(format!("{:.1}", 100.0 * skin.report.sealed_fraction));
        row.push(if skin.cached { "yes" } else { "no" }.to_owned());
    }
    row
}
