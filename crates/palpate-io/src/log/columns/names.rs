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
    is_measured_torque: bool,
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
/// Families of columns at most: of more, nobody can say which is meant.
const MOST_FAMILIES: usize = 200;

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
    Spelling { is_measured_torque: true, ..Spelling::new(&[&words[..], &of_makers].concat()) }
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
            r"^(?<prefix>.*/|(?:[a-z]\w*\.)+)?{}{BETWEEN}*[\[(]*(?<number>[0-9]+)[\])]*(?:{BETWEEN}?(?<after>{MEASURED}))?$",
            word(&any.as_str())
        );
        let named = words.iter().flat_map(|text| {
            let word = word(text);
            [
                format!(r"^(?<prefix>.*?/)??(?<joint>[^/]+?){BETWEEN}+{word}$"),
                format!(r"^(?<prefix>.*/)?{word}{BETWEEN}+(?<joint>.+)$"),
            ]
        });
        let patterns = std::iter::once(numbered).chain(named);
        Self {
            columns: patterns.map(|pattern| ignoring_case(&pattern)).collect(),
            array: ignoring_case(&format!("^{}$", word(&any.as_str()))),
            is_measured_torque: false,
        }
    }

    /// Whether an array of all joints is called so. Its name may say radians, but no other unit.
    pub(in crate::log) fn is_of_array(&self, name: &str) -> bool {
        self.array.is_match(name.strip_suffix("_rad").unwrap_or(name))
    }

    /// All families of columns whose names are spelt so, but for what was commanded, unless that is wanted. An error is
    /// half a sentence for the user.
    pub(super) fn families(
        &self,
        header: &[String],
        commands_count: bool,
    ) -> Result<Vec<Family>, String> {
        let mut families: Vec<Family> = Vec::new();
        for (place, name) in header.iter().enumerate() {
            let Some((key, label)) = self.classify(base(name)) else { continue };
            if !commands_count && is_command(&key, &label) {
                continue;
            }
            let member = (label, place);
            match families.iter().position(|family| family.key == key) {
                Some(family) => families[family].members.push(member),
                None if families.len() == MOST_FAMILIES => {
                    return Err(format!(
                        "more than {MOST_FAMILIES} sets of columns could be meant"
                    ));
                }
                None => families.push(Family { key, labels: Vec::new(), members: vec![member] }),
            }
        }
        let numbered: Vec<(String, String)> = families
            .iter()
            .filter(|family| family.is_numbered())
            .map(|family| (family.key.prefix.clone(), family.key.quantity.clone()))
            .collect();
        families.retain(|family| {
            let is_beside = |(prefix, quantity): &(String, String)| {
                *prefix == family.key.prefix && *quantity == family.key.quantity
            };
            let is_command = |(label, _): &(Label, usize)| match label {
                Label::Name(name) => COMMANDED_NUMBER.is_match(name),
                Label::Number(_) => false,
            };
            commands_count
                || !numbered.iter().any(is_beside)
                || !family.members.iter().all(is_command)
        });
        for family in &mut families {
            family.labels = family.members.iter().map(|(label, _)| label.clone()).collect();
            family.labels.sort();
        }
        Ok(families)
    }

    /// What a name shares with those of its family, and its joint.
    fn classify(&self, name: &str) -> Option<(Key, Label)> {
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
        let (prefix, lower) = (text("prefix").to_owned(), |group| text(group).to_ascii_lowercase());
        let (word, quantity) = (lower("word"), lower("quantity"));
        if self.is_measured_torque && EXTERNAL_TOPIC.is_match(&prefix) {
            return None;
        }
        Some((Key { kind, prefix, word, quantity, says_joint, is_measured }, label))
    }
}

fn is_command(key: &Key, label: &Label) -> bool {
    let of_joint = match label {
        Label::Name(name) => COMMANDED_JOINT.is_match(name),
        Label::Number(_) => false,
    };
    of_joint || COMMANDED_TOPIC.is_match(&key.prefix)
}

/// The joint that a column of a family belongs to.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Label {
    Number(u32),
    Name(String),
}

/// What the names of a family share.
#[derive(PartialEq)]
struct Key {
    /// Which of the patterns.
    kind: usize,
    /// The topic, or where in a message: what stands before the word, up to `/` or a dot.
    prefix: String,
    /// All of the word, in lower case: `joint_measured_torque`.
    word: String,
    /// What it is of that: `torque`.
    quantity: String,
    says_joint: bool,
    is_measured: bool,
}

/// Columns whose names differ only in the joint.
pub(super) struct Family {
    key: Key,
    pub(super) members: Vec<(Label, usize)>,
    /// Those of the members, sorted.
    labels: Vec<Label>,
}

impl Family {
    pub(super) fn is_numbered(&self) -> bool {
        self.key.kind == NUMBERED
    }

    /// The topic, or the part of a message, that it is of.
    pub(super) fn topic(&self) -> &str {
        &self.key.prefix
    }

    /// Whether it is of the same topic, and of the same joints.
    pub(super) fn stands_beside(&self, other: &Self) -> bool {
        self.key.prefix == other.key.prefix && self.labels == other.labels
    }

    /// Whether joints are numbered from 0 or 1 on, each once.
    pub(super) fn is_gapless(&self) -> bool {
        let first = if self.labels.contains(&Label::Number(0)) { 0 } else { 1 };
        self.labels.iter().zip(first..).all(|(label, number)| *label == Label::Number(number))
    }
}

/// Families of positions and of torques that have the same joints: if there are any of one topic, only those; and of those
/// that differ only in saying that they were measured, the ones that say so.
pub(super) fn pairs<'a>(
    positions: &'a [Family],
    torques: &'a [Family],
) -> Vec<(&'a Family, &'a Family)> {
    let all = positions.iter().flat_map(|q| torques.iter().map(move |tau| (q, tau)));
    let mut pairs: Vec<_> = all.filter(|(q, tau)| q.labels == tau.labels).collect();
    let is_of_one_topic = |(q, tau): &(&Family, &Family)| q.key.prefix == tau.key.prefix;
    if pairs.iter().any(is_of_one_topic) {
        pairs.retain(is_of_one_topic);
    }
    let what = |family: &'a Family| (&family.key.quantity, family.key.says_joint);
    let words = |(q, tau): &(&'a Family, &'a Family)| (what(q), what(tau));
    let measured = |(q, tau): &(&Family, &Family)| {
        usize::from(q.key.is_measured) + usize::from(tau.key.is_measured)
    };
    let most = |pair: &(&'a Family, &'a Family)| {
        pairs.iter().filter(|other| words(other) == words(pair)).map(measured).max()
    };
    pairs.iter().filter(|pair| Some(measured(pair)) == most(pair)).copied().collect()
}
