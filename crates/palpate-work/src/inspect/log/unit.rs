//! Degrees taken for radians, or the other way round.

use std::f64::consts::TAU;

use palpate::unstable::JointKind;
use palpate::{ExternalTorqueConfig, Robot};
use palpate_io::log::AngleUnit;

use super::super::finding::Finding;
use super::super::words::{number, word};
use super::reading::{fits, rests};
use crate::touches::RecordedTouch;

/// Beyond two turns, angles in radians are suspicious.
const SUSPICIOUS_RAD: f64 = 2.0 * TAU;
/// Beyond four turns they are degrees if gravity does not say otherwise.
const SURELY_RAD: f64 = 4.0 * TAU;

/// Converts the touches to radians if they were read in the wrong unit, and says so.
pub(super) fn correct(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    read_as: AngleUnit,
    set: &ExternalTorqueConfig,
) -> (AngleUnit, Option<Finding>) {
    let turns: Vec<bool> =
        robot.joints().iter().map(|joint| joint.kind != JointKind::Prismatic).collect();
    let samples = touches.iter().flat_map(|touch| &touch.samples);
    let angles = samples.flat_map(|sample| sample.q.iter().zip(&turns).filter(|at| *at.1));
    let largest = angles.map(|(angle, _)| angle.abs()).fold(0.0, f64::max);
    let (factor, unit, suspicious, surely) = match read_as {
        AngleUnit::Rad => {
            (1.0_f64.to_radians(), AngleUnit::Deg, largest > SUSPICIOUS_RAD, largest > SURELY_RAD)
        }
        // Read as degrees, a whole turn of radians is a tenth of one.
        AngleUnit::Deg => {
            let suspicious = largest > 0.0 && largest < TAU.to_radians();
            (1.0_f64.to_degrees(), AngleUnit::Rad, suspicious, false)
        }
    };
    if !suspicious {
        return (read_as, None);
    }
    let mut converted = touches.to_vec();
    for sample in converted.iter_mut().flat_map(|touch| &mut touch.samples) {
        sample.q.iter_mut().zip(&turns).filter(|at| *at.1).for_each(|(q, _)| *q *= factor);
    }
    let left_over = |touches: &[RecordedTouch]| {
        let order: Vec<usize> = (0..robot.n_joints()).collect();
        let fits = fits(robot, &rests(touches, set.still_rad), &order, set);
        (fits.best.left_over, fits.tell())
    };
    let ((as_read, tells), (as_other, other_tells)) = (left_over(touches), left_over(&converted));
    let gravity_agrees = other_tells && as_other < 0.5 * as_read;
    let gravity_denies = tells && as_read < 0.5 * as_other;
    if gravity_denies || !(gravity_agrees || surely) {
        return (read_as, None);
    }
    touches.clone_from_slice(&converted);
    (unit, Some(wrong_unit(largest, unit, gravity_agrees)))
}

fn wrong_unit(largest_rad: f64, unit: AngleUnit, gravity_agrees: bool) -> Finding {
    let agrees = if gravity_agrees { ", and gravity fits far better so" } else { "" };
    let (like, largest) = match unit {
        AngleUnit::Deg => ("degrees", largest_rad),
        AngleUnit::Rad => ("radians, not degrees", largest_rad.to_degrees()),
    };
    let what = format!("the angles look like {like}: they go up to {}{agrees}", number(largest));
    let unit = word(unit);
    let remedy = format!("use --angle-unit {unit}; below, they are read so");
    Finding::warning("angle_unit", what, remedy).try_flags(&["--angle-unit", &unit])
}
