//! Matching the joints of a log to those of a robot by name.

/// Why a log's joints do not serve a robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum JointNameError {
    /// A joint of the robot that the log does not hold.
    #[error("the robot's joint `{joint}` is not in the log, whose joints are {}", log.join(", "))]
    Missing { joint: String, log: Vec<String> },
    /// A name that the log holds twice.
    #[error("the log holds the joint `{joint}` twice")]
    Twice { joint: String },
}

/// Where each joint of the robot stands in the log: `q_robot[i] = q_log[permutation[i]]`.
///
/// Joints of the log that the robot does not have, such as a gripper's, are left out.
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
    fn a_missing_or_doubled_joint_is_named() {
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let error = reorder(&names(&["a", "b"]), &names(&["b", "c"])).unwrap_err().to_string();
        assert!(error.contains("`a`") && error.contains("b, c"), "{error}");
        let error = reorder(&names(&["b"]), &names(&["b", "b"])).unwrap_err();
        assert_eq!(error, JointNameError::Twice { joint: "b".to_owned() });
    }
}
