//! The work of an extrapolation: touches followed again, stiffness carried over, halves compared.

use std::path::Path;
use std::sync::Arc;

use nalgebra::DVector;
use palpate::arm::Arm;
use palpate::lattice::CellId;
use palpate::mapper::Config as MapperConfig;
use palpate_io::cloud::Cloud;
use palpate_io::field::Saved;
use palpate_learn::extrapolate::compare::{CompareError, Plan, Row};
use palpate_learn::extrapolate::{Config, Extrapolation, Method, Seen, extrapolate};
use palpate_learn::tracked::{Tracked, TrackedTouch};

use super::felt;
use crate::error::CliError;
use crate::interrupt;
use crate::output::Output;

/// What there is to do.
pub(crate) struct Work<'a> {
    pub(crate) arm: &'a Arc<Arm>,
    pub(crate) saved: &'a Saved,
    /// Field and cloud as the user calls them.
    pub(crate) names: [&'a Path; 2],
    pub(crate) cloud: &'a Cloud,
    pub(crate) config: Config,
    /// Random halves to compare on, if any.
    pub(crate) halves: Option<u32>,
    /// Whether the arm is to be drawn in its touches.
    pub(crate) drawn: bool,
    /// What is said to be kept on Ctrl-C.
    pub(crate) kept: &'a str,
}

/// What was found.
pub(crate) struct Found {
    pub(crate) seen: Seen,
    pub(crate) extrapolation: Extrapolation,
    /// Cells of the field's lattice at seen points, each with its expected stiffness, N/m.
    pub(crate) cells: Vec<(CellId, f64)>,
    /// Touches and frames in contact that the field remembers.
    pub(crate) felt: Option<(usize, usize)>,
    /// Joint positions of each remembered touch where the torque is largest, rad.
    pub(crate) touching: Vec<Vec<f64>>,
    pub(crate) rows: Option<Vec<Row>>,
}

impl Work<'_> {
    /// Does it.
    ///
    /// # Errors
    ///
    /// If the field was learnt with another robot, or the cloud is not where it was learnt.
    pub(crate) fn run(&self, output: &Output) -> Result<Found, CliError> {
        let colours = self.cloud.colours().expect("a cloud without colours was refused");
        let seen = Seen::new(self.cloud.points(), colours).map_err(CliError::file)?;
        let wanted = self.config.method == Method::Torque || self.halves.is_some() || self.drawn;
        let felt = if wanted && felt::remembers(self.saved) {
            let recalled = felt::recalled(self.saved, self.names[0], self.arm, output);
            self.unless_stopped()?;
            Some(recalled?)
        } else {
            None
        };
        let tracked = felt.as_ref().map(|(tracked, _)| tracked);
        let fault = |error: &dyn std::error::Error| {
            let [field, cloud] = self.names.map(Path::display);
            CliError::from(format!("`{field}` and `{cloud}`: {error}"))
        };
        let extrapolation = extrapolate(&seen, &self.saved.field, tracked, &self.config);
        let extrapolation = extrapolation.map_err(|error| fault(&error))?;
        self.unless_stopped()?;
        let rows = match (self.halves, &felt) {
            (Some(halves), Some((tracked, mapper))) => {
                let compared = self.compared(halves, (tracked, mapper), &seen, output);
                self.unless_stopped()?;
                Some(compared.map_err(|error| fault(&error))?)
            }
            _ => None,
        };
        let touching = tracked.iter().flat_map(|tracked| &tracked.touches).filter_map(deepest);
        Ok(Found {
            touching: touching.collect(),
            felt: tracked.map(|tracked| {
                let frames = tracked.touches.iter().map(TrackedTouch::frames_in_contact).sum();
                (tracked.touches.len(), frames)
            }),
            cells: extrapolation.cells(&seen, &self.saved.field.lattice, &self.config),
            seen,
            extrapolation,
            rows,
        })
    }

    /// An error after Ctrl-C.
    fn unless_stopped(&self) -> Result<(), CliError> {
        if interrupt::pressed() {
            return Err(CliError::Interrupted { kept: format!("; {}", self.kept) });
        }
        Ok(())
    }

    /// The comparison on halves, with a bar.
    fn compared(
        &self,
        halves: u32,
        (tracked, mapper): (&Tracked, &MapperConfig),
        seen: &Seen,
        output: &Output,
    ) -> Result<Vec<Row>, CompareError> {
        let plan = Plan { halves, ..Plan::of(self.config.clone()) };
        let bar = output.progress_of(Some(u64::from(halves)), "halves", "comparing");
        let rows = plan.run(tracked, seen, mapper, &interrupt::pressed, &|| bar.inc(1));
        bar.finish_and_clear();
        rows
    }
}

/// Where a touch is felt most, rad.
fn deepest(touch: &TrackedTouch) -> Option<Vec<f64>> {
    let torque = |tau: &[f64]| DVector::from_column_slice(tau).norm();
    let deepest =
        touch.frames.iter().max_by(|a, b| torque(&a.target).total_cmp(&torque(&b.target)));
    deepest.map(|frame| frame.q.clone())
}
