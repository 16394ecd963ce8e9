//! The page of an extrapolation: Fig. 4, to be turned, beside its figures and settings.

use std::fmt::Write;

use serde::Serialize;

use super::packed::{self, PER_METRE, PER_ONE, four_digits};
use super::page::{Page, escaped};
use super::scene::Scene;
use crate::error::CliError;
use crate::extrapolation_view::{ExtrapolationView, Table, reached_by};
use crate::picture;

/// Points of the cloud that are drawn, at most: with more, a browser turns them slowly.
const POINTS: usize = 30_000;
/// Part of the cloud that is beyond the colours of the uncertainty.
const BEYOND: f64 = 0.02;

/// What the page tells.
pub(crate) struct ExtrapolationPage<'a> {
    pub(crate) title: &'a str,
    /// What was found, as one sentence without its full stop.
    pub(crate) verdict: &'a str,
    /// Whether the touches come from a simulator, which the page then says.
    pub(crate) simulated: bool,
    pub(crate) seen: &'a ExtrapolationView<'a>,
    pub(crate) tables: &'a [Table],
    /// Where the data come from; a name and a text each.
    pub(crate) data: Vec<(&'static str, String)>,
    /// The settings of the extrapolation, as TOML.
    pub(crate) settings_toml: &'a str,
}

#[derive(Serialize)]
struct Data {
    per_metre: f64,
    per_one: f64,
    /// The threshold at first, N/m.
    threshold: f64,
    /// Stiffness at the ends of the colours, N/m.
    range: [f64; 2],
    /// Where one looks from at first.
    eye: [f64; 3],
    scene: Scene,
    cloud: Cloud,
}

/// The points of the cloud that are drawn.
#[derive(Serialize)]
struct Cloud {
    /// Points of the whole cloud.
    all: usize,
    /// x, y, z in turn.
    points: Vec<i64>,
    /// Six hexadecimal digits each, one text for all.
    colours: String,
    /// N/m.
    stiffness: Vec<f64>,
    std: Vec<f64>,
    /// What is on top of the colour bar of the latter, N/m.
    std_top: f64,
    /// `1` or `0` each, one text for all.
    touched: String,
}

impl ExtrapolationPage<'_> {
    /// The page.
    ///
    /// # Errors
    ///
    /// If the joint positions are not the arm's.
    pub(crate) fn html(self) -> Result<String, CliError> {
        let data = Data {
            per_metre: PER_METRE,
            per_one: PER_ONE,
            threshold: self.seen.threshold_n_per_m(),
            range: self.seen.colour_range_n_per_m(),
            eye: picture::View::of(&self.seen.middle()).towards().into(),
            scene: Scene::seen(self.seen)?,
            cloud: Cloud::of(self.seen),
        };
        let tables: String = self.tables.iter().enumerate().map(table).collect();
        let page = Page {
            title: self.title,
            verdict: self.verdict,
            simulated: self.simulated,
            body: format!("{}\n{tables}", include_str!("extrapolation.html")),
            card: self.data,
            settings: ("Settings of the extrapolation", self.settings_toml),
            data: packed::script(&data)?,
            script: include_str!("extrapolation.js"),
        };
        Ok(page.html())
    }
}

impl Cloud {
    fn of(seen: &ExtrapolationView<'_>) -> Self {
        let all = seen.points.len();
        let drawn = || (0..all.min(POINTS)).map(|n| n * all / all.min(POINTS));
        let colour = |at: usize| {
            let [red, green, blue] = seen.colours[at];
            format!("{red:02x}{green:02x}{blue:02x}")
        };
        let digits = |of: &[f64]| drawn().map(|at| four_digits(of[at])).collect();
        let std_top = reached_by(seen.std_n_per_m.iter().copied(), BEYOND);
        Self {
            all,
            points: drawn().flat_map(|at| packed::tenths(&seen.points[at])).collect(),
            colours: drawn().map(colour).collect(),
            stiffness: digits(seen.stiffness_n_per_m),
            std: digits(seen.std_n_per_m),
            std_top: four_digits(std_top.max(1e-6)),
            touched: drawn().map(|at| if seen.touched[at] { '1' } else { '0' }).collect(),
        }
    }
}

/// A section with a table; `at` gives it a name of its own.
fn table((at, table): (usize, &Table)) -> String {
    let mut html = format!(
        "<section aria-labelledby=\"table-{at}\">\n<h2 id=\"table-{at}\">{}</h2>\n<div \
         class=\"scroll\" tabindex=\"0\" role=\"region\" aria-labelledby=\"table-{at}\">\n<table>\n\
         <thead><tr>",
        escaped(&table.title)
    );
    for name in &table.head {
        let _ = write!(html, "<th scope=\"col\">{}</th>", escaped(name));
    }
    html += "</tr></thead>\n<tbody>\n";
    for row in &table.rows {
        html += "<tr>";
        for (column, text) in row.iter().enumerate() {
            let text = escaped(text);
            let _ = match column {
                0 => write!(html, "<th scope=\"row\">{text}</th>"),
                _ => write!(html, "<td>{text}</td>"),
            };
        }
        html += "</tr>\n";
    }
    html += "</tbody>\n</table>\n</div>\n";
    if !table.caption.is_empty() {
        let _ = writeln!(html, "<p class=\"caption\">{}</p>", escaped(&table.caption));
    }
    html + "</section>\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrapolation_view::tests::Example;

    #[test]
    fn a_large_cloud_is_thinned_evenly() {
        let cloud = |points| Cloud::of(&Example::new(0, points).seen());
        assert_eq!(cloud(1_000).stiffness.len(), 1_000);
        let thinned = cloud(100_000);
        assert_eq!((thinned.all, thinned.stiffness.len()), (100_000, POINTS));
        assert_eq!((thinned.points.len(), thinned.colours.len()), (3 * POINTS, 6 * POINTS));
        assert_eq!(thinned.touched.len(), POINTS);
        // The example goes from pole to pole: its upper half stays a half.
        let upper = thinned.points.iter().skip(2).step_by(3).filter(|&&z| z > 5_000).count();
        assert!(upper.abs_diff(POINTS / 2) < POINTS / 1_000, "{upper}");
        assert_eq!(cloud(0).stiffness.len(), 0);
    }

    #[test]
    fn words_cannot_break_out_of_a_table() {
        let made = Table {
            title: "<i>".to_owned(),
            caption: String::new(),
            head: vec!["class".to_owned(), "K & σ".to_owned()],
            rows: vec![vec!["</table>".to_owned(), "1.5".to_owned()]],
        };
        let html = table((0, &made));
        assert!(html.contains("&lt;i&gt;</h2>") && html.contains("K &amp; σ"));
        assert!(html.contains("<th scope=\"row\">&lt;/table&gt;</th><td>1.5</td>"));
        assert!(!html.contains("class=\"caption\""));
    }
}
