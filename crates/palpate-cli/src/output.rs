//! Results on stdout, everything else on stderr.
//!
//! Nothing here panics when a pipe is closed: a failed write to stdout is an error of the command, a
//! failed write to stderr is ignored.

use std::io::{self, Write};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use palpate_work::csv::visible;
use palpate_work::{Bar, Progress};
use serde::Serialize;

use crate::error::CliError;
use crate::interrupt;

/// How a command prints.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Output {
    /// No progress and no notes on stderr.
    pub quiet: bool,
}

/// The progress bars on the terminal, the newest last; lines of text are printed above them.
static BARS: Mutex<Vec<ProgressBar>> = Mutex::new(Vec::new());

impl Output {
    /// Prints a result.
    pub(crate) fn result(&self, text: &str) -> Result<(), CliError> {
        let mut out = io::stdout().lock();
        let written = out.write_all(visible(text).as_bytes()).and_then(|()| out.flush());
        written.map_err(|source| CliError::Write { what: "standard output".to_owned(), source })
    }

    /// Prints a result for programs: one JSON value.
    pub(crate) fn json<T: Serialize>(&self, value: &T) -> Result<(), CliError> {
        let text = serde_json::to_string_pretty(value).expect("results hold no maps but by name");
        self.result(&format!("{text}\n"))
    }

    /// Prints a result for programs that read line by line.
    #[cfg(feature = "full")]
    pub(crate) fn json_line<T: Serialize>(&self, value: &T) -> Result<(), CliError> {
        let text = serde_json::to_string(value).expect("results hold no maps but by name");
        self.result(&format!("{text}\n"))
    }

    /// Prints a note, which is no part of the result, unless `--quiet` was given.
    pub(crate) fn note(&self, text: &str) {
        if !self.quiet {
            complain(&format!("note: {text}"));
        }
    }

    /// Lines on stderr that every new message replaces.
    #[cfg(feature = "full")]
    pub(crate) fn view(&self) -> ProgressBar {
        drawn(None, "{msg}")
    }
}

/// A progress bar on stderr; hidden if stderr is not a terminal.
fn drawn(steps: Option<u64>, template: &str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(steps, ProgressDrawTarget::stderr_with_hz(8));
    bar.with_style(ProgressStyle::with_template(template).expect("the template is well-formed"))
}

impl Progress for Output {
    fn note(&self, text: &str) {
        Self::note(self, text);
    }

    fn warn(&self, text: &str) {
        complain(&format!("warning: {text}"));
    }

    fn begin(&self, steps: Option<u64>, things: &'static str, doing: &str) -> Box<dyn Bar> {
        if self.quiet {
            return Box::new(Shown(ProgressBar::hidden()));
        }
        let template = match steps {
            Some(_) => format!(
                "{{prefix}} {{bar:24}} {{percent:>3}} % of {{len}} {things}, {{eta}} left  {{wide_msg}}"
            ),
            None => format!("{{prefix}} {{spinner}} {{pos}} {things}  {{wide_msg}}"),
        };
        let bar = drawn(steps, &template).with_prefix(doing.to_owned());
        bars(|bars| bars.push(bar.clone()));
        Box::new(Shown(bar))
    }

    fn stopped(&self) -> bool {
        interrupt::pressed()
    }
}

/// A progress bar that is removed from the terminal when dropped.
struct Shown(ProgressBar);

impl Bar for Shown {
    fn step(&self) {
        self.0.inc(1);
    }

    fn at(&self, what: &str) {
        self.0.set_message(visible(what).into_owned());
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        self.0.finish_and_clear();
        bars(|bars| bars.retain(|bar| !bar.is_finished()));
    }
}

fn bars<R>(with: impl FnOnce(&mut Vec<ProgressBar>) -> R) -> R {
    with(&mut BARS.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Writes a line to stderr; a failure is ignored.
pub(crate) fn complain(line: &str) {
    let write = || {
        let _ = writeln!(io::stderr(), "{}", visible(line));
    };
    match bars(|bars| bars.last().cloned()) {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// A table with aligned columns: the first one to the left, the others to the right.
pub(crate) fn table(head: &[&str], body: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut rows = vec![head.iter().map(ToString::to_string).collect()];
    rows.extend(body);
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max()
    };
    let widths: Vec<usize> = (0..columns).map(|column| width(column).unwrap_or(0)).collect();
    let mut text = String::new();
    for row in &rows {
        let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
            if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
        });
        let line: Vec<String> = cells.collect();
        text += line.join("  ").trim_end();
        text.push('\n');
    }
    text
}

/// Names and their values, one below the other.
pub(crate) fn rows<N: AsRef<str>>(rows: &[(N, String)]) -> String {
    let widths = rows.iter().map(|(name, _)| name.as_ref().chars().count());
    let width = widths.fold(29, usize::max);
    rows.iter().map(|(name, value)| format!("  {:<width$}  {value}\n", name.as_ref())).collect()
}

/// A number with this many decimals, or `-` if there is none.
pub(crate) fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

/// A number of bytes as text, in MiB.
pub(crate) fn mib(bytes: usize) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

/// A duration as text, in seconds.
pub(crate) fn seconds(time: Duration) -> String {
    format!("{:.1} s", time.as_secs_f64())
}
