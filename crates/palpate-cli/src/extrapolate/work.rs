//! The work of an extrapolation: touches followed again, stiffness carried over, halves compared.

use std::path::Path;
use std::sync::Arc;

use nalgebra::DVector;
use palpate::arm::Arm;
use palpate::mapper::Config as MapperConfig;
use palpate_io::cloud::Cloud;
use palpate_io::field::Saved;
use palpate_learn::extrapolate::compare::{CompareError, Plan, Row};
use palpate_learn::extrapolate::{Config, Extrapolation, Seen, extrapolate};
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
}

/// What was found.
pub(crate) struct Found {
    pub(crate) seen: Seen,
    pub(crate) extrapolation: Extrapolation,
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
        let felt = if felt::remembers(self.saved) {
            Some(felt::recalled(self.saved, self.names[0], self.arm, output)?)
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
        let rows = match (self.halves, &felt) {
            (Some(halves), Some((tracked, mapper))) => {
                let compared = self.compared(halves, (tracked, mapper), &seen, output);
                Some(compared.map_err(|error| match error {
                    _ if interrupt::pressed() => stopped(),
                    other => fault(&other),
                })?)
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
            seen,
            extrapolation,
            rows,
        })
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

/// Ended by Ctrl-C.
pub(super) fn stopped() -> CliError {
    CliError::Interrupted { kept: "; nothing was written".to_owned() }
}

/// Where a touch is felt most, rad.
fn deepest(touch: &TrackedTouch) -> Option<Vec<f64>> {
    let torque = |tau: &[f64]| DVector::from_column_slice(tau).norm();
    let deepest =
        touch.frames.iter().max_by(|a, b| torque(&a.target).total_cmp(&torque(&b.target)));
    deepest.map(|frame| frame.q.clone())
}
