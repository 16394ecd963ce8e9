//! Content of a log, a robot or a field, and what looks wrong with it.
//!
//! | module        | content                                                                     |
//! |---------------|-----------------------------------------------------------------------------|
//! | `recognise`   | whether a path is a log, a robot or a field                                 |
//! | `finding`     | what looks wrong: evidence and remedy                                       |
//! | `words`       | numbers and names in sentences                                              |
//! | [`mod@log`]   | touches: clock, torques, tare, noise, gravity, joint order, what they touch |
//! | [`mod@robot`] | links, joints, masses, shapes, meshes                                       |
//! | [`mod@field`] | cells, stiffness, uncertainty, memory                                       |
//!
//! Paths are inspected one by one; an error in one does not stop the others. An *error* is what
//! learning or predicting would refuse; a *warning* is what they would accept, but probably not as
//! intended.

pub mod field;
mod finding;
pub mod log;
mod recognise;
pub mod robot;
mod words;

use std::cmp::Reverse;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::Arm;
use serde::Serialize;

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::Settings;
use crate::touches::Touches;
use crate::{resume, robot as robots};
pub use finding::{Finding, Level};
pub(crate) use log::{are_degrees, are_radians, farthest, is_misread, mean};
pub use recognise::Kind;
pub use words::{counted, number, word};

/// Result for one path.
#[derive(Debug, Serialize)]
pub struct Inspection {
    /// The path, as it was given.
    pub path: PathBuf,
    /// Kind of the path.
    pub kind: Kind,
    /// Facts about its content; absent if it cannot be read.
    #[serde(flatten)]
    pub holds: Option<FileKind>,
    /// What looks wrong, errors first.
    pub findings: Vec<Finding>,
}

/// Facts about the content of a path.
#[derive(Debug, Serialize)]
#[serde(untagged)]
#[allow(missing_docs)] // each holds its facts
pub enum FileKind {
    Log(Box<log::LogFacts>),
    Robot(robot::RobotFacts),
    Field(Box<field::FieldFacts>),
}

/// Inspects paths, and loads the robot of the logs only once.
pub struct Inspector<'a> {
    settings: &'a Settings,
    /// The field whose settings are used for logs, if one was given.
    field: Option<&'a Path>,
    progress: &'a dyn Progress,
    arm: Option<Arc<Arm>>,
}

impl<'a> Inspector<'a> {
    /// Logs are inspected under these settings, or under those of a field, which these must not
    /// contradict.
    pub fn new(
        settings: &'a Settings,
        field: Option<&'a Path>,
        progress: &'a dyn Progress,
    ) -> Self {
        Self { settings, field, progress, arm: None }
    }

    /// Inspects one path.
    ///
    /// # Errors
    ///
    /// If the settings are invalid, their robot cannot be loaded, or the progress stops it. What is
    /// wrong with the path itself is a finding.
    pub fn inspect(&mut self, path: &Path) -> Result<Inspection, WorkError> {
        let (kind, holds, mut findings) = match recognise::recognise(path) {
            Err(finding) => (Kind::Unknown, None, vec![*finding]),
            Ok(Kind::Field) => {
                let arm = match self.settings.robot.robot {
                    Some(_) => Some(self.arm()?),
                    None => None,
                };
                let (facts, findings) = field::inspect(path, (arm, self.progress));
                (Kind::Field, facts.map(|facts| FileKind::Field(Box::new(facts))), findings)
            }
            Ok(Kind::Robot) => {
                let (facts, findings) = robot::inspect(path, &self.settings.robot)?;
                (Kind::Robot, facts.map(FileKind::Robot), findings)
            }
            Ok(Kind::Log | Kind::Unknown) => {
                let (facts, findings) = self.log(path)?;
                (Kind::Log, facts.map(|facts| FileKind::Log(Box::new(facts))), findings)
            }
        };
        findings.sort_by_key(|finding| Reverse(finding.level));
        Ok(Inspection { path: path.to_owned(), kind, holds, findings })
    }

    fn log(&mut self, path: &Path) -> Result<(Option<log::LogFacts>, Vec<Finding>), WorkError> {
        // The measured torques are inspected, without an identified arm.
        let mut as_measured = self.settings.clone();
        as_measured.robot.arm = None;
        let config = match self.field {
            Some(field) => resume::config(field, &as_measured)?,
            None => as_measured.config()?,
        };
        let arm = self.arm()?;
        let touches = Touches::open(&[path.to_owned()], &self.settings.log.options());
        log::inspect(touches, (self.settings, &config), (&arm, self.progress))
    }

    /// The robot of the settings.
    fn arm(&mut self) -> Result<Arc<Arm>, WorkError> {
        if self.arm.is_none() {
            self.arm = Some(robots::load(&self.settings.robot, self.progress)?);
        }
        Ok(Arc::clone(self.arm.as_ref().expect("it was just loaded")))
    }
}
