//! Pages for readers, each one HTML file that opens without a network.
//!
//! [`Report`] is that of an evaluation: [`table`] words what was found, [`data`] gathers the curves
//! for the figures, [`Scene`] the field and the arm that moves before it; the page itself is
//! `report.html` with `report.css` and `report.js`. [`ExtrapolationPage`] is Fig. 4, to be turned:
//! `extrapolation.html` and `.js`. Both share `shared.js` and how numbers are [`packed`]; plotly.js
//! draws. Everything is inlined, and the pages forbid themselves to load anything else.
//! [`errors_csv`] is Table I touch by touch, for programs.

mod csv;
mod data;
mod extrapolation;
mod packed;
mod page;
mod scene;
mod table;

#[cfg(test)]
pub(crate) mod example;
#[cfg(test)]
mod needs_chromium;

use palpate_learn::evaluation::Evaluation;

use crate::error::CliError;

pub(crate) use csv::errors_csv;
pub(crate) use extrapolation::ExtrapolationPage;
pub(crate) use scene::Scene;

/// What a report tells.
pub(crate) struct Report<'a> {
    /// What was evaluated.
    pub title: &'a str,
    /// What was found.
    pub evaluation: &'a Evaluation,
    /// Whether the touches come from a simulator, which the page then says.
    pub simulated: bool,
    /// All settings, as a settings file.
    pub settings_toml: &'a str,
    /// Where the data come from: logs, robot; a name and a text each.
    pub data: &'a [(String, String)],
    /// The field and the arm, if they are to be shown.
    pub scene: Option<Scene>,
}

impl Report<'_> {
    /// The page.
    ///
    /// # Errors
    ///
    /// If the figures cannot be packed, which no evaluation has brought about.
    pub(crate) fn html(&self) -> Result<String, CliError> {
        let blob = data::json(self.evaluation, self.scene.as_ref())?;
        let simulated = if self.simulated { "<p>The touches are simulated.</p>" } else { "" };
        let slots = [
            ("title", page::escaped(self.title)),
            ("style", include_str!("report.css").to_owned()),
            ("verdict", page::escaped(&table::verdict(self.evaluation))),
            ("simulated", simulated.to_owned()),
            ("table", table::html(self.evaluation)),
            ("paper", table::beside_the_paper(self.evaluation)),
            ("remarks", table::remarks(self.evaluation)),
            ("card", page::card(&self.card())),
            ("settings", page::escaped(self.settings_toml)),
            ("plotly", page::plotly_js()),
            ("data", blob),
            ("script", [page::SHARED_JS, include_str!("report.js")].concat()),
        ];
        Ok(page::fill(include_str!("report.html"), &slots))
    }

    /// The data card: what the caller says, what can be counted, and versions.
    fn card(&self) -> Vec<(String, String)> {
        let touches = &self.evaluation.touches;
        let names: Vec<&str> = touches.iter().map(|touch| touch.name.as_str()).collect();
        let frames: usize = touches.iter().map(|touch| touch.time_s.len()).sum();
        let against = match self.evaluation.against.as_str() {
            "truth" => "the true external torque, which only a simulation knows".to_owned(),
            "measured" => "the measured external torque, with its noise".to_owned(),
            other => other.to_owned(),
        };
        let counted = [
            ("touches", format!("{}: {}", names.len(), names.join(", "))),
            ("frames scored", frames.to_string()),
            ("joints", self.evaluation.joint_names.join(", ")),
            ("errors count against", against),
            ("palpate", env!("CARGO_PKG_VERSION").to_owned()),
            ("plotly.js", page::plotly_version()),
        ];
        let counted = counted.map(|(name, text)| (name.to_owned(), text));
        self.data.iter().cloned().chain(counted).collect()
    }
}
