//! What looks wrong: the evidence, and what to do about it.

use serde::Serialize;

use super::words::listed;

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Learning goes on as meant, and could teach more.
    Note,
    /// Learning would go on, but probably not as meant.
    Warning,
    /// Learning would refuse it.
    Error,
}

/// One thing that looks wrong.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub level: Level,
    /// A name for programs, which stays when the words change.
    pub code: &'static str,
    /// What was seen, with numbers.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
    /// The touches that show it, if not all do.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub touches: Vec<String>,
    /// The joints or links that show it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<String>,
    /// Flags of `palpate map` and `predict` that would set it right.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flags: Vec<String>,
}

impl Finding {
    /// In one line: what looks wrong with `log`, and the flags that would set it right.
    pub fn line(&self, log: &str) -> String {
        let Self { code, what, flags, .. } = self;
        let remedy = match flags.is_empty() {
            true => String::new(),
            false => format!("; try {}", flags.join(" ")),
        };
        format!("{log} looks wrong ({code}): {what}{remedy}")
    }

    /// A warning of what happens at some places, each in a touch; `None` if there are none.
    ///
    /// `what` takes how often it happens, and the places in words.
    pub(super) fn at_places(
        code: &'static str,
        places: &[(&str, String)],
        what: impl FnOnce(usize, String) -> String,
        remedy: &str,
    ) -> Option<Self> {
        let (mut touches, rows): (Vec<&str>, Vec<&str>) =
            places.iter().map(|(touch, row)| (*touch, row.as_str())).unzip();
        touches.dedup();
        (!places.is_empty()).then(|| {
            Self::warning(code, what(places.len(), listed(&rows)), remedy).in_touches(&touches)
        })
    }

    /// A warning of some joints or links, each in words; `None` if there are none. `what` ends before
    /// them.
    pub(super) fn of_parts(
        code: &'static str,
        parts: &[(&str, String)],
        what: &str,
        remedy: &str,
    ) -> Option<Self> {
        let (names, texts): (Vec<&str>, Vec<&str>) =
            parts.iter().map(|(name, text)| (*name, text.as_str())).unzip();
        let what = || format!("{what}: {}", listed(&texts));
        (!parts.is_empty()).then(|| Self::warning(code, what(), remedy).at(&names))
    }

    /// Something that learning takes, but probably not as meant.
    pub(super) fn warning(
        code: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (what, remedy) = (what.into(), remedy.into());
        let (touches, parts, flags) = (Vec::new(), Vec::new(), Vec::new());
        Self { level: Level::Warning, code, what, remedy, touches, parts, flags }
    }

    /// The same, but nothing is wrong: it could teach more.
    pub(super) fn noted(self) -> Self {
        Self { level: Level::Note, ..self }
    }

    /// Something that learning refuses.
    pub(super) fn error(
        code: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::warning(code, what, remedy).refused()
    }

    /// The same, but learning refuses it.
    pub(super) fn refused(self) -> Self {
        Self { level: Level::Error, ..self }
    }

    /// The same, seen in these touches.
    pub(super) fn in_touches(self, touches: &[&str]) -> Self {
        Self { touches: touches.iter().map(ToString::to_string).collect(), ..self }
    }

    /// The same, seen at these joints or links.
    pub(super) fn at(self, parts: &[&str]) -> Self {
        Self { parts: parts.iter().map(ToString::to_string).collect(), ..self }
    }

    /// The same, with flags that would set it right.
    pub(super) fn try_flags(self, flags: &[impl ToString]) -> Self {
        Self { flags: flags.iter().map(ToString::to_string).collect(), ..self }
    }
}
