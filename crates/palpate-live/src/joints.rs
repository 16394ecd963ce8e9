//! Converts joint states to samples.
//!
//! A joint state that cannot be used is refused with a reason; the next one is read as usual.

use palpate::Sample;
use palpate_io::log::{JointNameError, reorder};

use crate::message::JointState;

/// A stamp earlier than the last one by at least this much, s, means that the clock was set back; a
/// stamp earlier by less, that the message came late.
const SET_BACK_S: f64 = 1.0;

/// Why a joint state is not used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub(crate) enum Refusal {
    #[error("{0}; is this the right topic (--joint-states), and the right robot (--robot)?")]
    Joints(#[from] JointNameError),
    /// Typical of publishers of grippers, or of controllers without torques.
    #[error(
        "it holds {found} {what} for {wanted} joints; positions and efforts of all joints are \
         needed: does the driver publish them, or is it another topic (--joint-states)?"
    )]
    Length { what: &'static str, found: usize, wanted: usize },
    #[error("the {what} of joint `{joint}` is {found}; every number must be finite")]
    NotFinite { what: &'static str, joint: String, found: f64 },
    #[error(
        "a joint is called `{now}`, which was `{before}` in earlier messages: is it another arm? After a change of \
         names, start palpate again"
    )]
    Renamed { now: String, before: String },
    #[error(
        "its time stamp {now_s:.6} s is that of the message before; each time stamp is used only once"
    )]
    Duplicate { now_s: f64 },
    #[error(
        "its time stamp {now_s:.6} s is before that of the last message, {last_s:.6} s: it came late"
    )]
    Late { now_s: f64, last_s: f64 },
}

impl Refusal {
    /// A short name, under which refused messages are counted.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Joints(_) | Self::Renamed { .. } => "joints",
            Self::Length { .. } => "length",
            Self::NotFinite { .. } => "not finite",
            Self::Duplicate { .. } => "duplicate",
            Self::Late { .. } => "late",
        }
    }
}

/// Reads the samples of one robot.
#[derive(Debug, Clone)]
pub(crate) struct JointReader {
    joints: Vec<String>,
    /// Names in the last message, and where the robot's joints are among them.
    names: Vec<String>,
    order: Vec<usize>,
    /// Names of the robot's joints in the last accepted message: joints of another arm, whose names would also
    /// match, are refused.
    called: Vec<String>,
    last_s: Option<f64>,
}

/// A sample, and whether the clock was set back.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReadSample {
    /// The sample.
    pub sample: Sample,
    /// Whether the clock was set back before it; the sample then does not continue the earlier ones.
    pub set_back: bool,
}

impl JointReader {
    /// A reader for a robot with these joints.
    pub(crate) fn new(joints: Vec<String>) -> Self {
        Self { joints, names: Vec::new(), order: Vec::new(), called: Vec::new(), last_s: None }
    }

    /// Converts a joint state to a sample, in the robot's order of joints.
    ///
    /// `received_s` is the time of its arrival, s, used for messages without a stamp.
    ///
    /// # Errors
    ///
    /// If it cannot be used.
    pub(crate) fn read(
        &mut self,
        state: &JointState,
        received_s: f64,
    ) -> Result<ReadSample, Refusal> {
        let (q, tau) = self.joints(state)?;
        for (what, numbers) in [("position", &q), ("effort", &tau)] {
            self.check_finite(what, numbers)?;
        }
        let now_s = state.header.stamp.seconds().unwrap_or(received_s);
        let set_back = self.tick(now_s)?;
        Ok(ReadSample { sample: Sample::new(Some(now_s), q, tau), set_back })
    }

    /// Positions and efforts of a joint state, in the robot's order of joints. Stamp and values are not
    /// checked.
    ///
    /// # Errors
    ///
    /// If joints are missing, the lengths differ, or the joints are those of another arm.
    pub(crate) fn joints(&mut self, state: &JointState) -> Result<(Vec<f64>, Vec<f64>), Refusal> {
        let wanted = state.name.len();
        for (what, numbers) in [("positions", &state.position), ("efforts", &state.effort)] {
            if numbers.len() != wanted {
                return Err(Refusal::Length { what, found: numbers.len(), wanted });
            }
        }
        if self.names != state.name {
            let order = reorder(&self.joints, &state.name)?;
            let called: Vec<String> =
                order.iter().map(|&place| state.name[place].clone()).collect();
            let mut pairs = called.iter().zip(&self.called);
            // The exact names of the robot are accepted even after other names.
            if called != self.joints
                && let Some((now, before)) = pairs.find(|(now, before)| now != before)
            {
                return Err(Refusal::Renamed { now: now.clone(), before: before.clone() });
            }
            (self.order, self.called) = (order, called);
            self.names.clone_from(&state.name);
        }
        let pick = |numbers: &[f64]| self.order.iter().map(|&place| numbers[place]).collect();
        Ok((pick(&state.position), pick(&state.effort)))
    }

    /// A joint whose name in the messages differs: its name in the URDF, and in the messages.
    pub(crate) fn other_name(&self) -> Option<(&str, &str)> {
        let mut pairs = self.joints.iter().zip(&self.called);
        pairs.find(|(own, called)| own != called).map(|(own, called)| (&own[..], &called[..]))
    }

    fn check_finite(&self, what: &'static str, numbers: &[f64]) -> Result<(), Refusal> {
        match self.joints.iter().zip(numbers).find(|(_, number)| !number.is_finite()) {
            Some((joint, &found)) => Err(Refusal::NotFinite { what, joint: joint.clone(), found }),
            None => Ok(()),
        }
    }

    /// Takes the next stamp; returns whether the clock was set back.
    fn tick(&mut self, now_s: f64) -> Result<bool, Refusal> {
        let set_back = match self.last_s {
            Some(last_s) if now_s == last_s => return Err(Refusal::Duplicate { now_s }),
            Some(last_s) if now_s < last_s && last_s - now_s < SET_BACK_S => {
                return Err(Refusal::Late { now_s, last_s });
            }
            Some(last_s) => now_s < last_s,
            None => false,
        };
        self.last_s = Some(now_s);
        Ok(set_back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Header, Stamp};
    use proptest::prelude::*;

    fn reader() -> JointReader {
        JointReader::new(vec!["a".to_owned(), "b".to_owned()])
    }

    fn state(time_s: f64) -> JointState {
        let (sec, nanosec) = (time_s as i32, (time_s.fract() * 1e9).round() as u32);
        JointState {
            header: Header { stamp: Stamp { sec, nanosec }, frame_id: String::new() },
            name: ["b", "finger", "a"].map(str::to_owned).to_vec(),
            position: vec![2.0, 9.0, 1.0],
            velocity: Vec::new(),
            effort: vec![20.0, 90.0, 10.0],
        }
    }

    #[test]
    fn joints_come_in_the_robots_order_whatever_the_messages() {
        let read = reader().read(&state(5.25), 0.0).unwrap();
        let sample = Sample::new(Some(5.25), vec![1.0, 2.0], vec![10.0, 20.0]);
        assert_eq!(read, ReadSample { sample, set_back: false });
    }

    #[test]
    fn an_unusable_message_is_refused_with_a_reason_and_the_next_one_is_read() {
        let mut reader = reader();
        let mut broken = |time_s, change: fn(&mut JointState)| {
            let mut state = state(time_s);
            change(&mut state);
            let name = reader.read(&state, 0.0).unwrap_err();
            (name.name(), name.to_string())
        };
        for (change, name, words) in [
            ((|s| s.effort.clear()) as fn(&mut JointState), "length", "0 efforts for 3 joints"),
            (|s| s.position.truncate(2), "length", "2 positions for 3 joints"),
            (|s| s.effort[0] = f64::NAN, "not finite", "effort of joint `b` is NaN"),
            (|s| s.position[2] = f64::INFINITY, "not finite", "position of joint `a` is inf"),
            (|s| s.name[2] = "c".to_owned(), "joints", "`a` is not in the log"),
        ] {
            let (found, message) = broken(1.0, change);
            assert!(found == name && message.contains(words), "{found}: {message}");
        }
        assert!(reader.read(&state(1.0), 0.0).is_ok());
        assert_eq!(reader.read(&state(1.0), 0.0).unwrap_err().name(), "duplicate");
        assert_eq!(reader.read(&state(0.5), 0.0).unwrap_err().name(), "late");
        assert!(!reader.read(&state(1.5), 0.0).unwrap().set_back);
        assert!(reader.read(&state(0.25), 0.0).unwrap().set_back);
    }

    #[test]
    fn another_arm_whose_names_would_match_is_refused_after_the_first() {
        let mut reader = reader();
        let renamed = |time_s, prefix: &str| {
            let mut state = state(time_s);
            state.name.iter_mut().for_each(|name| *name = format!("{prefix}{name}"));
            state
        };
        assert!(reader.read(&renamed(1.0, "left_"), 0.0).is_ok());
        assert_eq!(reader.other_name(), Some(("a", "left_a")));
        let refusal = reader.read(&renamed(2.0, "right_"), 0.0).unwrap_err();
        assert!(refusal.to_string().contains("`right_a`"), "{refusal}");
        let mut turned = renamed(3.0, "left_");
        turned.name.reverse();
        assert!(reader.read(&turned, 0.0).is_ok(), "another order is the same arm");
    }

    #[test]
    fn a_joint_of_the_gripper_may_be_not_finite() {
        let mut state = state(1.0);
        state.effort[1] = f64::NAN;
        assert!(reader().read(&state, 0.0).is_ok());
    }

    #[test]
    fn a_message_without_a_stamp_has_the_time_of_its_arrival() {
        let read = reader().read(&state(0.0), 7.5).unwrap();
        assert_eq!(read.sample.time_s, Some(7.5));
    }

    proptest! {
        #[test]
        fn times_of_what_is_read_grow_unless_the_clock_was_set_back(
            times in prop::collection::vec(1.0..20.0_f64, 1..50)
        ) {
            let mut reader = reader();
            let mut last_s = f64::NEG_INFINITY;
            for time_s in times {
                if let Ok(read) = reader.read(&state(time_s), 0.0) {
                    let now_s = read.sample.time_s.unwrap();
                    prop_assert!(now_s > last_s || read.set_back);
                    last_s = now_s;
                }
            }
        }
    }
}
