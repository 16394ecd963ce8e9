//! What is seen of a live session: a view that is drawn anew, or lines of JSON.

use std::io::IsTerminal;
use std::path::Path;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use palpate_live::News;
use palpate_live::figures::Figures;
use palpate_live::session::{Session, State};
use palpate_work::Progress;
use serde_json::json;

use crate::error::CliError;
use crate::output::{Output, visible};

/// Between two lines where there is no terminal to draw a view on.
const LINE: Duration = Duration::from_secs(10);
/// Between two lines of JSON.
const JSON: Duration = Duration::from_secs(1);

/// Shows the news.
pub(super) struct Shown {
    output: Output,
    json: bool,
    bar: ProgressBar,
    /// Whether there is a terminal for a view.
    terminal: bool,
    last_line: Option<Instant>,
    last: Option<Figures>,
}

impl Shown {
    pub(super) fn new(output: Output, json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && !json && !output.quiet;
        let bar = if terminal { output.view() } else { ProgressBar::hidden() };
        Self { output, json, bar, terminal, last_line: None, last: None }
    }

    /// Shows one of the news. A standard output that nobody reads any more is an error at the end.
    pub(super) fn show(&mut self, news: News) {
        match news {
            News::Note(note) if self.json => {
                let _ = self.output.json_line(&json!({ "note": note }));
            }
            News::Note(note) => self.bar.suspend(|| self.output.note(&note)),
            News::Figures(figures) => self.figures(*figures),
        }
    }

    /// Says what looks wrong.
    pub(super) fn warn(&self, warning: &str) {
        if self.json {
            let _ = self.output.json_line(&json!({ "warning": warning }));
        } else {
            self.bar.suspend(|| self.output.warn(warning));
        }
    }

    fn figures(&mut self, figures: Figures) {
        let every = if self.json { JSON } else { LINE };
        let due = self.last_line.is_none_or(|last| last.elapsed() >= every);
        if self.terminal {
            self.bar.set_message(visible(&view(&figures)).into_owned());
        } else if due {
            self.last_line = Some(Instant::now());
            if self.json {
                let _ = self.output.json_line(&figures);
            } else {
                self.output.note(&line(&figures));
            }
        }
        self.last = Some(figures);
    }

    /// Takes the view away.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Says what came of it.
    pub(super) fn end(&self, session: &Session, path: Option<&Path>) -> Result<(), CliError> {
        let (frames, _) = session.mapper().memory();
        let cells = session.mapper().n_cells();
        if self.json {
            let end = json!({
                "field": path, "cells": cells, "frames_remembered": frames, "figures": self.last,
            });
            return self.output.json_line(&end);
        }
        let mut text = match path {
            Some(path) => format!("The field is in `{}`.\n", path.display()),
            None => "Nothing was kept (--output keeps it).\n".to_owned(),
        };
        if let Some(figures) = &self.last {
            text += &view(figures);
            text.push('\n');
        }
        if let Some(path) = path {
            text += &format!("Next: palpate inspect {}\n", path.display());
        }
        self.output.result(&text)
    }
}

/// What the session does, in a word or some.
fn state(figures: &Figures) -> String {
    let does = match figures.state {
        State::Waiting => "waiting for the arm to pause",
        State::Taring => "taking the tare",
        State::Mapping => "mapping",
    };
    match &figures.stop {
        Some(cause) => format!("STOP: {cause}; {does}"),
        None => does.to_owned(),
    }
}

fn torque(n_m: Option<f64>) -> String {
    n_m.map_or("-".to_owned(), |n_m| format!("{n_m:.2} N·m"))
}

/// All figures, in four lines.
fn view(figures: &Figures) -> String {
    let Figures { latency_ms, step_ms, rate_hz, replays, contacts, cells, touches, .. } = figures;
    let checkpoint = figures.checkpoint_s.map_or(String::new(), |s| format!(", kept {s:.0} s ago"));
    let refused: u64 = figures.refused.values().sum();
    let lost = format!(
        "samples   {} mapped, {} dropped, {} never came, {refused} refused; {} messages unsent",
        figures.mapped, figures.dropped, figures.lost, figures.unsent
    );
    [
        format!(
            "{}, {rate_hz:.0} Hz, latency {:.2} ms (99 of 100 within {:.2}), step {:.2} ms, \
             {replays:.1} replays a sample",
            state(figures),
            latency_ms.median,
            latency_ms.p99,
            step_ms.median
        ),
        format!("contacts  {contacts} points now, {cells} cells in {touches} touches{checkpoint}"),
        format!(
            "torque    {} measured, {} predicted; error {} on average (predicting zero: {})",
            torque(figures.external_n_m),
            torque(figures.predicted_n_m),
            torque(figures.avg_error),
            torque(figures.zero_avg_error)
        ),
        lost,
    ]
    .join("\n")
}

/// The most important of them in one.
fn line(figures: &Figures) -> String {
    format!(
        "{}: {:.0} Hz, latency {:.2} ms, {} contacts, {} cells, error {} (predicting zero: {}), \
         {} dropped",
        state(figures),
        figures.rate_hz,
        figures.latency_ms.median,
        figures.contacts,
        figures.cells,
        torque(figures.avg_error),
        torque(figures.zero_avg_error),
        figures.dropped
    )
}
