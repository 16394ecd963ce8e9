//! Unique names of touches.

use std::collections::HashMap;

/// The names used so far, all different.
#[derive(Debug, Default)]
pub(super) struct UniqueNames {
    given: Vec<String>,
    /// How often each name was requested.
    times: HashMap<String, u32>,
}

impl UniqueNames {
    /// Adds a name; if it was used before, a number is appended.
    pub(super) fn start(&mut self, name: &str) {
        let mut unique = name.to_owned();
        while self.times.contains_key(&unique) {
            let times = self.times.entry(name.to_owned()).or_default();
            *times += 1;
            unique = format!("{name}_{times}");
        }
        self.times.insert(unique.clone(), 1);
        self.given.push(unique);
    }

    /// The name that was added last.
    pub(super) fn latest(&self) -> &str {
        self.given.last().map_or("touch", String::as_str)
    }

    /// All names in the order in which they were added.
    pub(super) fn given(&self) -> &[String] {
        &self.given
    }
}
