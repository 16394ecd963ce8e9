//! Names of columns that hold a quantity of each joint: which quantity, which joint, and whether it was measured.

use std::sync::LazyLock;

use regex::{Regex, RegexBuilder};

use super::base;

/// How columns of one quantity are called, and arrays of all joints.
pub(in crate::log) struct Spelling {
    /// The pattern of a number behind a word; then, word by word, those of a joint's name before it and behind it. The
    /// first that fits counts.
    columns: Vec<Regex>,
    array: Regex,
}

/// Which of the patterns has numbers.
const NUMBERED: usize = 0;

/// What may stand between words.
const BETWEEN: &str = "[_./:\\- ]";
/// Words that say that a quantity was measured, in contrast to what was commanded.
const MEASURED: &str = "actual|act|measured|meas|msr|feedback|fb";
/// Words that say that a quantity was commanded.
const COMMANDED: &str =
    "des|desired|cmd|command|commanded|target|ref|reference|goal|set|setpoint|planned|ipo";

/// What stands in the place of a joint but says that the quantity was commanded: `d_1`, `cmd_elbow`, `elbow target`.
static COMMANDED_JOINT: LazyLock<Regex> = LazyLock::new(|| {
    let (opened, number) = (format!("(?:{BETWEEN}|[\\[(])"), "[\\[(]?[0-9]+[\\])]?");
    ignoring_case(&format!(
        "^(?:{COMMANDED}){opened}|^d{opened}+[0-9]+[\\])]*$|\
         {BETWEEN}(?:{COMMANDED})(?:{BETWEEN}?{number})?$"
    ))
});
/// The same without anything between the word and a number, `d1`: unless it stands beside numbers, it is a joint's name.
static COMMANDED_NUMBER: LazyLock<Regex> =
    LazyLock::new(|| ignoring_case(&format!("^(?:d|{COMMANDED})[0-9]+$")));
/// A topic, or a part of a message, of what was commanded.
static COMMANDED_TOPIC: LazyLock<Regex> = LazyLock::new(|| {
    ignoring_case(
        "(?:^|[^a-z])(?:d|des|cmd|goal|ref|set|action)(?:[^a-z]|$)|desired|command|target|reference|setpoint",
    )
});
/// One of external torques.
static EXTERNAL_TOPIC: LazyLock<Regex> =
    LazyLock::new(|| ignoring_case("(?:^|[^a-z])ext(?:[^a-z]|$)|external"));

pub(in crate::log) static POSITIONS: LazyLock<Spelling> =
    LazyLock::new(|| Spelling::new(&["positions?", "angles?", "pos", "q", "mp", r"axisqmsr_\w+?"]));
pub(in crate::log) static TORQUES: LazyLock<Spelling> = LazyLock::new(|| {
    let words = ["torques?", "efforts?", "eff", "tau(?:_?j)?", "tq", "trq", "mt"];
    let of_makers = ["actual_current_as_torque", r"axis(?:tau|torque)msr_\w+?"];
    Spelling::new(&[&words[..], &of_makers].concat())
});
pub(super) static EXTERNAL_TORQUES: LazyLock<Spelling> = LazyLock::new(|| {
    // Only Franka's, whose sign is known.
    Spelling::new(&["tau_ext_hat_filtered"])
});
/// Columns of a message that hold the joint's name in every row.
pub(super) static JOINT_NAMES: LazyLock<Spelling> = LazyLock::new(|| Spelling::new(&["names?"]));
pub(super) static CURRENTS: LazyLock<Spelling> =
    LazyLock::new(|| Spelling::new(&["(?:motor_?)?currents?", "curr", "i"]));

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

    /// Whether an array of all joints is called so. Its name may say radians, but no other unit.
    pub(in crate::log) fn is_of_array(&self, name: &str) -> bool {
        self.array.is_match(name.strip_suffix("_rad").unwrap_or(name))
    }

    /// What a name says, if it is spelt so, and its joint.
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
    /// Whether it is no joint, but says that the quantity was commanded.
    pub(super) fn is_command(&self) -> bool {
        matches!(self, Self::Name(name) if COMMANDED_JOINT.is_match(name))
    }

    /// The same of a word with a number, which can be the name of a joint as well: `d1`.
    pub(super) fn may_be_command(&self) -> bool {
        matches!(self, Self::Name(name) if COMMANDED_NUMBER.is_match(name))
    }
}

/// What a column's name says besides the joint.
#[derive(PartialEq)]
pub(super) struct Key {
    /// Which of the patterns it fits.
    kind: usize,
    /// The topic, or where in a message: what stands before the word, up to `/` or a dot.
    pub(super) topic: String,
    /// All of the word, in lower case: `joint_measured_torque`.
    word: String,
    /// What it is of that: `torque`.
    pub(super) quantity: String,
    pub(super) says_joint: bool,
    pub(super) is_measured: bool,
}

impl Key {
    pub(super) fn is_numbered(&self) -> bool {
        self.kind == NUMBERED
    }

    /// Whether its topic is one of commands.
    pub(super) fn is_command(&self) -> bool {
        COMMANDED_TOPIC.is_match(&self.topic)
    }

    /// Whether its topic is one of external torques.
    pub(super) fn is_external(&self) -> bool {
        EXTERNAL_TOPIC.is_match(&self.topic)
    }
}
