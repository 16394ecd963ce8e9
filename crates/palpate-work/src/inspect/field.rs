//! Content of a field: cells, stiffness with standard deviations, and whether it can be continued.

use std::path::Path;
use std::sync::Arc;

use palpate::{
    Arm, ContactConfig, EstimatorConfig, EstimatorKind, ExternalTorqueConfig, Lattice, Snapshot,
};
use palpate_io::field::npz::read_npz;
use palpate_io::field::{self, FieldFile, SavedError, SavedField};
use serde::Serialize;

use super::finding::Finding;
use super::words::{counted, number};
use crate::forget;
use crate::held_joints::of_field;
use crate::progress::Progress;
use crate::quantile::{bounds, quantile};
use crate::robot::{OF_FIELD, other_robot};
use crate::settings::corners;

/// Cells below this share of the largest stiffness count as zero.
const ZERO: f64 = 1e-6;
/// Cells from this share of the largest stiffness on count as stiff.
const STIFF: f64 = 0.1;
/// A cell counts as not learnt if its standard deviation is at least this share of the prior's.
const UNCHANGED: f64 = 0.999;
/// The shares for which quantiles are given.
const SHARES: [f64; 5] = [0.1, 0.5, 0.9, 0.99, 1.0];

/// Facts about a field.
#[derive(Debug, Serialize)]
pub struct FieldFacts {
    /// Size of the file, bytes.
    pub file_bytes: u64,
    /// Number of touched cells; all figures are about these.
    pub cells: usize,
    /// Number of cells with a prior mean of their own that were never touched.
    pub expected_cells: usize,
    /// Quantiles 10, 50, 90, 99 and 100 % of the stiffness of cells above zero, N/m.
    pub stiffness_n_per_m: Option<[f64; 5]>,
    /// Sum of the stiffness of touched cells, N/m.
    pub total_n_per_m: f64,
    /// Share of the cells at zero.
    pub zero_share: f64,
    /// The same quantiles of the standard deviations, N/m.
    pub std_n_per_m: Option<[f64; 5]>,
    /// The same quantiles of the number of frames that touched a cell.
    pub frames_per_cell: Option<[f64; 5]>,
    /// Lowest and highest point of the cells of at least a tenth of the largest stiffness, m.
    pub stiff_box_m: Option<[[f64; 3]; 2]>,
    /// Number of cells of at least a tenth of the largest stiffness.
    pub stiff_cells: usize,
    /// Facts that only files of palpate contain.
    pub own: Option<OwnFacts>,
}

/// How a field was learnt.
#[derive(Debug, Serialize)]
pub struct OwnFacts {
    /// Name of the robot.
    pub robot: String,
    /// The lattice.
    pub lattice: LatticeFacts,
    /// The contact model.
    pub contact: ContactConfig,
    /// The torque convention of the logs.
    pub touch: ExternalTorqueConfig,
    /// The state from which mapping can continue; `None` if the field was saved without it.
    pub memory: Option<MemoryFacts>,
}

/// A lattice.
#[derive(Debug, Serialize)]
pub struct LatticeFacts {
    /// First point, m.
    pub origin_m: [f64; 3],
    /// Distance between neighbouring points, m.
    pub spacing_m: f64,
    /// Points along x, y and z.
    pub shape: [u32; 3],
    /// Corners of the box that the points fill, m.
    pub box_m: [[f64; 3]; 2],
    /// Points in all.
    pub cells_declared: u64,
}

/// The state from which mapping can continue.
#[derive(Debug, Serialize)]
pub struct MemoryFacts {
    /// The estimator.
    pub method: EstimatorKind,
    /// Its settings.
    pub estimator: EstimatorConfig,
    /// Standard deviation of an untouched cell in the field, times `stiffness_scale` as that of touched cells is, N/m.
    pub prior_std_n_per_m: f64,
    /// Number of touches so far.
    pub touches: u32,
    /// Touches whose samples are remembered, by number and name.
    pub remembered: Vec<String>,
    /// Number of remembered frames.
    pub frames: usize,
    /// Number of samples in the sample log.
    pub logged_samples: usize,
}

/// Inspects a field; with an `arm`, also whether it was learnt with this one.
pub fn inspect(
    path: &Path,
    (arm, progress): (Option<Arc<Arm>>, &dyn Progress),
) -> (Option<FieldFacts>, Vec<Finding>) {
    match field::load(path) {
        Ok(saved) => {
            let facts = FieldFacts::of_saved(path, &saved);
            let mut findings = facts.findings();
            let learnt = (&*saved.robot, saved.snapshot.as_ref());
            let arm = arm.map(|arm| of_field(arm, learnt.1, progress));
            if let Some(which) = arm.and_then(|arm| other_robot(learnt, &arm, "the given one")) {
                let what = format!("the field was learnt with {which}");
                findings.push(Finding::warning("other_robot", what, OF_FIELD));
            }
            (Some(facts), findings)
        }
        Err(SavedError::Foreign { missing, .. }) => foreign(path, missing),
        Err(error) => (None, vec![refused(error.to_string())]),
    }
}

fn refused(what: String) -> Finding {
    let remedy = "a field is an .npz with `points` and `K`, as `palpate map` writes it; map again, \
                  or copy the file again if it was whole";
    Finding::error("field", what, remedy)
}

/// Facts and findings of a field of another program.
fn foreign(path: &Path, missing: &str) -> (Option<FieldFacts>, Vec<Finding>) {
    let file = match read_npz(path).and_then(|arrays| FieldFile::from_arrays(&arrays)) {
        Ok(file) => file,
        Err(error) => return (None, vec![refused(error.to_string())]),
    };
    let facts = FieldFacts::new(path, &file);
    let what = format!(
        "the field was written by another program, such as OpenVSF: it lacks `{missing}`, which \
         says how its points were touched"
    );
    let remedy = "`palpate predict` cannot use it; map the logs with `palpate map`. Points, K and \
                  K_std can still be compared";
    let mut findings = vec![Finding::warning("foreign_field", what, remedy)];
    findings.extend(facts.findings());
    (Some(facts), findings)
}

/// Quantiles of some numbers at [`SHARES`].
fn quantiles(numbers: &[f64]) -> Option<[f64; 5]> {
    let all: Option<Vec<f64>> = SHARES.iter().map(|&share| quantile(numbers, share)).collect();
    all.and_then(|all| all.try_into().ok())
}

impl FieldFacts {
    fn new(path: &Path, file: &FieldFile) -> Self {
        // The touched cells; all cells, if the field has no counts.
        let touched = |row: &usize| file.counts.as_ref().is_none_or(|counts| counts[*row] > 0);
        let rows: Vec<usize> = (0..file.points.len()).filter(touched).collect();
        let of = |numbers: &Vec<f64>| rows.iter().map(|&row| numbers[row]).collect::<Vec<f64>>();
        let stiffness = of(&file.stiffness);
        let largest = stiffness.iter().copied().fold(0.0, f64::max);
        let above = |part: f64| move |k: f64| k > 0.0 && k >= part * largest;
        let positive: Vec<f64> = stiffness.iter().copied().filter(|&k| above(ZERO)(k)).collect();
        let stiff = rows.iter().filter(|&&row| above(STIFF)(file.stiffness[row]));
        let stiff: Vec<[f64; 3]> = stiff.map(|&row| file.points[row]).collect();
        let frames = |counts: &Vec<u32>| {
            quantiles(&rows.iter().map(|&row| f64::from(counts[row])).collect::<Vec<f64>>())
        };
        Self {
            file_bytes: path.metadata().map_or(0, |metadata| metadata.len()),
            cells: rows.len(),
            expected_cells: file.points.len() - rows.len(),
            stiffness_n_per_m: quantiles(&positive),
            total_n_per_m: stiffness.iter().sum(),
            zero_share: 1.0 - positive.len() as f64 / rows.len().max(1) as f64,
            std_n_per_m: file.std.as_ref().and_then(|std| quantiles(&of(std))),
            frames_per_cell: file.counts.as_ref().and_then(frames),
            stiff_box_m: bounds(&stiff),
            stiff_cells: stiff.len(),
            own: None,
        }
    }

    fn of_saved(path: &Path, saved: &SavedField) -> Self {
        let field = &saved.field;
        let own = OwnFacts {
            robot: saved.robot.clone(),
            lattice: LatticeFacts::new(&field.lattice),
            contact: field.contact.clone(),
            touch: field.touch.clone(),
            memory: saved.snapshot.as_ref().map(MemoryFacts::new),
        };
        Self { own: Some(own), ..Self::new(path, &FieldFile::from(field)) }
    }

    fn findings(&self) -> Vec<Finding> {
        [self.all_zero(), self.never_reduced()].into_iter().flatten().collect()
    }

    fn all_zero(&self) -> Option<Finding> {
        let remedy = "inspect the logs: torque sign and gravity first, then whether the arm \
                      touches the object inside the lattice's box";
        if self.cells == 0 {
            return Some(Finding::warning("empty_field", "no cell was ever touched", remedy));
        }
        (self.zero_share >= 1.0).then(|| {
            let what = format!("the stiffness of all {} is zero", counted(self.cells, "cell"));
            Finding::warning("all_zero", what, remedy)
        })
    }

    /// A warning if no standard deviation is below the prior's; if the prior is unknown, if all are
    /// equal.
    fn never_reduced(&self) -> Option<Finding> {
        let [least, _, _, _, largest] = self.std_n_per_m?;
        let memory = self.own.as_ref().and_then(|own| own.memory.as_ref());
        let prior = memory.map_or(largest, |memory| memory.prior_std_n_per_m);
        (prior > 0.0 && least >= UNCHANGED * prior && self.cells > 1).then(|| {
            let what = format!(
                "the standard deviation of every cell is still {} N/m, as before learning",
                number(least)
            );
            let remedy = "nothing was learnt from these touches: check whether frames are left \
                          after the tare (`palpate inspect LOG`), and check --torque-std";
            Finding::warning("std_never_reduced", what, remedy)
        })
    }
}

impl LatticeFacts {
    pub(super) fn new(lattice: &Lattice) -> Self {
        Self {
            origin_m: lattice.origin_m().into(),
            spacing_m: lattice.spacing_m(),
            shape: lattice.shape(),
            box_m: corners(lattice).into(),
            cells_declared: lattice.n_cells(),
        }
    }
}

impl MemoryFacts {
    fn new(snapshot: &Snapshot) -> Self {
        let config = &snapshot.config;
        let spacing_m = config.lattice.spacing_m();
        let samples = |touch: &palpate::unstable::LoggedTouch| {
            touch.q.len().checked_div(snapshot.n_joints).unwrap_or(0)
        };
        Self {
            method: config.method,
            estimator: config.estimator.clone(),
            prior_std_n_per_m: config.estimator.stiffness_scale
                * config.estimator.prior.at_spacing(spacing_m).1,
            touches: snapshot.touches,
            remembered: snapshot.sample_log.iter().map(forget::name).collect(),
            frames: snapshot.state.remembered.len(),
            logged_samples: snapshot.sample_log.iter().map(samples).sum(),
        }
    }
}
