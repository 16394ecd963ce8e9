//! Ranks candidate motions by how much they would teach about an object.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, EstimatorKind, Field, Gravity, MapperConfig, Predictor, Robot, Sample, Tare};
use palpate_io::field::SavedField;
use palpate_learn::calibrate::PredictedFrame;
use palpate_learn::next_touch::{Criterion, NextTouch, Proposal, Task, largest_torque_n_m};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use rayon::prelude::*;
use serde::Serialize;

use crate::contact_counts::low_and_high;
use crate::error::WorkError;
use crate::evaluate::{fault, touch_samples};
use crate::inspect::log::LIMIT_MARGIN;
use crate::progress::Progress;
use crate::settings::SettingsError;
use crate::touches::RecordedTouch;

/// How motions are to be ranked.
#[derive(Debug, Clone, Default)]
pub struct RankingRequest {
    /// Criterion by which motions are ranked.
    pub criterion: Criterion,
    /// Largest number of proposals.
    pub count: usize,
    /// Largest torque of a joint, N·m: motions whose predicted torque with its band exceeds it are left out.
    pub limit_n_m: Option<f64>,
    /// Two opposite corners of a box, m, world frame: motions are ranked by what they teach about the stiffness in it,
    /// in place of the torques of motions.
    pub box_m: Option<[[f64; 3]; 2]>,
}

/// Result of [`next`], printed by `palpate next --json`.
#[derive(Debug, Clone, Serialize)]
pub struct Proposals {
    /// The motions, the best first.
    pub proposals: Vec<NamedProposal>,
    /// Motions that may exceed the torque limit.
    pub beyond_limit: Vec<BeyondLimit>,
    /// Motions in which a joint goes beyond its limits.
    pub beyond_joint_limits: Vec<BeyondJointLimits>,
    /// Names of motions that touch nothing.
    pub touch_nothing: Vec<String>,
}

/// A motion that may exceed the torque limit.
#[derive(Debug, Clone, Serialize)]
pub struct BeyondLimit {
    /// Name of the motion.
    pub name: String,
    /// The largest torque of a joint with its band, N·m.
    pub with_band_n_m: f64,
}

/// A motion in which a joint goes beyond its limits.
#[derive(Debug, Clone, Serialize)]
pub struct BeyondJointLimits {
    /// Name of the motion.
    pub name: String,
    /// The joint that goes farthest beyond its limits.
    pub joint: String,
    /// Position of the joint that is farthest beyond, rad or m.
    pub position: f64,
    /// Lowest and highest position of the joint in the URDF, rad or m.
    pub limits: [f64; 2],
}

impl BeyondJointLimits {
    fn of(name: String, motion: &TouchSamples, robot: &Robot) -> Option<Self> {
        let positions =
            motion.samples.iter().flat_map(|sample| robot.joints().iter().zip(&sample.q));
        let beyond = positions.filter_map(|(joint, &position)| {
            let [low, high] = joint.range?;
            let beyond = (low - position).max(position - high);
            (beyond > LIMIT_MARGIN).then_some((beyond, joint, position, [low, high]))
        });
        let (_, joint, position, limits) = beyond.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(Self { name, joint: joint.name.clone(), position, limits })
    }
}

/// A proposed motion with its name.
#[derive(Debug, Clone, Serialize)]
pub struct NamedProposal {
    /// Name of the motion.
    pub name: String,
    /// The log with the motion.
    pub log: PathBuf,
    /// Index of the motion among the candidates, from 0.
    pub candidate: usize,
    /// What the motion would teach, and the torque to expect.
    #[serde(flatten)]
    pub proposal: Proposal,
}

/// Checks that the field belongs to the arm and that the request suits it.
fn check(
    arm: &Arm,
    field: &Field,
    request: &RankingRequest,
    progress: &dyn Progress,
) -> Result<(), WorkError> {
    if let Some(Err(what)) = field.bands().map(|own| own.check(arm.robot.n_joints())) {
        return Err(WorkError::from(format!("the field belongs to another robot: {what}")));
    }
    if let Some(limit) = request.limit_n_m.filter(|limit| !(*limit > 0.0 && limit.is_finite())) {
        return Err(WorkError::Usage(format!("the limit is {limit} N·m; wanted more than 0")));
    }
    if field.elastic.is_some() && field.bands().is_none() {
        if request.limit_n_m.is_some() {
            return Err(WorkError::Usage(
                "the field has an elastic body, but no bands with it, so palpate cannot say how large the torques may \
                 become; wanted a field of at least one touch, learned with this version (`palpate map --from FIELD` \
                 learns its touches again)"
                    .to_owned(),
            ));
        }
        progress.note("the torques are those of the field's springs, without its elastic body");
    }
    Ok(())
}

/// For each motion, the largest torque of a joint, N·m, predicted and with its band, if the field has an elastic body
/// and bands with it.
fn with_body(
    arm: &Arc<Arm>,
    field: &Field,
    motions: &[TouchSamples],
    progress: &dyn Progress,
) -> Result<Option<Vec<[f64; 2]>>, WorkError> {
    let Some(calibration) = field.bands().filter(|_| field.elastic.is_some()) else {
        return Ok(None);
    };
    let bar = progress.begin(Some(motions.len() as u64), "motions", "bending the elastic body");
    let largest = |motion: &TouchSamples| -> Result<[f64; 2], WorkError> {
        let mut predictor =
            Predictor::planned(Arc::clone(arm), field).map_err(SettingsError::value)?;
        predictor.begin_touch();
        let mut frames = Vec::new();
        for sample in &motion.samples {
            if progress.stopped() {
                return Err(WorkError::Interrupted { kept: String::new() });
            }
            let Some(at) = predictor.step(sample).map_err(WorkError::file)? else { continue };
            frames.push(PredictedFrame {
                torque: at.predicted.data.into(),
                spread: at.spread.map_or(Vec::new(), |spread| spread.data.into()),
                measured: at.external.data.into(),
                contacts: [at.contacts, at.known],
            });
        }
        bar.step();
        Ok(largest_torque_n_m(Some(calibration), frames))
    };
    let torques: Result<Vec<_>, WorkError> = motions.par_iter().map(largest).collect();
    torques.map(Some)
}

/// Ranks `candidates` by what they would teach about the torques of the motions in `task`, or of the candidates
/// themselves if it is empty.
///
/// Only joint positions are used, not the torques of recorded motions.
///
/// # Errors
///
/// If a motion cannot be used, or the progress stops it.
pub fn next(
    arm: &Arc<Arm>,
    saved: &SavedField,
    (candidates, task): (&[RecordedTouch], &[RecordedTouch]),
    request: &RankingRequest,
    progress: &dyn Progress,
) -> Result<Proposals, WorkError> {
    let field = &saved.field;
    check(arm, field, request, progress)?;
    let mut config = MapperConfig::of(EstimatorKind::Map);
    (config.lattice, config.contact) = (field.lattice.clone(), field.contact.clone());
    config.touch.gravity = Gravity::Removed;
    config.touch.tare = Tare::None;
    let recorded = [candidates, task].concat();
    let motions: Vec<TouchSamples> =
        touch_samples(&recorded, false)?.into_iter().map(planned).collect();
    let stop = || progress.stopped();
    let _bar = progress.begin(None, "motions", "judging");
    let fault = |error| fault(&recorded, error, String::new());
    let tracked = TrackedTouches::new(arm, &config, &motions, &stop).map_err(fault)?;
    let stds = (untouched_std_n_per_m(saved), torque_std_n_m(saved));
    let mut judge = NextTouch::new(&tracked, field, stds);
    if let Some(torques) = with_body(arm, field, &motions, progress)? {
        judge = judge.with_body(torques);
    }
    let count = candidates.len();
    let name = |motion: usize| tracked.touches[motion].name.clone();
    let (mut able, mut beyond_limit, mut touch_nothing) = (Vec::new(), Vec::new(), Vec::new());
    let (mut within, mut beyond_joint_limits) = (Vec::new(), Vec::new());
    for (motion, path) in motions[..count].iter().enumerate() {
        if let Some(own) = BeyondJointLimits::of(name(motion), path, &arm.robot) {
            beyond_joint_limits.push(own);
            continue;
        }
        within.push(motion);
        let torque = judge.torque_n_m(motion)[1];
        if tracked.touches[motion].frames_in_contact() == 0 {
            touch_nothing.push(name(motion));
        } else if !request.limit_n_m.is_none_or(|limit| torque <= limit) {
            beyond_limit.push(BeyondLimit { name: name(motion), with_band_n_m: torque });
        } else {
            able.push(motion);
        }
    }
    let mut found =
        Proposals { proposals: Vec::new(), beyond_limit, beyond_joint_limits, touch_nothing };
    if able.is_empty() {
        return Ok(found);
    }
    let of_motions = if task.is_empty() { within } else { (count..recorded.len()).collect() };
    let corners = request.box_m.map(low_and_high);
    let task = corners.map_or(Task::Motions(of_motions), Task::Box);
    let ranked = judge.rank((&able, request.count), &task, request.criterion, &stop);
    let named = |proposal: Proposal| NamedProposal {
        name: name(proposal.motion),
        log: recorded[proposal.motion].log.clone(),
        candidate: proposal.motion,
        proposal,
    };
    found.proposals = ranked.map_err(fault)?.into_iter().map(named).collect();
    Ok(found)
}

/// A motion with zero torques.
fn planned(touch: TouchSamples) -> TouchSamples {
    let still =
        |sample: Sample| Sample::new(sample.time_s, sample.q.clone(), vec![0.0; sample.q.len()]);
    TouchSamples { samples: touch.samples.into_iter().map(still).collect(), ..touch }
}

/// Standard deviation of a measured torque, N·m: the largest torque noise of a joint with which the field was learnt;
/// 0.2 if unknown.
fn torque_std_n_m(saved: &SavedField) -> f64 {
    let own = saved.snapshot.as_ref().map(|snapshot| &snapshot.config.estimator.torque_std);
    own.map_or(0.2, |own| own.iter().copied().fold(f64::MIN_POSITIVE, f64::max))
}

/// Standard deviation of untouched cells, N/m: from the calibration, else from the prior, else the largest one in the
/// field.
fn untouched_std_n_per_m(saved: &SavedField) -> f64 {
    let of_prior = saved.snapshot.as_ref().map(|snapshot| {
        let (config, spacing_m) = (&snapshot.config.estimator, snapshot.config.lattice.spacing_m());
        config.stiffness_scale * config.prior.at_spacing(spacing_m).1
    });
    let calibrated = saved.field.bands().map(|own| own.untouched_std_n_per_m);
    let least = || saved.field.std_n_per_m.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    calibrated.or(of_prior).unwrap_or_else(least)
}
