//! `palpate inspect`: what a log, a robot or a field holds, and what looks wrong with it.
//!
//! | file        | says                                                        |
//! |-------------|-------------------------------------------------------------|
//! | `recognise` | which of the three a path is                                |
//! | `finding`   | what looks wrong: evidence and remedy                       |
//! | `page`      | facts, tables and findings as text                          |
//! | `log`       | touches: clock, torques, tare, noise, gravity, joint order  |
//! | `robot`     | links, joints, masses, shapes, meshes                       |
//! | `field`     | cells, stiffness, uncertainty, memory                       |
//!
//! Paths are inspected one by one, and what is wrong with one keeps no other from being looked
//! at. An *error* is what `palpate map` or `predict` would refuse; a *warning* is what they would
//! take, but probably not as it was meant.

mod field;
mod finding;
mod log;
mod page;
mod recognise;
mod robot;

use std::cmp::Reverse;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::Arm;
use serde::Serialize;
use serde_json::json;

use crate::error::CliError;
use crate::output::Output;
use crate::settings::{RobotAndLogSettings, Settings};
use finding::{Finding, Level};
use recognise::Kind;

const NOTES: &str = "Examples:
  palpate inspect recordings/
  palpate inspect robot.urdf recordings/ --robot robot.urdf
  palpate inspect field.npz --json

The exit code is 0 if nothing is in the way of `palpate map` and `predict`, warnings or not, and 1
if something is; with --strict, warnings count as well.";

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
    /// End with exit code 1 if there is any warning
    #[arg(long)]
    pub strict: bool,
    #[command(flatten)]
    pub settings: RobotAndLogSettings,
}

/// What was found out about one path.
#[derive(Debug, Serialize)]
struct Inspection {
    path: PathBuf,
    kind: Kind,
    /// What it holds; absent if it cannot be read.
    #[serde(flatten)]
    holds: Option<Holds>,
    findings: Vec<Finding>,
}

/// What a path holds.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Holds {
    Log(Box<log::LogFacts>),
    Robot(robot::RobotFacts),
    Field(Box<field::FieldFacts>),
}

/// Inspects every path in turn.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = args.settings.load()?;
    let mut inspector = Inspector { settings: &settings, output, arm: None };
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
        let pages: Vec<String> = inspections.iter().map(page::of).collect();
        output.result(&pages.join("\n"))?;
    }
    let found = [(errors, "error"), (if args.strict { warnings } else { 0 }, "warning")];
    let found = found.iter().filter(|(count, _)| *count > 0);
    let found: Vec<String> = found.map(|&(count, what)| page::counted(count, what)).collect();
    if found.is_empty() {
        Ok(())
    } else {
        Err(CliError::from(format!("found {}", found.join(", "))))
    }
}

/// Looks at paths, and loads the robot of the logs once.
struct Inspector<'a> {
    settings: &'a Settings,
    output: &'a Output,
    arm: Option<Arc<Arm>>,
}

impl Inspector<'_> {
    fn inspect(&mut self, path: &Path) -> Result<Inspection, CliError> {
        let (kind, holds, mut findings) = match recognise::recognise(path) {
            Err(finding) => (Kind::Unknown, None, vec![*finding]),
            Ok(Kind::Field) => {
                let (facts, findings) = field::inspect(path);
                (Kind::Field, facts.map(|facts| Holds::Field(Box::new(facts))), findings)
            }
            Ok(Kind::Robot) => {
                let (facts, findings) = robot::inspect(path, &self.settings.robot)?;
                (Kind::Robot, facts.map(Holds::Robot), findings)
            }
            Ok(_) => {
                let arm = self.arm()?;
                let (facts, findings) = log::inspect(path, self.settings, &arm)?;
                (Kind::Log, facts.map(|facts| Holds::Log(Box::new(facts))), findings)
            }
        };
        findings.sort_by_key(|finding| Reverse(finding.level));
        Ok(Inspection { path: path.to_owned(), kind, holds, findings })
    }

    /// The robot that the logs are held against.
    fn arm(&mut self) -> Result<Arc<Arm>, CliError> {
        if self.arm.is_none() {
            self.arm = Some(crate::robot::load(&self.settings.robot, self.output)?);
        }
        Ok(Arc::clone(self.arm.as_ref().expect("it was just loaded")))
    }
}
