//! Forgetting touches: the mapper that would result if they had never been learnt.
//!
//! A mapper keeps the samples of the touches that it remembers, and learning takes a thousandth of the time of
//! touching. So all other touches are learnt again, in their order: stiffness, standard deviations, counts and memory
//! are equal to the bit to those of a mapper that never learnt the forgotten touches.
//! [`crate::unstable::MapEstimator::forget`] removes single remembered frames, but neither their effect on standard
//! deviations nor condensed frames.

use std::collections::HashSet;
use std::sync::Arc;

use super::{Mapper, MapperError, Snapshot};
use crate::arm::Arm;

impl Mapper {
    /// Rebuilds the mapper of a snapshot without some of its touches, given by their numbers
    /// ([`super::LoggedTouch::touch`]).
    ///
    /// The other touches keep their numbers. `step` is called after every sample; when it returns false, rebuilding
    /// stops and `None` is returned.
    ///
    /// # Errors
    ///
    /// If a number is not in the sample log, if the samples of another learnt touch are gone, so that it would be
    /// forgotten as well ([`Snapshot::gone`]), if the arm is not that of the snapshot, or the snapshot is inconsistent.
    pub fn without(
        arm: Arc<Arm>,
        snapshot: &Snapshot,
        touches: &[u32],
        mut step: impl FnMut() -> bool,
    ) -> Result<Option<Self>, MapperError> {
        snapshot.check_arm(&arm)?;
        let inconsistent = |what: String| MapperError::Snapshot { what };
        let known: HashSet<u32> = snapshot.sample_log.iter().map(|logged| logged.touch).collect();
        if let Some(unknown) = touches.iter().find(|touch| !known.contains(touch)) {
            return Err(inconsistent(format!("touch {unknown} is not in its sample log")));
        }
        if snapshot.gone > 0 {
            return Err(MapperError::Gone { touches: snapshot.gone });
        }
        let n_joints = arm.robot.n_joints();
        let prior: Vec<_> = snapshot
            .cells
            .iter()
            .copied()
            .zip(snapshot.prior_means_n_per_m.iter().copied())
            .collect();
        let mut mapper = Self::with_prior(arm, snapshot.config.clone(), &prior)?
            .with_calibration(snapshot.calibration.clone());
        for logged in snapshot.sample_log.iter().filter(|logged| !touches.contains(&logged.touch)) {
            mapper.log.number_next(logged.touch);
            mapper.begin_touch();
            mapper.name_touch(&logged.name);
            for sample in logged.samples(n_joints) {
                mapper.step(&sample)?;
                if !step() {
                    return Ok(None);
                }
            }
            if logged.open {
                mapper.tracker.set_learnt_s(snapshot.learnt_s);
            } else {
                mapper.end_touch()?;
            }
        }
        mapper.log.number_next(snapshot.touches);
        Ok(Some(mapper))
    }
}
