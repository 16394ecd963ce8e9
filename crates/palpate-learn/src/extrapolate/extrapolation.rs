//! Extrapolates the stiffness of a field to a cloud.

use palpate::{CellId, Field, Lattice};

use super::cloud::SeenCloud;
use super::config::{ExtrapolationConfig, ExtrapolationMethod};
use super::error::ExtrapolateError;
use super::process::{Evidence, Posterior, Process};
use super::{cells, knn, torque_evidence};
use crate::tracked::TrackedTouches;

/// A stiffness for every seen point.
#[derive(Debug, Clone, PartialEq)]
pub struct Extrapolation {
    /// Stiffness of a cell at each point, N/m, at least 0.
    pub stiffness_n_per_m: Vec<f64>,
    /// Standard deviation of the regression over features, N/m, without the variation between points of equal features.
    pub std_n_per_m: Vec<f64>,
    /// Whether the cell in which each point lies was touched.
    pub touched: Vec<bool>,
}

/// Extrapolates the stiffness of a field to all seen points.
///
/// `tracked` are the touches that the field was learnt from; only the method `torque` needs them.
///
/// # Errors
///
/// If a setting is out of its range, the cloud is not where the field was touched, or there are no
/// touches to learn torques from.
pub fn extrapolate(
    seen: &SeenCloud,
    field: &Field,
    tracked: Option<&TrackedTouches>,
    config: &ExtrapolationConfig,
) -> Result<Extrapolation, ExtrapolateError> {
    config.check()?;
    let (lattice, reach_m) = (&field.lattice, config.reach_m(&field.lattice));
    let (rows, touched_m) = touched_cells(field);
    seen.must_meet(&touched_m, reach_m)?;
    let features = config.features.of(seen);
    let prior_std = config.prior_std(lattice);
    let (stiffness_n_per_m, std_n_per_m) = match config.method {
        ExtrapolationMethod::Torque => {
            let has_contact = |tracked: &&TrackedTouches| {
                tracked.touches.iter().any(|touch| touch.frames_in_contact() > 0)
            };
            let tracked = tracked.filter(has_contact).ok_or(ExtrapolateError::NoTorques)?;
            // The field may have cells of touches that it no longer remembers.
            seen.must_meet(&tracked.points_m, reach_m)?;
            let process = Process::new(features, config.length_scale);
            let at = seen.at(&tracked.points_m, reach_m);
            let evidence = torque_evidence::evidence(tracked, &process, &at);
            let all: Vec<&Evidence> = evidence.iter().collect();
            let posterior = torque_evidence::posterior(&all, prior_std, config.torque_std);
            process.at_all_points(&posterior)
        }
        ExtrapolationMethod::Cells => {
            let process = Process::new(features, config.length_scale);
            let at = seen.at(&touched_m, reach_m);
            let evidence = cells::evidence(field, &process, &rows, &at);
            process.at_all_points(&Posterior::new(&evidence, prior_std, prior_std))
        }
        ExtrapolationMethod::Knn => {
            let at = seen.at(&touched_m, reach_m);
            let known = cells::of_points(field, seen, (&rows, &at));
            let neighbours = config.neighbours as usize;
            knn::at_all_points(&features, &known, neighbours, config.neighbour_scale)
        }
    };
    let touched = cells::touched(field, seen);
    Ok(Extrapolation { stiffness_n_per_m, std_n_per_m, touched })
}

/// The touched rows of a field, and their rest points, m.
fn touched_cells(field: &Field) -> (Vec<usize>, Vec<[f64; 3]>) {
    let touched = |row: &usize| field.counts[*row] > 0;
    let rows: Vec<usize> = (0..field.cells.len()).filter(touched).collect();
    let points = rows.iter().map(|&row| field.lattice.point(field.cells[row]).into()).collect();
    (rows, points)
}

impl Extrapolation {
    /// Prior means for the cells of a lattice that are near seen points, in the lattice's order: each
    /// has the stiffness of the nearest point, N/m.
    pub fn cells(
        &self,
        seen: &SeenCloud,
        lattice: &Lattice,
        config: &ExtrapolationConfig,
    ) -> Vec<(CellId, f64)> {
        let cells = seen.cells(lattice, config.reach_m(lattice));
        let stiffness = |point: u32| self.stiffness_n_per_m[point as usize];
        cells.into_iter().map(|(cell, point)| (cell, stiffness(point))).collect()
    }
}
