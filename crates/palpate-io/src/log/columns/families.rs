//! Columns that belong together: one quantity of all joints; and which positions go with which torques.

use super::names::{Key, Label, Spelling};

/// Families at most: of more, nobody can say which is meant.
const MOST: usize = 200;

/// Columns whose names differ only in the joint.
pub(super) struct Family {
    key: Key,
    pub(super) members: Vec<(Label, usize)>,
    /// Those of the members, sorted.
    labels: Vec<Label>,
}

/// All families of columns that are spelt so, but for what was commanded, unless that counts. An error is half a sentence
/// for the user.
pub(super) fn families(
    header: &[String],
    spelling: &Spelling,
    commands_count: bool,
) -> Result<Vec<Family>, String> {
    let mut families: Vec<Family> = Vec::new();
    for (place, name) in header.iter().enumerate() {
        let Some((key, label)) = spelling.classify(name) else { continue };
        if !commands_count && (key.is_command() || label.is_command()) {
            continue;
        }
        let member = (label, place);
        match families.iter().position(|family| family.key == key) {
            Some(family) => families[family].members.push(member),
            None if families.len() == MOST => {
                return Err(format!("more than {MOST} sets of columns could be meant"));
            }
            None => families.push(Family { key, labels: Vec::new(), members: vec![member] }),
        }
    }
    for family in &mut families {
        family.labels = family.members.iter().map(|(label, _)| label.clone()).collect();
        family.labels.sort();
    }
    if !commands_count {
        leave_out_numbered_commands(&mut families);
    }
    Ok(families)
}

/// Leaves out `q_d1` where there is `q1`: without it, `d1` is the name of a joint.
fn leave_out_numbered_commands(families: &mut Vec<Family>) {
    let what = |family: &Family| (family.key.topic.clone(), family.key.quantity.clone());
    let numbered: Vec<_> = families.iter().filter(|own| own.is_numbered()).map(what).collect();
    families.retain(|own| {
        !numbered.contains(&what(own)) || !own.labels.iter().all(Label::may_be_command)
    });
}

impl Family {
    pub(super) fn is_numbered(&self) -> bool {
        self.key.is_numbered()
    }

    /// Whether it is of a topic of external torques.
    pub(super) fn is_external(&self) -> bool {
        self.key.is_external()
    }

    /// The topic, or the part of a message, that it is of.
    pub(super) fn topic(&self) -> &str {
        &self.key.topic
    }

    /// Whether it is of the same topic, and of the same joints.
    pub(super) fn stands_beside(&self, other: &Self) -> bool {
        self.topic() == other.topic() && self.labels == other.labels
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
    let is_of_one_topic = |(q, tau): &(&Family, &Family)| q.topic() == tau.topic();
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
