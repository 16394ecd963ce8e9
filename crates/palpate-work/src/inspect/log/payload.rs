//! Finds a payload at the arm's end that explains torques which the robot's own gravity does not.
//!
//! A payload of mass m and centre of mass c adds `m·a₀ + Σ m·cᵢ·aᵢ` to the torque of gravity,
//! linear in m and m·c. The columns come from the robot itself, carrying one kilogram at the
//! link's origin and one metre beside it.

use nalgebra::{DMatrix, DVector};
use palpate::{Payload, Robot, Sample};

use super::reading::ConventionFit;
use crate::quantile::median;

/// The residual with the payload must be less than this part of the residual without it.
const EXPLAINS: f64 = 0.4;
/// Plausible range of the mass of a payload that is not given, kg.
const BELIEVABLE_KG: [f64; 2] = [0.05, 50.0];
/// Largest plausible coordinate of the centre of mass in the frame of the link, m.
const FARTHEST_M: f64 = 0.5;
/// Singular values below this part of the largest count as zero: the touches do not determine these directions.
const MIN_SINGULAR: f64 = 0.03;

/// The payload at the last link that explains the residual, if one does.
pub(super) fn explain(robot: &Robot, rests: &[Sample], fit: &ConventionFit) -> Option<Payload> {
    let link = robot.joints().last()?.child;
    let link = &robot.links()[link.index()].name;
    let carrying = |mass_kg: f64, com_link_m: [f64; 3]| {
        robot.clone().with_payload(&Payload::new(link, mass_kg, com_link_m)).ok()
    };
    let mut units = vec![carrying(1.0, [0.0; 3])?];
    for axis in 0..3 {
        let mut com_link_m = [0.0; 3];
        com_link_m[axis] = 1.0;
        units.push(carrying(1.0, com_link_m)?);
    }
    let n = robot.n_joints();
    let mut columns = DMatrix::zeros(n * rests.len(), 4);
    let mut wanted = DVector::zeros(n * rests.len());
    for (row, rest) in rests.iter().enumerate() {
        let gravity = |robot: &Robot| Some(robot.gravity_torque(&robot.forward(&rest.q).ok()?));
        let bare = gravity(robot)?;
        let at_origin = gravity(&units[0])?;
        let tau = DVector::from_column_slice(&rest.tau) * super::sign(fit.torque_sign);
        wanted.rows_mut(row * n, n).copy_from(&(tau - &bare));
        columns.view_mut((row * n, 0), (n, 1)).copy_from(&(&at_origin - bare));
        for axis in 0..3 {
            let beside = gravity(&units[1 + axis])? - &at_origin;
            columns.view_mut((row * n, 1 + axis), (n, 1)).copy_from(&beside);
        }
    }
    let svd = columns.clone().svd(true, true);
    let solved = svd.solve(&wanted, MIN_SINGULAR * svd.singular_values.max()).ok()?;
    let median_norm = |residual: &DVector<f64>| {
        let norms = residual.as_slice().chunks(n).map(|r| DVector::from_column_slice(r).norm());
        median(&norms.collect::<Vec<_>>()).unwrap_or(0.0)
    };
    let explained = median_norm(&(&wanted - &columns * &solved)) < EXPLAINS * median_norm(&wanted);
    let mass_kg = solved[0];
    let com_link_m = [1, 2, 3].map(|row| solved[row] / mass_kg);
    let [least, most] = BELIEVABLE_KG;
    let believable =
        (least..=most).contains(&mass_kg) && com_link_m.iter().all(|side| side.abs() < FARTHEST_M);
    (explained && believable).then(|| Payload::new(link, mass_kg, com_link_m))
}
