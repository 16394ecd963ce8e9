//! Names of columns that hold a quantity of each joint: which quantity, which joint, and whether it was measured.

use std::sync::LazyLock;

use regex::{Regex, RegexBuilder};

use super::base;

/// How columns of one quantity are called: the patterns of a number behind a word, and for each of its words that of a
/// joint's name before and behind it. Of two words in a name, the first in the list counts.
pub(super) struct Spelling(Vec<Regex>);

/// Which of the patterns has numbers.
const NUMBERED: usize = 0;

/// What may stand between words.
const BETWEEN: &str = "[_./:\\- ]";
/// Words that say that a quantity was measured, in contrast to what was commanded.
const MEASURED: &str = "actual|act|measured|meas|msr|feedback|fb";
/// Words that say of a quantity that it was commanded. What they name is no joint.
static COMMANDED: LazyLock<Regex> = LazyLock::new(|| {
    let words =
        "d|des|desired|cmd|command|commanded|target|ref|reference|goal|set|setpoint|planned|ipo";
    ignoring_case(&format!(
        "^(?:{words})(?:{BETWEEN}.*|[0-9]*)$|{BETWEEN}(?:{words}){BETWEEN}?[0-9]*$"
    ))
});

pub(super) static POSITIONS: LazyLock<Spelling> =
    LazyLock::new(|| Spelling::new(&["positions?", "angles?", "pos", "q", "mp", r"axisqmsr_\w+?"]));
pub(super) static TORQUES: LazyLock<Spelling> = LazyLock::new(|| {
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
        let joint = format!("(?:joints?{BETWEEN}?)?");
        let word = |word: &&str| {
            let before = format!("(?:(?<before>{MEASURED}){BETWEEN}?)?");
            let behind = format!("(?:{BETWEEN}?(?<behind>{MEASURED}))?");
            format!("(?<word>{joint}{before}{joint}(?:{word}){behind})")
        };
        let any = words.join("|");
        let numbered = format!(
            r"^(?<prefix>.*/|(?:[a-z]\w*\.)+)?{}{BETWEEN}*[\[(]*(?<number>[0-9]+)[\])]*$",
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
        Self(patterns.map(|pattern| ignoring_case(&pattern)).collect())
    }

    /// All families of columns whose names are spelt so.
    pub(super) fn families(&self, header: &[String]) -> Vec<Family> {
        let mut families: Vec<Family> = Vec::new();
        for (place, name) in header.iter().enumerate() {
            let Some((key, label)) = self.classify(base(name)) else { continue };
            match families.iter_mut().find(|family| family.key == key) {
                Some(family) => family.members.push((label, place)),
                None => families.push(Family { key, members: vec![(label, place)] }),
            }
        }
        families
    }

    /// What a name shares with those of its family, and its joint.
    fn classify(&self, name: &str) -> Option<(Key, Label)> {
        let (kind, found) = self
            .0
            .iter()
            .enumerate()
            .find_map(|(kind, pattern)| Some((kind, pattern.captures(name)?)))?;
        let label = match found.name("number") {
            Some(number) => Label::Number(number.as_str().parse().ok()?),
            None if COMMANDED.is_match(&found["joint"]) => return None,
            None => Label::Name(found["joint"].to_owned()),
        };
        let text = |group: &str| found.name(group).map_or("", |text| text.as_str());
        let key = Key {
            kind,
            prefix: text("prefix").to_owned(),
            word: text("word").to_ascii_lowercase(),
            is_measured: !text("before").is_empty() || !text("behind").is_empty(),
        };
        Some((key, label))
    }
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
    /// The word, in lower case.
    word: String,
    is_measured: bool,
}

/// Columns whose names differ only in the joint.
pub(super) struct Family {
    key: Key,
    pub(super) members: Vec<(Label, usize)>,
}

impl Family {
    pub(super) fn is_numbered(&self) -> bool {
        self.key.kind == NUMBERED
    }

    /// Whether it is of the same topic, and of the same joints.
    pub(super) fn stands_beside(&self, other: &Self) -> bool {
        self.key.prefix == other.key.prefix && self.labels() == other.labels()
    }

    pub(super) fn labels(&self) -> Vec<&Label> {
        let mut labels: Vec<&Label> = self.members.iter().map(|(label, _)| label).collect();
        labels.sort();
        labels
    }
}

/// Families of positions and of torques that have the same joints. Of several, those of one topic; of several of
/// these, those that say that they were measured.
pub(super) fn pairs<'a>(
    positions: &'a [Family],
    torques: &'a [Family],
) -> Vec<(&'a Family, &'a Family)> {
    let all = positions.iter().flat_map(|q| torques.iter().map(move |tau| (q, tau)));
    let mut pairs: Vec<_> = all.filter(|(q, tau)| q.labels() == tau.labels()).collect();
    let is_of_one_topic = |(q, tau): &(&Family, &Family)| q.key.prefix == tau.key.prefix;
    if pairs.iter().any(is_of_one_topic) {
        pairs.retain(is_of_one_topic);
    }
    let measured = |(q, tau): &(&Family, &Family)| {
        usize::from(q.key.is_measured) + usize::from(tau.key.is_measured)
    };
    let most = pairs.iter().map(measured).max();
    pairs.retain(|pair| Some(measured(pair)) == most);
    pairs
}
