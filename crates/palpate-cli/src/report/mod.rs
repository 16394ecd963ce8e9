//! HTML pages, each a single file that opens without a network.
//!
//! [`Report`] is the page of an evaluation: [`table`] has its table and sentences, [`data`] the
//! curves of the figures, [`Scene`] the field and the moving arm; its template is `report.html`
//! with `report.js`. [`ExtrapolationPage`] is an interactive Fig. 4: `extrapolation.html` and
//! `.js`. Both share the [`page`] around them (`page.html`, `report.css`, `shared.js`) and the
//! number formats of [`packed`]; plotly.js draws. The HTML files are templates of askama, which
//! escapes all text that is not marked as safe. Everything is inlined, and the content security
//! policy of the pages forbids loading anything else. [`errors_csv`] is Table I for each touch, as
//! CSV.

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
    /// The evaluation that is shown.
    pub(crate) evaluation: &'a Evaluation,
    /// The field and the arm, if they are shown.
    pub(crate) scene: Option<Scene>,
}

impl Report<'_> {
    /// The JSON data of the figures.
    fn data(&self) -> Data<'_> {
        Data::of(self.evaluation, self.scene.as_ref())
    }

    /// Number of frames of all touches.
    fn frames(&self) -> usize {
        self.evaluation.touches.iter().map(|touch| touch.time_s.len()).sum()
    }
}
