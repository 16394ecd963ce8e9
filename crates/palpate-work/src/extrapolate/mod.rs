//! The work of an extrapolation: touches followed again, stiffness carried over, halves compared.

use std::path::Path;
use std::sync::Arc;

use nalgebra::{DVector, Point3};
use palpate::{Arm, CellId, Field, MapperConfig};
use palpate_io::cloud::Cloud;
use palpate_io::field::Saved;
use palpate_learn::extrapolate::compare::{Plan, Row};
use palpate_learn::extrapolate::{
    Config, Extrapolation, Features, Method, REACH_CELLS, SeenCloud, extrapolate,
};
use palpate_learn::tracked::{Tracked, TrackedTouch};

mod back;
mod held_out;
mod torque_evidence;

pub use back::filled;
pub use held_out::HeldOut;
pub use torque_evidence::remembers;

use crate::error::WorkError;
use crate::progress::Progress;
use crate::quantile::bounds;

/// What is said of an extrapolation; the rest follows.
#[derive(Debug, Clone, Copy, Default)]
pub struct Chosen {
    /// How stiffness is carried over.
    pub method: Option<Method>,
    /// What points are compared by.
    pub features: Option<Features>,
    /// How far, in cells, a cell may be from the seen point that it lies at.
    pub reach_cells: Option<f64>,
    /// How far apart features must be to say nothing of each other, in standard deviations.
    pub length_scale: Option<f64>,
}

/// What there is to do.
pub struct Work<'a> {
    /// The robot.
    pub arm: &'a Arc<Arm>,
    /// The field.
    pub saved: &'a Saved,
    /// Field and cloud as the user calls them.
    pub names: [&'a Path; 2],
    /// What was seen, with colours.
    pub cloud: &'a Cloud,
    /// The settings that are given.
    pub given: Chosen,
    /// Random halves to compare on, if any.
    pub halves: Option<u32>,
    /// Whether the arm is to be drawn in its touches.
    pub drawn: bool,
    /// Whether the field is to get what is expected of its untouched cells.
    pub fills: bool,
    /// What is said to be kept on Ctrl-C.
    pub kept: &'a str,
}

/// What was found.
pub struct Found {
    /// What was seen.
    pub seen: SeenCloud,
    /// The settings, those included that were not given.
    pub config: Config,
    /// What the extrapolation is worth on touches held out, if they decided how it is done.
    pub held_out: Option<HeldOut>,
    /// The stiffness of every point.
    pub extrapolation: Extrapolation,
    /// Cells of the field's lattice at seen points, each with its expected stiffness, N/m; none where the field
    /// predicts better without.
    pub cells: Vec<(CellId, f64)>,
    /// Touches and frames in contact that the field remembers.
    pub remembered: Option<(usize, usize)>,
    /// Joint positions of each remembered touch where the torque is largest, rad.
    pub touching: Vec<Vec<f64>>,
    /// The comparison on halves, if one was asked for.
    pub rows: Option<Vec<Row>>,
}

/// Warns of a cloud whose points all have the same colour, or are mostly far from what was touched.
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

/// So near to what was touched, m, points are of the same object.
const NEAR_M: f64 = 0.3;

/// Warns if more than a third of the points lie far from the box of the touched cells: by more than a quarter of its longest side.
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
            "{far} of the {} points are more than {far_m:.2} m from the box of all that was touched: if they are floor or \
             background, cut them off (of a picture: --crop-low-m, --crop-high-m)",
            points.len()
        ));
    }
}

impl Work<'_> {
    /// Does it.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, the field was learnt with another robot, or the cloud is not where it was
    /// learnt.
    pub fn run(&self, progress: &dyn Progress) -> Result<Found, WorkError> {
        let colours = self.cloud.colours().expect("a cloud without colours was refused");
        warn_of_odd_cloud(colours, (self.cloud.points(), &self.saved.field), progress);
        let seen = SeenCloud::new(self.cloud.points(), colours).map_err(WorkError::file)?;
        let mut config = config(&self.given, self.saved, progress);
        config.check().map_err(|error| WorkError::Usage(error.to_string()))?;
        let remembered = self.remembered(&config, progress)?;
        let tracked = remembered.as_ref().map(|(tracked, _)| tracked);
        let carry = |config: &Config| {
            let carried = extrapolate(&seen, &self.saved.field, tracked, config);
            carried.map_err(|error| self.fault(&error))
        };
        // Faults of field and cloud come before any comparison.
        let mut extrapolation = carry(&config)?;
        unless_stopped(self.kept, progress)?;
        let compare = |plan: &Plan, label: &str| {
            let Some((tracked, mapper)) = &remembered else { return Ok(None) };
            let bar = progress.begin(Some(u64::from(plan.halves)), "halves", label);
            let rows = plan.run(tracked, &seen, mapper, &|| progress.stopped(), &|| bar.step());
            unless_stopped(self.kept, progress)?;
            rows.map(Some).map_err(|error| self.fault(&error))
        };
        let mut held_out = None;
        let touches = tracked.map_or(0, |tracked| tracked.touches.len());
        if self.given.method.is_none() && touches >= held_out::FEWEST_TOUCHES {
            let plan = Plan::methods(&config);
            let rows = compare(&plan, "choosing the method")?;
            if let Some((method, found)) = rows.and_then(|rows| HeldOut::of(&plan, &rows)) {
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
                if self.fills {
                    progress.warn(&found.to_string());
                }
                Vec::new()
            }
        };
        let rows = match self.halves {
            Some(halves) => compare(&Plan { halves, ..Plan::of(&config) }, "comparing")?,
            None => None,
        };
        let touching = tracked.iter().flat_map(|tracked| &tracked.touches).filter_map(deepest);
        Ok(Found {
            touching: touching.collect(),
            remembered: tracked.map(|tracked| {
                let frames = tracked.touches.iter().map(TrackedTouch::frames_in_contact).sum();
                (tracked.touches.len(), frames)
            }),
            cells,
            seen,
            config,
            held_out,
            extrapolation,
            rows,
        })
    }

    /// The touches that the field remembers, tracked, with their settings, if they are needed and there are some.
    fn remembered(
        &self,
        config: &Config,
        progress: &dyn Progress,
    ) -> Result<Option<(Tracked, MapperConfig)>, WorkError> {
        if let Some(model) = &self.saved.field.elastic {
            progress.note(&format!(
                "the field has an elastic body: in its predictions, K has a weight of {:.0} %",
                100.0 * (1.0 - model.share)
            ));
        }
        let wanted = config.method == Method::Torque || self.halves.is_some() || self.drawn;
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

/// An error after being stopped.
fn unless_stopped(kept: &str, progress: &dyn Progress) -> Result<(), WorkError> {
    if progress.stopped() {
        return Err(WorkError::Interrupted { kept: format!("; {kept}") });
    }
    Ok(())
}

/// The settings that hold where some are not given: what the field remembers decides the method,
/// and the method the features.
fn config(given: &Chosen, saved: &Saved, progress: &dyn Progress) -> Config {
    let method = given.method.unwrap_or_else(|| {
        if remembers(saved) {
            return Method::Torque;
        }
        progress
            .note("the field remembers no touch: `knn` on its cells takes the place of `torque`");
        Method::Knn
    });
    let features = given.features.unwrap_or_else(|| match method {
        Method::Knn => "rgb".parse().expect("our own name"),
        _ => Features::default(),
    });
    let mut config = Config { method, features, ..Config::default() };
    config.reach_cells = given.reach_cells.unwrap_or(match method {
        Method::Knn => config.reach_cells,
        Method::Torque | Method::Cells => reach_cells(saved),
    });
    config.length_scale = given.length_scale.unwrap_or(config.length_scale);
    config
}

/// How far in front of a surface its stiffness lies in a field, in cells: links take hold of points within the contact
/// distance, and a cell more.
fn reach_cells(saved: &Saved) -> f64 {
    let (contact, lattice) = (&saved.field.contact, &saved.field.lattice);
    (contact.contact_distance_m / lattice.spacing_m() + 1.0).clamp(REACH_CELLS[0], REACH_CELLS[1])
}

/// A method by its name.
///
/// # Errors
///
/// If there is none of that name; says which there are.
pub fn method_of(name: &str) -> Result<Method, String> {
    let all = [Method::Torque, Method::Cells, Method::Knn];
    let found = all.into_iter().find(|method| method.name() == name);
    found.ok_or_else(|| "there are torque, cells and knn".to_owned())
}

/// Joint positions where the torque of a touch is largest, rad.
fn deepest(touch: &TrackedTouch) -> Option<Vec<f64>> {
    let torque = |tau: &[f64]| DVector::from_column_slice(tau).norm();
    let deepest =
        touch.frames.iter().max_by(|a, b| torque(&a.target).total_cmp(&torque(&b.target)));
    deepest.map(|frame| frame.q.clone())
}
