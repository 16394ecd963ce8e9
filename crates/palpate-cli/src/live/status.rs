//! The output of a live session: a view that is updated in place, or lines of text or JSON.

use std::io::IsTerminal;
use std::path::Path;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use palpate_live::SessionEvent;
use palpate_live::figures::SessionFigures;
use palpate_live::session::{Session, SessionState};
use palpate_work::Progress;
use palpate_work::csv::visible;
use serde_json::json;

use crate::error::CliError;
use crate::output::Output;

/// Time between two lines of text, if there is no terminal for a view.
const LINE: Duration = Duration::from_secs(10);
/// Time between two lines of JSON.
const JSON: Duration = Duration::from_secs(1);

/// Shows the events of a session.
pub(super) struct Shown {
    output: Output,
    json: bool,
    bar: ProgressBar,
    /// Whether there is a terminal for a view.
    terminal: bool,
    last_line: Option<Instant>,
    last: Option<SessionFigures>,
}

impl Shown {
    pub(super) fn new(output: Output, json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && !json && !output.quiet;
        let bar = if terminal { output.view() } else { ProgressBar::hidden() };
        Self { output, json, bar, terminal, last_line: None, last: None }
    }

    /// Shows one event. That standard output is closed is an error only at the end.
    pub(super) fn show(&mut self, event: SessionEvent) {
        match event {
            SessionEvent::Note(note) if self.json => {
                let _ = self.output.json_line(&json!({ "note": note }));
            }
            SessionEvent::Note(note) => self.bar.suspend(|| self.output.note(&note)),
            SessionEvent::Figures(figures) => self.figures(*figures),
        }
    }

    /// Prints a warning.
    pub(super) fn warn(&self, warning: &str) {
        if self.json {
            let _ = self.output.json_line(&json!({ "warning": warning }));
        } else {
            self.bar.suspend(|| self.output.warn(warning));
        }
    }

    fn figures(&mut self, figures: SessionFigures) {
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

    /// Removes the view from the terminal.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Prints the result of a session, and the path if a field was saved.
    pub(super) fn end(
        &self,
        session: &Session,
        path: Option<&Path>,
        no_map: bool,
    ) -> Result<(), CliError> {
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
            None if no_map => String::new(),
            None => "The field was not saved (--output FIELD.npz saves it).\n".to_owned(),
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

/// The state of the session in words, with the cause if the robot must stop.
fn state(figures: &SessionFigures) -> String {
    let does = match figures.state {
        SessionState::Waiting if figures.received == 0 => "waiting for joint states",
        SessionState::Waiting => "waiting for the arm to pause",
        SessionState::Taring => "taking the tare",
        SessionState::Mapping => "mapping",
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
fn view(figures: &SessionFigures) -> String {
    let SessionFigures { latency_ms, step_ms, rate_hz, replays, contacts, cells, touches, .. } =
        figures;
    let checkpoint =
        figures.checkpoint_s.map_or(String::new(), |s| format!(", saved {s:.0} s ago"));
    let refused: u64 = figures.refused.values().sum();
    let lost = format!(
        "samples   {} mapped, {} dropped, {} lost on the network, {refused} refused; {} messages unsent",
        figures.mapped, figures.dropped, figures.lost, figures.unsent
    );
    [
        format!(
            "{}, {rate_hz:.0} Hz, latency {:.2} ms (99th percentile {:.2}), step {:.2} ms, \
             {replays:.1} replays per sample",
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

/// The most important figures, in one line.
fn line(figures: &SessionFigures) -> String {
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
