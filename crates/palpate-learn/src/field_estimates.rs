//! Estimates of a field for the cells of tracked touches, indexed by their rows.

use palpate::unstable::{CellRows, CellState, spring_variance};
use palpate::{CellEstimate, Field};

use crate::calibrate::PredictedFrame;
use crate::tracked::{TrackedFrame, TrackedTouches};

/// Estimates of a field for the cells of tracked touches, indexed by row of [`TrackedTouches`].
pub(crate) struct FieldEstimates {
    pub(crate) estimates: Vec<CellEstimate>,
    pub(crate) cells: Vec<CellState>,
    /// ρ of the field's bands ([`palpate::Calibration`]); 0 without bands for these joints.
    relative_std: f64,
}

impl FieldEstimates {
    /// `untouched_std_n_per_m` is the standard deviation of cells that are not in the field.
    pub(crate) fn of(tracked: &TrackedTouches, field: &Field, untouched_std_n_per_m: f64) -> Self {
        let rows = CellRows::of(field.lattice.clone(), &field.cells);
        let known = tracked.cells.iter().map(|cell| rows.find(*cell));
        let estimates: Vec<CellEstimate> =
            known.map(|row| field.estimate(row, untouched_std_n_per_m)).collect();
        let cells = tracked.with_stiffness(|row| estimates[row].stiffness_n_per_m);
        let calibration = field.calibration.as_ref();
        let calibration = calibration.filter(|own| own.check(tracked.n_joints).is_ok());
        let relative_std = calibration.map_or(0.0, |own| own.relative_std);
        Self { estimates, cells, relative_std }
    }

    /// Torque and spread that the field predicts for a frame.
    pub(crate) fn predicted(&self, frame: &TrackedFrame) -> PredictedFrame {
        let of_row = |row: usize| {
            let CellEstimate { stiffness_n_per_m, std_n_per_m, count, .. } = self.estimates[row];
            (spring_variance(self.relative_std, stiffness_n_per_m, std_n_per_m.powi(2)), count > 0)
        };
        PredictedFrame::of(frame, &self.cells, of_row)
    }

    /// Share of the contacts of frames whose cells were touched in the field; 0 without contacts.
    pub(crate) fn known<'f>(&self, frames: impl Iterator<Item = &'f TrackedFrame>) -> f64 {
        let rows = frames.flat_map(|frame| frame.observation.rows());
        let [all, known] = rows.fold([0.0; 2], |[all, known], row| {
            [all + 1.0, known + f64::from(self.estimates[row].count > 0)]
        });
        if all > 0.0 { known / all } else { 0.0 }
    }
}
