//! Touches with their contacts, tracked once and shared by all folds and methods.
//!
//! Contacts follow from the motion of the arm alone, so a touch is simulated once, and its frames
//! are given to every estimator that learns from it. Rows of cells are numbered over all touches; a
//! row that an estimator has not seen has the prior.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Unit, Vector3};
use palpate::unstable::{
    CellRows, CellState, Downsampling, ElasticBody, Observation, ObservationBuilder, StiffnessRule,
    TrackedSample, Tracker, torque_weights,
};
use palpate::{
    Arm, CellId, ContactConfig, EstimatorConfig, Lattice, MapperConfig, Sample, Tare, TrackerError,
};
use rayon::prelude::*;

use crate::elastic::{BodyTorques, ConvergenceCounts, with_torque};
use crate::error::{LearnError, Stop, unless_stopped};
use crate::folds::inner_folds;
use crate::regression::Frames;
use crate::thinning::Ways;

/// About the most steps of the simulator for a contact model in [`TrackedTouches::sparse`] and in [`largest_torques`]:
/// a little more than sixteen simulated touches of 400 samples take.
const STEPS: f64 = 7_000.0;
/// The same for the sum of contacts over all steps.
const CONTACTS: f64 = 2e7;

/// A touch as logged, with the true torques if they are known.
#[derive(Debug, Clone)]
pub struct TouchSamples {
    /// Name of the touch.
    pub name: String,
    /// Its samples in order.
    pub samples: Vec<Sample>,
    /// True external torque of every sample, n_joints, N·m; predictions are compared with it in place of the measured
    /// one.
    pub truth: Option<Vec<Vec<f64>>>,
}

/// All touches, tracked.
#[derive(Debug, Clone)]
pub struct TrackedTouches {
    /// The touches in the order in which they were given.
    pub touches: Vec<TrackedTouch>,
    /// The lattice of the cells.
    pub lattice: Lattice,
    /// All touched cells, by row.
    pub cells: Vec<CellId>,
    /// Rest points of the cells, by row, world frame, m.
    pub points_m: Vec<[f64; 3]>,
    /// Number of joints of the arm.
    pub n_joints: usize,
    /// Every n-th of the learnt samples was simulated; this is n.
    pub(crate) thinning: usize,
    /// All learnt samples after the tare, by touch, simulated or not.
    pub(crate) motions: Arc<[Vec<MotionFrame>]>,
    /// Torques of an elastic body along the touches, if there is a body.
    pub(crate) body: Option<Arc<BodyTorques>>,
}

/// A touch with its contacts.
#[derive(Debug, Clone)]
pub struct TrackedTouch {
    /// Name of the touch.
    pub name: String,
    /// Its frames after the tare, downsampled for learning ([`Downsampling`]).
    pub frames: Vec<TrackedFrame>,
    /// Torques during the tare, with the bias, n_joints, N·m.
    of_tare: Vec<DVector<f64>>,
    /// The motion of the arm while it touches something.
    pub(crate) in_contact: PathLength,
}

/// Position and torque of a learnt sample after the tare.
#[derive(Debug, Clone)]
pub(crate) struct MotionFrame {
    /// Logged time, s.
    pub(crate) time_s: Option<f64>,
    /// Joint positions, n_joints, rad.
    pub(crate) q: Vec<f64>,
    /// [`TrackedFrame::unwrapped`], n_joints, rad.
    pub(crate) unwrapped: Vec<f64>,
    /// External torque, n_joints, N·m.
    pub(crate) tau: Vec<f64>,
}

impl MotionFrame {
    fn of(sample: &Sample, unwrapped: &[f64], tau: &DVector<f64>) -> Self {
        let [q, unwrapped, tau] = [&sample.q, unwrapped, tau.as_slice()].map(<[f64]>::to_vec);
        Self { time_s: sample.time_s, q, unwrapped, tau }
    }
}

/// Path length and duration of a motion; 0 without times.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PathLength {
    /// Path of the fastest point of the arm, m.
    pub(crate) path_m: f64,
    /// Duration, s.
    pub(crate) time_s: f64,
}

/// One frame after the tare.
#[derive(Debug, Clone)]
pub struct TrackedFrame {
    /// Index of the sample in its touch.
    pub sample: u32,
    /// Logged time, s.
    pub time_s: Option<f64>,
    /// Joint positions, n_joints, rad.
    pub q: Vec<f64>,
    /// Joint positions with continuous joints unwrapped, counted from the first sample of the first touch.
    pub unwrapped: Vec<f64>,
    /// Contacts, and the measured external torque.
    pub observation: Observation,
    /// Standard deviations of the measured torque, n_joints, N·m, if they are known.
    tau_std: Option<Vec<f64>>,
    /// The external torque to predict, n_joints, N·m: the true one if known, otherwise the measured one.
    pub target: Vec<f64>,
    /// Direction in which the arm pushes, world frame: that of the sum of the displacements, if there are any.
    pub(crate) push: Option<Unit<Vector3<f64>>>,
}

impl TrackedTouches {
    /// Tracks all touches, in parallel; the result does not depend on the number of threads.
    ///
    /// `stop` is polled before every sample.
    ///
    /// # Errors
    ///
    /// Names the first touch and sample that cannot be used.
    pub fn new(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        touches: &[TouchSamples],
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        touches.iter().try_for_each(|touch| check_truth(touch, arm.robot.n_joints()))?;
        Self::track(arm, config, (touches, 1), (None, 1), stop)
    }

    /// [`TrackedTouches::new`] with fewer samples of long touches, so that tracking them and [tuning](crate::tune) take
    /// less time.
    ///
    /// # Errors
    ///
    /// As [`TrackedTouches::new`].
    pub fn sparse(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        touches: &[TouchSamples],
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
        let ways = Ways::of(arm, config, &samples);
        let thinning = ways.thinned_to(STEPS, 1);
        let mut tracked = Self::track(arm, config, (touches, thinning), (None, 1), stop)?;
        let most = CONTACTS / tracked.contacts_per_frame().max(1.0);
        tracked.thin(ways.thinned_to(most, thinning));
        Ok(tracked)
    }

    /// Tracks the same samples again under other settings.
    ///
    /// # Errors
    ///
    /// As [`TrackedTouches::new`].
    pub fn again(
        &self,
        arm: &Arc<Arm>,
        config: &MapperConfig,
        touches: &[TouchSamples],
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        Self::track(arm, config, (touches, self.thinning), (None, 1), stop)
    }

    /// Mean number of contacts of a frame.
    pub(crate) fn contacts_per_frame(&self) -> f64 {
        let frames = self.touches.iter().flat_map(|touch| &touch.frames);
        let counts = frames.clone().map(|frame| frame.observation.n_contacts());
        counts.sum::<usize>() as f64 / frames.count().max(1) as f64
    }

    /// Drops frames, so that every n-th of the learnt samples is left; n is a multiple of the present thinning.
    fn thin(&mut self, n: usize) {
        for touch in &mut self.touches {
            let mut number = 0..;
            let is_left = |number: usize| number.is_multiple_of(n / self.thinning);
            touch.frames.retain(|_| number.next().is_some_and(is_left));
        }
        self.thinning = n;
    }

    /// Tracks every n-th frame again under another contact model, with the external torques of `self`.
    ///
    /// # Errors
    ///
    /// If a setting of the contact model is out of its range, or on being stopped.
    pub fn with_contact_model(
        &self,
        contact: &ContactConfig,
        arm: &Arc<Arm>,
        config: &MapperConfig,
        (touches, n): (&[TouchSamples], usize),
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        let mut config = config.clone();
        config.contact = contact.clone();
        config.touch.tare = Tare::None; // The torques of `self` are already tared.
        Self::track(arm, &config, (touches, self.thinning), (Some(self), n), stop)
    }

    /// Adds the simulated torques of an elastic body along every touch, for [`crate::method::Method::Elastic`]. Several
    /// bodies are alternatives for the same object, the most likely first. `training` are the sets of touches, by
    /// index, from which the body will be learnt and bands calibrated. `step` is called [`crate::elastic::steps`]
    /// times, from any thread.
    ///
    /// # Errors
    ///
    /// On being stopped.
    ///
    /// # Panics
    ///
    /// If `touches` are not those that were tracked, or `bodies` is empty.
    pub fn with_bodies(
        mut self,
        arm: &Arc<Arm>,
        bodies: &[Arc<ElasticBody>],
        (touches, training): (&[TouchSamples], &[Vec<usize>]),
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<Self, LearnError> {
        let folds = training.iter().flat_map(|train| inner_folds(&with_torque(&self, train)));
        let folds = folds.map(|fold| fold.train);
        let training: Vec<Vec<usize>> = training.iter().cloned().chain(folds).collect();
        let mut torques = BodyTorques::new(bodies);
        torques.extend(arm, (&self, touches), &training, (stop, step))?;
        self.body = Some(Arc::new(torques));
        Ok(self)
    }

    /// How often the simulation of the body converged, if there is a body.
    pub fn convergence(&self) -> Option<ConvergenceCounts> {
        Some(self.body.as_ref()?.convergence)
    }

    /// Every n-th frame of each touch, from the first on, without a body.
    pub fn thinned(&self, n: usize) -> Self {
        let touch = |touch: &TrackedTouch| TrackedTouch {
            name: touch.name.clone(),
            frames: touch.frames.iter().step_by(n.max(1)).cloned().collect(),
            of_tare: touch.of_tare.clone(),
            in_contact: touch.in_contact,
        };
        Self {
            touches: self.touches.iter().map(touch).collect(),
            lattice: self.lattice.clone(),
            cells: self.cells.clone(),
            points_m: self.points_m.clone(),
            n_joints: self.n_joints,
            thinning: self.thinning,
            motions: Arc::clone(&self.motions),
            body: None,
        }
    }

    /// Without times of the frames.
    pub(crate) fn without_times(mut self) -> Self {
        let motions = Arc::make_mut(&mut self.motions);
        motions.iter_mut().flatten().for_each(|frame| frame.time_s = None);
        self
    }

    fn track(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        (touches, thinning): (&[TouchSamples], usize),
        (like, every): (Option<&Self>, usize),
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        let (contact, touch) = (config.contact.clone(), config.touch.clone());
        let tracker = Tracker::new(Arc::clone(arm), config.lattice.clone(), &contact, touch)?;
        let first = touches.iter().flat_map(|touch| &touch.samples).map(|sample| &sample.q).next();
        let track = |(number, touch): (usize, &TouchSamples)| {
            let like = like.map(|like| like.touches[number].frames.as_slice());
            follow(tracker.clone(), (number, touch, thinning), (first, like, every.max(1)), stop)
        };
        let mut observations = ObservationBuilder::new(CellRows::new(config.lattice.clone()));
        let mut tracked = Vec::with_capacity(touches.len());
        let mut motions = Vec::with_capacity(touches.len());
        let numbered: Vec<(usize, &TouchSamples)> = touches.iter().enumerate().collect();
        // Contacts need more memory than observations, so only one chunk of touches has them at a time.
        for some in numbered.chunks(rayon::current_num_threads().max(1)) {
            let followed: Vec<_> = some.par_iter().map(|touch| track(*touch)).collect();
            for (frames, (number, touch)) in followed.into_iter().zip(some) {
                let Followed { frames, mut of_tare, motion } = frames?;
                motions.push(motion);
                if let Some(like) = like {
                    of_tare.clone_from(&like.touches[*number].of_tare);
                }
                let in_contact = in_contact(arm, &frames, touch);
                let frames = frames.into_iter();
                let frames = frames.map(|frame| frame.observed(arm, touch, &mut observations));
                let (name, frames) = (touch.name.clone(), frames.collect());
                tracked.push(TrackedTouch { name, frames, of_tare, in_contact });
            }
        }
        Ok(Self {
            touches: tracked,
            lattice: config.lattice.clone(),
            cells: observations.rows().cells().to_vec(),
            points_m: observations.rows().points_m().to_vec(),
            n_joints: arm.robot.n_joints(),
            thinning,
            motions: like.map_or_else(|| motions.into(), |like| Arc::clone(&like.motions)),
            body: like.filter(|_| every == 1).and_then(|like| like.body.clone()),
        })
    }

    /// By row, whether any of these touches has displaced the cell.
    pub fn touched_rows(&self, touches: &[usize]) -> Vec<bool> {
        let mut met = vec![false; self.cells.len()];
        for frame in touches.iter().flat_map(|&touch| &self.touches[touch].frames) {
            frame.observation.rows().for_each(|row| met[row] = true);
        }
        met
    }

    /// All cells with the stiffness that `stiffness` gives for their row, N/m; called in the order of rows.
    pub(crate) fn with_stiffness(&self, mut stiffness: impl FnMut(usize) -> f64) -> Vec<CellState> {
        let cell = |(row, &point): (usize, &[f64; 3])| CellState::new(point, stiffness(row));
        self.points_m.iter().enumerate().map(cell).collect()
    }

    /// Standard deviation of the torques during the tares of these touches, where nothing is
    /// touched, n_joints, N·m; 0 without such frames.
    pub fn noise_std(&self, touches: &[usize]) -> Vec<f64> {
        let (mut squares, mut freedom) = (DVector::<f64>::zeros(self.n_joints), 0.0);
        let torques = touches.iter().map(|&touch| &self.touches[touch].of_tare);
        for torques in torques.filter(|torques| !torques.is_empty()) {
            let n = torques.len() as f64;
            let mean = torques.iter().sum::<DVector<f64>>() / n;
            let apart = torques.iter().map(|torque| torque - &mean);
            squares += apart.map(|apart| apart.component_mul(&apart)).sum::<DVector<f64>>();
            freedom += n - 1.0;
        }
        squares.iter().map(|square| (square / f64::max(freedom, 1.0)).sqrt()).collect()
    }

    /// Joint positions and measured torques of these touches, for regressions that learn from joint positions.
    pub fn frames(&self, touches: &[usize]) -> Frames {
        let of =
            |&touch: &usize| self.touches[touch].frames.iter().map(move |frame| (touch, frame));
        let frames: Vec<(usize, &TrackedFrame)> = touches.iter().flat_map(of).collect();
        let q = |joint: usize, frame: usize| frames[frame].1.unwrapped[joint];
        let tau = |joint: usize, frame: usize| frames[frame].1.observation.tau()[joint];
        Frames {
            q: DMatrix::from_fn(self.n_joints, frames.len(), q),
            tau: DMatrix::from_fn(self.n_joints, frames.len(), tau),
            touch: frames.iter().map(|(touch, _)| *touch).collect(),
        }
    }
}

impl TrackedTouch {
    /// Frames in which the arm displaces something.
    pub fn frames_in_contact(&self) -> usize {
        self.in_contact().count()
    }

    /// The frames in contact.
    pub fn in_contact(&self) -> impl Iterator<Item = &TrackedFrame> + Clone {
        self.frames.iter().filter(|frame| frame.observation.n_contacts() > 0)
    }
}

impl TrackedFrame {
    /// The observation with the weights of this frame's torques, for an estimator.
    pub(crate) fn weighted(
        &self,
        observation: Observation,
        config: &EstimatorConfig,
    ) -> Observation {
        match &self.tau_std {
            Some(std) => observation.weighted(&torque_weights(std, &config.torque_std)),
            None => observation,
        }
    }

    /// Predicted torque `τ̂ = Σ wᵢ Kᵢ` (Eq. 5), n_joints, N·m. Cells are by row; their stiffness counts as at least 0.
    pub(crate) fn predict(&self, cells: &[CellState]) -> Vec<f64> {
        self.observation.predict(cells, StiffnessRule::Positive).as_slice().to_vec()
    }
}

/// For each touch, given by its samples, the largest norm of the external torque in contact, N·m; 0 without contact. In
/// long logs, a touch is simulated only up to its first contact, and counts as in contact from then on.
///
/// # Errors
///
/// Names the first touch and sample that cannot be used.
pub fn largest_torques(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[&[Sample]],
    stop: Stop<'_>,
) -> Result<Vec<f64>, LearnError> {
    let (contact, touch) = (&config.contact, config.touch.clone());
    let tracker = Tracker::new(Arc::clone(arm), config.lattice.clone(), contact, touch)?;
    let is_long = Ways::of(arm, config, touches).steps(1) > STEPS;
    let largest = |(number, samples): (usize, &&[Sample])| {
        let at = |sample, source: TrackerError| {
            let source = source.into();
            LearnError::Sample { touch: number, sample, source }
        };
        let (mut tracker, mut downsampling, mut largest) =
            (tracker.clone(), Downsampling::default(), 0.0_f64);
        tracker.begin_touch();
        for (sample, logged) in samples.iter().enumerate() {
            unless_stopped(stop)?;
            if !downsampling.takes(logged) && tracker.tare().is_some() {
                continue;
            }
            if let Some(tare) = tracker.tare().filter(|_| is_long && largest > 0.0) {
                let (_, untared) = tracker.check(logged).map_err(|error| at(sample, error))?;
                largest = largest.max((untared - tare).norm());
                continue;
            }
            let frame = tracker.feed(logged).map_err(|error| at(sample, error))?;
            if let Some(external) = frame.external.filter(|_| !frame.contacts.is_empty()) {
                largest = largest.max(external.norm());
            }
        }
        Ok(largest)
    };
    let each: Vec<Result<f64, LearnError>> = touches.par_iter().enumerate().map(largest).collect();
    each.into_iter().collect()
}

/// A frame that was simulated, before it becomes a [`TrackedFrame`].
struct SimulatedFrame {
    /// Index of the sample in its touch.
    sample: usize,
    unwrapped: Vec<f64>,
    tracked: TrackedSample,
    external: DVector<f64>,
}

impl SimulatedFrame {
    fn observed(
        self,
        arm: &Arm,
        touch: &TouchSamples,
        observations: &mut ObservationBuilder,
    ) -> TrackedFrame {
        let Sample { time_s, ref q, .. } = touch.samples[self.sample];
        let TrackedSample { poses, contacts, .. } = &self.tracked;
        let truth = touch.truth.as_ref().map(|truth| truth[self.sample].clone());
        let displacements = contacts.links.iter().flat_map(|link| &link.displacements_m);
        let push = displacements.map(|u| Vector3::from(*u).cast::<f64>()).sum();
        TrackedFrame {
            sample: self.sample as u32,
            time_s,
            q: q.clone(),
            unwrapped: self.unwrapped,
            observation: observations.build(&arm.robot, poses, contacts, &self.external),
            tau_std: self.tracked.tau_std.clone(),
            target: truth.unwrap_or_else(|| self.external.as_slice().to_vec()),
            push: Unit::try_new(push, 0.0),
        }
    }
}

/// A touch that was simulated.
#[derive(Default)]
struct Followed {
    frames: Vec<SimulatedFrame>,
    of_tare: Vec<DVector<f64>>,
    motion: Vec<MotionFrame>,
}

/// Simulates a touch: every n-th of its downsampled and thinned frames after the tare (if `like` is given, of its frames
/// and with their torques), and the torques during the tare, with the bias.
fn follow(
    mut tracker: Tracker,
    (number, touch, thinning): (usize, &TouchSamples, usize),
    (first, like, every): (Option<&Vec<f64>>, Option<&[TrackedFrame]>, usize),
    stop: Stop<'_>,
) -> Result<Followed, LearnError> {
    let at = |sample, source| LearnError::Sample { touch: number, sample, source };
    let arm = Arc::clone(tracker.arm());
    tracker.begin_touch();
    let (mut followed, mut n_frames) = (Followed::default(), 0);
    // If the first sample is of another robot, it is ignored here; the check reports the error at the right place.
    let first = first.filter(|q| q.len() == arm.robot.n_joints());
    let mut before = first.or(touch.samples.first().map(|sample| &sample.q)).cloned();
    let mut unwrapped = before.clone().unwrap_or_default();
    let mut downsampling = Downsampling::default();
    for (index, sample) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        let (_, untared) = tracker.check(sample).map_err(|error| at(index, error.into()))?;
        let is_learnt = downsampling.takes(sample);
        let is_simulated = is_learnt
            && match like {
                Some(like) => (like.get(n_frames))
                    .is_some_and(|next| n_frames == 0 || next.sample == index as u32),
                None => followed.motion.len().is_multiple_of(thinning),
            };
        let tracked = match tracker.tare() {
            Some(_) if !is_simulated => None,
            _ => Some(tracker.feed(sample).map_err(|error| at(index, error.into()))?),
        };
        if is_learnt || tracked.is_some() {
            let way = arm.robot.difference(before.as_ref().unwrap_or(&sample.q), &sample.q);
            unwrapped.iter_mut().zip(&way).for_each(|(total, way)| *total += way);
            before = Some(sample.q.clone());
        }
        let Some(tare) = tracker.tare() else {
            followed.of_tare.push(untared);
            continue;
        };
        if !is_learnt {
            continue;
        }
        let unwrapped = unwrapped.clone();
        let external = match like {
            None => untared - tare,
            Some(like) => match like.get(n_frames) {
                Some(known) if known.sample == index as u32 => known.observation.tau().into_owned(),
                _ => continue,
            },
        };
        if like.is_none() {
            followed.motion.push(MotionFrame::of(sample, &unwrapped, &external));
        }
        if let Some(tracked) = tracked {
            if n_frames.is_multiple_of(every) {
                let frame = SimulatedFrame { sample: index, unwrapped, tracked, external };
                followed.frames.push(frame);
            }
            n_frames += 1;
        }
    }
    tracker.end_touch().map_err(|error| at(touch.samples.len(), error.into()))?;
    Ok(followed)
}

/// The motion of the arm between successive frames in contact.
fn in_contact(arm: &Arm, frames: &[SimulatedFrame], touch: &TouchSamples) -> PathLength {
    frames.windows(2).fold(PathLength::default(), |sum, pair| {
        let time_s = |of: &SimulatedFrame| touch.samples[of.sample].time_s;
        let passed_s = time_s(&pair[1]).zip(time_s(&pair[0])).map(|(now, before)| now - before);
        let touches = pair.iter().all(|frame| !frame.tracked.contacts.is_empty());
        match passed_s.filter(|passed_s| touches && *passed_s > 0.0 && passed_s.is_finite()) {
            Some(passed_s) => {
                let [from, to] = [0, 1].map(|of| &pair[of].tracked.poses.world_from_link);
                let path_m = sum.path_m + arm.travel_m(from, to);
                PathLength { path_m, time_s: sum.time_s + passed_s }
            }
            None => sum,
        }
    })
}

fn check_truth(touch: &TouchSamples, n_joints: usize) -> Result<(), LearnError> {
    let Some(truth) = &touch.truth else { return Ok(()) };
    let odd = truth.iter().map(Vec::len).find(|n| *n != n_joints);
    if truth.len() == touch.samples.len() && odd.is_none() {
        return Ok(());
    }
    let size = |rows: usize, joints: usize| format!("{rows} rows of {joints} joints");
    Err(LearnError::Truth {
        touch: touch.name.clone(),
        got: size(truth.len(), odd.unwrap_or(n_joints)),
        expected: size(touch.samples.len(), n_joints),
    })
}
