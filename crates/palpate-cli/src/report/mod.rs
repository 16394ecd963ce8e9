//! Pages for readers, each one HTML file that opens without a network.
//!
//! [`Report`] is that of an evaluation: [`table`] words what was found, [`data`] gathers the curves
//! for the figures, [`Scene`] the field and the arm that moves before it; its part of the page is
//! `report.html` with `report.js`. [`ExtrapolationPage`] is Fig. 4, to be turned:
//! `extrapolation.html` and `.js`. Both share the [`page`] around them (`page.html`, `report.css`,
//! `shared.js`) and how numbers are [`packed`]; plotly.js draws. The HTML are templates of askama,
//! which makes all text safe that is not marked as such. Everything is inlined, and the pages
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

use askama::Template;
use palpate_learn::evaluation::Evaluation;

pub(crate) use csv::errors_csv;
use data::Data;
pub(crate) use extrapolation::ExtrapolationPage;
pub(crate) use page::Page;
pub(crate) use scene::Scene;

/// The page of an evaluation.
#[derive(Template)]
#[template(path = "report.html")]
pub(crate) struct Report<'a> {
    pub(crate) page: Page<'a>,
    /// What was found.
    pub(crate) evaluation: &'a Evaluation,
    /// The field and the arm, if they are to be shown.
    pub(crate) scene: Option<Scene>,
}

impl Report<'_> {
    /// What is drawn.
    fn data(&self) -> Data<'_> {
        Data::of(self.evaluation, self.scene.as_ref())
    }

    /// Frames of all touches.
    fn frames(&self) -> usize {
        self.evaluation.touches.iter().map(|touch| touch.time_s.len()).sum()
    }
}
