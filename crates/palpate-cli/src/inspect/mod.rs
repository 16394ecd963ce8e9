//! `palpate inspect`: the content of a log, a robot or a field, and what looks wrong with it, as
//! text or JSON. The checks are in `palpate_work::inspect`.
//!
//! | file    | content                             |
//! |---------|-------------------------------------|
//! | `page`  | facts and tables as text, wrapped   |
//! | `log`   | the facts of a log                  |
//! | `robot` | the facts of a robot                |
//! | `field` | the facts of a field                |

mod field;
mod log;
mod page;
mod robot;

use std::path::PathBuf;

use palpate_work::inspect::{FileKind, Finding, Inspection, Inspector, Level, counted, word};
use serde_json::json;

use crate::error::CliError;
use crate::output::Output;
use crate::settings::LogAndLatticeSettings;

const NOTES: &str = "Examples:
  palpate inspect recordings/
  palpate inspect robot.urdf recordings/ --robot robot.urdf
  palpate inspect recordings/ --box-low-m 0.2,-0.3,0 --box-high-m 0.8,0.3,0.6
  palpate inspect field.npz --json

A log is checked in the lattice of the settings, as `palpate map` would learn it.

The exit code is 1 if an error was found, which would stop `palpate map` or `predict`, and 0 \
otherwise. With --strict, warnings count as errors.";

/// Flags of `palpate inspect`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs, URDFs, names of built-in robots, or fields
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
    /// Check logs in the lattice and with the settings of a saved field
    #[arg(long, value_name = "FIELD.npz")]
    pub from: Option<PathBuf>,
    #[command(flatten)]
    pub settings: LogAndLatticeSettings,
}

/// Inspects every path in turn.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = args.settings.load()?;
    let mut inspector = Inspector::new(&settings, args.from.as_deref(), output);
    let mut inspections = Vec::new();
    for path in &args.paths {
        inspections.push(inspector.inspect(path)?);
    }
    let count = |level| {
        let findings = inspections.iter().flat_map(|inspection| &inspection.findings);
        findings.filter(|finding| finding.level == level).count()
    };
    let (errors, warnings) = (count(Level::Error), count(Level::Warning));
    if args.json {
        output.json(&json!({ "paths": inspections, "errors": errors, "warnings": warnings }))?;
    } else {
        let pages: Vec<String> = inspections.iter().map(text_of).collect();
        output.result(&pages.join("\n"))?;
    }
    let found = [
        (errors, "error"),
        (if settings.log.strict == Some(true) { warnings } else { 0 }, "warning"),
    ];
    let found = found.iter().filter(|(count, _)| *count > 0);
    let found: Vec<String> = found.map(|&(count, what)| counted(count, what)).collect();
    if found.is_empty() {
        Ok(())
    } else {
        Err(CliError::from(format!("found {}", found.join(", "))))
    }
}

/// Facts and findings of one path, as text.
fn text_of(inspection: &Inspection) -> String {
    let mut text = format!("{} `{}`\n", word(inspection.kind), inspection.path.display());
    text += &match &inspection.holds {
        Some(FileKind::Log(facts)) => log::text(facts),
        Some(FileKind::Robot(facts)) => robot::text(facts),
        Some(FileKind::Field(facts)) => field::text(facts),
        None => String::new(),
    };
    text.push('\n');
    for finding in &inspection.findings {
        text += &finding_text(finding);
    }
    let clean = inspection.findings.iter().all(|finding| finding.level == Level::Note);
    text + if clean { "  Nothing looks wrong.\n" } else { "" }
}

/// A finding with its remedy below it, as text.
fn finding_text(finding: &Finding) -> String {
    let mark = word(finding.level).to_uppercase();
    let text = page::wrapped(&format!("{mark}  {}", finding.what), "  ", "    ");
    text + &page::wrapped(&finding.remedy, "    -> ", "       ")
}
