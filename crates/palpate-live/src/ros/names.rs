//! Names of the node and its topics, with the remapping rules of ROS.

use serde::{Deserialize, Serialize};

/// Topics that palpate publishes and services that it offers.
const OWN: [&str; 14] = [
    "/palpate/torque_external",
    "/palpate/torque_predicted",
    "/palpate/torque_std",
    "/palpate/touched",
    "/palpate/contacts",
    "/palpate/field",
    "/palpate/wrench",
    "/palpate/stop",
    "/palpate/guard",
    "/palpate/tare",
    "/palpate/reset",
    "/palpate/save",
    "/palpate/ask",
    "/diagnostics",
];
/// Other topics that palpate uses.
const OTHERS: [&str; 4] =
    ["/joint_states", "/robot_description", "/clock", "/trajectory_execution_event"];

/// Name and namespace of the node, and remapping rules.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct TopicNames {
    /// Name of the node.
    pub(super) node: String,
    /// Prefix of the names of palpate's own topics; empty, or begins with a slash.
    pub(super) namespace: String,
    /// Pairs of absolute names: from, to.
    rules: Vec<(String, String)>,
}

impl Default for TopicNames {
    fn default() -> Self {
        Self { node: "palpate".to_owned(), namespace: String::new(), rules: Vec::new() }
    }
}

impl TopicNames {
    /// Parses rules such as `/palpate/stop:=/arm/stop`, `__node:=left_hand` and `__ns:=/left`.
    ///
    /// # Errors
    ///
    /// Names the rule that cannot be applied, and what is expected.
    pub fn new(rules: &[String]) -> Result<Self, String> {
        let mut names = Self::default();
        let mut topics = Vec::new();
        for rule in rules {
            let parts =
                rule.split_once(":=").filter(|(from, to)| !from.is_empty() && !to.is_empty());
            let Some((from, to)) = parts else {
                return Err(format!(
                    "`{rule}` does not say which name becomes which; wanted FROM:=TO, such as \
                     /palpate/stop:=/arm/stop, __node:=NAME or __ns:=/NAMESPACE"
                ));
            };
            match from {
                "__node" | "__name" => names.node = to.to_owned(),
                "__ns" if to.starts_with('/') => {
                    names.namespace = to.trim_end_matches('/').to_owned();
                }
                "__ns" => return Err(format!("`{rule}`: a namespace begins with `/`")),
                _ => topics.push((rule, from, to)),
            }
        }
        for (rule, from, to) in topics {
            let from = match from.strip_prefix("~/") {
                Some(own) => names.in_namespace(&format!("palpate/{own}")),
                None => names.absolute(from),
            };
            let known = OWN.iter().chain(&OTHERS).map(|name| names.of_palpate(name));
            if !known.clone().any(|name| name == from) {
                let known: Vec<String> = known.collect();
                return Err(format!(
                    "`{rule}`: palpate has no name `{from}`; it has {}",
                    known.join(", ")
                ));
            }
            names.rules.push((from, names.absolute(to)));
        }
        Ok(names)
    }

    /// The absolute form of a name.
    fn absolute(&self, name: &str) -> String {
        match (name.strip_prefix("~/"), name.starts_with('/')) {
            (Some(own), _) => self.in_namespace(&format!("{}/{own}", self.node)),
            (None, true) => name.to_owned(),
            (None, false) => self.in_namespace(name),
        }
    }

    fn in_namespace(&self, name: &str) -> String {
        format!("{}/{name}", self.namespace)
    }

    /// The absolute name of a topic or service before the rules, with the namespace if it is palpate's own.
    fn of_palpate(&self, name: &str) -> String {
        match name.strip_prefix('/') {
            Some(relative) if name.starts_with("/palpate/") => self.in_namespace(relative),
            _ => name.to_owned(),
        }
    }

    /// The final name of a topic or service.
    pub fn of(&self, name: &str) -> String {
        self.renamed(name).unwrap_or_else(|| self.of_palpate(name))
    }

    /// The name given to a topic or service by a rule, if there is one for it.
    pub fn renamed(&self, name: &str) -> Option<String> {
        let name = self.of_palpate(name);
        let rule = self.rules.iter().find(|(from, _)| *from == name);
        rule.map(|(_, to)| to.clone())
    }

    /// Whether a topic is published by palpate, this instance or another, and not by a robot.
    pub(super) fn are_own(&self, topic: &str) -> bool {
        OWN.iter().any(|own| topic.ends_with(own) || self.of(own) == topic)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(rules: &[&str]) -> Result<TopicNames, String> {
        TopicNames::new(&rules.iter().map(|&rule| rule.to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn own_names_are_in_the_namespace_and_rules_come_after() {
        let names = names(&[
            "__ns:=/left",
            "__node:=hand",
            "palpate/stop:=/safety/stop",
            "~/guard:=~/why",
            "/diagnostics:=diag",
        ]);
        let names = names.unwrap();
        for (name, wanted) in [
            ("/palpate/stop", "/safety/stop"),
            ("/palpate/guard", "/left/hand/why"),
            ("/palpate/field", "/left/palpate/field"),
            ("/diagnostics", "/left/diag"),
            ("/joint_states", "/joint_states"),
        ] {
            assert_eq!(names.of(name), wanted);
        }
        assert_eq!((&*names.node, &*names.namespace), ("hand", "/left"));
        assert!(names.are_own("/safety/stop") && names.are_own("/right/palpate/torque_external"));
        assert!(names.are_own("/left/diag") && !names.are_own("/lab/palpate/joint_states"));
        assert_eq!(names.renamed("/joint_states"), None);
        assert_eq!(TopicNames::default().of("/palpate/stop"), "/palpate/stop");
    }

    #[test]
    fn a_rule_that_cannot_be_followed_is_reported_with_what_is_wanted() {
        for rule in ["/a", "/a:=", ":=/b", "__ns:=left", "/palpate/stpo:=/stop"] {
            let error = names(&[rule]).unwrap_err();
            assert!(error.contains(rule) && error.contains('/'), "{error}");
        }
        assert!(
            names(&["/palpate/stpo:=/stop"]).unwrap_err().contains("it has /palpate/torque_ext")
        );
        let arm = names(&["/joint_states:=/arm/joint_states"]).unwrap();
        assert_eq!(arm.of("/joint_states"), "/arm/joint_states");
    }
}
