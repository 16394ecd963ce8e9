//! Joints of the robot that are not in a log, such as a gripper's fingers, and stand still.

use std::sync::Arc;

use palpate::unstable::{Joint, JointKind, LinkId};
use palpate::{Arm, Robot, Snapshot};
use palpate_io::log::{reorder, unmatched};

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::HeldJoint;

/// Whether a joint has the name of a gripper's joint.
fn has_finger_name(joint: &Joint) -> bool {
    let name = joint.name.to_lowercase();
    let parts = ["finger", "gripper", "knuckle", "jaw", "claw", "thumb"];
    parts.iter().any(|part| name.contains(part))
}

/// Whether a joint that a log lacks seems to belong to a gripper.
fn is_finger(joint: &Joint) -> bool {
    joint.kind == JointKind::Prismatic || has_finger_name(joint)
}

/// Names of the first matched joint in the log and in the robot, if they differ.
pub(crate) fn other_name(robot: &Robot, log: &[String]) -> Option<(String, String)> {
    let own: Vec<String> = robot.joint_names().map(str::to_owned).collect();
    let missing = unmatched(&own, log).0;
    let in_log = own.into_iter().enumerate().filter(|(joint, _)| !missing.contains(joint));
    let own: Vec<String> = in_log.map(|(_, name)| name).collect();
    let order = reorder(&own, log).ok()?;
    let (log, own) = (&log[*order.first()?], own.first()?);
    (log != own).then(|| (log.clone(), own.clone()))
}

/// Joints that are not in a log and are assumed to stand still in the middle of their ranges; empty if the log does not
/// fit the robot even then.
///
/// A missing joint can stand still if it carries no link of a joint in the log and is a finger. It need not be a finger
/// if the robot knows all names of the log. A log without names is assumed to begin with the joints of the arm, and may
/// lack fingers.
pub(crate) fn not_in_log(robot: &Robot, names: Option<&[String]>, count: usize) -> Vec<HeldJoint> {
    let joints = robot.joints();
    let own: Vec<String> = robot.joint_names().map(str::to_owned).collect();
    let (missing, unknown) = match names {
        Some(names) => unmatched(&own, names),
        None => ((count.min(joints.len())..joints.len()).collect(), 1),
    };
    let may_stand = |joint: &Joint| unknown == 0 || is_finger(joint);
    standing(robot, &missing, may_stand)
}

/// These joints, standing still in the middle of their ranges; empty if one of them carries a link of another joint or
/// must not stand still.
fn standing(robot: &Robot, still: &[usize], may_stand: impl Fn(&Joint) -> bool) -> Vec<HeldJoint> {
    let joints = robot.joints();
    let moving = (0..joints.len()).filter(|joint| !still.contains(joint));
    let links: Vec<LinkId> = moving.map(|joint| joints[joint].child).collect();
    let can_stand = |&joint: &usize| {
        let joint = &joints[joint];
        let at_tip = !links.iter().any(|link| robot.carries(joint, *link));
        at_tip && may_stand(joint)
    };
    if links.is_empty() || !still.iter().all(can_stand) {
        return Vec::new();
    }
    let held = |&joint: &usize| HeldJoint {
        joint: joints[joint].name.clone(),
        position: joints[joint].middle(),
    };
    still.iter().map(held).collect()
}

/// The arm with a gripper's joints standing still in the middle of their ranges, for motions that the arm's controller
/// executes: it does not know these joints.
///
/// # Errors
///
/// If a joint cannot be made to stand still.
pub fn without_fingers(arm: Arc<Arm>, progress: &dyn Progress) -> Result<Arc<Arm>, WorkError> {
    let joints = arm.robot.joints().iter().enumerate();
    let fingers: Vec<usize> =
        joints.filter(|(_, joint)| has_finger_name(joint)).map(|(j, _)| j).collect();
    let held = standing(&arm.robot, &fingers, |_| true);
    if held.is_empty() {
        return Ok(arm);
    }
    let arm = Arc::new(holding(&arm, &held)?);
    note_held(&arm, &held, "the motion", progress);
    Ok(arm)
}

/// The arm with which a field was learnt, if that is `arm` with some fingers standing still; else `arm`.
pub fn of_field(arm: Arc<Arm>, snapshot: Option<&Snapshot>, progress: &dyn Progress) -> Arc<Arm> {
    let Some(snapshot) = snapshot else { return arm };
    let held = not_in_log(&arm.robot, None, snapshot.n_joints);
    match holding(&arm, &held).ok().filter(|_| !held.is_empty()) {
        Some(other) if other.fingerprint() == snapshot.robot.1 => {
            note_held(&other, &held, "the field", progress);
            Arc::new(other)
        }
        _ => arm,
    }
}

/// The arm with some joints standing still.
pub(crate) fn holding(arm: &Arm, held: &[HeldJoint]) -> Result<Arm, WorkError> {
    let mut arm = arm.clone();
    for HeldJoint { joint, position } in held {
        arm.robot = arm.robot.with_fixed_joint(joint, *position).map_err(WorkError::file)?;
    }
    Ok(arm)
}

/// Notes which joints are assumed to stand still, and at which positions.
pub(crate) fn note_held(arm: &Arm, held: &[HeldJoint], of: &str, progress: &dyn Progress) {
    let flags: Vec<String> = held.iter().cloned().map(String::from).collect();
    progress.note(&format!(
        "{of} has no joint {}: assumed to stand still in the middle of its range (as with --hold {}, which can also \
         give another position); {} joints are left",
        held.iter().map(|held| format!("`{}`", held.joint)).collect::<Vec<_>>().join(", "),
        flags.join(","),
        arm.robot.n_joints()
    ));
}
