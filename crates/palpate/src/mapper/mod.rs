//! The loop: one sample in, one report out (Sec. II).
//!
//! [`Mapper`] learns a [`Field`] from touches: it simulates what the arm displaces, predicts the torque,
//! corrects the field by the measured one, and replays remembered frames. It can be saved at any sample
//! and continued as if it had never stopped ([`Snapshot`]). The module opens no file; palpate-io writes
//! snapshots and fields.

mod relearn;
mod sample_log;
mod snapshot;

use std::sync::Arc;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

pub use self::relearn::{LogPosition, TouchLog};
pub use self::sample_log::{LoggedTouch, NO_STD};
pub use self::snapshot::Snapshot;

use self::sample_log::SampleLog;
use crate::arm::Arm;
use crate::calibration::{Calibration, LearntTorques};
use crate::contact::{ContactConfig, Contacts};
use crate::ekf::EkfEstimator;
use crate::estimator::{
    CellEstimate, Estimator, EstimatorConfig, EstimatorError, EstimatorKind, FrameId, padded,
};
use crate::external_torque::ExternalTorqueConfig;
use crate::field::Field;
use crate::lattice::{CellId, Lattice};
use crate::map::MapEstimator;
use crate::path_predictor::{PathChecker, PathPredictor, Springs};
use crate::prior_means::{self, PriorMeansError};
use crate::replay::{ReplayPolicy, Replays};
use crate::robot::RobotError;
use crate::setting::SettingError;
use crate::torque::ObservationBuilder;
use crate::tracker::{Sample, TrackedSample, Tracker, TrackerError, torque_weights};

/// All settings that determine what is learnt from a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct MapperConfig {
    /// The workspace box.
    pub lattice: Lattice,
    /// The contact model.
    pub contact: ContactConfig,
    /// Sign, gravity and tare of the torques.
    pub touch: ExternalTorqueConfig,
    /// The estimator.
    pub method: EstimatorKind,
    /// Its settings.
    pub estimator: EstimatorConfig,
}

impl MapperConfig {
    /// The default settings of an estimator, in the workspace box of the paper.
    pub fn of(method: EstimatorKind) -> Self {
        Self {
            lattice: Lattice::default(),
            contact: ContactConfig::default(),
            touch: ExternalTorqueConfig::default(),
            method,
            estimator: EstimatorConfig::of(method),
        }
    }

    /// A new estimator with these settings, for torques of `n_joints` joints.
    ///
    /// # Errors
    ///
    /// If a setting of the estimator is out of its range.
    pub fn estimator(&self, n_joints: usize) -> Result<Box<dyn Estimator>, EstimatorError> {
        let (config, spacing_m) = (&self.estimator, self.lattice.spacing_m());
        Ok(match self.method {
            EstimatorKind::Map | EstimatorKind::Elastic => {
                Box::new(MapEstimator::new(config, spacing_m, n_joints)?)
            }
            EstimatorKind::Ekf => Box::new(EkfEstimator::new(config, spacing_m, n_joints)?),
        })
    }
}

/// What can go wrong in mapping.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum MapperError {
    #[error(transparent)]
    Tracker(#[from] TrackerError),
    #[error(transparent)]
    Setting(#[from] SettingError),
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    #[error(transparent)]
    PriorMeans(#[from] PriorMeansError),
    /// A snapshot of another robot.
    #[error(
        "the field was learnt with robot `{learnt}`, of which `{given}` differs in joints, masses \
         or shapes; continue with the same robot, or start a new field"
    )]
    OtherRobot { learnt: String, given: String },
    /// Learnt touches whose samples are no longer in memory.
    #[error(
        "the samples of {touches} touches that the field has learnt from are no longer in its memory, so these touches \
         would be forgotten as well; map again only the logs to keep, or map all logs with more memory (`memory_mib`)"
    )]
    Gone { touches: u32 },
    /// The same, where all touches are to be learnt again.
    #[error(
        "learnt touches ({touches}) are no longer in memory, so they cannot be learnt again; raise `memory_mib`"
    )]
    NotLogged { touches: u32 },
    /// A snapshot that contradicts itself.
    #[error("the saved mapper is inconsistent: {what}")]
    Snapshot { what: String },
}

impl From<RobotError> for MapperError {
    fn from(error: RobotError) -> Self {
        Self::Tracker(error.into())
    }
}

/// Largest number of remembered frames from which the residual on learnt touches is computed.
const ERROR_FRAMES: usize = 200;

/// Result of one step.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct StepReport {
    /// Number of touched points.
    pub contacts: usize,
    /// τ_ext, n_joints, N·m; `None` while the tare is being taken.
    pub external: Option<DVector<f64>>,
    /// τ̂ before the sample was learnt from, n_joints, N·m; `None` if `external` is `None`.
    pub predicted: Option<DVector<f64>>,
    /// Half-width of the band for the largest torque around `predicted`, n_joints, N·m; only with
    /// [`Mapper::with_band`].
    pub peak_half_width: Option<DVector<f64>>,
}

/// Learns a stiffness field from samples.
pub struct Mapper {
    config: MapperConfig,
    tracker: Tracker,
    observations: ObservationBuilder,
    replays: Replays,
    /// Prior means of the rows with their own prior mean, N/m.
    prior_means_n_per_m: Vec<f64>,
    log: SampleLog,
    calibration: Option<Calibration>,
    /// Bands of other objects, updated at the end of each touch.
    others: Option<Calibration>,
    /// Level of the band that steps report.
    band: Option<f64>,
}

impl Mapper {
    /// A new mapper, without prior means by cell.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(arm: Arc<Arm>, config: MapperConfig) -> Result<Self, MapperError> {
        Self::with_prior(arm, config, &[])
    }

    /// A new mapper in which some cells have their own prior mean, N/m; all others have the prior mean of the settings.
    ///
    /// These cells get the first rows, in the lattice's order; [`Mapper::field`] lists them with a
    /// count of 0. With `ekf` a mean below the settings' prior mean is raised to it
    /// ([`Estimator::set_prior_means`]).
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, a cell outside the lattice or given twice, or a mean
    /// negative or not finite.
    pub fn with_prior(
        arm: Arc<Arm>,
        config: MapperConfig,
        prior: &[(CellId, f64)],
    ) -> Result<Self, MapperError> {
        let (rows, means) = prior_means::rows(&config.lattice, prior)?;
        let mut estimator = config.estimator(arm.robot.n_joints())?;
        estimator.set_prior_means(rows.points_m(), &means);
        // Read back, because `ekf` raises small means.
        let prior_means_n_per_m = (0..rows.len()).map(|row| estimator.stiffness(row)).collect();
        let (contact, touch) = (&config.contact, config.touch.clone());
        let per_frame = config.estimator.replays;
        Ok(Self {
            tracker: Tracker::new(arm, config.lattice.clone(), contact, touch)?,
            observations: ObservationBuilder::new(rows),
            replays: Replays::new(estimator, per_frame, ReplayPolicy::default()),
            prior_means_n_per_m,
            log: SampleLog::default(),
            calibration: None,
            others: None,
            band: None,
            config,
        })
    }

    /// Sets the policy of replays; by default they are made in the background.
    #[must_use]
    pub fn with_replays(mut self, policy: ReplayPolicy) -> Self {
        self.replays.set_policy(policy);
        self
    }

    /// Sets bands that were calibrated on held-out touches. Without them, fields have bands of other objects from the
    /// end of the first touch on ([`Calibration::of_other_objects`]). If the given bands are of other objects, the next
    /// touch replaces them, except for their misfits.
    #[must_use]
    pub fn with_calibration(mut self, calibration: Option<Calibration>) -> Self {
        (self.others, self.calibration) = match calibration {
            Some(others) if others.of_other_objects => (Some(others), None),
            own => (None, own),
        };
        self
    }

    /// Calibration of the prediction bands, if there is one.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.calibration.as_ref().or(self.others.as_ref())
    }

    /// Updates the bands of other objects to the touches learnt so far.
    fn update_bands(&mut self) {
        let n_joints = self.tracker.arm().robot.n_joints();
        let estimator = self.replays.estimator();
        let unweighted = |(frame, own): (FrameId, [DVector<f64>; 2])| {
            let tau_std = self.log.tau_std(frame, n_joints);
            let weights = tau_std.map(|std| torque_weights(std, &self.config.estimator.torque_std));
            let weights = DVector::from_vec(weights.unwrap_or(vec![1.0; n_joints]));
            own.map(|torque| torque.component_div(&weights).as_slice().to_vec())
        };
        let learnt = LearntTorques::of(estimator.errors(ERROR_FRAMES).into_iter().map(unweighted));
        let (touches, untouched_std) = (self.log.learnt(), estimator.std(usize::MAX));
        drop(estimator);
        let bands = |learnt| Calibration::of_other_objects(&learnt, touches, untouched_std);
        if let Some(others) = learnt.and_then(bands) {
            let misfits = self.others.take().map(|before| before.misfits).unwrap_or_default();
            self.others = Some(Calibration { misfits, ..others });
        }
    }

    /// Lets steps report the band around their predictions at a level; `None` if there is no band at that level
    /// ([`Calibration::at`]).
    #[must_use]
    pub fn with_band(mut self, level: f64) -> Option<Self> {
        let n_joints = self.tracker.arm().robot.n_joints();
        let calibration = self.calibration().filter(|own| own.check(n_joints).is_ok())?;
        calibration.at(level)?;
        self.band = Some(level);
        Some(self)
    }

    /// Starts a touch.
    pub fn begin_touch(&mut self) {
        self.log.begin_touch(&self.replays.estimator().frame_ids());
        self.tracker.begin_touch();
    }

    /// Names the touch under way ([`LoggedTouch::name`]).
    pub fn name_touch(&mut self, name: &str) {
        self.log.name(name);
    }

    /// Learns from one sample: simulate, predict, correct, replay (Sec. II). A sample within 45 ms of the last learnt
    /// one is only predicted: it has hardly any new information, but would count as an independent measurement.
    ///
    /// When replays are made depends on the [`ReplayPolicy`]; by default they run in the background while the next
    /// sample is simulated.
    ///
    /// # Errors
    ///
    /// If the sample cannot be used: it does not fit the robot, is not finite, or shows that the
    /// touch has no contact-free start. Nothing is learnt from it.
    pub fn step(&mut self, sample: &Sample) -> Result<StepReport, MapperError> {
        // Where the arm pushes the points of the field, and by how much (assumption ii).
        let tracked = self.tracker.feed(sample)?;
        self.replays.begin_step();
        let frame = self.record(sample, !tracked.is_learnt);
        let contacts = tracked.contacts.len();
        let Some(external) = &tracked.external else {
            return Ok(StepReport {
                contacts,
                external: None,
                predicted: None,
                peak_half_width: None,
            });
        };

        // What torque the field predicts there (Eqs. 2 and 5), and the correction of the touched cells
        // by the measured one (Eqs. 5 and 6).
        let (predicted, peak_half_width) = match contacts {
            0 => self.pass_without_contact(external.len(), tracked.is_learnt),
            _ => self.predict_and_correct(frame, &tracked, external)?,
        };

        // Remembered frames are fused again, so that they are not forgotten.
        if contacts > 0 && tracked.is_learnt {
            self.replays.replay();
        }
        let external = tracked.external;
        Ok(StepReport { contacts, external, predicted: Some(predicted), peak_half_width })
    }

    /// [`Mapper::step`] without the prediction of samples that are not learnt: these are checked, but not simulated, and
    /// `None` is returned. For logs at a high rate, where most samples are not learnt, this is much faster. The arm then
    /// moves straight from one learnt sample to the next.
    ///
    /// # Errors
    ///
    /// As [`Mapper::step`]; a jump of the arm to a sample that is passed over and back is not found.
    pub fn step_if_learnt(&mut self, sample: &Sample) -> Result<Option<StepReport>, MapperError> {
        match self.tracker.pass_over(sample)? {
            true => Ok(None),
            false => self.step(sample).map(Some),
        }
    }

    /// Predicts the torque of a frame and, if the frame is to be learnt, corrects the belief by the measured torque.
    /// Returns the prediction, and the half-width of its band if bands are reported, n_joints, N·m.
    fn predict_and_correct(
        &mut self,
        frame: FrameId,
        tracked: &TrackedSample,
        external: &DVector<f64>,
    ) -> Result<(DVector<f64>, Option<DVector<f64>>), EstimatorError> {
        let robot = &self.tracker.arm().robot;
        let (poses, contacts) = (&tracked.poses, &tracked.contacts);
        let observation = self.observations.build(robot, poses, contacts, external);
        let points_m = self.observations.rows().points_m();
        let calibration = self.band.and_then(|_| self.calibration());
        let relative_std = calibration.map(|own| own.relative_std);
        let beside = relative_std.map(|relative_std| {
            let mut estimator = self.replays.estimator();
            let known = observation.rows().filter(|&row| estimator.count(row) > 0).count();
            let spread = estimator.band_spread(points_m, &observation, relative_std);
            (spread, [observation.n_contacts(), known])
        });
        if tracked.is_learnt {
            self.log.learns(frame);
        }
        let predicted = match self.weights(tracked) {
            _ if !tracked.is_learnt => self.replays.estimator().predict(points_m, &observation),
            None => self.replays.estimator().correct(points_m, observation, frame)?,
            Some(weights) => {
                let weighted = observation.weighted(&weights);
                let predicted = self.replays.estimator().correct(points_m, weighted, frame)?;
                predicted.component_div(&DVector::from_vec(weights))
            }
        };
        let peak_half_width = beside.and_then(|beside| self.peak_half_width(&predicted, &beside));
        Ok((predicted, peak_half_width))
    }

    /// Weights of the joint torques ([`torque_weights`]), if the sample has standard deviations.
    fn weights(&self, tracked: &TrackedSample) -> Option<Vec<f64>> {
        let tau_std = tracked.tau_std.as_ref()?;
        Some(torque_weights(tau_std, &self.config.estimator.torque_std))
    }

    /// Half-width of the band for the largest torque around a prediction, n_joints, N·m, given its spread, the number
    /// of touched points and the number of known ones.
    fn peak_half_width(
        &self,
        predicted: &DVector<f64>,
        (spread, contacts): &(DVector<f64>, [usize; 2]),
    ) -> Option<DVector<f64>> {
        let calibration = self.calibration()?;
        calibration.peak_half_width(self.band?, predicted.as_slice(), spread.as_slice(), *contacts)
    }

    /// A step without contact: predicts zero and, with `ages`, advances the time of the belief.
    fn pass_without_contact(
        &mut self,
        n_joints: usize,
        ages: bool,
    ) -> (DVector<f64>, Option<DVector<f64>>) {
        if ages {
            self.replays.estimator().advance_time();
        }
        let nothing = DVector::zeros(n_joints);
        let peak_half_width = self.peak_half_width(&nothing, &(nothing.clone(), [0, 0]));
        (nothing, peak_half_width)
    }

    /// Logs a sample; frames whose samples no longer fit into the log are condensed.
    fn record(&mut self, sample: &Sample, is_skipped: bool) -> FrameId {
        let frame = self.log.record(sample, is_skipped);
        for touch in self.log.bound(self.config.estimator.memory.bytes) {
            self.replays.estimator().condense(touch);
        }
        frame
    }

    /// Number of an earlier touch in memory whose samples are equal to the bit to the first samples, or all, of the
    /// touch under way: the same recording, which then counts twice.
    pub fn repeated_touch(&self) -> Option<u32> {
        self.log.repeated(self.tracker.arm().robot.n_joints()).map(|touch| touch.touch)
    }

    /// Ends a touch.
    ///
    /// # Errors
    ///
    /// If the touch has fewer frames than were requested for the tare.
    pub fn end_touch(&mut self) -> Result<(), MapperError> {
        self.replays.end_touch();
        self.log.end_touch(&self.replays.estimator().frame_ids());
        self.update_bands();
        Ok(self.tracker.end_touch()?)
    }

    /// Makes replays in spare time of the caller; returns how many.
    ///
    /// `grant` gets the number of replays that may still be made and returns how many to make before it is called
    /// again. Stops when `grant` returns 0, when no more may be made, or when nothing is remembered. Without
    /// [`ReplayPolicy::SpareTime`] or [`ReplayPolicy::SpareTimeUnbounded`] no replays are left to be made.
    pub fn spare_time(&mut self, grant: impl FnMut(u32) -> u32) -> u32 {
        self.replays.spare_time(grant)
    }

    /// Number of replays that may still be made in spare time.
    pub fn spare_replays(&self) -> u32 {
        self.replays.spare()
    }

    /// The settings.
    pub fn config(&self) -> &MapperConfig {
        &self.config
    }

    /// The arm.
    pub fn arm(&self) -> &Arc<Arm> {
        self.tracker.arm()
    }

    /// The tare of the touch under way, n_joints, N·m, once it is known.
    pub fn tare(&self) -> Option<&DVector<f64>> {
        self.tracker.tare()
    }

    /// The estimate of a cell, touched or not.
    pub fn cell(&self, cell: CellId) -> CellEstimate {
        let row = self.observations.rows().find(cell);
        self.replays.estimator().estimate(row.map_or(usize::MAX, |row| row as usize))
    }

    /// Number of cells that were touched or have their own prior mean.
    pub fn n_cells(&self) -> usize {
        self.observations.rows().len()
    }

    /// The contacts of the last sample.
    pub fn contacts(&self) -> Contacts {
        self.tracker.contacts()
    }

    /// Number of remembered frames, and bytes of these frames and the sample log together; the frames and the log are
    /// each limited by [`crate::MemoryLimits::bytes`].
    pub fn memory(&self) -> (usize, usize) {
        let estimator = self.replays.estimator();
        (estimator.frame_ids().len(), estimator.memory_bytes() + self.log.bytes())
    }

    /// The field as it is now.
    pub fn field(&self) -> Field {
        let (rows, estimator) = (self.observations.rows(), self.replays.estimator());
        let of_rows = 0..rows.len();
        Field {
            lattice: self.config.lattice.clone(),
            contact: self.config.contact.clone(),
            touch: self.config.touch.clone(),
            cells: rows.cells().to_vec(),
            stiffness_n_per_m: of_rows.clone().map(|row| estimator.stiffness(row)).collect(),
            std_n_per_m: of_rows.clone().map(|row| estimator.std(row)).collect(),
            counts: of_rows.map(|row| estimator.count(row)).collect(),
            untouched_n_per_m: estimator.stiffness(usize::MAX),
            elastic: None,
            calibration: self.calibration().cloned(),
        }
    }

    /// A copy of the field and of the arm with its contacts, which predicts the torque of motions on any
    /// thread while mapping goes on.
    ///
    /// Cost: 3 to 5 ns for each touched cell, and a copy of the contacts. Replays of the last step that are still due
    /// are made first, as before every access to the belief.
    pub fn path_predictor(&self) -> PathPredictor {
        self.coarse_path_predictor(1.0)
    }

    /// [`Mapper::path_predictor`] with one spring for each cluster of neighbouring cells, for fast predictions; with a
    /// `cluster_weight` of 1 or less, or NaN, every cell has its own spring.
    ///
    /// The weight of a cluster, from its stiffness and variance, is at most that of `cluster_weight` average cells.
    /// Most clusters weigh less: with 24, there is one spring for 11 to 15 cells. Cells that the field does not know
    /// have one spring for each block of 4³. Torques are then off by some percent, see [`crate::CLUSTER_WEIGHT`], and
    /// numbers of contacts are estimates. Clusters depend on the field alone: the same field gives the same prediction.
    ///
    /// Cost: as [`Mapper::path_predictor`]; clusters are formed later, near the paths that are predicted.
    pub fn coarse_path_predictor(&self, cluster_weight: f64) -> PathPredictor {
        let (contact, rows) = (self.config.contact.clone(), self.observations.rows());
        let springs = Springs::new(rows, &*self.replays.estimator(), cluster_weight);
        PathPredictor::new(&self.tracker, contact, springs).calibrated(self.calibration().cloned())
    }

    /// A checker of paths for this mapper's path predictors; it does not copy the field.
    pub fn path_checker(&self) -> PathChecker {
        PathChecker::new(self.tracker.substeps().clone(), self.config.lattice.spacing_m())
    }

    /// Prior means of the cells with their own prior mean, N/m, which have the first rows; empty if there are none.
    pub fn prior_means_n_per_m(&self) -> &[f64] {
        &self.prior_means_n_per_m
    }

    /// Prior means of all rows of [`Mapper::field`], N/m; `None` without prior means by cell.
    pub fn prior_n_per_m(&self) -> Option<Vec<f64>> {
        let of_others = self.replays.estimator().stiffness(usize::MAX);
        (!self.prior_means_n_per_m.is_empty())
            .then(|| padded(&self.prior_means_n_per_m, self.observations.rows().len(), of_others))
    }
}
