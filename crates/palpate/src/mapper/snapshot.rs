//! Saving a mapper between two samples, and continuing it later.

use std::collections::HashMap;
use std::sync::Arc;

use super::sample_log::{LoggedTouch, SampleLog};
use super::{Mapper, MapperConfig, MapperError};
use crate::arm::Arm;
use crate::calibration::Calibration;
use crate::estimator::{EstimatorState, FrameId};
use crate::lattice::{CellId, CellRows};
use crate::torque::{Observation, ObservationBuilder};

/// Everything that is needed to continue a mapper, apart from the robot. [`Mapper::resume`] checks that it is
/// consistent.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Its settings.
    pub config: MapperConfig,
    /// The robot's name and [`Arm::fingerprint`].
    pub robot: (String, u64),
    /// Number of joints of its samples.
    pub n_joints: usize,
    /// Cells by row: those with their own prior mean, then the others in the order of first contact.
    pub cells: Vec<CellId>,
    /// Prior means of the first rows, N/m; empty without prior means by cell.
    pub prior_means_n_per_m: Vec<f64>,
    /// State of the estimator.
    pub state: EstimatorState,
    /// Number of touches begun so far.
    pub touches: u32,
    /// Samples of the touches with remembered frames, and of the one under way.
    pub sample_log: Vec<LoggedTouch>,
    /// Number of learnt touches that are no longer in `sample_log`.
    pub gone: u32,
    /// Time of the last learnt sample of a touch under way, s.
    pub learnt_s: Option<f64>,
    /// Calibration of the prediction bands, if there is one.
    pub calibration: Option<Calibration>,
}

impl Snapshot {
    /// Checks that the arm is the one of the snapshot, by its fingerprint.
    ///
    /// # Errors
    ///
    /// [`MapperError::OtherRobot`].
    pub fn check_arm(&self, arm: &Arm) -> Result<(), MapperError> {
        let (learnt, fingerprint) = &self.robot;
        if *fingerprint == arm.fingerprint() {
            return Ok(());
        }
        let (learnt, given) = (learnt.clone(), arm.robot.name().to_owned());
        Err(MapperError::OtherRobot { learnt, given })
    }
}

impl Mapper {
    /// Everything needed to continue later as if mapping had never stopped, to the bit.
    pub fn snapshot(&self) -> Snapshot {
        let mut state = self.replays.estimator().state(self.observations.rows().len());
        state.remembered.retain(|frame| !self.log.is_lost(frame.id.touch));
        let remembered: Vec<FrameId> = state.remembered.iter().map(|frame| frame.id).collect();
        let arm = self.tracker.arm();
        let (sample_log, gone) = self.log.needed_by(&remembered, (0, self.tracker.is_in_touch()));
        Snapshot {
            config: self.config.clone(),
            robot: (arm.robot.name().to_owned(), arm.fingerprint()),
            n_joints: arm.robot.n_joints(),
            cells: self.observations.rows().cells().to_vec(),
            prior_means_n_per_m: self.prior_means_n_per_m.clone(),
            sample_log,
            touches: self.log.begun(),
            gone,
            learnt_s: self.tracker.is_in_touch().then(|| self.tracker.learnt_s()).flatten(),
            calibration: self.calibration().cloned(),
            state,
        }
    }

    /// Continues from a snapshot as if mapping had never stopped.
    ///
    /// Replays are made in the background, whatever the policy was ([`Mapper::with_replays`]); replays that were left
    /// for spare time are dropped. The contacts of the remembered frames are simulated again from the sample log, which
    /// costs about as much as predicting those touches.
    ///
    /// # Errors
    ///
    /// If the arm is not the one of the snapshot, or the snapshot contradicts itself.
    pub fn resume(arm: Arc<Arm>, snapshot: Snapshot) -> Result<Self, MapperError> {
        let resumed = Self::resume_unless_stopped(arm, snapshot, || true)?;
        Ok(resumed.expect("nothing stops it"))
    }

    /// As [`Mapper::resume`]. `goes_on` is called after every sample of the sample log; when it returns false, resuming
    /// stops and `None` is returned.
    ///
    /// # Errors
    ///
    /// As [`Mapper::resume`].
    pub fn resume_unless_stopped(
        arm: Arc<Arm>,
        snapshot: Snapshot,
        goes_on: impl FnMut() -> bool,
    ) -> Result<Option<Self>, MapperError> {
        snapshot.check_arm(&arm)?;
        let n_joints = arm.robot.n_joints();
        let mut mapper = Self::new(arm, snapshot.config)?.with_calibration(snapshot.calibration);
        if let Some(calibration) = mapper.calibration() {
            calibration.check(n_joints).map_err(inconsistent)?;
        }
        let lattice = &mapper.config.lattice;
        if let Some(cell) = snapshot.cells.iter().find(|cell| !lattice.contains(**cell)) {
            return Err(inconsistent(format!("cell {} is not in the lattice", cell.0)));
        }
        let rows = CellRows::of(lattice.clone(), &snapshot.cells);
        if snapshot.prior_means_n_per_m.len() > rows.len() {
            let what = "it has more prior means than cells";
            return Err(inconsistent(what.to_owned()));
        }
        mapper.observations = ObservationBuilder::new(rows);
        mapper.prior_means_n_per_m = snapshot.prior_means_n_per_m;
        let simulated = mapper.simulate_again(&snapshot.sample_log, &snapshot.state, goes_on)?;
        let Some(observations) = simulated else { return Ok(None) };
        mapper.tracker.set_learnt_s(snapshot.learnt_s);
        let points_m = mapper.observations.rows().points_m();
        mapper.replays.estimator().restore(&snapshot.state, points_m, observations)?;
        if !snapshot.sample_log.last().is_some_and(|touch| touch.open) {
            mapper.tracker.end_touch()?; // the last logged touch is over
        }
        let remembered = snapshot.state.remembered.iter().map(|frame| frame.id);
        let counts = (snapshot.touches, snapshot.gone);
        mapper.log = SampleLog::resume(snapshot.sample_log, counts, remembered, n_joints);
        Ok(Some(mapper))
    }

    /// The observations of the remembered frames, in their order, from the logged touches; also determines whether the
    /// last sample was learnt from.
    fn simulate_again(
        &mut self,
        sample_log: &[LoggedTouch],
        state: &EstimatorState,
        mut goes_on: impl FnMut() -> bool,
    ) -> Result<Option<Vec<Observation>>, MapperError> {
        let n_joints = self.tracker.arm().robot.n_joints();
        let mut found: Vec<Option<Observation>> = vec![None; state.remembered.len()];
        let ids = state.remembered.iter().enumerate().map(|(index, frame)| (frame.id, index));
        let index_of: HashMap<FrameId, usize> = ids.collect();
        let mut learnt = false;
        for logged in sample_log {
            let LoggedTouch { touch, open, q, tau, tau_std, .. } = logged;
            let stds = tau_std.len();
            if q.len() != tau.len() || q.len() % n_joints != 0 || (stds != 0 && stds != q.len()) {
                return Err(inconsistent(format!(
                    "positions and torques of touch {touch} are not n × {n_joints}"
                )));
            }
            self.tracker.begin_touch();
            for (number, sample) in logged.samples(n_joints).enumerate() {
                let tracked = self.tracker.feed(&sample)?;
                let is_frame = tracked.external.is_some() && !tracked.contacts.is_empty();
                learnt = *open && tracked.is_learnt && is_frame;
                let frame = FrameId { touch: *touch, sample: number as u32 };
                if let (Some(&index), Some(external)) = (index_of.get(&frame), &tracked.external) {
                    let robot = &self.tracker.arm().robot;
                    let (poses, contacts) = (&tracked.poses, &tracked.contacts);
                    let observation = self.observations.build(robot, poses, contacts, external);
                    found[index] = Some(match self.weights(&tracked) {
                        Some(weights) => observation.weighted(&weights),
                        None => observation,
                    });
                }
                if !goes_on() {
                    return Ok(None);
                }
            }
        }
        self.replays.set_learnt(learnt);
        let missing = || inconsistent("the sample log lacks a remembered frame".to_owned());
        found.into_iter().map(|frame| frame.ok_or_else(missing)).collect::<Result<_, _>>().map(Some)
    }
}

fn inconsistent(what: String) -> MapperError {
    MapperError::Snapshot { what }
}
