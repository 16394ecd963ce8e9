//! Names of touches, no two of which are the same.

use std::collections::HashMap;

/// Names that differ.
#[derive(Debug, Default)]
pub(super) struct Names {
    given: Vec<String>,
    /// How often each name was asked for.
    times: HashMap<String, u32>,
}

impl Names {
    /// Gives a name, with a number behind it if it was given before.
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

    /// The name that was given last.
    pub(super) fn latest(&self) -> &str {
        self.given.last().map_or("touch", String::as_str)
    }

    /// All names in their order.
    pub(super) fn given(&self) -> &[String] {
        &self.given
    }
}
