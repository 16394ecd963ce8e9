//! The joints of a log, put into the robot's order by name.

use palpate::Robot;
use palpate_io::log::reorder;
use serde::Serialize;

use super::super::finding::Finding;
use super::super::words::listed;
use crate::touches::{RecordedTouch, reorder_joints};

/// How the joints of the log were matched to those of the robot; for several touches, the variant
/// that comes last in this list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Matching {
    /// The log names no joints: their order is taken to be the robot's, and checked by gravity.
    Unnamed,
    /// By name, and their order is the robot's.
    InOrder,
    /// By name, and their order is another.
    Reordered,
    /// The names, or their number, do not match the robot.
    Unmatched,
}

/// Puts the joints into the robot's order by name, if they have names; the findings are about
/// joints that do not match the robot. Without a match the joints stay as they are.
pub(super) fn match_joints(
    touches: &mut [RecordedTouch],
    robot: &Robot,
) -> (Matching, Vec<Finding>) {
    let joints: Vec<String> = robot.joint_names().map(str::to_owned).collect();
    let mut matching = Matching::Unnamed;
    let mut findings: Vec<Finding> = Vec::new();
    for touch in &mut *touches {
        let Some(names) = &touch.joint_names else { continue };
        match reorder(&joints, names) {
            Ok(order) => {
                let in_order = order.is_sorted();
                touch.permute(&order);
                touch.joint_names = Some(joints.clone());
                let found = if in_order { Matching::InOrder } else { Matching::Reordered };
                matching = matching.max(found);
            }
            Err(error) => {
                matching = Matching::Unmatched;
                let what = error.to_string();
                if findings.iter().all(|finding| finding.what != what) {
                    findings.push(unmatched(what, &joints));
                }
            }
        }
    }
    let miscounted = touches.iter().find_map(|touch| miscounted(touch, robot));
    if let Some(finding) = miscounted.filter(|_| findings.is_empty()) {
        matching = Matching::Unmatched;
        findings.push(finding);
    }
    (matching, findings)
}

/// The finding for a touch with another number of joints than the robot.
pub(super) fn miscounted(touch: &RecordedTouch, robot: &Robot) -> Option<Finding> {
    let (found, wanted) = (touch.n_joints(), robot.n_joints());
    (found != wanted).then(|| {
        let names: Vec<&str> = robot.joint_names().collect();
        let what = format!(
            "the log has {found} joints, the robot `{}` has {wanted}: {}",
            robot.name(),
            listed(&names)
        );
        let remedy = "name the right robot (--robot), or save only its joints; what \
                      needs the robot was not checked";
        Finding::error("joint_count", what, remedy)
    })
}

fn unmatched(what: String, joints: &[String]) -> Finding {
    let remedy = format!(
        "name the right robot (--robot), or the columns in the order {} (--columns \
         'q=...;tau=...'); then their names do not matter",
        joints.join(", ")
    );
    Finding::error("joint_names", what, remedy)
}

impl RecordedTouch {
    /// Reorders positions and torques: joint j gets those of `order[j]`; joints that are not in
    /// `order` are dropped.
    pub(super) fn permute(&mut self, order: &[usize]) {
        self.samples.iter_mut().for_each(|sample| reorder_joints(sample, order));
    }
}
