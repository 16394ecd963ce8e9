//! Finds the columns of a table: by the user's map, or by the spelling of their names.
//!
//! The known spellings are listed below. Upper and lower case are equal. Words may be separated by `_`, `.`, `/`, `:`,
//! `-` or a blank. A topic or a part of a message may precede them (`/joint_states/`, `field.`), `measured`, `actual`
//! or `feedback` may be added, and a unit such as `[rad]` may follow:
//!
//! | what     | numbered                                                | named after the joint           |
//! |----------|---------------------------------------------------------|---------------------------------|
//! | position | `q1`, `joint_position_1`, `position[0]`, `pos1`         | `elbow_position`, `angle_elbow` |
//! | torque   | `tau1`, `joint_torque_1`, `effort[0]`                   | `elbow_effort`, `torque_elbow`  |
//! | external | `external_torque_1`, `tau_ext1`                         | `elbow_external_torque`         |
//! | current  | `current1`, `motor_current_1`, `i_actual_0`             | `elbow_current`                 |
//! | time     | `time`, `timestamp_ns`, `stamp.sec` and `stamp.nanosec` |                                 |
//! | touch    | `touch`, `sequence`, `seq`, `episode`                   |                                 |
//!
//! Names of the manufacturers' programs are also known: Universal Robots' RTDE (`actual_q_0`,
//! `actual_current_as_torque_0`, `actual_current_0`), libfranka (`state.q[0]`, `state.tau_J[0]`, with a time in
//! milliseconds), KUKA's recorder (`axisQMsr_LBR_iiwa_7_R800_1[0]`) and pyfri (`mp1`, `mt1`).
//!
//! Columns are used only if exactly one family of positions and one of torques have the same joints; an ambiguous
//! header is an error. Commanded quantities are ignored. Pairs of the same topic have priority over other pairs, and
//! of two that differ only in `measured`, the measured one is used. If no measured torques fit, external
//! torques are used, or else motor currents.

mod families;
mod names;
mod time;
mod unit;

use std::path::Path;
use std::sync::LazyLock;

use regex::Regex;

use super::event::LoggedTorques;
use super::files::FileDescription;
use super::options::CsvColumns;
use families::{Family, families, pairs, unpaired};
use names::{JOINT_NAMES, Label};
pub(super) use names::{POSITIONS, Spelling, TORQUES};
pub(super) use time::{Time, date_s};

/// Indices of the columns in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Columns {
    pub(super) q: Vec<usize>,
    pub(super) tau: Vec<usize>,
    /// For each column of positions, whether its name says degrees; empty if the unit is given.
    pub(super) degrees: Vec<bool>,
    pub(super) joint_names: Option<Vec<String>>,
    /// Columns of the joint names, if rows contain them, in the order of `q`; a single column may hold all names as a
    /// list.
    pub(super) named_in_row: Option<Vec<usize>>,
    pub(super) time: Option<Time>,
    pub(super) touch: Option<usize>,
    /// Kind of torques in `tau`, from their names.
    pub(super) torques: LoggedTorques,
}

const TOUCHES: &[&str] = &["touch", "sequence", "seq", "episode"];

impl Columns {
    /// The columns in `map`, or those recognised by their spelling. The error is the end of a message
    /// to the user.
    pub(super) fn find(header: &[String], map: Option<&CsvColumns>) -> Result<Self, String> {
        Self::checked(
            header,
            match map {
                Some(map) => Self::mapped(header, map)?,
                None => Self::recognised(header, true)?,
            },
        )
    }

    /// The columns of a planned motion, in which torques may be missing; `tau` is then empty.
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

    /// Indices of all columns that are read.
    pub(super) fn used(&self) -> impl Iterator<Item = usize> {
        let time = self.time.iter().flat_map(Time::places);
        self.q.iter().chain(&self.tau).chain(&self.touch).copied().chain(time)
    }

    /// Description of the file that these columns belong to.
    pub(super) fn describe(&self, path: &Path, header: &[String]) -> FileDescription {
        let names = |places: &[usize]| places.iter().map(|&place| header[place].clone()).collect();
        let time = self.time.as_ref().map(|time| names(&time.places().collect::<Vec<_>>()));
        FileDescription {
            name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            columns: Some(CsvColumns {
                q: names(&self.q),
                tau: names(&self.tau),
                joints: self.joint_names.clone(),
                time: time.map(|names: Vec<String>| names.join(" and ")),
                touch: self.touch.map(|place| header[place].clone()),
            }),
            joint_names: self.joint_names.clone(),
            names_touches: self.touch.is_some(),
            torques: self.torques,
            ..FileDescription::default()
        }
    }

    fn mapped(header: &[String], map: &CsvColumns) -> Result<Self, String> {
        let place = |name: &String| place_of(name, header);
        let (n, joints) = (map.q.len(), map.joints.as_ref().map_or(map.q.len(), Vec::len));
        if n == 0 || map.tau.len() != n || joints != n {
            let tau = map.tau.len();
            return Err(format!(
                "`columns` names {n} `q`, {tau} `tau` and {joints} `joints`; wanted as many of each"
            ));
        }
        let time = map.time.as_ref().map(|name| time_called(name, header));
        Ok(Self {
            q: map.q.iter().map(place).collect::<Result<_, _>>()?,
            tau: map.tau.iter().map(place).collect::<Result<_, _>>()?,
            degrees: Vec::new(),
            joint_names: map.joints.clone(),
            named_in_row: None,
            time: time.transpose()?,
            touch: map.touch.as_ref().map(place).transpose()?,
            torques: LoggedTorques::Unknown,
        })
    }

    /// Recognises columns by their spelling. Without torques (`has_torques` false) the table is a plan, so commanded
    /// positions count.
    fn recognised(header: &[String], has_torques: bool) -> Result<Self, String> {
        let all = |spelling: &Spelling| families(header, spelling, !has_torques);
        let (positions, joint_names) = (all(&POSITIONS)?, all(&JOINT_NAMES)?);
        let found = match has_torques {
            true => torques_by_kind(header)?,
            // The positions are paired with themselves.
            false => vec![(LoggedTorques::Unknown, all(&POSITIONS)?)],
        };
        let fits = |(_, torques): &&(_, Vec<_>)| !pairs(&positions, torques).is_empty();
        let (kind, torques) = found.iter().find(fits).unwrap_or(&found[0]);
        let pairs = pairs(&positions, torques);
        let [(q, tau)] = pairs[..] else {
            return Err(match (positions.is_empty(), torques.is_empty(), pairs.is_empty()) {
                (true, _, _) => "no column has a known name of joint positions".to_owned(),
                (_, true, _) => "no column has a known name of joint torques".to_owned(),
                (_, _, true) => unpaired(header, &positions[0], &torques[0]),
                _ => "more than one set of columns looks like positions and torques".to_owned(),
            });
        };
        if q.is_numbered() && !q.is_gapless() {
            return Err("the numbers of the joints have gaps or repeat".to_owned());
        }
        // Numbered joints by their number, named ones in the order of the file.
        let mut members = q.members.clone();
        if q.is_numbered() {
            members.sort();
        }
        let places = |of: &Family| -> Vec<usize> {
            let place = |label: &Label| of.members.iter().find(|(other, _)| other == label);
            members.iter().filter_map(|(label, _)| place(label)).map(|(_, place)| *place).collect()
        };
        let names = members.iter().map(|(label, _)| match label {
            Label::Name(name) => Some(name.clone()),
            Label::Number(_) => None,
        });
        Ok(Self {
            q: members.iter().map(|(_, place)| *place).collect(),
            tau: match has_torques {
                true => places(tau),
                false => Vec::new(),
            },
            degrees: Vec::new(),
            joint_names: names.collect(),
            named_in_row: (joint_names.iter().find(|of| of.stands_beside(q)).map(places))
                .or_else(|| all_names(header, q.topic()).map(|place| vec![place])),
            time: Time::find(header, q.topic()),
            touch: touch(header),
            torques: *kind,
        })
    }
}

/// Families of torques, by kind: by their names, or by their topics if these are of external torques.
fn torques_by_kind(header: &[String]) -> Result<Vec<(LoggedTorques, Vec<Family>)>, String> {
    let mut found: Vec<(LoggedTorques, Vec<Family>)> = Vec::new();
    for (kind, spelling) in &*TORQUES {
        found.push((*kind, families(header, spelling, false)?));
    }
    let (of_topics, rest): (Vec<Family>, Vec<Family>) =
        std::mem::take(&mut found[0].1).into_iter().partition(|own| own.kind_of_topic().is_some());
    found[0].1 = rest;
    for family in of_topics {
        let kind = found.iter_mut().find(|(kind, _)| Some(*kind) == family.kind_of_topic());
        kind.expect("external torques are among the kinds").1.push(family);
    }
    Ok(found)
}

/// The only column with this name.
fn place_of(name: &str, header: &[String]) -> Result<usize, String> {
    let mut places = header.iter().enumerate().filter(|(_, held)| held.trim() == name.trim());
    match (places.next(), places.next()) {
        (Some((place, _)), None) => Ok(place),
        (None, _) => Err(format!("there is no column `{name}`")),
        (Some(_), Some(_)) => Err(format!("there are two columns `{name}`")),
    }
}

/// The time in the column with this name, or in two columns, `seconds and nanoseconds`.
fn time_called(name: &str, header: &[String]) -> Result<Time, String> {
    match (place_of(name, header), name.split_once(" and ")) {
        (Err(_), Some((seconds, nanoseconds))) => {
            let nanoseconds = place_of(nanoseconds, header)?;
            Ok(Time::at(place_of(seconds, header)?, Some(nanoseconds), header))
        }
        (place, _) => Ok(Time::at(place?, None, header)),
    }
}

/// The column with a list of all joint names, as bagpy writes it.
fn all_names(header: &[String], topic: &str) -> Option<usize> {
    header.iter().position(|held| held.trim().eq_ignore_ascii_case(&format!("{topic}name")))
}

/// The column that says which touch a row belongs to; earlier words in [`TOUCHES`] have priority.
fn touch(header: &[String]) -> Option<usize> {
    let plain: Vec<String> = header.iter().map(|name| base(name).to_ascii_lowercase()).collect();
    TOUCHES.iter().find_map(|word| plain.iter().position(|name| name == word))
}

/// A name without surrounding blanks and without its unit: `q1` for ` q1 [rad]` and `q1_rad`.
fn base(name: &str) -> &str {
    static UNIT: LazyLock<Regex> = LazyLock::new(|| {
        let in_brackets = "rad|radians?|deg|degrees?|°|n[ .·*]?m|m|n|a|amperes?";
        let pattern = format!(r"(?:\s*[\[(](?i:{in_brackets})[\])]|_(?:rad|deg|nm|Nm|m|N|A))$");
        Regex::new(&pattern).expect("units fit a pattern")
    });
    let name = name.trim();
    UNIT.find(name).map_or(name, |unit| &name[..unit.start()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate::TorqueSign;

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
            let Columns { q, tau, joint_names, named_in_row, time, touch, torques, .. } = columns;
            assert_eq!((q, tau), (vec![1, 2], vec![3, 4]), "{header}");
            assert_eq!((joint_names, named_in_row, touch), (None, None, None), "{header}");
            assert_eq!(torques, LoggedTorques::Unknown);
            assert!(time.unwrap().places().eq([0]), "{header}");
        }
    }

    #[test]
    fn motor_currents_are_taken_where_there_are_no_torques() {
        for header in [
            "timestamp,target_current_0,actual_q_0,actual_q_1,actual_current_0,actual_current_1",
            "time,x,elbow_position,wrist_position,elbow_current [A],wrist_current [A]",
            "t,x,q1,q2,motor_current_1_A,motor_current_2_A",
            "t,i_target_0,q_actual_0,q_actual_1,i_actual_0,i_actual_1,m_target_0,qd_actual_0",
            "t,x,q_elbow_joint,q_wrist_joint,i_elbow_joint,i_wrist_joint",
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert_eq!(columns.torques, LoggedTorques::Currents, "{header}");
            assert_eq!((columns.q, columns.tau), (vec![2, 3], vec![4, 5]), "{header}");
        }
        assert_eq!(find("q1,current1,tau1").unwrap().torques, LoggedTorques::Unknown);
        assert!(find("q1,current1,tau1,effort1").unwrap_err().contains("more than one"));
    }

    #[test]
    fn external_torques_are_taken_where_there_are_no_measured_ones() {
        let (of_unknown_sign, franka, kuka) =
            (None, Some(TorqueSign::Minus), Some(TorqueSign::Plus));
        for (header, sign) in [
            ("x,q_0,q_1,external_torque_0,external_torque_1,current_0,current_1", of_unknown_sign),
            ("x,q1,q2,tau_ext_1 [Nm],tau_ext_2 [Nm]", of_unknown_sign),
            ("x,q0,q1,joint_external_torque_0_nm,joint_external_torque_1_nm", of_unknown_sign),
            ("x,q[0],q[1],torque_external[0],torque_external[1]", of_unknown_sign),
            ("x,jointPosition1,jointPosition2,externalJointTorque1,externalJointTorque2", None),
            (
                "x,/lbr/state/measured_joint_position[0],/lbr/state/measured_joint_position[1],\
                 /lbr/state/external_torque[0],/lbr/state/external_torque[1],\
                 /lbr/state/commanded_torque[0],/lbr/state/commanded_torque[1]",
                of_unknown_sign,
            ),
            (
                "x,/js/elbow/position,/js/wrist/position,/js/elbow/external_torque,\
                 /js/wrist/external_torque",
                of_unknown_sign,
            ),
            (
                "x,/iiwa/state/JointPosition/position/a1,/iiwa/state/JointPosition/position/a2,\
                 /iiwa/state/ExternalJointTorque/torque/a1,/iiwa/state/ExternalJointTorque/torque/a2",
                of_unknown_sign,
            ),
            ("x,q_0,q_1,tau_ext_hat_filtered_0,tau_ext_hat_filtered_1,i_0,i_1", franka),
            (
                "x,measured_joint_state.position[0],measured_joint_state.position[1],\
                 tau_ext_hat_filtered.effort[0],tau_ext_hat_filtered.effort[1]",
                franka,
            ),
            ("x,mp1,mp2,et1,et2,ip1,ip2", kuka),
            (
                "x,axisQMsr_iiwa[0],axisQMsr_iiwa[1],axisTauExtMsr_iiwa[0],axisTauExtMsr_iiwa[1]",
                kuka,
            ),
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert_eq!(columns.torques, LoggedTorques::External(sign), "{header}");
            assert_eq!((columns.q, columns.tau), (vec![1, 2], vec![3, 4]), "{header}");
        }
        for external in ["tau_ext_hat_filtered", "external_torque", "tau_ext"] {
            let both = find(&format!("q0,{external}0,tau0,current0")).unwrap();
            assert_eq!((both.torques, both.tau), (LoggedTorques::Unknown, vec![2]), "{external}");
        }
    }

    /// Headers from the documentation or from recordings of other programs.
    #[test]
    fn what_other_programs_write_is_recognised() {
        for header in [
            // `rostopic echo -p` of ROS 1, of joint states and of franka_ros
            "%time,field.header.seq,field.position0,field.position1,field.effort0,field.effort1,\
             field.velocity0,field.velocity1",
            "%time,x,field.q0,field.q1,field.tau_J0,field.tau_J1,field.q_d0,field.q_d1,\
             field.tau_J_d0,field.tau_J_d1,field.dq0,field.dq1,field.tau_ext_hat_filtered0,\
             field.tau_ext_hat_filtered1",
            // bagpy, of joint states and of franka_ros
            "Time,header.seq,position_0,position_1,effort_0,effort_1,velocity_0,velocity_1",
            "Time,x,q_0,q_1,tau_J_0,tau_J_1,q_d_0,q_d_1,tau_J_d_0,tau_J_d_1,dq_0,dq_1,\
             tau_ext_hat_filtered_0,tau_ext_hat_filtered_1",
            // Foxglove
            "header.stamp.sec,header.stamp.nanosec,position[0],position[1],effort[0],effort[1]",
            // PlotJuggler, of two topics
            "__time,x,/joint_states/position[0],/joint_states/position[1],/joint_states/effort[0],\
             /joint_states/effort[1],/desired/position[0],/desired/position[1]",
            // KUKA's DataRecorder, and pyfri
            "ZeitInSec,ZeitInNanoSec,axisQMsr_LBR_iiwa_7_R800_1[0],axisQMsr_LBR_iiwa_7_R800_1[1],\
             axisTauMsr_LBR_iiwa_7_R800_1[0],axisTauMsr_LBR_iiwa_7_R800_1[1],\
             axisQCmdT1m_LBR_iiwa_7_R800_1[0],axisQCmdT1m_LBR_iiwa_7_R800_1[1],\
             axisTauExtMsr_LBR_iiwa_7_R800_1[0],axisTauExtMsr_LBR_iiwa_7_R800_1[1],cartForce1_X",
            "index,time,mp1,mp2,mt1,mt2,ip1,ip2,et1,et2,record_time_nsec,tsec,tnsec,dt",
            // PlotJuggler, of the state of lbr_fri_ros2_stack
            "/lbr/state/time_stamp_nano_sec,/lbr/state/time_stamp_sec,\
             /lbr/state/measured_joint_position[0],/lbr/state/measured_joint_position[1],\
             /lbr/state/measured_torque[0],/lbr/state/measured_torque[1],\
             /lbr/state/commanded_torque[0],/lbr/state/commanded_torque[1],\
             /lbr/state/external_torque[0],/lbr/state/external_torque[1],\
             /lbr/state/ipo_joint_position[0],/lbr/state/ipo_joint_position[1],/lbr/state/sample_time",
            "time_stamp_sec,time_stamp_nano_sec,measured_joint_position_0,measured_joint_position_1,\
             measured_torque_0,measured_torque_1,commanded_torque_0,commanded_torque_1,\
             external_torque_0,external_torque_1,ipo_joint_position_0,ipo_joint_position_1",
            // Doosan, and scripts
            "time_stamp,x,actual_joint_position_0,actual_joint_position_1,actual_joint_torque_0,\
             actual_joint_torque_1,external_joint_torque_0,external_joint_torque_1",
            "host_time_s,x,q1,q2,joint_measured_torque_1_nm,joint_measured_torque_2_nm,\
             joint_external_torque_1_nm,joint_external_torque_2_nm,dq1_radps,dq2_radps",
            "timestamp,x,actual_q_0,actual_q_1,measured_tq_0,measured_tq_1,target_q_0,target_q_1,\
             external_tq_0,external_tq_1,force_X",
            "TIMESTAMP,x,POSITION_FEEDBACK_1,POSITION_FEEDBACK_2,TORQUE_FEEDBACK_1,TORQUE_FEEDBACK_2",
            "time,x,pos_meas1,pos_meas2,tau_meas1,tau_meas2,pos1,pos2,pos_des1,pos_des2,tau_con1",
            "time,x,jointPosition1,jointPosition2,jointTorque1,jointTorque2",
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            let found = (columns.q, columns.tau, columns.torques);
            assert_eq!(found, (vec![2, 3], vec![4, 5], LoggedTorques::Unknown), "{header}");
            assert!(columns.joint_names.is_none() && columns.touch.is_none(), "{header}");
            assert!(columns.time.is_some(), "{header}");
        }
    }

    #[test]
    fn columns_of_one_topic_count_and_commands_are_no_joints() {
        let columns = find(
            "/js/elbow/position,/js/wrist/position,/js/elbow/effort,/js/wrist/effort,\
             /goal/elbow/position,/goal/wrist/position,target_elbow_position,elbow_cmd_position,\
             position_d_1,effort_d_1",
        );
        let columns = columns.unwrap();
        assert_eq!((columns.q, columns.tau), (vec![0, 1], vec![2, 3]));
        assert_eq!(columns.joint_names.unwrap(), ["elbow", "wrist"]);
        // Joints may have names that look like commands.
        for header in [
            "position_theta1,position_theta2,position_d3,effort_theta1,effort_theta2,effort_d3",
            "a_pos,c_pos,d_pos,a_torque,c_torque,d_torque",
        ] {
            assert_eq!(find(header).unwrap().q, [0, 1, 2], "{header}");
        }
        assert_eq!(find("q1,q2,tau1,tau2,q_d1,q_d2,tau_d1,tau_d2").unwrap().q, [0, 1]);
        // In a plan, commanded positions are used.
        let plan = ["time", "target_elbow_position", "target_wrist_position"].map(str::to_owned);
        assert_eq!(Columns::find_planned(&plan).unwrap().q, [1, 2]);
        let two_topics = find("/a/q[0],/a/tau[0],/b/q[0],/b/tau[0]").unwrap_err();
        assert!(two_topics.contains("more than one"), "{two_topics}");
    }

    #[test]
    fn nothing_that_was_commanded_or_is_external_is_taken_for_measured() {
        for header in [
            "q_d[0],q_d[1],tau_J_d[0],tau_J_d[1]",
            "q1 (cmd),q2 (cmd),tau1,tau2",
            "desired.q[0],desired.tau[0]",
            "/command/elbow/position,/js/elbow/effort",
            "q1 [mrad],tau1",
            "q1,tau1 [mNm]",
            "joint_pos_0,joint_torque_0,actual_pos_0",
            // Measured positions may also be those of a tool.
            "q_0,q_1,q_2,tau_0,tau_1,tau_2,actual_pos_0,actual_pos_1,actual_pos_2",
        ] {
            assert!(find(header).is_err(), "{header}");
        }
        for (header, q, tau) in [
            ("/fs/q[0],/fs/q_d[0],/fs/tau_J[0],/fs/tau_J_d[0]", 0, 2),
            ("/js/position[0],/desired/position[0],/desired/effort[0],/sensor/effort[0]", 0, 3),
            ("state.q[0],cmd.q[0],state.tau_J[0],cmd.tau_J[0]", 0, 2),
            ("q1,q1_meas,tau1,tau1_meas", 1, 3),
            ("position_0,position_1,joint_position_0,joint_torque_0", 2, 3),
            ("q1_actual,q1_cmd,tau1_actual", 0, 2),
            ("measured.position[0],measured.effort[0],tau_ext_hat_filtered.effort[0]", 0, 1),
        ] {
            let columns = find(header).unwrap_or_else(|error| panic!("{header}: {error}"));
            assert_eq!((columns.q, columns.tau), (vec![q], vec![tau]), "{header}");
        }
    }

    #[test]
    fn a_header_of_too_many_topics_is_refused_at_once() {
        let topics = |word: &str| (0..10_000).map(|k| format!("t{k}/{word}1")).collect::<Vec<_>>();
        let error = find(&[topics("q"), topics("tau")].concat().join(",")).unwrap_err();
        assert!(error.contains("more than 200 sets"), "{error}");
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
            ("a,b,c", "known name of joint positions"),
            ("q1,q2,dq1", "known name of joint torques"),
            ("q1,q2,tau1", "not of the same joints: no torque belongs to `q2`"),
            ("q1,q2,tau1,tau2,tau2", "one joint has several columns: `tau2`, `tau2`"),
            ("q0,q1,tau1,tau2", "no torque belongs to `q0`; no position belongs to `tau2`"),
            ("q1,q3,tau1,tau3", "gaps"),
            ("q1,q1,tau1,tau1", "gaps or repeat"),
            ("q1,pos1,tau1", "more than one"),
        ] {
            let error = find(header).unwrap_err();
            assert!(error.contains(wanted), "{header}: {error}");
        }
    }
}
