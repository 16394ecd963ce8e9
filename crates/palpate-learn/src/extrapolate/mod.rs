//! From what was touched to what was only seen (Sec. III-B).
//!
//! A few touches and one coloured cloud give a stiffness for every seen point: what looks alike is
//! taken to be alike. Three ways, of which the first is the default:
//!
//! | [`Method`] | regression of                                | on                              |
//! |------------|----------------------------------------------|---------------------------------|
//! | `torque`   | stiffness over features, by Gaussian process | the torques themselves (`felt`) |
//! | `cells`    | the same                                     | stiffness of touched cells      |
//! | `knn`      | the paper's: k nearest, RBF weights          | stiffness of touched points     |
//!
//! All three give back a spring as [`palpate::Field`] has it: of a cell of its lattice. So
//! [`Extrapolation::cells`] is a prior for cells that no touch has reached. [`mod@compare`] says what
//! such a prior is worth on touches that nothing has learnt from.

mod basis;
mod cells;
mod cloud;
pub mod compare;
mod features;
mod knn;
mod process;
mod rank;
mod torque_evidence;

use palpate::{CellId, Field, Lattice};
use serde::{Deserialize, Serialize};

pub use cloud::SeenCloud;
pub use features::{Colour, Features};
pub use rank::{area_under_roc, spearman};

use crate::tracked::Tracked;
use process::{Evidence, Posterior, Process};

/// How stiffness is carried over.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// A Gaussian process over features, learnt from torques.
    #[default]
    Torque,
    /// The same, learnt from the stiffness of touched cells.
    Cells,
    /// The paper's: the nearest neighbours among touched points.
    Knn,
}

impl Method {
    /// As it is called in settings and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Cells => "cells",
            Self::Knn => "knn",
        }
    }
}

/// Settings of the extrapolation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// How stiffness is carried over.
    pub method: Method,
    /// What points are compared by.
    pub features: Features,
    /// A cell lies at a seen point that is no further away than so many cells.
    pub reach_cells: f64,
    /// How far apart features must be to say nothing of each other, in standard deviations over the
    /// cloud; `torque` and `cells`.
    pub length_scale: f64,
    /// Standard deviation of K before anything is touched, N/m for a cell of 1 cm; it goes with the
    /// volume of the cell.
    pub std_n_per_m: f64,
    /// Noise of a touch's torques taken together, N·m; `torque`.
    pub torque_std: f64,
    /// Neighbours, and how far apart in standard deviations they still count; `knn`.
    pub neighbours: u32,
    /// See `neighbours`.
    pub neighbour_scale: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            method: Method::default(),
            features: Features::default(),
            reach_cells: 1.25,
            length_scale: 2.0,
            std_n_per_m: 0.6,
            torque_std: 0.4,
            neighbours: 50,
            neighbour_scale: 0.5,
        }
    }
}

/// Why nothing could be carried over.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ExtrapolateError {
    /// A setting out of its range.
    #[error("`{setting}` is {found}; it must be {wanted}")]
    Setting { setting: &'static str, found: f64, wanted: &'static str },
    /// A cloud without points.
    #[error("the cloud holds no point")]
    NothingSeen,
    /// A field without touched cells.
    #[error("the field holds no touched cell: there is nothing to carry over")]
    NothingTouched,
    /// A cloud elsewhere.
    #[error(
        "the cloud and the touched cells miss each other by {gap_m:.3} m (along x, y, z by \
         {apart_m:.3?}): the cloud spans {cloud} m, the cells {field} m; is the cloud in the frame \
         of the robot's base, in metres, and is it the object that was touched?"
    )]
    Apart { gap_m: f64, apart_m: [f64; 3], cloud: String, field: String },
    /// A cloud of what was not touched.
    #[error(
        "no touched cell lies at a point of the cloud: the nearest is {gap_m:.3} m away, further \
         than {reach_m:.3} m; touch what the camera sees, or widen the reach"
    )]
    NoneTouched { gap_m: f64, reach_m: f64 },
    /// A field that forgot what it learnt from.
    #[error(
        "the method `torque` learns from torques, and there is no touch to take them from; use \
         `cells` or `knn`, or a field that was saved with its memory"
    )]
    NothingFelt,
    /// Asked to stop.
    #[error("stopped")]
    Stopped,
}

/// A stiffness for every seen point.
#[derive(Debug, Clone, PartialEq)]
pub struct Extrapolation {
    /// K of a cell at each point, N/m, at least 0.
    pub stiffness_n_per_m: Vec<f64>,
    /// Its standard deviation, N/m: of the regression over features, not of single points.
    pub std_n_per_m: Vec<f64>,
    /// Whether the cell that the point lies in was touched.
    pub touched: Vec<bool>,
}

impl Config {
    /// Checks every setting against its range.
    ///
    /// # Errors
    ///
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), ExtrapolateError> {
        if !(0.5..=4.0).contains(&self.reach_cells) {
            let (setting, found) = ("reach_cells", self.reach_cells);
            return Err(ExtrapolateError::Setting { setting, found, wanted: "from 0.5 to 4" });
        }
        let settings = [
            ("length_scale", self.length_scale),
            ("std_n_per_m", self.std_n_per_m),
            ("torque_std", self.torque_std),
            ("neighbours", f64::from(self.neighbours)),
            ("neighbour_scale", self.neighbour_scale),
        ];
        for (setting, found) in settings {
            if !(1e-6..=1e6).contains(&found) {
                let wanted = "from 1e-6 to 1e6";
                return Err(ExtrapolateError::Setting { setting, found, wanted });
            }
        }
        Ok(())
    }

    /// How far a cell may be from the seen point that it lies at, m.
    pub fn reach_m(&self, lattice: &Lattice) -> f64 {
        self.reach_cells * lattice.spacing_m()
    }

    /// Standard deviation of K of a cell of the lattice before anything is touched, N/m.
    fn prior_std(&self, lattice: &Lattice) -> f64 {
        self.std_n_per_m * (lattice.spacing_m() / 0.01).powi(3)
    }
}

/// Carries the stiffness of a field over to all that was seen.
///
/// `felt` holds the touches that the field was learnt from, which the method `torque` needs.
///
/// # Errors
///
/// If a setting is out of its range, the cloud is not where the field was touched, or there are no
/// touches to learn torques from.
pub fn extrapolate(
    seen: &SeenCloud,
    field: &Field,
    felt: Option<&Tracked>,
    config: &Config,
) -> Result<Extrapolation, ExtrapolateError> {
    config.check()?;
    let (lattice, reach_m) = (&field.lattice, config.reach_m(&field.lattice));
    let (rows, touched_m) = touched_cells(field);
    seen.must_meet(&touched_m, reach_m)?;
    let features = config.features.of(seen);
    let prior_std = config.prior_std(lattice);
    let (stiffness_n_per_m, std_n_per_m) = match config.method {
        Method::Torque => {
            let felt = felt.filter(|felt| felt.touches.iter().any(|t| t.frames_in_contact() > 0));
            let felt = felt.ok_or(ExtrapolateError::NothingFelt)?;
            // A field may know more than the touches that it still remembers.
            seen.must_meet(&felt.points_m, reach_m)?;
            let process = Process::new(features, config.length_scale);
            let evidence =
                torque_evidence::evidence(felt, &process, &seen.at(&felt.points_m, reach_m));
            let all: Vec<&Evidence> = evidence.iter().collect();
            let posterior = torque_evidence::posterior(&all, prior_std, config.torque_std);
            process.at_all_points(&posterior)
        }
        Method::Cells => {
            let process = Process::new(features, config.length_scale);
            let at = seen.at(&touched_m, reach_m);
            let evidence = cells::evidence(field, &process, &rows, &at);
            process.at_all_points(&Posterior::new(&evidence, prior_std, prior_std))
        }
        Method::Knn => {
            let at = seen.at(&touched_m, reach_m);
            let known = cells::of_points(field, seen, (&rows, &at));
            let neighbours = config.neighbours as usize;
            knn::at_all_points(&features, &known, neighbours, config.neighbour_scale)
        }
    };
    let touched = cells::touched(field, seen);
    Ok(Extrapolation { stiffness_n_per_m, std_n_per_m, touched })
}

/// The rows of a field that were touched, and their points.
fn touched_cells(field: &Field) -> (Vec<usize>, Vec<[f64; 3]>) {
    let touched = |row: &usize| field.counts[*row] > 0;
    let rows: Vec<usize> = (0..field.cells.len()).filter(touched).collect();
    let points = rows.iter().map(|&row| field.lattice.point(field.cells[row]).into()).collect();
    (rows, points)
}

impl Extrapolation {
    /// What cells of a lattice are expected to be: those at seen points, in the lattice's order, each
    /// with the stiffness of the point nearest to it, N/m.
    pub fn cells(
        &self,
        seen: &SeenCloud,
        lattice: &Lattice,
        config: &Config,
    ) -> Vec<(CellId, f64)> {
        let cells = seen.cells(lattice, config.reach_m(lattice));
        let stiffness = |point: u32| self.stiffness_n_per_m[point as usize];
        cells.into_iter().map(|(cell, point)| (cell, stiffness(point))).collect()
    }
}
