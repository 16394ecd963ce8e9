//! What looks wrong: the evidence, and what to do about it.

use serde::Serialize;

use super::words::listed;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Learning works as intended, and could be improved.
    Note,
    /// Learning works, but probably not as intended.
    Warning,
    /// Learning refuses the input.
    Error,
}

/// A thing that looks wrong.
#[derive(Debug, Clone, Serialize)]
pub struct Finding {
    /// Severity.
    pub level: Level,
    /// A name for programs, which does not change with the wording.
    pub code: &'static str,
    /// What was seen, with numbers.
    pub what: String,
    /// What to do about it.
    pub remedy: String,
    /// Names of the touches that show it; may be empty if all do.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub touches: Vec<String>,
    /// The joints or links that show it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<String>,
    /// Flags of `palpate map` and `predict` that would correct it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flags: Vec<String>,
}

impl Finding {
    /// In one line: what looks wrong with `log`, and the flags that would correct it.
    pub fn line(&self, log: &str) -> String {
        let Self { code, what, flags, .. } = self;
        let remedy = match flags.is_empty() {
            true => String::new(),
            false => format!("; try {}", flags.join(" ")),
        };
        format!("{log} looks wrong ({code}): {what}{remedy}")
    }

    /// A warning about some places, each with the name of its touch; `None` if there are none.
    ///
    /// `what` makes the message from the number of places and a list of them.
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

    /// A warning about some joints or links, each with its name and text; `None` if there are none. The message is
    /// `what`, followed by the texts.
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

    /// A finding of level [`Level::Warning`].
    pub(super) fn warning(
        code: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        let (what, remedy) = (what.into(), remedy.into());
        let (touches, parts, flags) = (Vec::new(), Vec::new(), Vec::new());
        Self { level: Level::Warning, code, what, remedy, touches, parts, flags }
    }

    /// The same finding as a note.
    pub(super) fn noted(self) -> Self {
        Self { level: Level::Note, ..self }
    }

    /// A finding of level [`Level::Error`].
    pub(super) fn error(
        code: &'static str,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::warning(code, what, remedy).refused()
    }

    /// The same finding as an error.
    pub(super) fn refused(self) -> Self {
        Self { level: Level::Error, ..self }
    }

    /// The same finding, shown by these touches.
    pub(super) fn in_touches(self, touches: &[&str]) -> Self {
        Self { touches: touches.iter().map(ToString::to_string).collect(), ..self }
    }

    /// The same finding, shown by these joints or links.
    pub(super) fn at(self, parts: &[&str]) -> Self {
        Self { parts: parts.iter().map(ToString::to_string).collect(), ..self }
    }

    /// The same finding, with flags that would correct it.
    pub(super) fn try_flags(self, flags: &[impl ToString]) -> Self {
        Self { flags: flags.iter().map(ToString::to_string).collect(), ..self }
    }
}
