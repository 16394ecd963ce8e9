//! Degrees taken for radians, or the other way round.

use std::f64::consts::TAU;

use palpate::unstable::JointKind;
use palpate::{ExternalTorqueConfig, Robot, Sample};
use palpate_io::log::AngleUnit;

use super::super::finding::Finding;
use super::super::words::{number, word};
use super::reading::{fits, rests};
use crate::quantile::median;
use crate::touches::RecordedTouch;

/// Beyond two turns, angles in radians are suspicious.
const SUSPICIOUS_RAD: f64 = 2.0 * TAU;
/// Beyond four turns they are degrees if gravity does not say otherwise.
const SURELY_RAD: f64 = 4.0 * TAU;

/// Converts the touches to radians if they were read in the wrong unit, and returns the right unit with a finding,
/// which is a warning if the wrong unit was given or a joint is prismatic.
pub(super) fn correct(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    given: Option<AngleUnit>,
    set: &ExternalTorqueConfig,
) -> (AngleUnit, Option<Finding>) {
    let read_as = given.unwrap_or_default();
    let Some((unit, what)) = other_unit(touches, robot, read_as, set) else {
        return (read_as, None);
    };
    let in_words = match unit {
        AngleUnit::Deg => "degrees",
        AngleUnit::Rad => "radians",
    };
    let finding = match given {
        _ if slides(robot) => {
            let remedy = format!(
                "convert the angles of the log to radians; this report reads them as {in_words}"
            );
            Finding::warning("angle_unit", what, remedy)
        }
        None => {
            let remedy = format!("nothing to do: they are read as {in_words}");
            Finding::warning("angle_unit", what, remedy).noted()
        }
        Some(_) => {
            let unit = word(unit);
            let remedy = format!("use --angle-unit {unit}; this report reads them as {in_words}");
            Finding::warning("angle_unit", what, remedy).try_flags(&["--angle-unit", &unit])
        }
    };
    (unit, Some(finding))
}

/// The reason why touches that were read as radians are in degrees, if they are; they are then converted to radians.
/// `None` for an arm with a prismatic joint, whose positions are in m.
pub(crate) fn are_degrees(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    set: &ExternalTorqueConfig,
) -> Option<String> {
    let found = (!slides(robot)).then(|| other_unit(touches, robot, AngleUnit::Rad, set));
    found.flatten().map(|(_, what)| what)
}

/// Whether touches that were read as radians are in radians for certain: half of the samples stay within a turn, and
/// gravity fits far worse in degrees.
pub(crate) fn are_radians(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    set: &ExternalTorqueConfig,
) -> bool {
    let angles = touches.iter_mut().flat_map(|touch| &mut touch.samples).flat_map(|own| &mut own.q);
    angles.for_each(|angle| *angle = angle.to_radians());
    !slides(robot) && other_unit(touches, robot, AngleUnit::Deg, set).is_some()
}

fn slides(robot: &Robot) -> bool {
    robot.joints().iter().any(|joint| joint.kind == JointKind::Prismatic)
}

/// The unit of touches and the reason, if it is not the one in which they were read; they are then converted to
/// radians.
fn other_unit(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    read_as: AngleUnit,
    set: &ExternalTorqueConfig,
) -> Option<(AngleUnit, String)> {
    let turns: Vec<bool> =
        robot.joints().iter().map(|joint| joint.kind != JointKind::Prismatic).collect();
    // The median over samples, so that a broken one has no effect.
    let largest_of = |sample: &Sample| {
        let angles = sample.q.iter().zip(&turns).filter(|at| *at.1);
        angles.map(|(angle, _)| angle.abs()).fold(0.0, f64::max)
    };
    let samples = touches.iter().flat_map(|touch| &touch.samples);
    let largest = median(&samples.map(largest_of).collect::<Vec<_>>())?;
    let (factor, unit, suspicious, surely) = match read_as {
        AngleUnit::Rad => {
            (1.0_f64.to_radians(), AngleUnit::Deg, largest > SUSPICIOUS_RAD, largest > SURELY_RAD)
        }
        // A whole turn in radians, read as degrees, is 0.11 rad.
        AngleUnit::Deg => {
            let suspicious = largest > 0.0 && largest < TAU.to_radians();
            (1.0_f64.to_degrees(), AngleUnit::Rad, suspicious, false)
        }
    };
    if !suspicious {
        return None;
    }
    let mut converted = touches.to_vec();
    for sample in converted.iter_mut().flat_map(|touch| &mut touch.samples) {
        sample.q.iter_mut().zip(&turns).filter(|at| *at.1).for_each(|(q, _)| *q *= factor);
    }
    let residual_of = |touches: &[RecordedTouch]| {
        let order: Vec<usize> = (0..robot.n_joints()).collect();
        let fits = fits(robot, &rests(touches, set.still_rad), &order, set);
        (fits.best.residual, fits.has_enough_gravity())
    };
    let (as_read, decides) = residual_of(touches);
    let (as_other, other_decides) = residual_of(&converted);
    let gravity_agrees = other_decides && as_other < 0.5 * as_read;
    let gravity_denies = decides && as_read < 0.5 * as_other;
    if gravity_denies || !(gravity_agrees || surely) {
        return None;
    }
    touches.clone_from_slice(&converted);
    let agrees = if gravity_agrees { ", and gravity fits far better in this unit" } else { "" };
    let (like, largest) = match unit {
        AngleUnit::Deg => ("degrees", largest),
        AngleUnit::Rad => ("radians, not degrees", largest.to_degrees()),
    };
    let reach = number(largest);
    Some((unit, format!("the angles look like {like}: half of the samples reach {reach}{agrees}")))
}
