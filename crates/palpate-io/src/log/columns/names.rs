//! Parses names of columns that hold a quantity of one joint: which quantity, which joint, measured or commanded.

use std::sync::LazyLock;

use palpate::TorqueSign;
use regex::{Regex, RegexBuilder};

use super::base;
use crate::log::event::LoggedTorques;

/// Patterns for the names of one quantity: of columns of one joint, and of arrays of all joints.
pub(in crate::log) struct Spelling {
    /// First the pattern for a word with a joint number after it; then, for each word, the patterns for a joint name
    /// before it and after it. The first match counts.
    columns: Vec<Regex>,
    array: Regex,
}

/// Index in `Spelling::columns` of the pattern for numbered joints.
const NUMBERED: usize = 0;

/// Pattern for a separator between words.
const BETWEEN: &str = "[_./:\\- ]";
/// Words that say that a quantity was measured, in contrast to what was commanded.
const MEASURED: &str = "actual|act|measured|meas|msr|feedback|fb";
/// Words that say that a quantity was commanded.
const COMMANDED: &str =
    "des|desired|cmd|command|commanded|target|ref|reference|goal|set|setpoint|planned|ipo";

/// Matches a joint label that says that the quantity was commanded: `d_1`, `cmd_elbow`, `elbow target`.
static COMMANDED_JOINT: LazyLock<Regex> = LazyLock::new(|| {
    let (opened, number) = (format!("(?:{BETWEEN}|[\\[(])"), "[\\[(]?[0-9]+[\\])]?");
    ignoring_case(&format!(
        "^(?:{COMMANDED}){opened}|^d{opened}+[0-9]+[\\])]*$|\
         {BETWEEN}(?:{COMMANDED})(?:{BETWEEN}?{number})?$"
    ))
});
/// Matches such a label without a separator before the number, such as `d1`, which may also be the name of a joint. It
/// means a command only if the same quantity also has numbered columns.
static COMMANDED_NUMBER: LazyLock<Regex> =
    LazyLock::new(|| ignoring_case(&format!("^(?:d|{COMMANDED})[0-9]+$")));
/// Matches a topic, or a part of a message, with commanded quantities.
static COMMANDED_TOPIC: LazyLock<Regex> = LazyLock::new(|| {
    ignoring_case(
        "(?:^|[^a-z])(?:d|des|cmd|goal|ref|set|action)(?:[^a-z]|$)|desired|command|target|reference|setpoint",
    )
});
/// Matches a topic, or a part of a message, with external torques.
static EXTERNAL_TOPIC: LazyLock<Regex> =
    LazyLock::new(|| ignoring_case("(?:^|[^a-z])ext(?:[^a-z]|$)|external"));

pub(in crate::log) static POSITIONS: LazyLock<Spelling> =
    LazyLock::new(|| Spelling::new(&["positions?", "angles?", "pos", "q", "mp", r"axisqmsr_\w+?"]));
/// Kinds of torques with the names of their columns and arrays; of several kinds, the first is read.
pub(in crate::log) static TORQUES: LazyLock<[(LoggedTorques, Spelling); 5]> = LazyLock::new(|| {
    let words = ["torques?", "efforts?", "eff", "tau(?:_?j)?", "tq", "trq", "mt"];
    let of_makers = ["actual_current_as_torque", r"axis(?:tau|torque)msr_\w+?"];
    let any = words[..words.len() - 1].join("|");
    let external = [
        format!("(?:external|ext){BETWEEN}?(?:joint{BETWEEN}?)?(?:{any})"),
        format!("(?:{any}){BETWEEN}?(?:external|ext)"),
    ];
    let currents = ["(?:motor_?)?currents?", "curr", "i"];
    let of = |sign| LoggedTorques::External(sign);
    [
        (LoggedTorques::Unknown, Spelling::new(&[&words[..], &of_makers].concat())),
        (of(Some(TorqueSign::Minus)), Spelling::new(&[FRANKA])),
        (of(Some(TorqueSign::Plus)), Spelling::new(&["et", r"axistauextmsr_\w+?"])), // KUKA
        (of(None), Spelling::new(&external.each_ref().map(String::as_str))),
        (LoggedTorques::Currents, Spelling::new(&currents)),
    ]
});
/// Franka's name for external torques.
const FRANKA: &str = "tau_ext_hat_filtered";
/// Columns that contain the name of a joint in every row.
pub(super) static JOINT_NAMES: LazyLock<Spelling> = LazyLock::new(|| Spelling::new(&["names?"]));

fn ignoring_case(pattern: &str) -> Regex {
    let pattern = RegexBuilder::new(pattern).case_insensitive(true).build();
    pattern.expect("the words fit a pattern")
}

impl Spelling {
    fn new(words: &[&str]) -> Self {
        let joint = |group: &str| format!("(?:(?<{group}>joints?){BETWEEN}?)?");
        let (first, second) = (joint("joint_first"), joint("joint_second"));
        let word = |word: &&str| {
            let before = format!("(?:(?<before>{MEASURED}){BETWEEN}?)?");
            let behind = format!("(?:{BETWEEN}?(?<behind>{MEASURED}))?");
            format!("(?<word>{first}{before}{second}(?<quantity>{word}){behind})")
        };
        let any = words.join("|");
        let numbered = format!(
            r"^(?<topic>.*/|(?:[a-z]\w*\.)+)?{}{BETWEEN}*[\[(]*(?<number>[0-9]+)[\])]*(?:{BETWEEN}?(?<after>{MEASURED}))?$",
            word(&any.as_str())
        );
        let named = words.iter().flat_map(|text| {
            let word = word(text);
            [
                format!(r"^(?<topic>.*?/)??(?<joint>[^/]+?){BETWEEN}+{word}$"),
                format!(r"^(?<topic>.*/)?{word}{BETWEEN}+(?<joint>.+)$"),
            ]
        });
        let patterns = std::iter::once(numbered).chain(named);
        Self {
            columns: patterns.map(|pattern| ignoring_case(&pattern)).collect(),
            array: ignoring_case(&format!("^{}$", word(&any.as_str()))),
        }
    }

    /// Whether this is a name of an array of all joints. It may end in `_rad`, but not in another unit.
    pub(in crate::log) fn is_of_array(&self, name: &str) -> bool {
        self.array.is_match(name.strip_suffix("_rad").unwrap_or(name))
    }

    /// Parses the name of a column; `None` if it does not have this spelling.
    pub(super) fn classify(&self, name: &str) -> Option<(Key, Label)> {
        let name = base(name);
        let (kind, found) = self
            .columns
            .iter()
            .enumerate()
            .find_map(|(kind, pattern)| Some((kind, pattern.captures(name)?)))?;
        let label = match found.name("number") {
            Some(number) => Label::Number(number.as_str().parse().ok()?),
            None => Label::Name(found["joint"].to_owned()),
        };
        let text = |group: &str| found.name(group).map_or("", |text| text.as_str());
        let any = |groups: &[&str]| groups.iter().any(|group| !text(group).is_empty());
        let is_measured = any(&["before", "behind", "after"]);
        let says_joint = any(&["joint_first", "joint_second"]);
        let (topic, lower) = (text("topic").to_owned(), |group| text(group).to_ascii_lowercase());
        let (word, quantity) = (lower("word"), lower("quantity"));
        Some((Key { kind, topic, word, quantity, says_joint, is_measured }, label))
    }
}

/// The joint that a column belongs to.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Label {
    Number(u32),
    Name(String),
}

impl Label {
    /// Whether the label is no joint but says that the quantity was commanded.
    pub(super) fn is_command(&self) -> bool {
        matches!(self, Self::Name(name) if COMMANDED_JOINT.is_match(name))
    }

    /// Whether the label may mean a command, but may also be the name of a joint: `d1`.
    pub(super) fn may_be_command(&self) -> bool {
        matches!(self, Self::Name(name) if COMMANDED_NUMBER.is_match(name))
    }
}

/// The parts of a column's name other than the joint.
#[derive(PartialEq)]
pub(super) struct Key {
    /// Index of the pattern that matched.
    kind: usize,
    /// Topic or part of a message: the text before the word, up to and including `/` or a dot.
    pub(super) topic: String,
    /// The whole word, in lower case: `joint_measured_torque`.
    word: String,
    /// The part of the word that names the quantity: `torque`.
    pub(super) quantity: String,
    pub(super) says_joint: bool,
    pub(super) is_measured: bool,
}

impl Key {
    pub(super) fn is_numbered(&self) -> bool {
        self.kind == NUMBERED
    }

    /// Whether its topic is one of commanded quantities.
    pub(super) fn is_command(&self) -> bool {
        COMMANDED_TOPIC.is_match(&self.topic)
    }

    /// Kind of the torques of its topic, if the topic says it.
    pub(super) fn kind_of_topic(&self) -> Option<LoggedTorques> {
        let sign = self.topic.to_ascii_lowercase().contains(FRANKA).then_some(TorqueSign::Minus);
        EXTERNAL_TOPIC.is_match(&self.topic).then_some(LoggedTorques::External(sign))
    }
}
