//! Pages for readers, each one HTML file that opens without a network.
//!
//! [`Report`] is that of an evaluation: [`table`] words what was found, [`data`] gathers the curves
//! for the figures, [`Scene`] the field and the arm that moves before it; its part of the page is
//! `report.html` with `report.js`. [`ExtrapolationPage`] is Fig. 4, to be turned:
//! `extrapolation.html` and `.js`. Both share the [`page`] around them (`page.html`, `report.css`,
//! `shared.js`) and how numbers are [`packed`]; plotly.js draws. Everything is inlined, and the pages
//! forbid themselves to load anything else. [`errors_csv`] is Table I touch by touch, for programs.

mod csv;
mod data;
mod extrapolation;
mod frames;
mod packed;
mod page;
mod scene;
mod table;

#[cfg(test)]
mod needs_chromium;

use palpate_learn::evaluation::Evaluation;

use crate::error::CliError;

pub(crate) use csv::errors_csv;
pub(crate) use extrapolation::ExtrapolationPage;
use page::Page;
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
    pub data: Vec<(&'static str, String)>,
    /// The field and the arm, if they are to be shown.
    pub scene: Option<Scene>,
}

impl Report<'_> {
    /// The page.
    ///
    /// # Errors
    ///
    /// If the figures cannot be packed, which no evaluation has brought about.
    pub(crate) fn html(self) -> Result<String, CliError> {
        let slots = [
            ("table", table::html(self.evaluation)),
            ("paper", table::beside_the_paper(self.evaluation)),
            ("remarks", table::remarks(self.evaluation)),
        ];
        let page = Page {
            title: self.title,
            verdict: &table::verdict(self.evaluation),
            simulated: self.simulated,
            body: page::fill(include_str!("report.html"), &slots),
            card: self.data.iter().cloned().chain(self.counted()).collect(),
            settings: ("All settings, as a settings file", self.settings_toml),
            data: data::json(self.evaluation, self.scene.as_ref())?,
            script: include_str!("report.js"),
        };
        Ok(page.html())
    }

    /// What can be counted.
    fn counted(&self) -> [(&'static str, String); 4] {
        let touches = &self.evaluation.touches;
        let names: Vec<&str> = touches.iter().map(|touch| touch.name.as_str()).collect();
        let frames: usize = touches.iter().map(|touch| touch.time_s.len()).sum();
        let against = match self.evaluation.against.as_str() {
            "truth" => "the true external torque, which only a simulation knows".to_owned(),
            "measured" => "the measured external torque, with its noise".to_owned(),
            other => other.to_owned(),
        };
        [
            ("touches", format!("{}: {}", names.len(), names.join(", "))),
            ("frames scored", frames.to_string()),
            ("joints", self.evaluation.joint_names.join(", ")),
            ("errors count against", against),
        ]
    }
}
