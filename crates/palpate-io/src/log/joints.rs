//! Matching the joints of a log to those of a robot by name.

/// Why a log's joints do not serve a robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum JointNameError {
    /// A joint of the robot that the log does not hold.
    #[error(
        "the robot's joint `{joint}` is not in the log, whose joints are {} (--rename LOG=URDF says which is which)",
        log.join(", ")
    )]
    Missing { joint: String, log: Vec<String> },
    /// A name that the log holds twice.
    #[error("the log holds the joint `{joint}` twice")]
    Twice { joint: String },
}

/// Where each joint of the robot stands in the log: `q_robot[i] = q_log[permutation[i]]`.
///
/// Joints of the log that the robot does not have, such as a gripper's, are left out. Names that differ in what all
/// names of a side begin with, up to `_` or `/`, or end with, from `_` on, are taken for the same: `fr3_joint1` and
/// `panda_joint1`, `/left/j1` and `j1`, or `elbow_joint` and `elbow`.
///
/// # Errors
///
/// If a joint of the robot is missing from the log or there twice.
///
/// # Example
///
/// ```
/// let names = |names: &[&str]| names.iter().map(|name| name.to_string()).collect::<Vec<_>>();
/// let (robot, log) = (names(&["j1", "j2"]), names(&["finger", "j2", "j1"]));
/// assert_eq!(palpate_io::log::reorder(&robot, &log), Ok(vec![2, 1]));
/// ```
pub fn reorder(robot: &[String], log: &[String]) -> Result<Vec<usize>, JointNameError> {
    let exact = reorder_exactly(robot, log);
    if !matches!(exact, Err(JointNameError::Missing { .. })) {
        return exact;
    }
    reorder_exactly(&bare(robot), &bare(log)).map_err(|error| {
        let tail = |name: &str| name.rsplit(['_', '/']).next().map(str::to_owned);
        let tails: Vec<_> = log.iter().map(|name| tail(name)).collect();
        let missing = unmatched(robot, log).0;
        // One that only its prefix parts from the log's is not to blame.
        let odd = missing.iter().find(|&&joint| !tails.contains(&tail(&robot[joint])));
        match odd.or(missing.first()) {
            Some(&joint) => {
                JointNameError::Missing { joint: robot[joint].clone(), log: log.to_vec() }
            }
            None => error,
        }
    })
}

/// The joints of the robot, by number, that are not in the log, and how many names of the log are none of the
/// robot's; names are taken for the same as [`reorder`] does, if more are the same then.
pub fn unmatched(robot: &[String], log: &[String]) -> (Vec<usize>, usize) {
    let of = |robot: &[String], log: &[String]| {
        let missing: Vec<usize> =
            (0..robot.len()).filter(|joint| !log.contains(&robot[*joint])).collect();
        (missing, log.iter().filter(|name| !robot.contains(name)).count())
    };
    let (exact, alike) = (of(robot, log), of(&bare(robot), &bare(log)));
    if alike.0.len() < exact.0.len() { alike } else { exact }
}

/// Names without what all of them begin and end with.
fn bare(names: &[String]) -> Vec<String> {
    let prefix = common_prefix(names);
    let rest: Vec<&str> = names.iter().map(|name| &name[prefix..]).collect();
    let ending = rest.first().and_then(|first| first.rfind('_').map(|at| &first[at..]));
    let shared = ending.filter(|_| rest.len() > 1).filter(|ending| {
        rest.iter().all(|name| name.len() > ending.len() && name.ends_with(ending))
    });
    let end = shared.map_or(0, str::len);
    rest.iter().map(|name| name[..name.len() - end].to_owned()).collect()
}

/// Bytes that all names begin with, up to the last `_` or `/` among them; none of a single name.
fn common_prefix(names: &[String]) -> usize {
    let [first, others @ ..] = names else { return 0 };
    let common =
        |other: &String| first.bytes().zip(other.bytes()).take_while(|(a, b)| a == b).count();
    let bytes = others.iter().map(common).min().unwrap_or(0);
    first.as_bytes()[..bytes].iter().rposition(|byte| b"_/".contains(byte)).map_or(0, |at| at + 1)
}

fn reorder_exactly(robot: &[String], log: &[String]) -> Result<Vec<usize>, JointNameError> {
    let place = |joint: &String| {
        let mut places = log.iter().enumerate().filter(|(_, name)| *name == joint);
        match (places.next(), places.next()) {
            (Some((place, _)), None) => Ok(place),
            (None, _) => Err(JointNameError::Missing { joint: joint.clone(), log: log.to_vec() }),
            (Some(_), Some(_)) => Err(JointNameError::Twice { joint: joint.clone() }),
        }
    };
    robot.iter().map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prefixes_of_all_names_do_not_matter() {
        let arm = |prefix: &str| (1..=3).map(|j| format!("{prefix}joint{j}")).collect::<Vec<_>>();
        for (robot, log) in [("fr3_", "panda_"), ("", "panda_"), ("lbr_", ""), ("a_", "/left/b_")] {
            let mut log = arm(log);
            log.reverse();
            assert_eq!(reorder(&arm(robot), &log), Ok(vec![2, 1, 0]), "{robot}, {log:?}");
        }
        let mut with_finger = arm("panda_");
        with_finger.insert(0, "panda_finger_joint1".to_owned());
        assert_eq!(reorder(&arm("fer_"), &with_finger), Ok(vec![1, 2, 3]));
        // What only some names have is no prefix.
        let two_arms = [arm("left_"), arm("right_")].concat();
        assert!(reorder(&arm("fr3_"), &two_arms).is_err());
        assert_eq!(reorder(&arm("right_"), &two_arms), Ok(vec![3, 4, 5]));
    }

    #[test]
    fn endings_of_all_names_do_not_matter() {
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let robot = names(&["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"]);
        let log = names(&["elbow", "wrist_1", "shoulder_pan"]);
        assert_eq!(reorder(&robot, &log), Ok(vec![2, 0, 1]));
        assert_eq!(reorder(&log, &robot), Ok(vec![1, 2, 0]));
        // What only some names have is no ending.
        assert!(reorder(&names(&["elbow_joint", "wrist"]), &names(&["elbow", "wrist"])).is_err());
    }

    #[test]
    fn a_missing_or_doubled_joint_is_named() {
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let error = reorder(&names(&["a", "b"]), &names(&["b", "c"])).unwrap_err().to_string();
        assert!(error.contains("`a`") && error.contains("b, c"), "{error}");
        let robot = names(&["a_joint1", "elbow", "a_joint3"]);
        let log = names(&["b_joint1", "b_joint2", "b_joint3"]);
        let error = reorder(&robot, &log).unwrap_err().to_string();
        assert!(error.contains("`elbow`") && error.contains("--rename"), "{error}");
        let error = reorder(&names(&["b"]), &names(&["b", "b"])).unwrap_err();
        assert_eq!(error, JointNameError::Twice { joint: "b".to_owned() });
    }
}
