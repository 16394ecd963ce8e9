//! The results of an extrapolation, as text, JSON, picture and page.

use std::collections::HashSet;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

use askama::Template;
use palpate_io::cloud::PointTruth;
use palpate_learn::extrapolate::compare::VariantErrors;
use palpate_learn::extrapolate::{area_under_roc, spearman};
use palpate_work::extrapolate::{ExtrapolationJob, ExtrapolationResult, HeldOutErrors};
use serde::Serialize;
use serde_json::{Value, json};

use crate::error::CliError;
use crate::extrapolation_view::{ExtrapolationView, Table};
use crate::file_paths::last_part;
use crate::output::{figure, rows, seconds, table};
use crate::picture;
use crate::report::{ExtrapolationPage, Page, Scene};
use palpate_work::quantile::quantile;

/// An extrapolation, and what it is compared with.
pub(crate) struct ExtrapolationSummary<'a> {
    pub(crate) work: &'a ExtrapolationJob<'a>,
    pub(crate) found: &'a ExtrapolationResult,
    pub(crate) truth: Option<&'a PointTruth>,
    /// Whether the touches come from a simulator; the page then says so.
    pub(crate) simulated: bool,
}

/// How well the order of the points agrees with the truth.
#[derive(Serialize)]
struct Order {
    /// Name of this set of points.
    #[serde(skip)]
    name: &'static str,
    /// Number of points.
    points: usize,
    /// Area under the ROC curve: the first class of the simulation against all others.
    auc: Option<f64>,
    spearman: Option<f64>,
}

/// Where the cloud was written, and the field if it was.
type Files<'a> = (&'a Path, Option<&'a Path>);

impl ExtrapolationSummary<'_> {
    /// Number of the cloud's points in touched cells.
    fn touched(&self) -> usize {
        self.found.extrapolation.touched.iter().filter(|touched| **touched).count()
    }

    /// How the stiffness was extrapolated, and from what.
    fn method(&self) -> Vec<(&'static str, String)> {
        let config = &self.found.config;
        let method = format!("{} on {}", config.method.name(), config.features);
        let frames = |(touches, frames)| format!("{touches} touches, {frames} frames in contact");
        let remembered = self.found.remembered.map(|counts| ("remembered", frames(counts)));
        let errors = |HeldOutErrors { with, without, relative }| {
            let unit = if relative { "relative to predicting zero" } else { "N·m" };
            let [with, without] =
                [with, without].map(|error| format!("{:.3} ± {:.3}", error.mean, error.std));
            format!("{with} with the extrapolation, {without} without; {unit}, over random halves")
        };
        let held_out = self.found.held_out.map(|found| ("error, held-out touches", errors(found)));
        std::iter::once(("method", method)).chain(remembered).chain(held_out).collect()
    }

    /// Number of untouched cells at the cloud's points.
    fn expected(&self) -> usize {
        let field = &self.work.saved.field;
        let touched: HashSet<_> = field.touched_rows().map(|row| field.cells[row]).collect();
        self.found.cells.iter().filter(|(cell, _)| !touched.contains(cell)).count()
    }

    /// The 10 %, 50 % and 90 % quantiles of the points' stiffness, N/m.
    fn quantiles(&self) -> [f64; 3] {
        let stiffness = &self.found.extrapolation.stiffness_n_per_m;
        [0.1, 0.5, 0.9].map(|share| quantile(stiffness, share).unwrap_or_default())
    }

    /// How well the order agrees with the truth, for the untouched points and for all.
    fn orders(&self) -> Option<[Order; 2]> {
        let truth = self.truth?;
        let touched = &self.found.extrapolation.touched;
        Some([("untouched points", true), ("all points", false)].map(|(name, untouched_only)| {
            let points: Vec<usize> = (0..self.found.seen.len())
                .filter(|&point| !(untouched_only && touched[point]))
                .collect();
            let pick = |values: &[f64]| points.iter().map(|&at| values[at]).collect::<Vec<f64>>();
            let k = pick(&self.found.extrapolation.stiffness_n_per_m);
            let other: Vec<bool> = points.iter().map(|&at| truth.class[at] > 0).collect();
            Order {
                name,
                points: points.len(),
                auc: area_under_roc(&k, &other),
                spearman: spearman(&k, &pick(&truth.stiffness_n_per_m)),
            }
        }))
    }

    pub(super) fn json(&self, (cloud, field): Files<'_>, elapsed: Duration) -> Value {
        let [soft, median, stiff] = self.quantiles();
        let row = |row: &VariantErrors| {
            let (relative, error) = row.means();
            json!({
                "name": row.name,
                "avg_relative": {"mean": relative, "halves": row.avg_relative},
                "avg_error": {"mean": error, "halves": row.avg_error},
            })
        };
        json!({
            "cloud": cloud,
            "field": field,
            "method": self.found.config.method.name(),
            "features": self.found.config.features,
            "points": self.found.seen.len(),
            "touched": self.touched(),
            "cells_touched": self.work.saved.field.touched_rows().count(),
            "cells_expected": self.expected(),
            "touches": self.found.remembered.map(|(touches, _)| touches),
            "frames": self.found.remembered.map(|(_, frames)| frames),
            "held_out": self.found.held_out.map(|HeldOutErrors { with, without, relative }| {
                json!({"with": with.mean, "without": without.mean, "relative": relative})
            }),
            "stiffness": {"q10": soft, "median": median, "q90": stiff},
            "truth": self.orders().map(|[untouched, all]| json!({"untouched": untouched, "all": all})),
            "compare": self.found.rows.as_ref().map(|rows| rows.iter().map(row).collect::<Vec<_>>()),
            "seconds": elapsed.as_secs_f64(),
        })
    }

    pub(super) fn text(&self, (cloud, field): Files<'_>, elapsed: Duration) -> String {
        let (points, touched) = (self.found.seen.len(), self.touched());
        let part = 100.0 * touched as f64 / points as f64;
        let [soft, median, stiff] = self.quantiles();
        let mut found = self.method();
        found.extend([
            ("points", points.to_string()),
            ("of them in touched cells", format!("{touched} ({part:.0} %)")),
            ("10, 50, 90 % quantiles of K", format!("{soft:.3}, {median:.3}, {stiff:.3} N/m")),
            ("untouched cells estimated", self.expected().to_string()),
        ]);
        for order in self.orders().iter().flatten() {
            let (auc, rho) = (figure(order.auc, 3), figure(order.spearman, 3));
            let scores = format!("area under ROC {auc}, Spearman {rho} (against truth)");
            found.push((order.name, scores));
        }
        found.push(("time", seconds(elapsed)));
        let mut text = format!("The cloud is in `{}`.\n{}", cloud.display(), rows(&found));
        if let Some(rows) = &self.found.rows {
            let Table { caption, head, rows, .. } = compared(rows);
            let _ = write!(text, "\n{caption}\n\n{}\n", table(&head, rows));
        }
        if let Some(path) = field {
            let path = path.display();
            let _ = writeln!(text, "The field is in `{path}`.");
        }
        text
    }

    /// Fig. 4.
    pub(crate) fn picture(&self, threshold_n_per_m: Option<f64>) -> Result<String, CliError> {
        Ok(picture::fig4(&self.seen(), threshold_n_per_m)?)
    }

    /// The page, with an interactive Fig. 4.
    pub(crate) fn page(&self) -> Result<String, CliError> {
        let [field, cloud] = self.work.names.map(last_part);
        let page = Page {
            title: &format!("Stiffness of {cloud}, extrapolated from {field}"),
            simulated: self.simulated,
            card: self.card(),
            settings_toml: &toml::to_string(&self.found.config).map_err(CliError::file)?,
        };
        let (seen, verdict, tables) = (&self.seen(), self.verdict(), self.tables());
        let page = ExtrapolationPage { page, verdict, seen, scene: Scene::seen(seen)?, tables };
        page.render().map_err(CliError::file)
    }

    fn seen(&self) -> ExtrapolationView<'_> {
        ExtrapolationView {
            field: &self.work.saved.field,
            arm: self.work.arm,
            touching: &self.found.touching,
            points: self.work.cloud.points(),
            colours: self.found.seen.colours(),
            found: &self.found.extrapolation,
        }
    }

    /// What was found, as one sentence without its full stop.
    fn verdict(&self) -> String {
        let (points, touched) = (self.found.seen.len(), self.touched());
        let mut verdict = format!(
            "{touched} of {points} seen points lie in touched cells; the stiffness of the others is \
             extrapolated from points that look alike"
        );
        let rows = self.found.rows.as_deref().unwrap_or_default();
        let means: Vec<f64> = rows.iter().filter_map(|row| row.means().0).collect();
        if let [_, without, _, with, ..] = means[..] {
            let halves = rows[0].avg_error.len();
            let _ = write!(
                verdict,
                "; if one half of the touches is predicted from the other, the average relative error is \
                 {with:.3} with the extrapolated stiffness as the prior of untouched cells, and \
                 {without:.3} without it (means of {halves} random halves)"
            );
        }
        verdict
    }

    fn tables(&self) -> Vec<Table> {
        let mut tables: Vec<Table> = self.found.rows.iter().map(|rows| compared(rows)).collect();
        let row = |Order { name, points, auc, spearman }: Order| {
            vec![name.to_owned(), points.to_string(), figure(auc, 3), figure(spearman, 3)]
        };
        if let Some(orders) = self.orders() {
            tables.push(Table {
                title: "Ranking of the points by stiffness, compared with the simulation's truth",
                caption: "Area under the ROC curve of separating the simulation's first class (leaf) \
                          from all others by stiffness, and Spearman's correlation with the true one.",
                head: vec!["", "points", "area", "Spearman"],
                rows: orders.map(row).to_vec(),
            });
        }
        tables
    }

    fn card(&self) -> Vec<(&'static str, String)> {
        let [field, cloud] = self.work.names.map(|name| name.display().to_string());
        let robot = self.work.saved.robot.clone();
        let mut card = vec![("field", field), ("cloud", cloud), ("robot", robot)];
        card.extend(self.method());
        card
    }
}

/// The table of a comparison.
fn compared(rows: &[VariantErrors]) -> Table {
    let row = |row: &VariantErrors| {
        let (relative, error) = row.means();
        let by_half: Vec<String> = row.avg_relative.iter().map(|r| format!("{r:.2}")).collect();
        vec![row.name.clone(), figure(relative, 3), format!("{error:.3}"), by_half.join(" ")]
    };
    Table {
        title: "Methods and features",
        caption: "Error of the predicted torque on one half of the touches, learnt from the other; \
                  means over random halves, against measured torques.",
        head: vec!["", "relative", "N·m", "relative, by half"],
        rows: rows.iter().map(row).collect(),
    }
}
