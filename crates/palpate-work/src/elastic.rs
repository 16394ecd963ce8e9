//! Elastic bodies: made from a cloud, learnt from touches, bent along a path.

use std::sync::Arc;

use nalgebra::Point3;
use palpate::unstable::{Downsampling, ElasticBody, ElasticModel, SegmentKind};
use palpate::{
    Arm, EstimatorKind, ExternalTorqueConfig, Field, Mapper, MapperError, Predictor, Sample,
};
use palpate_io::cloud::Cloud;
use palpate_io::field::SavedField;
use palpate_learn::body::{ObjectCloud, ObjectHints, ObjectKind, candidate_bodies};
use palpate_learn::calibrate::PredictedFrame;
use palpate_learn::elastic::{ConvergenceCounts, ElasticBodyLearner, steps};
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_learn::{LearnError, Stop};
use rayon::prelude::*;

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::{Settings, SettingsError};

/// Largest width of a cloud, m; wider ones are refused, since their unit is probably not m.
const WIDEST_M: f64 = 30.0;
/// Largest distance of a root from the nearest point of the clouds, m.
const FARTHEST_ROOT_M: f64 = 1.0;

/// A cloud from one camera, and the position of the camera, m, world frame, if it is known.
pub type CloudWithViewpoint = (Cloud, Option<Point3<f64>>);

/// Possible elastic bodies for the clouds of an object, the most likely first; empty if nothing in them can bend. A
/// note or a warning says what was found; `name` is the name of the clouds in it.
///
/// # Errors
///
/// If a cloud is too wide for lengths in m, a root is far from all points, or a root is given for a cushion.
///
/// # Panics
///
/// If a cloud has no colours.
pub fn bodies(
    clouds: &[CloudWithViewpoint],
    hints: &ObjectHints,
    name: &str,
    progress: &dyn Progress,
) -> Result<Vec<Arc<ElasticBody>>, WorkError> {
    check_size(clouds, name)?;
    check_roots(clouds, hints)?;
    let pictures = clouds.iter().map(|(cloud, viewpoint)| ObjectCloud {
        points: cloud.points(),
        colours: cloud.colours().expect("the caller gave colours"),
        viewpoint: *viewpoint,
    });
    let pictures: Vec<ObjectCloud<'_>> = pictures.collect();
    let bodies = candidate_bodies(&pictures, hints);
    let kind = hints.kind();
    match bodies.first() {
        Some(body) => {
            let or_plant = body.has_blocks() && kind.is_none();
            let hint = if or_plant {
                "; if it is a plant, cut off what else the cloud shows, or say so with --object-kind plant"
            } else {
                ""
            };
            let n = bodies.len();
            progress.note(&format!("{}; variants compared: {n}{hint}", in_words(body)));
        }
        None => {
            let missing = match kind {
                None => "neither a stem with branches nor a surface above its lowest point",
                Some(ObjectKind::Plant) => "no stem with branches",
                Some(ObjectKind::Cushion) => "no surface above its lowest point",
            };
            progress.warn(&format!(
                "no elastic body: palpate found {missing} in `{name}` ({} points; lengths are taken as m), \
                 so `map` is used alone",
                clouds.iter().map(|(cloud, _)| cloud.len()).sum::<usize>()
            ));
        }
    }
    Ok(bodies.into_iter().map(Arc::new).collect())
}

/// Refuses clouds that are wider than [`WIDEST_M`] between the 5 % and 95 % quantiles of an axis: they may be in mm.
fn check_size(clouds: &[CloudWithViewpoint], name: &str) -> Result<(), WorkError> {
    let spans = clouds.iter().flat_map(|(cloud, _)| {
        (0..3).map(|axis| {
            let mut along: Vec<f64> = cloud.points().iter().map(|point| point[axis]).collect();
            along.sort_by(f64::total_cmp);
            let at = |part: usize| along.get(part * along.len() / 20).copied().unwrap_or_default();
            at(19) - at(1)
        })
    });
    let widest_m = spans.fold(0.0, f64::max);
    if widest_m > WIDEST_M {
        return Err(WorkError::Usage(format!(
            "the points of `{name}` span {widest_m:.0} m; wanted an object within an arm's reach, in the frame of the \
             robot's base and in m: are they in mm?"
        )));
    }
    Ok(())
}

/// Refuses roots of a cushion, and roots that are far from all points.
fn check_roots(clouds: &[CloudWithViewpoint], hints: &ObjectHints) -> Result<(), WorkError> {
    if hints.kind == Some(ObjectKind::Cushion) && !hints.roots_m.is_empty() {
        let message = "a root is the point where a plant is held, but the given kind of object is a cushion; \
                       leave one of the two out";
        return Err(WorkError::Usage(message.to_owned()));
    }
    for root in &hints.roots_m {
        let points = clouds.iter().flat_map(|(cloud, _)| cloud.points());
        let nearest_m = points.map(|point| (point - root).norm()).fold(f64::INFINITY, f64::min);
        if nearest_m > FARTHEST_ROOT_M {
            let [x, y, z] = [root.x, root.y, root.z];
            return Err(WorkError::Usage(format!(
                "the root {x},{y},{z} is {nearest_m:.3} m from the nearest point that was seen; wanted at most \
                 {FARTHEST_ROOT_M} m (lengths are taken as m)"
            )));
        }
    }
    Ok(())
}

/// Describes the parts of a body in words.
fn in_words(body: &ElasticBody) -> String {
    let of = |kind: SegmentKind| body.segments().iter().filter(move |segment| segment.kind == kind);
    let length: f64 = of(SegmentKind::Wood).map(|segment| segment.axis().norm()).sum();
    let branches =
        of(SegmentKind::Wood).map(|segment| segment.branch).max().map_or(0, |last| last + 1);
    let leaves = of(SegmentKind::Leaf).count();
    let blocks = of(SegmentKind::Block).count();
    if blocks > 0 {
        let materials = body.n_trees();
        return format!(
            "elastic body: a cushion of {blocks} blocks, number of materials {materials}"
        );
    }
    format!("elastic body: {length:.2} m of wood in {branches} stems and branches, {leaves} leaves")
}

/// Replaces the estimator `elastic` by `map` in the settings of an evaluation, in which both are methods.
///
/// # Errors
///
/// If `elastic` is set and there is no body.
pub fn replace_elastic_by_map(
    settings: &mut Settings,
    has_body: bool,
) -> Result<(), SettingsError> {
    let estimator = &mut settings.estimator.estimator;
    match (*estimator, has_body) {
        (Some(EstimatorKind::Elastic), true) => *estimator = Some(EstimatorKind::Map),
        (Some(EstimatorKind::Elastic), false) => return Err(without_body()),
        _ => {}
    }
    Ok(())
}

/// The error if `elastic` is set where no body can be made.
pub fn without_body() -> SettingsError {
    SettingsError::Together(
        "the estimator `elastic` needs a coloured cloud of the object, or a picture with depth: give \
         `palpate map`, `evaluate` or `live` one with --cloud (other commands do not learn elastic bodies)"
            .to_owned(),
    )
}

/// Simulates bodies along all touches. `training` are the sets of touches, by number, from which a body will be learnt.
///
/// # Errors
///
/// On being stopped.
pub(crate) fn simulate_bodies(
    tracked: TrackedTouches,
    (arm, bodies): (&Arc<Arm>, &[Arc<ElasticBody>]),
    (touches, training): (&[TouchSamples], &[Vec<usize>]),
    progress: &dyn Progress,
) -> Result<TrackedTouches, LearnError> {
    simulating(steps(touches.len(), bodies.len()), progress, |stop_and_step| {
        let tracked = tracked.with_bodies(arm, bodies, (touches, training), stop_and_step)?;
        let convergence = tracked.convergence().unwrap_or_default();
        Ok((tracked, convergence))
    })
}

/// Runs a simulation of bodies along touches with a progress bar of so many steps, and notes how often the body did not
/// come to rest.
fn simulating<T>(
    steps: usize,
    progress: &dyn Progress,
    simulate: impl FnOnce((Stop<'_>, &(dyn Fn() + Sync))) -> Result<(T, ConvergenceCounts), LearnError>,
) -> Result<T, LearnError> {
    let bar = progress.begin(Some(steps as u64), "touches", "simulating the elastic body");
    let (simulated, convergence) = simulate((&|| progress.stopped(), &|| bar.step()))?;
    drop(bar);
    if convergence.not_converged > 0 {
        let percent = 100.0 * convergence.not_converged as f64 / convergence.samples as f64;
        progress.note(&format!(
            "the elastic body did not come to rest in {percent:.1} % of the samples; there, its torque \
             is that of the last iteration"
        ));
    }
    Ok(simulated)
}

/// The field of a mapper, with an elastic body learnt from the same touches; the field alone if there are no bodies. The
/// bands are those of both together; there are none if the field has extrapolated stiffness, with which the body was not
/// learnt. `touches` are the samples of all touches that the mapper has learnt.
///
/// # Errors
///
/// If a sample cannot be used, or on being stopped.
pub fn learn_body(
    mapper: &Mapper,
    bodies: &[Arc<ElasticBody>],
    touches: Vec<Vec<Sample>>,
    progress: &dyn Progress,
) -> Result<SavedField, WorkError> {
    let mut saved = SavedField::of_mapper(mapper);
    if bodies.is_empty() {
        return Ok(saved);
    }
    let mut learner = ElasticBodyLearner::new(mapper.arm(), mapper.config(), bodies).calibrating();
    let folds = learner.folds(touches.len());
    let steps = steps(touches.len(), bodies.len()) + folds;
    let learnt = simulating(steps, progress, |stop_and_step| {
        let model = learner.learn(touches.clone(), stop_and_step)?;
        Ok((model, learner.convergence()))
    });
    let mut learnt = learnt.map_err(|error| match error {
        LearnError::Stopped => {
            let kept = " while the elastic body was learnt; nothing was written".to_owned();
            WorkError::Interrupted { kept }
        }
        other => WorkError::file(other),
    })?;
    if learnt.likeliest().stiffness_factors.iter().all(|factor| *factor == 0.0) {
        progress.warn(
            "no stiffness of the elastic body explains the touches, so it predicts no torque: is the object of another \
             kind (--object-kind), or is it not where the cloud shows it?",
        );
    }
    if saved.prior_n_per_m.is_some() {
        learnt.calibration = None;
    }
    saved.field.elastic = Some(Arc::new(learnt));
    saved.elastic_touches = touches;
    Ok(saved)
}

/// A field's predictions for the samples of touches, with its elastic body; `None` for samples of the tare, and for those
/// that are too close to the one before to be learnt.
///
/// # Errors
///
/// Names the first touch and sample that cannot be used; or on being stopped.
pub(crate) fn predicted_with_body(
    (arm, field): (&Arc<Arm>, &Field),
    config: &ExternalTorqueConfig,
    touches: &[TouchSamples],
    (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
) -> Result<Vec<Vec<Option<PredictedFrame>>>, LearnError> {
    let predict = |(number, touch): (usize, &TouchSamples)| {
        let mut predictor = Predictor::new(Arc::clone(arm), field, config.clone())?;
        predictor.begin_touch();
        let mut downsampling = Downsampling::default();
        let frames = touch.samples.iter().enumerate().map(|(sample, logged)| {
            if stop() {
                return Err(LearnError::Stopped);
            }
            if !downsampling.takes(logged) && predictor.tare().is_some() {
                return Ok(None);
            }
            let at = predictor.step(logged).map_err(|error| {
                let source = MapperError::from(error);
                LearnError::Sample { touch: number, sample, source }
            })?;
            Ok(at.map(|at| PredictedFrame {
                torque: at.predicted.data.into(),
                spread: at.spread.map_or(Vec::new(), |spread| spread.data.into()),
                measured: at.external.data.into(),
                contacts: [at.contacts, at.known],
            }))
        });
        let frames = frames.collect::<Result<_, LearnError>>();
        step();
        frames
    };
    touches.par_iter().enumerate().with_max_len(1).map(predict).collect()
}

/// Start and end of each segment of a body, m, by frame.
pub type BentFrames = Vec<Vec<[Point3<f64>; 2]>>;

/// A path of the arm that starts without contact.
#[derive(Debug, Clone, Copy)]
pub struct ArmPath<'a> {
    /// Joint positions, frames × n_joints, rad or m.
    pub q: &'a [Vec<f64>],
    /// Time of each frame, s.
    pub times_s: &'a [f64],
    /// The body is returned for every n-th frame.
    pub every: usize,
}

/// How the most likely body bends along paths of the arm.
///
/// # Errors
///
/// If positions are not the arm's, or the progress stops it.
pub fn bend_along(
    arm: &Arc<Arm>,
    model: &ElasticModel,
    paths: &[ArmPath<'_>],
    progress: &dyn Progress,
) -> Result<Vec<BentFrames>, WorkError> {
    let bar = progress.begin(Some(paths.len() as u64), "touches", "bending the elastic body");
    let follow = |path: &ArmPath<'_>| -> Result<BentFrames, WorkError> {
        let mut equilibrium = model.equilibrium(arm);
        let mut bent = Vec::new();
        let mut before_s = None;
        for (at, (q, &time_s)) in path.q.iter().zip(path.times_s).enumerate() {
            if progress.stopped() {
                let kept = " while the elastic body was bent for the report".to_owned();
                return Err(WorkError::Interrupted { kept });
            }
            let poses = arm.robot.forward(q).map_err(WorkError::file)?;
            equilibrium.advance(&poses.world_from_link, before_s.map(|before_s| time_s - before_s));
            before_s = Some(time_s);
            if at % path.every.max(1) == 0 {
                bent.push(equilibrium.segments_m());
            }
        }
        bar.step();
        Ok(bent)
    };
    paths.par_iter().with_max_len(1).map(follow).collect()
}
