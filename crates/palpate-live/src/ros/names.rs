//! Names of the node and its topics, remapped as ROS does.

use serde::{Deserialize, Serialize};

/// palpate's own topics and services, which it does not listen to.
const OWN: &str = "/palpate/";

/// Rules by which names change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Names {
    /// The node's.
    pub(super) node: String,
    /// Before the names of palpate's own topics; empty, or begins with a slash.
    pub(super) namespace: String,
    /// From which to which.
    rules: Vec<(String, String)>,
}

impl Default for Names {
    fn default() -> Self {
        Self { node: "palpate".to_owned(), namespace: String::new(), rules: Vec::new() }
    }
}

impl Names {
    /// Rules such as `/palpate/stop:=/arm/stop`, `__node:=left_hand` and `__ns:=/left`.
    ///
    /// # Errors
    ///
    /// Which rule is none, and what is wanted.
    pub fn new(rules: &[String]) -> Result<Self, String> {
        let mut names = Self::default();
        let mut topics = Vec::new();
        for rule in rules {
            let parts =
                rule.split_once(":=").filter(|(from, to)| !from.is_empty() && !to.is_empty());
            let Some((from, to)) = parts else {
                return Err(format!(
                    "`{rule}` is no rule; wanted FROM:=TO, such as /palpate/stop:=/arm/stop, __node:=NAME or \
                     __ns:=/NAMESPACE"
                ));
            };
            match from {
                "__node" | "__name" => names.node = to.to_owned(),
                "__ns" if to.starts_with('/') => {
                    names.namespace = to.trim_end_matches('/').to_owned()
                }
                "__ns" => return Err(format!("`{rule}`: a namespace begins with `/`")),
                _ => topics.push((from, to)),
            }
        }
        names.rules = topics
            .into_iter()
            .map(|(from, to)| (names.absolute(from), names.absolute(to)))
            .collect();
        Ok(names)
    }

    /// A name in the node's namespace, unless it is absolute.
    fn absolute(&self, name: &str) -> String {
        match name.starts_with('/') {
            true => name.to_owned(),
            false => format!("{}/{name}", self.namespace),
        }
    }

    /// What a topic or service of palpate's is called.
    pub fn of(&self, name: &str) -> String {
        let name = match name.strip_prefix('/') {
            Some(relative) if name.starts_with(OWN) => self.absolute(relative),
            _ => name.to_owned(),
        };
        let rule = self.rules.iter().find(|(from, _)| *from == name);
        rule.map_or(name, |(_, to)| to.clone())
    }

    /// Whether palpate publishes on a topic, this one or another, so that it is no robot's.
    pub(super) fn are_own(&self, topic: &str) -> bool {
        let is_ours = |(from, to): &(String, String)| to == topic && from.contains(OWN);
        topic.contains(OWN) || self.rules.iter().any(is_ours)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(rules: &[&str]) -> Result<Names, String> {
        Names::new(&rules.iter().map(|&rule| rule.to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn own_names_are_in_the_namespace_and_rules_come_after() {
        let names = names(&[
            "__ns:=/left",
            "__node:=hand",
            "palpate/stop:=/safety/stop",
            "/diagnostics:=diag",
        ]);
        let names = names.unwrap();
        for (name, wanted) in [
            ("/palpate/stop", "/safety/stop"),
            ("/palpate/field", "/left/palpate/field"),
            ("/diagnostics", "/left/diag"),
            ("/joint_states", "/joint_states"),
        ] {
            assert_eq!(names.of(name), wanted);
        }
        assert_eq!((&*names.node, &*names.namespace), ("hand", "/left"));
        assert!(names.are_own("/safety/stop") && names.are_own("/right/palpate/torque_external"));
        assert!(!names.are_own("/left/diag") && !names.are_own("/joint_states"));
        assert_eq!(Names::default().of("/palpate/stop"), "/palpate/stop");
    }

    #[test]
    fn what_is_no_rule_is_told_with_what_is_wanted() {
        for rule in ["/a", "/a:=", ":=/b", "__ns:=left"] {
            let error = names(&[rule]).unwrap_err();
            assert!(error.contains(rule) && error.contains('/'), "{error}");
        }
    }
}
