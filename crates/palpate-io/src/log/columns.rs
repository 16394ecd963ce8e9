//! Which column of a table is what: by the user's map, or by the spelling of its name.
//!
//! Spellings that are known, in any case, with `_`, `.`, `/`, `:`, `-` or a blank between words and
//! a unit such as `[rad]` behind:
//!
//! | what        | numbered                                       | named after the joint           |
//! |-------------|------------------------------------------------|---------------------------------|
//! | position    | `q1`, `joint_position_1`, `position[0]`, `pos1` | `elbow_position`, `angle_elbow` |
//! | torque      | `tau1`, `joint_torque_1`, `effort[0]`          | `elbow_effort`, `torque_elbow`  |
//! | current     | `current1`, `motor_current_1`                  | `elbow_current`                 |
//! | time        | `time`, `t`, `stamp`, `timestamp`, `time_ms`   |                                 |
//! | touch       | `touch`, `sequence`, `seq`, `episode`          |                                 |
//!
//! What Universal Robots' RTDE and libfranka write is known as well: `actual_q_0`, `actual_current_0`,
//! `actual_current_as_torque_0`; `state.q[0]`, `state.tau_J[0]`, with a time in milliseconds.
//!
//! Columns are taken only if exactly one family of positions and one of torques have the same
//! joints: what is ambiguous is an error, not a guess. Where no torques fit, motor currents do.

use std::path::Path;
use std::sync::LazyLock;

use regex::{Regex, RegexBuilder};

use super::event::LoggedTorques;
use super::files::FileDescription;
use super::options::{AngleUnit, CsvColumns};

/// Places of the columns in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    pub(super) q: Vec<usize>,
    pub(super) tau: Vec<usize>,
    pub(super) joint_names: Option<Vec<String>>,
    pub(super) time: Option<usize>,
    pub(super) touch: Option<usize>,
    /// Seconds in a unit of the time.
    pub(super) time_unit_s: f64,
    /// `tau` are motor currents by their names.
    pub(super) currents: bool,
}

/// How columns of positions, of torques and of motor currents are called; of two words in a name, the first here counts.
static POSITIONS: LazyLock<Vec<Regex>> = LazyLock::new(|| {
    patterns(
        "joint_positions|joint_position|joint_angles|joint_angle|joint_pos|positions|position|\
         angles|angle|pos|actual_q|q",
    )
});
static TORQUES: LazyLock<Vec<Regex>> = LazyLock::new(|| {
    patterns(
        "joint_torques|joint_torque|joint_efforts|joint_effort|torques|torque|efforts|effort|\
         tau_j|tau|actual_current_as_torque",
    )
});
static CURRENTS: LazyLock<Vec<Regex>> = LazyLock::new(|| {
    patterns(
        "joint_currents|joint_current|motor_currents|motor_current|actual_current|currents|current",
    )
});
const TIMES: &[&str] =
    &["time", "t", "stamp", "timestamp", "time_s", "__time", "time_ms", "t_ms", "timestamp_ms"];
/// Names of the time, ms, and of another column in what libfranka's `logToCSV` writes, now and in older versions.
const LIBFRANKA: [[&str; 2]; 2] = [["time", "success_rate"], ["duration", "success rate"]];
const TOUCHES: &[&str] = &["touch", "sequence", "seq", "episode"];

/// Which of the [`patterns`] has numbers.
const NUMBERED: usize = 0;

/// Names that hold one of `words`, with the number of a joint behind it, or else the joint's name before
/// or behind it.
fn patterns(words: &str) -> Vec<Regex> {
    let between = "[_./:\\- ]";
    let numbered =
        format!(r"^(?:.*/|state\.)?(?<word>{words}){between}*[\[(]*(?<number>[0-9]+)[\])]*$");
    let named = words.split('|').flat_map(|word| {
        [
            format!(r"^(?:.*?/)??(?<joint>[^/]+?){between}+(?<word>{word})$"),
            format!(r"^(?<word>{word}){between}+(?<joint>.+)$"),
        ]
    });
    let pattern = |pattern: String| {
        let pattern = RegexBuilder::new(&pattern).case_insensitive(true).build();
        pattern.expect("the words fit a pattern")
    };
    std::iter::once(numbered).chain(named).map(pattern).collect()
}

impl Columns {
    /// The columns that `map` names, or those that are recognised by their spelling. An error is
    /// half a sentence for the user.
    pub(super) fn find(header: &[String], map: Option<&CsvColumns>) -> Result<Self, String> {
        Self::checked(
            header,
            match map {
                Some(map) => Self::mapped(header, map)?,
                None => Self::recognised(header, true)?,
            },
        )
    }

    /// The same of a motion that is only planned, in which torques may be missing: then `tau` is empty.
    pub(super) fn find_planned(header: &[String]) -> Result<Self, String> {
        let with_torques = Self::find(header, None);
        with_torques.or_else(|_| Self::checked(header, Self::recognised(header, false)?))
    }

    fn checked(header: &[String], columns: Self) -> Result<Self, String> {
        let mut used: Vec<usize> = columns.used().collect();
        used.sort_unstable();
        match used.array_windows().find(|[a, b]| a == b) {
            Some(&[column, _]) => Err(format!("column `{}` is used twice", header[column])),
            None => Ok(columns),
        }
    }

    /// All places that are read.
    pub(super) fn used(&self) -> impl Iterator<Item = usize> {
        self.q.iter().chain(&self.tau).chain(&self.time).chain(&self.touch).copied()
    }

    /// What they say of their file.
    pub(super) fn describe(&self, path: &Path) -> FileDescription {
        FileDescription {
            name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            joint_names: self.joint_names.clone(),
            names_touches: self.touch.is_some(),
            torques: match self.currents {
                true => LoggedTorques::Currents,
                false => LoggedTorques::Unsaid,
            },
            ..FileDescription::default()
        }
    }

    /// A column of positions whose name contradicts the unit.
    pub(super) fn wrong_unit(&self, header: &[String], unit: AngleUnit) -> Option<usize> {
        let says = |name: &str, word: &str| {
            let name = name.trim().to_ascii_lowercase();
            name.split(|c: char| !c.is_ascii_alphabetic()).next_back() == Some(word)
                || name.ends_with(&format!("[{word}]"))
                || name.ends_with(&format!("({word})"))
        };
        let others: &[&str] = match unit {
            AngleUnit::Rad => &["deg", "degree", "degrees"],
            AngleUnit::Deg => &["rad", "radian", "radians"],
        };
        self.q.iter().copied().find(|&place| others.iter().any(|word| says(&header[place], word)))
    }

    fn mapped(header: &[String], map: &CsvColumns) -> Result<Self, String> {
        let place = |name: &String| {
            let mut places =
                header.iter().enumerate().filter(|(_, held)| held.trim() == name.trim());
            match (places.next(), places.next()) {
                (Some((place, _)), None) => Ok(place),
                (None, _) => Err(format!("there is no column `{name}`")),
                (Some(_), Some(_)) => Err(format!("there are two columns `{name}`")),
            }
        };
        let (n, joints) = (map.q.len(), map.joints.as_ref().map_or(map.q.len(), Vec::len));
        if n == 0 || map.tau.len() != n || joints != n {
            let tau = map.tau.len();
            return Err(format!("the map has {n} `q`, {tau} `tau` and {joints} `joints`"));
        }
        let time = map.time.as_ref().map(place).transpose()?;
        Ok(Self {
            q: map.q.iter().map(place).collect::<Result<_, _>>()?,
            tau: map.tau.iter().map(place).collect::<Result<_, _>>()?,
            joint_names: map.joints.clone(),
            time,
            touch: map.touch.as_ref().map(place).transpose()?,
            time_unit_s: time_unit_s(header, time),
            currents: false,
        })
    }

    fn recognised(header: &[String], has_torques: bool) -> Result<Self, String> {
        let positions = families(header, &POSITIONS);
        let of_torques = match has_torques {
            true => families(header, &TORQUES),
            // Positions stand for them, so that they are of the same joints.
            false => families(header, &POSITIONS),
        };
        let of_currents = if has_torques { families(header, &CURRENTS) } else { Vec::new() };
        let currents = pairs(&positions, &of_torques).is_empty()
            && !pairs(&positions, &of_currents).is_empty();
        let torques = if currents { of_currents } else { of_torques };
        let pairs = pairs(&positions, &torques);
        let [(q, tau)] = pairs[..] else {
            return Err(match (positions.is_empty(), torques.is_empty(), pairs.is_empty()) {
                (true, _, _) => "no column is spelt like a joint position".to_owned(),
                (_, true, _) => "no column is spelt like a joint torque".to_owned(),
                (_, _, true) => "positions and torques are not of the same joints".to_owned(),
                _ => "more than one set of columns could be meant".to_owned(),
            });
        };
        let numbered = q.key.0 == NUMBERED;
        if numbered && !is_gapless(&q.labels()) {
            return Err("the numbers of the joints have gaps or repeat".to_owned());
        }
        // Numbered joints by their number, named ones in the order of the file.
        let mut members = q.members.clone();
        if numbered {
            members.sort();
        }
        let of_torque = |label: &Label| {
            tau.members.iter().find(|(other, _)| other == label).map(|(_, place)| *place)
        };
        let names = members.iter().map(|(label, _)| match label {
            Label::Name(name) => Some(name.clone()),
            Label::Number(_) => None,
        });
        let time = time_of_libfranka(header).or_else(|| only(header, TIMES));
        Ok(Self {
            q: members.iter().map(|(_, place)| *place).collect(),
            tau: match has_torques {
                true => members.iter().filter_map(|(label, _)| of_torque(label)).collect(),
                false => Vec::new(),
            },
            joint_names: names.collect(),
            time,
            touch: only(header, TOUCHES),
            time_unit_s: time_unit_s(header, time),
            currents,
        })
    }
}

/// The time in what libfranka writes.
fn time_of_libfranka(header: &[String]) -> Option<usize> {
    let place = |wanted: &str| header.iter().position(|name| name.trim() == wanted);
    LIBFRANKA.iter().find_map(|[time, other]| place(other).and(place(time)))
}

/// Seconds in a unit of the column of times: milliseconds if its name says so, or libfranka wrote it.
fn time_unit_s(header: &[String], time: Option<usize>) -> f64 {
    let says_so = |place: usize| {
        let name = header[place].to_ascii_lowercase();
        let mut words = name.split(|c: char| !c.is_ascii_alphanumeric());
        words.rfind(|word| !word.is_empty()) == Some("ms")
    };
    let of_libfranka = time.is_some() && time == time_of_libfranka(header);
    if of_libfranka || time.is_some_and(says_so) { 1e-3 } else { 1.0 }
}

/// The column whose whole name is one of `words`, the first word counting most.
fn only(header: &[String], words: &[&str]) -> Option<usize> {
    let plain: Vec<String> = header.iter().map(|name| base(name).to_ascii_lowercase()).collect();
    words.iter().find_map(|word| plain.iter().position(|name| name == word))
}

/// The joint that a column of a family belongs to.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Label {
    Number(u32),
    Name(String),
}

/// Columns whose names differ only in the joint.
struct Family {
    /// What they share: the pattern, and the word in it.
    key: (usize, String),
    members: Vec<(Label, usize)>,
}

impl Family {
    fn labels(&self) -> Vec<&Label> {
        let mut labels: Vec<&Label> = self.members.iter().map(|(label, _)| label).collect();
        labels.sort();
        labels
    }
}

/// Families of positions and of torques that have the same joints.
fn pairs<'a>(positions: &'a [Family], torques: &'a [Family]) -> Vec<(&'a Family, &'a Family)> {
    let all = positions.iter().flat_map(|q| torques.iter().map(move |tau| (q, tau)));
    all.filter(|(q, tau)| q.labels() == tau.labels()).collect()
}

/// Numbers from 0 or 1 on, each once.
fn is_gapless(labels: &[&Label]) -> bool {
    let first = if labels.contains(&&Label::Number(0)) { 0 } else { 1 };
    labels.iter().zip(first..).all(|(label, number)| **label == Label::Number(number))
}

/// All families of columns whose names fit one of the patterns.
fn families(header: &[String], patterns: &[Regex]) -> Vec<Family> {
    let mut families: Vec<Family> = Vec::new();
    for (place, name) in header.iter().enumerate() {
        let fit = |(kind, pattern)| Some((kind, classify(base(name), pattern)?));
        let Some((kind, (word, label))) = patterns.iter().enumerate().find_map(fit) else {
            continue;
        };
        let key = (kind, word);
        match families.iter_mut().find(|family| family.key == key) {
            Some(family) => family.members.push((label, place)),
            None => families.push(Family { key, members: vec![(label, place)] }),
        }
    }
    families
}

/// The word in a name, and its joint.
fn classify(name: &str, pattern: &Regex) -> Option<(String, Label)> {
    let found = pattern.captures(name)?;
    let label = match found.name("number") {
        Some(number) => Label::Number(number.as_str().parse().ok()?),
        None => Label::Name(found["joint"].to_owned()),
    };
    Some((found["word"].to_ascii_lowercase(), label))
}

/// A name without blanks around it and without its unit: `q1` of ` q1 [rad]`, `q1_rad`.
fn base(name: &str) -> &str {
    let mut name = name.trim();
    if let Some((front, unit)) = name.rsplit_once(['[', '('])
        && !unit.starts_with(|c: char| c.is_ascii_digit())
    {
        name = front.trim_end();
    }
    for unit in ["_rad", "_deg", "_nm", "_Nm", "_m", "_N", "_A"] {
        name = name.strip_suffix(unit).unwrap_or(name);
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find(header: &str) -> Result<Columns, String> {
        let header: Vec<String> = header.split(',').map(str::to_owned).collect();
        Columns::find(&header, None)
    }

    #[test]
    fn common_spellings_are_recognised() {
        for header in [
            "t,q0,q1,tau0,tau1",
            "time,q1,q2,tau1,tau2",
            "Time [s],Q1 [rad],Q2 [rad],Tau1 [Nm],Tau2 [Nm]",
            "stamp,joint_position_0,joint_position_1,joint_torque_0,joint_torque_1",
            "timestamp,pos_1,pos_2,effort_1,effort_2",
            "time_s,angle1_rad,angle2_rad,torque1_Nm,torque2_Nm",
            "timestamp,actual_q_0,actual_q_1,actual_current_as_torque_0,actual_current_as_torque_1,\
             target_q_0,target_q_1,actual_current_0,actual_current_1,target_current_0,\
             target_current_1,target_moment_0,target_moment_1,actual_qd_0,actual_qd_1",
            "__time,/joint_states/position[0],/joint_states/position[1],/joint_states/effort[0],\
             /joint_states/effort[1]",
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            let (q, tau) = (vec![1, 2], vec![3, 4]);
            let (joint_names, time, touch) = (None, Some(0), None);
            let (time_unit_s, currents) = (1.0, false);
            let wanted = Columns { q, tau, joint_names, time, touch, time_unit_s, currents };
            assert_eq!(columns, wanted, "{header}");
        }
    }

    #[test]
    fn a_time_in_milliseconds_is_one_if_its_name_or_libfranka_says_so() {
        for (header, unit_s) in [
            ("time,q1,tau1", 1.0),
            ("Time [s],q1,tau1", 1.0),
            ("Time [ms],q1,tau1", 1e-3),
            ("time_ms,q1,tau1", 1e-3),
            (
                "time,success_rate,state.q[0],state.q_d[0],state.dq[0],state.tau_J[0],cmd.q_d[0],cmd.tau_J_d[0]",
                1e-3,
            ),
            (
                "duration, success rate, q[0],q_d[0],tau_J[0],tau_ext_hat_filtered[0],sent commands,q_d[0],tau_J_d[0]",
                1e-3,
            ),
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert_eq!((columns.time, columns.time_unit_s), (Some(0), unit_s), "{header}");
        }
        // Another's duration is no time.
        assert_eq!(find("duration,q1,tau1").unwrap().time, None);
    }

    #[test]
    fn motor_currents_are_taken_where_there_are_no_torques() {
        for header in [
            "timestamp,target_current_0,actual_q_0,actual_q_1,actual_current_0,actual_current_1",
            "time,x,elbow_position,wrist_position,elbow_current [A],wrist_current [A]",
            "t,x,q1,q2,motor_current_1_A,motor_current_2_A",
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert!(columns.currents, "{header}");
            assert_eq!((columns.q, columns.tau), (vec![2, 3], vec![4, 5]), "{header}");
        }
        assert!(!find("q1,current1,tau1").unwrap().currents);
        assert!(find("q1,current1,tau1,effort1").unwrap_err().contains("more than one"));
    }

    #[test]
    fn the_name_of_a_joint_may_end_in_another_of_the_words() {
        let columns =
            find("position_hip_angle,position_knee_angle,torque_hip_angle,torque_knee_angle");
        let columns = columns.unwrap();
        assert_eq!((columns.q, columns.tau), (vec![0, 1], vec![2, 3]));
        assert_eq!(columns.joint_names.unwrap(), ["hip_angle", "knee_angle"]);
    }

    #[test]
    fn joints_are_named_after_their_columns() {
        for header in [
            "episode,arm_Elbow_position,arm_Wrist_position,arm_Wrist_effort,arm_Elbow_effort",
            "seq,position_arm_Elbow,pos.x,effort_arm_Elbow,x",
            "touch,/js/arm_Elbow/position,/js/arm_Wrist/position,/js/arm_Wrist/effort,\
             /js/arm_Elbow/effort",
            "touch,arm_Elbow/joint_pos,x/joint_pos,x/joint_effort,arm_Elbow/joint_effort",
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert_eq!(columns.joint_names.unwrap()[0], "arm_Elbow", "{header}");
            assert_eq!(columns.touch, Some(0));
            let last_is_elbow = header.ends_with("Elbow_effort")
                || header.ends_with("Elbow/effort")
                || header.ends_with("Elbow/joint_effort");
            assert_eq!(columns.tau[0], if last_is_elbow { 4 } else { 3 });
        }
    }

    #[test]
    fn other_columns_do_not_disturb_and_the_order_does_not_matter() {
        let columns = find("tau2,tau1,q_d_1,dq1,dq2,q2,q1,position_x,position_y,comment").unwrap();
        assert_eq!((columns.q, columns.tau), (vec![6, 5], vec![1, 0]));
        let columns = find(
            "q1,q10,q2,q3,q4,q5,q6,q7,q8,q9,tau1,tau2,tau3,tau4,tau5,tau6,tau7,tau8,\
                            tau9,tau10",
        )
        .unwrap();
        assert_eq!(columns.q, [0, 2, 3, 4, 5, 6, 7, 8, 9, 1]);
        assert_eq!(columns.tau, (10..20).collect::<Vec<_>>());
    }

    #[test]
    fn missing_or_ambiguous_columns_are_an_error() {
        for (header, wanted) in [
            ("a,b,c", "like a joint position"),
            ("q1,q2,dq1", "like a joint torque"),
            ("q1,q2,tau1", "not of the same joints"),
            ("q0,q1,tau1,tau2", "not of the same joints"),
            ("q1,q3,tau1,tau3", "gaps"),
            ("q1,q1,tau1,tau1", "gaps or repeat"),
            ("q1,pos1,tau1", "more than one"),
        ] {
            let error = find(header).unwrap_err();
            assert!(error.contains(wanted), "{header}: {error}");
        }
    }

    #[test]
    fn a_name_that_says_degrees_contradicts_radians() {
        let header = ["q1 [deg]", "tau1"].map(str::to_owned);
        let columns = Columns::find(&header, None).unwrap();
        assert_eq!(columns.wrong_unit(&header, AngleUnit::Rad), Some(0));
        assert_eq!(columns.wrong_unit(&header, AngleUnit::Deg), None);
        let header = ["q1_rad", "tau1"].map(str::to_owned);
        assert_eq!(columns.wrong_unit(&header, AngleUnit::Deg), Some(0));
    }
}
