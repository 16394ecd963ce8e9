//! What a log holds, touch by touch, and what looks wrong with it.
//!
//! | file      | says                                                        |
//! |-----------|-------------------------------------------------------------|
//! | `record`  | the log held whole, joints matched by name                  |
//! | `frames`  | repeated frames, clock, frozen torques                      |
//! | `motion`  | positions, speeds and torques beyond the robot's limits     |
//! | `unit`    | degrees or radians                                          |
//! | `reading` | sign, gravity and order of joints that fit best             |
//! | `gravity` | the same in words                                           |
//! | `payload` | what weight would explain torques that gravity does not     |
//! | `figures` | start, tare, noise, push and end of each touch              |
//! | `rest`    | what of that looks wrong                                    |
//! | `text`    | all of it for people                                        |
//!
//! A defect is told once: where the log seems to be in degrees, or its torques in the other sign,
//! the rest is looked at as if that had been put right.

mod figures;
mod frames;
mod gravity;
mod motion;
mod payload;
mod reading;
mod record;
mod rest;
mod text;
mod unit;

use std::path::Path;
use std::sync::Arc;

use palpate::{Arm, Gravity, TorqueSign};
use palpate_io::log::{Format, LoggedTorques};
use serde::Serialize;

use super::finding::Finding;
use crate::error::CliError;
use crate::pauses::Pauses;
use crate::settings::{Settings, SettingsError};
use figures::{Figures, TouchFacts};
use frames::ClockFacts;
use reading::Reading;
use record::{Matching, Record};
use rest::Figured;

/// What a log holds.
#[derive(Debug, Serialize)]
pub(super) struct LogFacts {
    format: Format,
    robot: String,
    frames: usize,
    clock: Option<ClockFacts>,
    /// In the order of all lists by joint: the robot's, if the log serves it.
    joints: Vec<String>,
    matching: Matching,
    /// Only if the joints are the robot's.
    reading: Option<Reading>,
    touches: Vec<TouchFacts>,
}

/// Looks at a log.
pub(super) fn inspect(
    path: &Path,
    settings: &Settings,
    arm: &Arc<Arm>,
) -> Result<(Option<LogFacts>, Vec<Finding>), CliError> {
    let config = settings.config()?;
    let mut set = config.touch;
    let options = settings.log.options();
    let mut record = match record::read(path, &options) {
        Ok(record) => record,
        Err(error) => return Ok((None, vec![unreadable(&error.to_string())])),
    };
    let mut findings: Vec<Finding> =
        record.broken.iter().map(|error| unreadable(&error.to_string())).collect();
    findings.extend(record.warnings.iter().map(|odd| left_out(odd)));
    if record.touches.is_empty() {
        return Ok((None, findings));
    }
    if record.torques == LoggedTorques::External && settings.touch.gravity.is_none() {
        set.gravity = Gravity::Removed;
    }
    let robot = &arm.robot;
    if let Err(error) = settings.log.check_for(robot) {
        let remedy = "a log of a robot with a prismatic joint must be in radians and metres";
        findings.push(Finding::error("angle_unit", error.to_string(), remedy));
    }
    let (matching, unmatched) = record.match_joints(robot);
    findings.extend(unmatched);
    let mut facts = LogFacts::new(&record, robot.name(), matching);
    if matching == Matching::Unmatched {
        findings.extend(frames::findings(&record.touches, &facts.joints));
        return Ok((Some(facts), findings));
    }

    if let Some(parted) = settings.log.pauses() {
        let mut pauses = Pauses::new(arm, (config.lattice, config.contact), parted)?;
        if let Err(error) = record.part(&mut pauses) {
            findings.push(unreadable(&error.to_string()));
        }
        if record.touches.is_empty() {
            return Ok((Some(facts), findings));
        }
    }
    facts.joints = robot.joint_names().map(str::to_owned).collect();
    let touches = &mut record.touches;
    let (angle_unit, wrong_unit) = unit::correct(touches, robot, options.angle_unit, &set);
    findings.extend(wrong_unit);
    let (reading, by_gravity) = gravity::judge(touches, robot, &set, (angle_unit, matching));
    findings.extend(by_gravity);
    findings.extend(frames::findings(touches, &facts.joints));
    findings.extend(motion::findings(touches, robot, facts.clock.map(|clock| clock.period_s)));

    let (fit, gravity_fits) = (reading.fits.accepted(), !reading.fits.misfit());
    let out_of_range =
        |error: palpate::SettingError| CliError::from(SettingsError::Value(Box::new(error.into())));
    let mut figures = Figures::new(arm, &set, fit).map_err(out_of_range)?;
    facts.touches = touches.iter().map(|touch| figures.of(touch)).collect();
    let sign_is_told = reading.fits.tell() && fit.gravity == Gravity::Included;
    let figured = Figured { robot, touches: &facts.touches, tare: set.tare, fit, sign_is_told };
    findings.extend(figured.findings(gravity_fits));
    facts.reading = Some(reading);
    Ok((Some(facts), findings))
}

fn left_out(what: &str) -> Finding {
    let remedy = "nothing, if that is as meant; else see --joints, --touch-topic and the recording";
    Finding::warning("left_out", what, remedy)
}

fn unreadable(what: &str) -> Finding {
    let remedy = "put right what the message names; what could be read before it is told here";
    Finding::error("unreadable", what, remedy)
}

impl LogFacts {
    /// What shows before the robot comes in.
    fn new(record: &Record, robot: &str, matching: Matching) -> Self {
        let first = &record.touches[0];
        let numbered = || (1..=first.n_joints()).map(|joint| format!("joint {joint}")).collect();
        Self {
            format: record.format,
            robot: robot.to_owned(),
            frames: record.touches.iter().map(record::Touch::frames).sum(),
            clock: frames::clock(&record.touches),
            joints: first.joint_names.clone().unwrap_or_else(numbered),
            matching,
            reading: None,
            touches: Vec::new(),
        }
    }
}

/// The mean of each column.
fn mean(rows: &[Vec<f64>]) -> Vec<f64> {
    let columns = rows.first().map_or(0, Vec::len);
    let mean = |j: usize| rows.iter().map(|row| row[j]).sum::<f64>() / rows.len() as f64;
    (0..columns).map(mean).collect()
}

/// What logged torques are multiplied with to be external ones.
fn sign(torque_sign: TorqueSign) -> f64 {
    match torque_sign {
        TorqueSign::Plus => 1.0,
        TorqueSign::Minus => -1.0,
    }
}
