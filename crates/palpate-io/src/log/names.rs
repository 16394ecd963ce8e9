//! Names of touches, no two of which are the same.

use std::collections::HashSet;

/// Names that differ.
#[derive(Debug, Default)]
pub(super) struct Names {
    given: Vec<String>,
    taken: HashSet<String>,
}

impl Names {
    /// Gives a name, with a number behind it if it was given before.
    pub(super) fn start(&mut self, name: &str) {
        let mut unique = name.to_owned();
        let mut times = 1;
        while !self.taken.insert(unique.clone()) {
            times += 1;
            unique = format!("{name}_{times}");
        }
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
