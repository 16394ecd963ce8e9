//! Groups columns to families (one quantity of all joints), and pairs families of positions with families of torques.

use super::names::{Key, Label, Spelling};
use crate::log::event::LoggedTorques;

/// Largest number of families; a header with more is refused as ambiguous.
const MOST: usize = 200;

/// Columns whose names differ only in the joint.
pub(super) struct Family {
    key: Key,
    pub(super) members: Vec<(Label, usize)>,
    /// Labels of the members, sorted.
    labels: Vec<Label>,
}

/// All families of columns with this spelling; commanded quantities are included only if `commands_count`. The error is
/// the end of a message to the user.
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
                return Err(format!(
                    "more than {MOST} sets of columns look like positions and torques"
                ));
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

/// Removes the family of `q_d1` if there is `q1`. If there is not, `d1` is taken for the name of a joint.
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

    /// Kind of the torques of its topic, if the topic says it.
    pub(super) fn kind_of_topic(&self) -> Option<LoggedTorques> {
        self.key.kind_of_topic()
    }

    /// Its topic or part of a message, such as `/joint_states/` or `state.`.
    pub(super) fn topic(&self) -> &str {
        &self.key.topic
    }

    /// Whether both families have the same topic and the same joints.
    pub(super) fn stands_beside(&self, other: &Self) -> bool {
        self.topic() == other.topic() && self.labels == other.labels
    }

    /// Whether the joints are numbered consecutively from 0 or 1, without repetition.
    pub(super) fn is_gapless(&self) -> bool {
        let first = if self.labels.contains(&Label::Number(0)) { 0 } else { 1 };
        self.labels.iter().zip(first..).all(|(label, number)| *label == Label::Number(number))
    }
}

/// Pairs of families of positions and of torques with the same joints. If both families of any pair have the same
/// topic, only such pairs count. Of pairs that differ only in words such as `measured`, those with the most of them
/// count.
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

/// Why a family of positions and one of torques are no pair: the end of a message to the user.
pub(super) fn unpaired(header: &[String], q: &Family, tau: &Family) -> String {
    let columns = |own: &Family, wanted: &dyn Fn(&Label) -> bool| {
        let members = own.members.iter().filter(|(label, _)| wanted(label));
        let names: Vec<String> =
            members.map(|(_, place)| format!("`{}`", header[*place])).take(3).collect();
        names.join(", ")
    };
    let is_double =
        |own: &Family, label: &Label| own.labels.iter().filter(|other| *other == label).count() > 1;
    let parts = [
        ("no torque belongs to", columns(q, &|label| !tau.labels.contains(label))),
        ("no position belongs to", columns(tau, &|label| !q.labels.contains(label))),
        ("one joint has several columns:", columns(q, &|label| is_double(q, label))),
        ("one joint has several columns:", columns(tau, &|label| is_double(tau, label))),
    ];
    let parts = parts.iter().filter(|(_, columns)| !columns.is_empty());
    let parts: Vec<String> = parts.map(|(what, columns)| format!("{what} {columns}")).collect();
    format!("positions and torques are not of the same joints: {}", parts.join("; "))
}
