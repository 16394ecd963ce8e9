//! The four errors of Table I, per touch and over all frames, as text.

use palpate_learn::bands::{CLASSES, Coverage};
use palpate_work::prediction_report::{ErrorFigures, PredictionReport, TouchErrors};

use crate::output::{figure, table};

/// A row of the table.
fn cells(row: &TouchErrors) -> Vec<String> {
    let mut cells = vec![row.name.clone().unwrap_or("overall".to_owned()), row.frames.to_string()];
    for figures in [&row.errors, &row.zero] {
        let ErrorFigures { avg_error, max_error, avg_relative, max_relative } = *figures;
        cells.extend([avg_error, max_error].map(|error| figure(error, 3)));
        cells.extend([avg_relative, max_relative].map(|error| figure(error, 2)));
    }
    cells
}

/// The report as text.
pub(crate) fn text(report: &PredictionReport) -> String {
    let against = report.against.word();
    let mut text = format!(
        "Error of the predicted torque against the {against} one, N·m over all joints, and\n\
         relative on frames of at least 1 N·m; the same for predicting zero.\n\n"
    );
    let four = ["average", "largest", "av. rel.", "max. rel."];
    let second = [&["touch", "frames"][..], &four, &four].concat();
    let mut rows = vec![second.iter().map(ToString::to_string).collect()];
    rows.extend(report.touches.iter().map(cells));
    if report.touches.len() != 1 {
        rows.push(cells(&report.overall));
    }
    text += &table(&["", "", "field", "", "", "", "zero"], rows);
    if let Some(coverage) = &report.bands {
        text += &format!("\n{}", bands("Bands", coverage));
    }
    text
}

/// Coverage and width of bands as text, which begins with `of`.
pub(crate) fn bands(of: &str, coverage: &Coverage) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let classes = CLASSES.iter().zip(coverage.classes).filter_map(|(class, own)| {
        let [inside, width] = own?;
        Some(format!("{class} {} (± {width:.2} N·m)", percent(inside)))
    });
    format!(
        "{of} ({}): they contain {} of the torques and {} of the joints' largest torques.\n\
         By contact: {}.\n\
         Mean half-width {:.3} N·m (a constant band that contains as many torques needs {:.3} N·m).\n",
        percent(coverage.level),
        percent(coverage.torque_share),
        percent(coverage.peak_share),
        classes.collect::<Vec<_>>().join(", "),
        coverage.half_width_n_m,
        coverage.constant_half_width_n_m,
    )
}
