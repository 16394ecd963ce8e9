//! What a field says of the cells that tracked touches meet, by their rows.

use palpate::unstable::{Cell, CellRows};
use palpate::{CellEstimate, Field};

use crate::calibrate::PredictedFrame;
use crate::tracked::{Tracked, TrackedFrame};

/// The cells of tracked touches as a field has them.
pub(crate) struct FieldRows {
    pub(crate) estimates: Vec<CellEstimate>,
    pub(crate) cells: Vec<Cell>,
}

impl FieldRows {
    /// `untouched_std_n_per_m` is the standard deviation of cells that the field does not know.
    pub(crate) fn of(tracked: &Tracked, field: &Field, untouched_std_n_per_m: f64) -> Self {
        let rows = CellRows::of(field.lattice.clone(), &field.cells);
        let known = tracked.cells.iter().map(|cell| rows.find(*cell));
        let estimates: Vec<CellEstimate> =
            known.map(|row| field.estimate(row, untouched_std_n_per_m)).collect();
        let cells = tracked.with_stiffness(|row| estimates[row].stiffness_n_per_m);
        Self { estimates, cells }
    }

    /// What the field says of a frame.
    pub(crate) fn predicted(&self, frame: &TrackedFrame) -> PredictedFrame {
        let of_row = |row: usize| (self.estimates[row].std_n_per_m, self.estimates[row].count > 0);
        PredictedFrame::of(frame, &self.cells, of_row)
    }

    /// Share of the contacts of frames that the field knows; 0 without any.
    pub(crate) fn known<'f>(&self, frames: impl Iterator<Item = &'f TrackedFrame>) -> f64 {
        let rows = frames.flat_map(|frame| frame.observation.rows());
        let [all, known] = rows.fold([0.0; 2], |[all, known], row| {
            [all + 1.0, known + f64::from(self.estimates[row].count > 0)]
        });
        if all > 0.0 { known / all } else { 0.0 }
    }
}
