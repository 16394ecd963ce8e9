//! Matching the joints of a log to those of a robot by name.

use std::collections::BTreeMap;

/// Why the joints of a log cannot be matched to those of a robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum JointNameError {
    /// A joint of the robot that is not in the log.
    #[error(
        "the robot's joint `{joint}` is not in the log, whose joints are {} (if it has another name there, \
         give --rename LOG=URDF)",
        log.join(", ")
    )]
    Missing { joint: String, log: Vec<String> },
    /// A name that occurs twice in the log.
    #[error("the log holds the joint `{joint}` twice")]
    Twice { joint: String },
}

/// Index in the log of each joint of the robot: `q_robot[i] = q_log[permutation[i]]`.
///
/// Joints of the log that the robot does not have, such as a gripper's, are left out. If the names do not match
/// exactly, a prefix (up to `_` or `/`) and a suffix (from `_` on) that all names of the robot or of the log share are
/// ignored: `fr3_joint1` matches `panda_joint1`, `/left/j1` matches `j1`, and `elbow_joint` matches `elbow`. Otherwise
/// numbered names without the name of a robot match by number: `joint_1` or `actuators[0]` match `Actuator1`.
///
/// # Errors
///
/// If a joint of the robot is missing from the log or occurs twice in it.
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
    let by_number = || renamed_by_number(robot, log).map(|log| reorder_exactly(robot, &log));
    let found = reorder_exactly(&bare(robot), &bare(log));
    found.or_else(|error| by_number().and_then(Result::ok).ok_or(error)).map_err(|error| {
        let tail = |name: &str| name.rsplit(['_', '/']).next().map(str::to_owned);
        let tails: Vec<_> = log.iter().map(|name| tail(name)).collect();
        let missing = unmatched(robot, log).0;
        // The message should not name a joint whose name differs from one of the log only by its prefix.
        let odd = missing.iter().find(|&&joint| !tails.contains(&tail(&robot[joint])));
        match odd.or(missing.first()) {
            Some(&joint) => {
                JointNameError::Missing { joint: robot[joint].clone(), log: log.to_vec() }
            }
            None => error,
        }
    })
}

/// Indices of the joints of the robot that are not in the log, and the number of names of the log that the robot does
/// not have. Of the ways in which [`reorder`] compares names, the one with the fewest missing joints is used.
pub fn unmatched(robot: &[String], log: &[String]) -> (Vec<usize>, usize) {
    let of = |robot: &[String], log: &[String]| {
        let missing: Vec<usize> =
            (0..robot.len()).filter(|joint| !log.contains(&robot[*joint])).collect();
        (missing, log.iter().filter(|name| !robot.contains(name)).count())
    };
    let (exact, alike) = (of(robot, log), of(&bare(robot), &bare(log)));
    let by_number = renamed_by_number(robot, log).map(|log| of(robot, &log));
    // `min_by_key` takes the first of equal ones.
    let all = [Some(exact), Some(alike), by_number];
    all.into_iter()
        .flatten()
        .min_by_key(|(missing, _)| missing.len())
        .expect("there are at least two")
}

/// A series of names that differ only in their number, by number.
type Counted<'a> = BTreeMap<u32, &'a str>;

/// Shortest series of numbered names that is matched by number.
const MIN_COUNTED: usize = 4;

/// The names of the log, in which one series is replaced by the longest series of the robot. `None` if the robot has no
/// series, or if the log has not exactly one series of that length without the name of a robot.
fn renamed_by_number(robot: &[String], log: &[String]) -> Option<Vec<String>> {
    let own = counted(robot).into_iter().max_by_key(Counted::len)?;
    let of_any_robot = |series: &Counted<'_>| series.values().all(|name| is_of_any_robot(name));
    let series = counted(log).into_iter().filter(of_any_robot);
    let mut theirs = series.filter(|series| series.len() == own.len());
    let (theirs, another) = (theirs.next()?, theirs.next());
    if another.is_some() {
        return None; // two arms
    }
    let of_own = |name: &String| {
        let place = theirs.values().position(|other| other == name);
        place.and_then(|place| own.values().nth(place).map(|own| (*own).to_owned()))
    };
    Some(log.iter().map(|name| of_own(name).unwrap_or_else(|| name.clone())).collect())
}

/// Whether a name does not contain the name of a robot: true for `joint_3`, `actuators[2]`, `A3`; false for
/// `panda_joint3`.
fn is_of_any_robot(name: &str) -> bool {
    let letters: String = name.chars().filter(|sign| sign.is_alphabetic()).collect();
    let known = ["", "a", "j", "q", "axis", "joint", "joints", "actuator", "actuators"];
    known.contains(&letters.to_lowercase().as_str())
}

/// The series of numbered names that start at 0 or 1, have no gap and have at least [`MIN_COUNTED`] names.
fn counted(names: &[String]) -> Vec<Counted<'_>> {
    let mut series: BTreeMap<(&str, &str), Counted<'_>> = BTreeMap::new();
    for name in names {
        let is_digit = |sign: char| sign.is_ascii_digit();
        let Some(end) = name.rfind(is_digit).map(|at| at + 1) else { continue };
        let stem = name[..end].trim_end_matches(is_digit);
        let Ok(number) = name[stem.len()..end].parse() else { continue };
        series.entry((stem, &name[end..])).or_default().insert(number, name);
    }
    let is_whole = |series: &Counted<'_>| {
        let first = *series.keys().next().expect("no series is empty");
        let rises = series.keys().zip(first..).all(|(number, wanted)| *number == wanted);
        series.len() >= MIN_COUNTED && first <= 1 && rises
    };
    series.into_values().filter(is_whole).collect()
}

/// The names without the prefix and the suffix that all of them share.
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

/// Length of the prefix that all names share, up to its last `_` or `/`, bytes; 0 for a single name.
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
    fn prefixes_that_all_names_share_are_ignored() {
        let arm = |prefix: &str| (1..=3).map(|j| format!("{prefix}joint{j}")).collect::<Vec<_>>();
        for (robot, log) in [("fr3_", "panda_"), ("", "panda_"), ("lbr_", ""), ("a_", "/left/b_")] {
            let mut log = arm(log);
            log.reverse();
            assert_eq!(reorder(&arm(robot), &log), Ok(vec![2, 1, 0]), "{robot}, {log:?}");
        }
        let mut with_finger = arm("panda_");
        with_finger.insert(0, "panda_finger_joint1".to_owned());
        assert_eq!(reorder(&arm("fer_"), &with_finger), Ok(vec![1, 2, 3]));
        // A prefix counts only if all names have it.
        let two_arms = [arm("left_"), arm("right_")].concat();
        assert!(reorder(&arm("fr3_"), &two_arms).is_err());
        assert_eq!(reorder(&arm("right_"), &two_arms), Ok(vec![3, 4, 5]));
    }

    #[test]
    fn suffixes_that_all_names_share_are_ignored() {
        let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect::<Vec<_>>();
        let robot = names(&["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"]);
        let log = names(&["elbow", "wrist_1", "shoulder_pan"]);
        assert_eq!(reorder(&robot, &log), Ok(vec![2, 0, 1]));
        assert_eq!(reorder(&log, &robot), Ok(vec![1, 2, 0]));
        // A suffix counts only if all names have it.
        assert!(reorder(&names(&["elbow_joint", "wrist"]), &names(&["elbow", "wrist"])).is_err());
    }

    #[test]
    fn names_that_differ_only_in_a_number_are_matched_by_their_numbers() {
        let count = |stem: &str, numbers: std::ops::Range<u32>, end: &str| -> Vec<String> {
            numbers.map(|number| format!("{stem}{number}{end}")).collect()
        };
        let gen3 = count("Actuator", 1..8, "");
        let mut log = count("joint_", 1..8, "");
        log.reverse();
        log.insert(2, "robotiq_85_left_knuckle_joint".to_owned());
        assert_eq!(reorder(&gen3, &log), Ok(vec![7, 6, 5, 4, 3, 1, 0]));
        assert_eq!(unmatched(&gen3, &log), (vec![], 1));
        assert_eq!(reorder(&gen3, &count("actuators[", 0..7, "]")), Ok((0..7).collect()));
        let with_finger = [gen3.clone(), vec!["finger_joint".to_owned()]].concat();
        assert_eq!(unmatched(&with_finger, &count("joint_", 1..8, "")), (vec![7], 0));
        // Two arms, another number of joints, a gap, another robot.
        for log in [
            [count("left_", 1..8, ""), count("right_", 1..8, "")].concat(),
            count("joint_", 1..7, ""),
            [count("joint_", 1..4, ""), count("joint_", 5..9, "")].concat(),
            count("joint_", 2..9, ""),
            count("panda_joint", 1..8, ""),
        ] {
            let error = reorder(&gen3, &log).unwrap_err();
            assert!(error.to_string().contains("`Actuator1` is not in the log"), "{error}");
        }
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
