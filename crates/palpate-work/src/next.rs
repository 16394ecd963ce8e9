//! Ranks candidate motions by how much they would teach about an object.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{
    Arm, Calibration, EstimatorKind, ExternalTorqueConfig, Field, Gravity, MapperConfig, Robot,
    Sample, Tare,
};
use palpate_io::field::SavedField;
use palpate_learn::next_touch::{Criterion, NextTouch, Proposal, Task, largest_torque_n_m};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::{LearnError, Stop};
use serde::Serialize;

use crate::contact_counts::low_and_high;
use crate::elastic::predicted_with_body;
use crate::error::WorkError;
use crate::evaluate::{fault, touch_samples};
use crate::inspect::log::LIMIT_MARGIN;
use crate::progress::Progress;
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
                "the field has an elastic body, but no bands, so palpate cannot say how large the torques may become; \
                 wanted a field that has learned at least one touch with this version of palpate, and no extrapolated \
                 stiffness (`palpate map LOG --cloud CLOUD` learns one)"
                    .to_owned(),
            ));
        }
        progress.note("the torques are those of the field's springs, without its elastic body");
    }
    Ok(())
}

/// The largest torque of a joint in each motion, N·m, predicted by springs and body and with its band; 0 where a motion
/// is not among the `wanted`.
fn torques_with_body(
    (arm, field): (&Arc<Arm>, &Field),
    (config, calibration): (&ExternalTorqueConfig, &Calibration),
    (motions, wanted): (&[TouchSamples], &[usize]),
    progress: &dyn Progress,
) -> Result<Vec<[f64; 2]>, LearnError> {
    let bar = progress.begin(Some(wanted.len() as u64), "motions", "bending the elastic body");
    let watch: (Stop<'_>, &(dyn Fn() + Sync)) = (&|| progress.stopped(), &|| bar.step());
    let touches: Vec<TouchSamples> = wanted.iter().map(|motion| motions[*motion].clone()).collect();
    let predicted = predicted_with_body((arm, field), config, &touches, watch)?;
    let mut torques = vec![[0.0; 2]; motions.len()];
    for (&motion, frames) in wanted.iter().zip(predicted) {
        torques[motion] = largest_torque_n_m(Some(calibration), frames.into_iter().flatten());
    }
    Ok(torques)
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
    let config = of_plans(field);
    let recorded = [candidates, task].concat();
    let motions: Vec<TouchSamples> =
        touch_samples(&recorded, false)?.into_iter().map(|own| planned(own, &arm.robot)).collect();
    let stop = || progress.stopped();
    let fault = |error| fault(&recorded, error, String::new());
    let bar = progress.begin(None, "motions", "judging");
    let tracked = TrackedTouches::new(arm, &config, &motions, &stop).map_err(fault)?;
    drop(bar);
    let stds = (untouched_std_n_per_m(saved), torque_std_n_m(saved));
    let mut judge = NextTouch::new(&tracked, field, stds);
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
        match tracked.touches[motion].frames_in_contact() {
            0 => touch_nothing.push(name(motion)),
            _ => able.push(motion),
        }
    }
    if let Some(calibration) = field.bands().filter(|_| field.elastic.is_some()) {
        let own = (&config.touch, calibration);
        let torques = torques_with_body((arm, field), own, (&motions, &able), progress);
        judge = judge.with_torques(torques.map_err(fault)?);
    }
    able.retain(|&motion| {
        let with_band_n_m = judge.torque_n_m(motion)[1];
        let is_within = request.limit_n_m.is_none_or(|limit| with_band_n_m <= limit);
        if !is_within {
            beyond_limit.push(BeyondLimit { name: name(motion), with_band_n_m });
        }
        is_within
    });
    let _bar = progress.begin(None, "motions", "ranking");
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

/// The settings with which motions without torques are simulated.
fn of_plans(field: &Field) -> MapperConfig {
    let mut config = MapperConfig::of(EstimatorKind::Map);
    (config.lattice, config.contact) = (field.lattice.clone(), field.contact.clone());
    (config.touch.gravity, config.touch.tare) = (Gravity::Removed, Tare::None);
    config
}

/// Largest motion of a joint from one judged position to the next, rad or m.
const LONGEST_STEP: f64 = 0.02;
/// Most judged positions from one position of a motion to the next.
const MOST_STEPS: f64 = 1_000.0;

/// A motion with zero torques, and with positions between those that are far apart: the largest torque may come there.
fn planned(touch: TouchSamples, robot: &Robot) -> TouchSamples {
    let mut samples: Vec<Sample> = Vec::with_capacity(touch.samples.len());
    for sample in touch.samples {
        if let Some(before) = samples.last().cloned() {
            samples.extend(between(&before, &sample, robot));
        }
        let torques = vec![0.0; sample.q.len()];
        samples.push(Sample::new(sample.time_s, sample.q, torques));
    }
    TouchSamples { samples, ..touch }
}

/// Samples between two, such that no joint moves by more than [`LONGEST_STEP`]; none for positions of another robot,
/// which are refused later.
fn between(from: &Sample, to: &Sample, robot: &Robot) -> Vec<Sample> {
    let n_joints = robot.n_joints();
    if from.q.len() != n_joints || to.q.len() != n_joints {
        return Vec::new();
    }
    let way = robot.difference(&from.q, &to.q);
    let longest = way.iter().fold(0.0, |most: f64, own| most.max(own.abs()));
    let steps = (longest / LONGEST_STEP).ceil().clamp(1.0, MOST_STEPS);
    let at = |step: usize| {
        let part = step as f64 / steps;
        let time_s = from.time_s.zip(to.time_s).map(|(from, to)| from + part * (to - from));
        Sample::new(time_s, robot.interpolate(&from.q, &to.q, part), vec![0.0; n_joints])
    };
    (1..steps as usize).map(at).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sparse_plan_is_judged_along_the_whole_way() {
        let robot = Robot::built_in("kinova_gen3").unwrap();
        let (mut from, mut to) = (vec![0.0; 7], vec![0.0; 7]);
        (from[0], to[0], to[1]) = (3.1, -3.1, 0.5);
        let samples = [(0.0, &from), (2.0, &to)].map(|(time_s, q): (f64, &Vec<f64>)| {
            Sample::new(Some(time_s), q.clone(), vec![1.0; 7])
        });
        let touch = TouchSamples { name: "plan".into(), samples: samples.to_vec(), truth: None };
        let found = planned(touch, &robot).samples;
        assert_eq!(found.len(), 26);
        assert_eq!([&found[0].q, &found[25].q], [&from, &to]);
        for pair in found.windows(2) {
            let way = robot.difference(&pair[0].q, &pair[1].q);
            assert!(way.iter().all(|own| own.abs() <= LONGEST_STEP + 1e-12), "{way:?}");
            let passed_s = pair[1].time_s.unwrap() - pair[0].time_s.unwrap();
            assert!((passed_s - 0.08).abs() < 1e-9, "{passed_s}");
        }
        assert!(found.iter().all(|sample| sample.tau == [0.0; 7]));
    }
}
