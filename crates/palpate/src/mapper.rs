//! The loop: one sample in, one report out (Sec. II).
//!
//! [`Mapper`] learns a [`Field`] from touches. It can be saved at any sample and continued as if
//! it had never stopped: a [`Snapshot`] holds the belief and, in place of megabytes of contacts,
//! the *sample_log* of joint positions and torques from which the remembered frames are simulated
//! again. The module opens no file; palpate-io writes snapshots and fields.

use std::collections::HashSet;
use std::sync::Arc;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::arm::Arm;
use crate::contact::{ContactConfig, Contacts};
use crate::ekf::EkfEstimator;
use crate::estimator::{
    CellEstimate, Estimator, EstimatorConfig, EstimatorError, EstimatorKind, EstimatorState,
    FrameId, padded,
};
use crate::field::Field;
use crate::lattice::{CellId, CellRows, Lattice};
use crate::map::MapEstimator;
use crate::path_predictor::{PathChecker, PathPredictor, Springs};
use crate::prior_means::{self, PriorMeansError};
use crate::replayer::Replayer;
use crate::robot::RobotError;
use crate::setting::SettingError;
use crate::torque::{Observation, ObservationBuilder};
use crate::tracker::{ExternalTorqueConfig, Sample, TrackedSample, Tracker, TrackerError};

/// Everything that decides what is learnt from a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapperConfig {
    /// The workspace box.
    pub lattice: Lattice,
    /// The contact model.
    pub contact: ContactConfig,
    /// Gravity and tare.
    pub touch: ExternalTorqueConfig,
    /// The estimator.
    pub method: EstimatorKind,
    /// Its settings.
    pub estimator: EstimatorConfig,
}

impl MapperConfig {
    /// The shipped settings of an estimator, in the paper's box.
    pub fn of(method: EstimatorKind) -> Self {
        Self {
            lattice: Lattice::default(),
            contact: ContactConfig::default(),
            touch: ExternalTorqueConfig::default(),
            method,
            estimator: EstimatorConfig::of(method),
        }
    }

    /// An estimator that knows nothing yet, for torques of so many joints.
    ///
    /// # Errors
    ///
    /// If a setting of the estimator is out of its range.
    pub fn estimator(&self, n_joints: usize) -> Result<Box<dyn Estimator>, EstimatorError> {
        let (config, spacing_m) = (&self.estimator, self.lattice.spacing_m());
        Ok(match self.method {
            EstimatorKind::Map => Box::new(MapEstimator::new(config, spacing_m, n_joints)?),
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
    /// A snapshot that contradicts itself.
    #[error("the saved mapper is inconsistent: {what}")]
    Snapshot { what: String },
}

impl From<RobotError> for MapperError {
    fn from(error: RobotError) -> Self {
        Self::Tracker(error.into())
    }
}

/// What one step found.
#[derive(Debug, Clone)]
pub struct StepReport {
    /// Points touched.
    pub contacts: usize,
    /// τ_ext, n_joints, N·m; `None` while the tare is being taken.
    pub external: Option<DVector<f64>>,
    /// τ̂ before the sample was learnt from, n_joints, N·m; `None` with `external`.
    pub predicted: Option<DVector<f64>>,
}

/// The samples of one touch, as logged.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LoggedTouch {
    /// The touch's number over the mapper's life.
    pub touch: u32,
    /// Whether more samples may follow.
    pub open: bool,
    /// Whether its samples outgrew the sample_log's bound and are gone.
    pub lost: bool,
    /// Joint positions of all samples in a row, samples × n_joints.
    pub q: Vec<f64>,
    /// Logged torques, samples × n_joints.
    pub tau: Vec<f64>,
}

/// A mapper in numbers: enough to continue it, given the robot.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Its settings.
    pub config: MapperConfig,
    /// The robot's name and [`Arm::fingerprint`].
    pub robot: (String, u64),
    /// Joints of its samples.
    pub n_joints: usize,
    /// Cells by row: those of a prior by cell, then the others in the order of first touch.
    pub cells: Vec<CellId>,
    /// Prior means of the first rows, N/m, if there was a prior by cell; else empty.
    pub prior_means_n_per_m: Vec<f64>,
    /// The belief.
    pub state: EstimatorState,
    /// Touches begun so far.
    pub touches: u32,
    /// Whether the replays that belong to the frame learnt last are still to be made.
    pub replays_due: bool,
    /// Touches with remembered frames, and the one under way.
    pub sample_log: Vec<LoggedTouch>,
}

/// Learns a stiffness field from samples.
pub struct Mapper {
    config: MapperConfig,
    tracker: Tracker,
    observations: ObservationBuilder,
    estimator: Replayer,
    /// Prior means of the rows that a prior by cell declared, N/m.
    prior_means_n_per_m: Vec<f64>,
    /// Whether old frames are still to be visited for the frame learnt last.
    replays_due: bool,
    touches: u32,
    /// Samples of the touch under way.
    samples: u32,
    sample_log: Vec<LoggedTouch>,
}

impl Mapper {
    /// A mapper that knows nothing yet.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(arm: Arc<Arm>, config: MapperConfig) -> Result<Self, MapperError> {
        Self::with_prior(arm, config, &[])
    }

    /// A mapper that has touched nothing yet and expects a stiffness of its own, N/m, of some
    /// cells; of all others, the prior mean of its settings.
    ///
    /// These cells get the first rows, in the lattice's order; [`Mapper::field`] lists them with a
    /// count of 0. With `ekf` a mean below the prior's is raised to it ([`Estimator::set_prior_means`]).
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
        // As the estimator took them.
        let prior_means_n_per_m = (0..rows.len()).map(|row| estimator.stiffness(row)).collect();
        Ok(Self {
            tracker: Self::tracker(arm, &config)?,
            config,
            observations: ObservationBuilder::new(rows),
            estimator: Replayer::new(estimator),
            prior_means_n_per_m,
            replays_due: false,
            touches: 0,
            samples: 0,
            sample_log: Vec::new(),
        })
    }

    /// Starts a touch.
    pub fn begin_touch(&mut self) {
        self.close_sample_log();
        self.tracker.begin_touch();
        self.sample_log.push(LoggedTouch {
            touch: self.touches,
            open: true,
            ..LoggedTouch::default()
        });
        self.touches += 1;
        self.samples = 0;
    }

    /// Folds one sample into the field: simulate, predict, correct, replay (Sec. II).
    ///
    /// The replays that belong to a frame are made while the next sample is simulated, on another
    /// core if there is one: they need nothing of it. So visits come in the order of the paper,
    /// and the result is the same to the bit on one thread or two.
    ///
    /// # Errors
    ///
    /// If the sample cannot be used: it does not fit the robot, is not finite, or shows that the
    /// touch has no contact-free start ([`Tracker::feed`]). It has then taught nothing.
    pub fn step(&mut self, sample: &Sample) -> Result<StepReport, MapperError> {
        // Where the arm pushes the points of the field, and by how much (assumption ii); meanwhile
        // old frames are fused again, so that they are not forgotten.
        let frame = self.track_and_replay(sample)?;
        let frame_id = self.record(sample);
        self.bound_sample_log();
        let contacts = frame.contacts.len();
        let Some(external) = frame.external else {
            return Ok(StepReport { contacts, external: None, predicted: None });
        };

        // What the joints should feel before looking at the sensors (Eqs. 2 and 5), and what they
        // did feel, which corrects the touched cells (Eqs. 5 and 6).
        let predicted = if contacts == 0 {
            self.estimator.advance_time();
            DVector::zeros(external.len())
        } else {
            let robot = &self.tracker.arm().robot;
            let observation =
                self.observations.build(robot, &frame.poses, &frame.contacts, &external);
            let points_m = self.observations.rows().points_m();
            let predicted = self.estimator.correct(points_m, observation, frame_id)?;
            self.replays_due = true;
            predicted
        };
        Ok(StepReport { contacts, external: Some(external), predicted: Some(predicted) })
    }

    /// The simulator's work on a sample beside the replays that the last frame left to do.
    fn track_and_replay(&mut self, sample: &Sample) -> Result<TrackedSample, TrackerError> {
        let visits = self.take_due();
        let (tracker, estimator) = (&mut self.tracker, &mut self.estimator);
        if visits == 0 {
            return tracker.feed(sample);
        }
        estimator.replay_beside(visits, || tracker.feed(sample))
    }

    /// The replays that are due, which then no longer are.
    fn take_due(&mut self) -> u32 {
        let due = std::mem::take(&mut self.replays_due);
        if due { self.config.estimator.replays } else { 0 }
    }

    /// Ends a touch, with the replays that its last frame left to do.
    ///
    /// # Errors
    ///
    /// If the touch was shorter than the tare frames asked for.
    pub fn end_touch(&mut self) -> Result<(), MapperError> {
        let visits = self.take_due();
        self.estimator.replay(visits);
        self.close_sample_log();
        Ok(self.tracker.end_touch()?)
    }

    /// Visits remembered frames without a new one; returns how many there were to visit.
    pub fn replay(&mut self, visits: u32) -> u32 {
        self.estimator.replay(visits).frames
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

    /// What is known of a cell, touched or not.
    pub fn cell(&self, cell: CellId) -> CellEstimate {
        let row = self.observations.rows().find(cell);
        self.estimator.estimate(row.map_or(usize::MAX, |row| row as usize))
    }

    /// Cells that were touched or of which a prior expects something.
    pub fn n_cells(&self) -> usize {
        self.observations.rows().len()
    }

    /// What the arm displaced in the last sample, for whoever draws it.
    pub fn contacts(&self) -> Contacts {
        self.tracker.contacts()
    }

    /// Frames remembered, and the bytes that they and the sample_log hold; each of the two is bounded
    /// by [`crate::replay_memory::MemoryLimits::bytes`].
    pub fn memory(&self) -> (usize, usize) {
        let bytes = self.estimator.memory_bytes() + self.sample_log_bytes();
        (self.estimator.frame_ids().len(), bytes)
    }

    /// The field as it is now.
    pub fn field(&self) -> Field {
        let rows = 0..self.observations.rows().len();
        Field {
            lattice: self.config.lattice.clone(),
            contact: self.config.contact.clone(),
            touch: self.config.touch.clone(),
            cells: self.observations.rows().cells().to_vec(),
            stiffness_n_per_m: rows.clone().map(|row| self.estimator.stiffness(row)).collect(),
            std_n_per_m: rows.clone().map(|row| self.estimator.std(row)).collect(),
            counts: rows.map(|row| self.estimator.count(row)).collect(),
            untouched_n_per_m: self.estimator.stiffness(usize::MAX),
        }
    }

    /// The field as it is now and the arm where it is, to be asked about motions while mapping goes
    /// on, by another thread if need be.
    ///
    /// Cost: a copy of what is known of the touched cells, 3 to 5 ns each, and of the contacts.
    pub fn path_predictor(&self) -> PathPredictor {
        self.coarse_path_predictor(1.0)
    }

    /// [`Mapper::path_predictor`] with springs that each stand for a block of neighbours, where an answer
    /// must come fast; with 1 or less, or NaN, one with all.
    ///
    /// No block weighs more than `cluster_weight` springs of the mean, by stiffness and by uncertainty.
    /// Most weigh less: at 24, one spring in 11 to 15 is left.
    ///
    /// Of the cells of which the field knows nothing, one in every block of 4³ is kept. Torques are
    /// then off by some percent, see [`crate::path_predictor::CLUSTER_WEIGHT`], and counts of contacts are
    /// estimates. The choice follows from the field alone: the same field has the same answer.
    ///
    /// Cost: as [`Mapper::path_predictor`]; which spring stands for which is worked out where a path leads, by
    /// whoever asks.
    pub fn coarse_path_predictor(&self, cluster_weight: f64) -> PathPredictor {
        let (contact, rows) = (self.config.contact.clone(), self.observations.rows());
        let springs = Springs::new(rows, &*self.estimator, cluster_weight);
        PathPredictor::new(&self.tracker, contact, springs)
    }

    /// What says of paths whether this mapper's path predictors can answer them, before one is asked for.
    pub fn path_checker(&self) -> PathChecker {
        PathChecker::new(self.tracker.substeps().clone(), self.config.lattice.spacing_m())
    }

    /// Prior means of the cells that a prior by cell declared, N/m: those of the first rows, as
    /// many as there are; empty without such a prior.
    pub fn prior_means_n_per_m(&self) -> &[f64] {
        &self.prior_means_n_per_m
    }

    /// Prior means of all rows of [`Mapper::field`], N/m; `None` without a prior by cell.
    pub fn prior_n_per_m(&self) -> Option<Vec<f64>> {
        let of_others = self.estimator.stiffness(usize::MAX);
        (!self.prior_means_n_per_m.is_empty())
            .then(|| padded(&self.prior_means_n_per_m, self.observations.rows().len(), of_others))
    }

    /// Everything needed to go on later.
    pub fn snapshot(&self) -> Snapshot {
        let mut state = self.estimator.state(self.observations.rows().len());
        let lost =
            |touch: u32| self.sample_log.iter().any(|logged| logged.touch == touch && logged.lost);
        state.remembered.retain(|(from, _)| !lost(from.touch));
        let needed: HashSet<u32> = state.remembered.iter().map(|(from, _)| from.touch).collect();
        let keep =
            |touch: &&LoggedTouch| !touch.lost && (touch.open || needed.contains(&touch.touch));
        let arm = self.tracker.arm();
        Snapshot {
            config: self.config.clone(),
            robot: (arm.robot.name().to_owned(), arm.fingerprint()),
            n_joints: arm.robot.n_joints(),
            cells: self.observations.rows().cells().to_vec(),
            prior_means_n_per_m: self.prior_means_n_per_m.clone(),
            sample_log: self.sample_log.iter().filter(keep).cloned().collect(),
            touches: self.touches,
            replays_due: self.replays_due,
            state,
        }
    }

    /// Goes on from a snapshot as if it had never stopped.
    ///
    /// The remembered frames' contacts are simulated again from the sample_log, which costs about as
    /// much as predicting those touches.
    ///
    /// # Errors
    ///
    /// If the arm is not the one of the snapshot, or the snapshot contradicts itself.
    pub fn resume(arm: Arc<Arm>, snapshot: Snapshot) -> Result<Self, MapperError> {
        let (learnt, fingerprint) = &snapshot.robot;
        if *fingerprint != arm.fingerprint() {
            let (learnt, given) = (learnt.clone(), arm.robot.name().to_owned());
            return Err(MapperError::OtherRobot { learnt, given });
        }
        let config = snapshot.config;
        let (spacing_m, n_joints) = (config.lattice.spacing_m(), arm.robot.n_joints());
        let mut mapper = Self::new(arm, config.clone())?;
        let mut rows = CellRows::new(config.lattice.clone());
        for cell in &snapshot.cells {
            if !config.lattice.contains(*cell) {
                let what = format!("cell {} is not in the lattice", cell.0);
                return Err(MapperError::Snapshot { what });
            }
            rows.row_of(*cell);
        }
        if snapshot.prior_means_n_per_m.len() > rows.len() {
            let what = "it expects something of more cells than there are".to_owned();
            return Err(MapperError::Snapshot { what });
        }
        mapper.observations = ObservationBuilder::new(rows);
        mapper.prior_means_n_per_m = snapshot.prior_means_n_per_m;
        mapper.replays_due = snapshot.replays_due;
        let remembered: Vec<FrameId> =
            snapshot.state.remembered.iter().map(|(frame_id, _)| *frame_id).collect();
        let observations = mapper.simulate_again(&snapshot.sample_log, &remembered)?;
        let points_m = mapper.observations.rows().points_m();
        let estimator: Box<dyn Estimator> = match config.method {
            EstimatorKind::Map => {
                Box::new(MapEstimator::new(&config.estimator, spacing_m, n_joints)?.restore(
                    &snapshot.state,
                    points_m,
                    observations,
                )?)
            }
            EstimatorKind::Ekf => {
                Box::new(EkfEstimator::new(&config.estimator, spacing_m, n_joints)?.restore(
                    &snapshot.state,
                    points_m,
                    observations,
                )?)
            }
        };
        mapper.estimator = Replayer::new(estimator);
        mapper.touches = snapshot.touches;
        match snapshot.sample_log.last().filter(|touch| touch.open) {
            Some(under_way) => mapper.samples = (under_way.q.len() / n_joints) as u32,
            None => mapper.tracker.end_touch()?, // the sample_log's last touch is not to be gone on with
        }
        mapper.sample_log = snapshot.sample_log;
        Ok(mapper)
    }

    /// A tracker for an arm under these settings.
    fn tracker(arm: Arc<Arm>, config: &MapperConfig) -> Result<Tracker, MapperError> {
        let (contact, touch) = (config.contact.clone(), config.touch.clone());
        Ok(Tracker::new(arm, config.lattice.clone(), contact, touch)?)
    }

    /// Runs the logged touches again and folds the frames that were remembered, in their order.
    fn simulate_again(
        &mut self,
        sample_log: &[LoggedTouch],
        remembered: &[FrameId],
    ) -> Result<Vec<Observation>, MapperError> {
        let n_joints = self.tracker.arm().robot.n_joints();
        let mut found: Vec<Option<Observation>> = vec![None; remembered.len()];
        let order: std::collections::HashMap<FrameId, usize> =
            remembered.iter().enumerate().map(|(index, frame_id)| (*frame_id, index)).collect();
        for touch in sample_log {
            if touch.q.len() != touch.tau.len() || touch.q.len() % n_joints != 0 {
                let what = format!("the sample_log of touch {} is not n × {n_joints}", touch.touch);
                return Err(MapperError::Snapshot { what });
            }
            self.tracker.begin_touch();
            let samples = touch.q.chunks(n_joints).zip(touch.tau.chunks(n_joints));
            for (number, (q, tau)) in samples.enumerate() {
                let sample = Sample { time_s: None, q: q.to_vec(), tau: tau.to_vec() };
                let frame = self.tracker.feed(&sample)?;
                let frame_id = FrameId { touch: touch.touch, sample: number as u32 };
                if let (Some(&index), Some(external)) = (order.get(&frame_id), &frame.external) {
                    let (robot, contacts) = (&self.tracker.arm().robot, &frame.contacts);
                    let folded = self.observations.build(robot, &frame.poses, contacts, external);
                    found[index] = Some(folded);
                }
            }
        }
        let missing =
            || MapperError::Snapshot { what: "the sample_log lacks a remembered frame".into() };
        found.into_iter().map(|frame| frame.ok_or_else(missing)).collect()
    }

    /// Puts a sample on the sample_log and says where it stands there.
    fn record(&mut self, sample: &Sample) -> FrameId {
        let touch = self.sample_log.last_mut().expect("feed refuses samples before a touch");
        if !touch.lost {
            touch.q.extend_from_slice(&sample.q);
            touch.tau.extend_from_slice(&sample.tau);
        }
        self.samples += 1;
        FrameId { touch: touch.touch, sample: self.samples - 1 }
    }

    /// Keeps the sample_log within the memory's bound on bytes: the oldest touches are condensed and their
    /// samples dropped. A single touch that outgrows the bound goes on, but what it teaches is
    /// condensed when the mapper is saved.
    fn bound_sample_log(&mut self) {
        while self.sample_log_bytes() > self.config.estimator.memory.bytes {
            let oldest = &mut self.sample_log[0];
            if oldest.open {
                oldest.lost = true;
                (oldest.q, oldest.tau) = (Vec::new(), Vec::new());
            } else {
                let touch = self.sample_log.remove(0).touch;
                self.estimator.condense(touch);
            }
        }
    }

    /// Bytes of the logged samples.
    fn sample_log_bytes(&self) -> usize {
        let numbers: usize =
            self.sample_log.iter().map(|touch| touch.q.len() + touch.tau.len()).sum();
        numbers * size_of::<f64>()
    }

    /// Closes the last touch's sample_log and drops those that no remembered frame needs.
    fn close_sample_log(&mut self) {
        if let Some(touch) = self.sample_log.last_mut() {
            touch.open = false;
        }
        let needed: HashSet<u32> =
            self.estimator.frame_ids().iter().map(|frame_id| frame_id.touch).collect();
        self.sample_log.retain(|touch| needed.contains(&touch.touch));
    }
}
