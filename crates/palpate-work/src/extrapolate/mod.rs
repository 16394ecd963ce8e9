//! Runs an extrapolation: tracks the remembered touches again, extrapolates stiffness, compares on halves.

use std::path::Path;
use std::sync::Arc;

use nalgebra::{DVector, Point3};
use palpate::{Arm, CellId, Field, MapperConfig};
use palpate_io::cloud::Cloud;
use palpate_io::field::SavedField;
use palpate_learn::extrapolate::compare::{ComparisonPlan, VariantErrors};
use palpate_learn::extrapolate::{
    Extrapolation, ExtrapolationConfig, ExtrapolationMethod, Features, REACH_CELLS, SeenCloud,
    extrapolate,
};
use palpate_learn::tracked::{TrackedTouch, TrackedTouches};

mod fill_field;
mod held_out;
mod torque_evidence;

pub use fill_field::filled;
pub use held_out::HeldOutErrors;
pub use torque_evidence::remembers;

use crate::error::WorkError;
use crate::progress::Progress;
use crate::quantile::bounds;

/// Given settings of an extrapolation; the others are derived from them.
#[derive(Debug, Clone, Copy, Default)]
pub struct ExtrapolationSettings {
    /// Method of extrapolation.
    pub method: Option<ExtrapolationMethod>,
    /// Features by which points are compared.
    pub features: Option<Features>,
    /// Largest distance of a cell from the seen point to which it belongs, in cells.
    pub reach_cells: Option<f64>,
    /// Length scale of the Gaussian process, in standard deviations of the features over the cloud.
    pub length_scale: Option<f64>,
}

/// Input of an extrapolation.
pub struct ExtrapolationJob<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// The field.
    pub saved: &'a SavedField,
    /// Paths of field and cloud, for messages.
    pub names: [&'a Path; 2],
    /// The cloud, with colours.
    pub cloud: &'a Cloud,
    /// The settings that are given.
    pub given: ExtrapolationSettings,
    /// Number of random divisions into halves for a comparison, if one is asked for.
    pub halves: Option<u32>,
    /// Whether the arm is to be drawn in its touches.
    pub drawn: bool,
    /// Whether the expected stiffness is to be written into the field.
    pub fills: bool,
    /// Text about what was kept, for the error if the work is stopped.
    pub kept: &'a str,
}

/// Result of an extrapolation.
pub struct ExtrapolationResult {
    /// The cloud, prepared for the extrapolation.
    pub seen: SeenCloud,
    /// All settings, given and derived.
    pub config: ExtrapolationConfig,
    /// Errors on held-out touches, if the method was chosen by them.
    pub held_out: Option<HeldOutErrors>,
    /// The stiffness of every point.
    pub extrapolation: Extrapolation,
    /// Cells of the field's lattice at seen points, each with its expected stiffness, N/m; empty if the field predicts
    /// better without them.
    pub cells: Vec<(CellId, f64)>,
    /// Number of remembered touches, and of their frames in contact.
    pub remembered: Option<(usize, usize)>,
    /// Joint positions of each remembered touch where the torque is largest, rad.
    pub touching: Vec<Vec<f64>>,
    /// The comparison on halves, if one was asked for.
    pub rows: Option<Vec<VariantErrors>>,
}

/// Warns of a cloud whose points all have the same colour, or of which many are far from the touched cells.
fn warn_of_odd_cloud(
    colours: &[[u8; 3]],
    (points, field): (&[Point3<f64>], &Field),
    progress: &dyn Progress,
) {
    if colours.iter().all(|colour| *colour == colours[0]) {
        progress.warn(
            "all points of the cloud have one colour, so colours cannot distinguish parts of the object: was it saved \
             without colours?",
        );
    }
    warn_of_far_points(points, field, progress);
}

/// Points within this distance of the box of the touched cells, m, are never far.
const NEAR_M: f64 = 0.3;

/// Warns if more than a third of the points are far from the box of the touched cells: farther than a quarter of its
/// longest side and than [`NEAR_M`].
fn warn_of_far_points(points: &[Point3<f64>], field: &Field, progress: &dyn Progress) {
    let touched = field.touched_rows().map(|row| field.lattice.point(field.cells[row]).into());
    let Some([low, high]) = bounds(&touched.collect::<Vec<[f64; 3]>>()) else { return };
    let far_m = (0..3).map(|axis| 0.25 * (high[axis] - low[axis])).fold(NEAR_M, f64::max);
    let is_far = |point: &&Point3<f64>| {
        (0..3).any(|axis| point[axis] < low[axis] - far_m || point[axis] > high[axis] + far_m)
    };
    let far = points.iter().filter(is_far).count();
    if 3 * far > points.len() {
        progress.warn(&format!(
            "{far} of the {} points are more than {far_m:.2} m from the box of all touched cells: if they are floor or \
             background, cut them off (for a picture: --crop-low-m, --crop-high-m)",
            points.len()
        ));
    }
}

/// Number of touches, and of their frames in contact.
fn counts(tracked: &TrackedTouches) -> (usize, usize) {
    let frames = tracked.touches.iter().map(TrackedTouch::frames_in_contact).sum();
    (tracked.touches.len(), frames)
}

impl ExtrapolationJob<'_> {
    /// Runs the extrapolation.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, the field was learnt with another robot, the touched cells and the cloud do
    /// not meet, or on being stopped.
    pub fn run(&self, progress: &dyn Progress) -> Result<ExtrapolationResult, WorkError> {
        let colours = self.cloud.colours().expect("a cloud without colours was refused");
        warn_of_odd_cloud(colours, (self.cloud.points(), &self.saved.field), progress);
        let seen = SeenCloud::new(self.cloud.points(), colours).map_err(WorkError::file)?;
        let mut config = config(&self.given, self.saved, progress);
        config.check().map_err(|error| WorkError::Usage(error.to_string()))?;
        let remembered = self.remembered(&config, progress)?;
        let tracked = remembered.as_ref().map(|(tracked, _)| tracked);
        let carry = |config: &ExtrapolationConfig| {
            let carried = extrapolate(&seen, &self.saved.field, tracked, config);
            carried.map_err(|error| self.fault(&error))
        };
        // Faults of field and cloud come before any comparison.
        let mut extrapolation = carry(&config)?;
        unless_stopped(self.kept, progress)?;
        let compare = |plan: &ComparisonPlan, label: &str| {
            let Some((tracked, mapper)) = &remembered else { return Ok(None) };
            let bar = progress.begin(Some(u64::from(plan.halves)), "halves", label);
            let rows = plan.run(tracked, &seen, mapper, &|| progress.stopped(), &|| bar.step());
            unless_stopped(self.kept, progress)?;
            rows.map(Some).map_err(|error| self.fault(&error))
        };
        let mut held_out = None;
        let touches = tracked.map_or(0, |tracked| tracked.touches.len());
        if self.given.method.is_none() && touches >= held_out::MIN_TOUCHES {
            let plan = ComparisonPlan::methods(&config);
            let rows = compare(&plan, "choosing the method")?;
            if let Some((method, found)) = rows.and_then(|rows| HeldOutErrors::of(&plan, &rows)) {
                if method != config.method {
                    config.method = method;
                    extrapolation = carry(&config)?;
                }
                held_out = Some(found);
            }
        }
        let cells = match held_out.filter(|found| !found.helps()) {
            None => extrapolation.cells(&seen, &self.saved.field.lattice, &config),
            Some(found) => {
                progress.warn(&found.warning(self.fills));
                Vec::new()
            }
        };
        let rows = match self.halves {
            Some(halves) => {
                compare(&ComparisonPlan { halves, ..ComparisonPlan::of(&config) }, "comparing")?
            }
            None => None,
        };
        let touching = tracked.iter().flat_map(|tracked| &tracked.touches).filter_map(deepest);
        Ok(ExtrapolationResult {
            touching: touching.collect(),
            remembered: tracked.map(counts),
            cells,
            seen,
            config,
            held_out,
            extrapolation,
            rows,
        })
    }

    /// The remembered touches, tracked, with their settings; `None` if they are not needed or there are none.
    fn remembered(
        &self,
        config: &ExtrapolationConfig,
        progress: &dyn Progress,
    ) -> Result<Option<(TrackedTouches, MapperConfig)>, WorkError> {
        if let Some(model) = &self.saved.field.elastic {
            progress.note(&format!(
                "the field has an elastic body: in its predictions, K has a weight of {:.0} %",
                100.0 * (1.0 - model.share)
            ));
        }
        let wanted =
            config.method == ExtrapolationMethod::Torque || self.halves.is_some() || self.drawn;
        let Some(snapshot) =
            self.saved.snapshot.as_ref().filter(|_| wanted && remembers(self.saved))
        else {
            return Ok(None);
        };
        let recalled = torque_evidence::recalled(snapshot, self.names[0], self.arm, progress);
        unless_stopped(self.kept, progress)?;
        recalled.map(Some)
    }

    fn fault(&self, error: &dyn std::error::Error) -> WorkError {
        let [field, cloud] = self.names.map(Path::display);
        WorkError::from(format!("`{field}` and `{cloud}`: {error}"))
    }
}

/// An error if the work was stopped.
fn unless_stopped(kept: &str, progress: &dyn Progress) -> Result<(), WorkError> {
    if progress.stopped() {
        return Err(WorkError::Interrupted { kept: format!("; {kept}") });
    }
    Ok(())
}

/// Completes the given settings: the method depends on whether the field remembers touches, and the features depend on
/// the method.
fn config(
    given: &ExtrapolationSettings,
    saved: &SavedField,
    progress: &dyn Progress,
) -> ExtrapolationConfig {
    let method = given.method.unwrap_or_else(|| {
        if remembers(saved) {
            return ExtrapolationMethod::Torque;
        }
        progress
            .note("the field remembers no touch: the method is `knn` on its cells, not `torque`");
        ExtrapolationMethod::Knn
    });
    let features = given.features.unwrap_or_else(|| match method {
        ExtrapolationMethod::Knn => "rgb".parse().expect("our own name"),
        _ => Features::default(),
    });
    let mut config = ExtrapolationConfig { method, features, ..ExtrapolationConfig::default() };
    config.reach_cells = given.reach_cells.unwrap_or(match method {
        ExtrapolationMethod::Knn => config.reach_cells,
        ExtrapolationMethod::Torque | ExtrapolationMethod::Cells => reach_cells(saved),
    });
    config.length_scale = given.length_scale.unwrap_or(config.length_scale);
    config
}

/// How far in front of a surface its stiffness may lie in a field, in cells: the contact distance, within which links
/// push points, plus one cell.
fn reach_cells(saved: &SavedField) -> f64 {
    let (contact, lattice) = (&saved.field.contact, &saved.field.lattice);
    (contact.contact_distance_m / lattice.spacing_m() + 1.0).clamp(REACH_CELLS[0], REACH_CELLS[1])
}

/// The method with this name.
///
/// # Errors
///
/// If there is no such method; the message lists all.
pub fn method_of(name: &str) -> Result<ExtrapolationMethod, String> {
    let all = [ExtrapolationMethod::Torque, ExtrapolationMethod::Cells, ExtrapolationMethod::Knn];
    let found = all.into_iter().find(|method| method.name() == name);
    found.ok_or_else(|| "wanted torque, cells or knn".to_owned())
}

/// Joint positions where the torque of a touch is largest, rad.
fn deepest(touch: &TrackedTouch) -> Option<Vec<f64>> {
    let torque = |tau: &[f64]| DVector::from_column_slice(tau).norm();
    let deepest =
        touch.frames.iter().max_by(|a, b| torque(&a.target).total_cmp(&torque(&b.target)));
    deepest.map(|frame| frame.q.clone())
}
