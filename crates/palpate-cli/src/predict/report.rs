//! The four figures of Table I, per touch and over all frames, for people and for programs.

use std::path::PathBuf;

use palpate_learn::errors::{ErrorSum, Errors};
use serde::Serialize;

use crate::output::{Output, table};

use super::{Against, TouchResult};

/// What `--json` prints.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Report {
    touches: Vec<Row>,
    overall: Row,
    against: Against,
}

/// One touch, or all of them.
#[derive(Debug, Clone, Serialize)]
struct Row {
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<PathBuf>,
    /// Scored frames.
    frames: u64,
    /// All that the log holds.
    frames_in_log: u64,
    /// Those that the tare was taken from.
    tare_frames: u64,
    /// Those of at least 1 N·m, which have a relative error.
    relative_frames: u64,
    frames_in_contact: u64,
    frames_on_known: u64,
    #[serde(flatten)]
    errors: Figures,
    zero: Figures,
}

/// The four figures; null where there are none.
#[derive(Debug, Clone, Copy, Serialize)]
struct Figures {
    avg_error: Option<f64>,
    max_error: Option<f64>,
    avg_relative: Option<f64>,
    max_relative: Option<f64>,
}

impl From<Option<Errors>> for Figures {
    fn from(errors: Option<Errors>) -> Self {
        Self {
            avg_error: errors.map(|e| e.avg_error),
            max_error: errors.map(|e| e.max_error),
            avg_relative: errors.and_then(|e| e.avg_relative),
            max_relative: errors.and_then(|e| e.max_relative),
        }
    }
}

impl Row {
    fn of(touches: &[&TouchResult], one: Option<&TouchResult>) -> Self {
        let sum = |of: fn(&TouchResult) -> u64| touches.iter().map(|touch| of(touch)).sum();
        let (mut field, mut zero) = (ErrorSum::default(), ErrorSum::default());
        for touch in touches {
            field.merge(&touch.field);
            zero.merge(&touch.zero);
        }
        Self {
            name: one.map(|touch| touch.name.clone()),
            log: one.map(|touch| touch.log.clone()),
            frames: field.frames(),
            frames_in_log: sum(|touch| touch.frames_in_log),
            tare_frames: sum(|touch| touch.frames_in_log - touch.field.frames()),
            relative_frames: field.relative_frames(),
            frames_in_contact: sum(|touch| touch.frames_in_contact),
            frames_on_known: sum(|touch| touch.frames_on_known),
            errors: field.errors().into(),
            zero: zero.errors().into(),
        }
    }

    fn cells(&self) -> Vec<String> {
        let mut cells =
            vec![self.name.clone().unwrap_or("overall".to_owned()), self.frames.to_string()];
        for figures in [&self.errors, &self.zero] {
            let Figures { avg_error, max_error, avg_relative, max_relative } = *figures;
            let shown = |figure: Option<f64>, digits: usize| match figure {
                Some(figure) => format!("{figure:.digits$}"),
                None => "-".to_owned(),
            };
            cells.extend([avg_error, max_error].map(|figure| shown(figure, 3)));
            cells.extend([avg_relative, max_relative].map(|figure| shown(figure, 2)));
        }
        cells
    }
}

impl Report {
    /// The figures of all touches.
    pub(crate) fn new(results: &[TouchResult], against: Against) -> Self {
        let touches = results.iter().map(|touch| Row::of(&[touch], Some(touch)));
        let overall = Row::of(&results.iter().collect::<Vec<_>>(), None);
        Self { touches: touches.collect(), overall, against }
    }

    /// A table for people.
    pub(crate) fn text(&self) -> String {
        let against = self.against.word();
        let mut text = format!(
            "Error of the predicted torque against the {against} one, N·m over all joints, and\n\
             relative on frames of at least 1 N·m; the same for predicting zero.\n\n"
        );
        let words = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect();
        let four = ["average", "largest", "av. rel.", "max. rel."];
        let mut rows: Vec<Vec<String>> = vec![
            words(&["", "", "field", "", "", "", "zero"]),
            words(&[&["touch", "frames"][..], &four, &four].concat()),
        ];
        rows.extend(self.touches.iter().map(Row::cells));
        if self.touches.len() != 1 {
            rows.push(self.overall.cells());
        }
        text += &table(&rows);
        text
    }
}

/// Notes what a reader of the errors should know.
pub(crate) fn tell_oddities(results: &[TouchResult], output: &Output) {
    if results.iter().all(|touch| touch.frames_on_known == 0) {
        output.note(
            "no touch meets a point that the field knows: the predictions are what is expected of \
             untouched points; check that field, robot and log belong together",
        );
        return;
    }
    for touch in results {
        let name = &touch.name;
        if touch.frames.is_empty() {
            output.note(&format!(
                "touch `{name}` never leaves its contact-free start: nothing was scored"
            ));
        } else if touch.frames_in_contact == 0 {
            output.note(&format!("touch `{name}` touches no point of the field's lattice"));
        } else if touch.frames_on_known == 0 {
            output.note(&format!("touch `{name}` meets no point that the field knows"));
        } else if let (Some(field), Some(zero)) = (touch.field.errors(), touch.zero.errors())
            && field.avg_error > zero.avg_error
        {
            output.note(&format!("touch `{name}`: the field is worse than predicting zero"));
        }
    }
}
