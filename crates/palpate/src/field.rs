//! A learnt field, and predictions of the torque of a motion from it.
//!
//! [`Field`] is the result of mapping: K of every cell that was touched or has its own prior mean, with the settings
//! under which it was learnt. [`Predictor`] computes the torque of a motion (Eq. 5), with the same contacts, gravity
//! and tare as the mapper, without learning.

use std::sync::Arc;

use nalgebra::DVector;

use crate::arm::Arm;
use crate::calibration::Calibration;
use crate::contact::{ContactConfig, Contacts};
use crate::elastic::{ElasticModel, ElasticTorque, Equilibrium};
use crate::estimator::CellEstimate;
use crate::external_torque::{ExternalTorqueConfig, Gravity};
use crate::lattice::{CellId, CellRows, Lattice};
use crate::robot::{Poses, Robot};
use crate::setting::SettingError;
use crate::tare::Tare;
use crate::torque::{CellState, Observation, ObservationBuilder, StiffnessRule};
use crate::tracker::{Sample, Tracker, TrackerError};

/// The stiffness of all cells that were touched or have their own prior mean, by row.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Field {
    /// The lattice of the cells.
    pub lattice: Lattice,
    /// The contact model under which the stiffness was learnt.
    pub contact: ContactConfig,
    /// Sign, gravity and tare of the logs from which the field was learnt.
    pub touch: ExternalTorqueConfig,
    /// The cells: first those with their own prior mean, in the lattice's order, then the others in the order of first
    /// touch.
    pub cells: Vec<CellId>,
    /// K by row, N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// Standard deviation of K, N/m; what it means depends on the estimator, see
    /// [`crate::unstable::MapEstimator`] and [`crate::unstable::EkfEstimator`].
    pub std_n_per_m: Vec<f64>,
    /// Number of frames that touched the cell; with 0, its stiffness is its prior mean.
    pub counts: Vec<u32>,
    /// K of all other cells, N/m.
    pub untouched_n_per_m: f64,
    /// The object as an elastic body, if one was learnt. The prediction is then the torque of the body plus that of
    /// springs with the stiffness [`ElasticModel::spring_n_per_m`].
    pub elastic: Option<Arc<ElasticModel>>,
    /// Calibration of the bands around predictions of the springs alone, if there is one; with an elastic body,
    /// [`Field::bands`] is that of both together.
    pub calibration: Option<Calibration>,
}

impl Field {
    /// A field without known cells: all have a stiffness of `untouched_n_per_m`, N/m.
    pub fn new(
        lattice: Lattice,
        contact: ContactConfig,
        touch: ExternalTorqueConfig,
        untouched_n_per_m: f64,
    ) -> Self {
        Self {
            lattice,
            contact,
            touch,
            cells: Vec::new(),
            stiffness_n_per_m: Vec::new(),
            std_n_per_m: Vec::new(),
            counts: Vec::new(),
            untouched_n_per_m,
            elastic: None,
            calibration: None,
        }
    }

    /// The rows of the touched cells, without those that have only a prior mean.
    pub fn touched_rows(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.cells.len()).filter(|&row| self.counts[row] > 0)
    }

    /// The estimate of the nearest cell to each place (m, world frame); `None` outside the lattice.
    ///
    /// `untouched_std_n_per_m` is the standard deviation of cells that are not in the field. Cost: one pass over the
    /// field, then one look-up for each place.
    pub fn at(
        &self,
        places_m: &[[f64; 3]],
        untouched_std_n_per_m: f64,
    ) -> Vec<Option<CellEstimate>> {
        let rows = CellRows::of(self.lattice.clone(), &self.cells);
        let at = |place_m: &[f64; 3]| {
            let cell = self.lattice.nearest(&(*place_m).into())?;
            Some(self.estimate(rows.find(cell), untouched_std_n_per_m))
        };
        places_m.iter().map(at).collect()
    }

    /// The calibration of the bands around this field's predictions: that with the elastic body, if there is a body.
    pub fn bands(&self) -> Option<&Calibration> {
        match &self.elastic {
            Some(model) => model.calibration.as_ref(),
            None => self.calibration.as_ref(),
        }
    }

    /// The estimate of a row, or without a row that of a cell that is not in the field, with standard deviation
    /// `untouched_std_n_per_m`.
    ///
    /// # Panics
    ///
    /// If there is no such row.
    pub fn estimate(&self, row: Option<u32>, untouched_std_n_per_m: f64) -> CellEstimate {
        match row {
            Some(row) => CellEstimate {
                stiffness_n_per_m: self.stiffness_n_per_m[row as usize],
                std_n_per_m: self.std_n_per_m[row as usize],
                count: self.counts[row as usize],
            },
            None => CellEstimate {
                stiffness_n_per_m: self.untouched_n_per_m,
                std_n_per_m: untouched_std_n_per_m,
                count: 0,
            },
        }
    }
}

/// Prediction for one sample.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Prediction {
    /// Number of touched points.
    pub contacts: usize,
    /// Number of these points that were touched when the field was learnt.
    pub known: usize,
    /// τ̂, n_joints, N·m.
    pub predicted: DVector<f64>,
    /// s of [`Calibration::half_width`], n_joints, N·m, if the field is calibrated.
    pub spread: Option<DVector<f64>>,
    /// τ_ext of the sample, n_joints, N·m.
    pub external: DVector<f64>,
}

/// The springs of a [`Predictor`], by row: first the cells of the field, then others in the order of first touch.
#[derive(Debug)]
struct FieldSprings {
    observations: ObservationBuilder,
    cells: Vec<CellState>,
    /// Number of frames that touched each cell of the field.
    counts: Vec<u32>,
    untouched_n_per_m: f64,
    /// [`Calibration::spring_variance`] of the first rows, and of all other cells, if the field is calibrated.
    variances: Option<(Vec<f64>, f64)>,
}

impl FieldSprings {
    /// The springs with which a field predicts; with an elastic body, those beside the body.
    fn of(field: &Field) -> Self {
        let mut rows = CellRows::of(field.lattice.clone(), &field.cells);
        let mut stiffness_n_per_m = field.stiffness_n_per_m.clone();
        let mut untouched_n_per_m = field.untouched_n_per_m;
        if let Some(model) = &field.elastic {
            let residual = rows.by_row(model.residual(), model.untouched_residual_n_per_m);
            stiffness_n_per_m.resize(residual.len(), field.untouched_n_per_m);
            let both = stiffness_n_per_m.iter_mut().zip(residual);
            both.for_each(|(k, residual)| *k = model.spring_n_per_m(*k, residual));
            untouched_n_per_m =
                model.spring_n_per_m(untouched_n_per_m, model.untouched_residual_n_per_m);
        }
        let variances = field.bands().map(|calibration| {
            let untouched_std = calibration.untouched_std_n_per_m;
            let std = field.std_n_per_m.iter().copied().chain(std::iter::repeat(untouched_std));
            let own = stiffness_n_per_m.iter().zip(std);
            let own = own.map(|(&k, std)| calibration.spring_variance(k, std)).collect();
            (own, calibration.spring_variance(untouched_n_per_m, untouched_std))
        });
        let points_and_k = rows.points_m().iter().zip(stiffness_n_per_m);
        let cells = points_and_k.map(|(&point, k)| CellState::new(point, k)).collect();
        let (observations, counts) = (ObservationBuilder::new(rows), field.counts.clone());
        Self { observations, cells, counts, untouched_n_per_m, variances }
    }

    /// The observation of a frame: its contacts, and `tau`, n_joints, N·m.
    fn build(
        &mut self,
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        tau: &DVector<f64>,
    ) -> Observation {
        let observation = self.observations.build(robot, poses, contacts, tau);
        let met = self.observations.rows().points_m()[self.cells.len()..].iter();
        self.cells.extend(met.map(|&point| CellState::new(point, self.untouched_n_per_m)));
        observation
    }

    /// τ̂ of an observation from [`Self::build`], n_joints, N·m.
    fn predict(&self, observation: &Observation) -> DVector<f64> {
        observation.predict(&self.cells, StiffnessRule::Positive)
    }

    /// s of [`Calibration::half_width`], n_joints, N·m, if the field is calibrated.
    fn spread(&self, observation: &Observation) -> Option<DVector<f64>> {
        let (own, other) = self.variances.as_ref()?;
        let variance = |row: usize| own.get(row).copied().unwrap_or(*other);
        Some(observation.torque_std(&self.cells, variance))
    }

    /// Whether the cell of a row was touched when the field was learnt.
    fn is_known(&self, row: usize) -> bool {
        self.counts.get(row).is_some_and(|&count| count > 0)
    }
}

/// Predicts the torque of motions from a field, without changing it.
pub struct Predictor {
    tracker: Tracker,
    springs: FieldSprings,
    elastic: Option<ElasticTorque>,
}

impl Predictor {
    /// A predictor for an arm, which may be another than the one that the field was learnt with.
    ///
    /// `touch` describes how the torques of this arm are logged.
    ///
    /// # Errors
    ///
    /// If a setting of the contact model is out of its range.
    pub fn new(
        arm: Arc<Arm>,
        field: &Field,
        touch: ExternalTorqueConfig,
    ) -> Result<Self, SettingError> {
        let elastic = field.elastic.as_deref().map(|model| ElasticTorque::new(&arm, model));
        let tracker = Tracker::new(arm, field.lattice.clone(), &field.contact, touch)?;
        let springs = FieldSprings::of(field);
        Ok(Self { tracker, springs, elastic })
    }

    /// A predictor of planned motions. Without measured torques there is neither gravity nor tare to subtract, so
    /// predictions start with the first sample.
    ///
    /// # Errors
    ///
    /// As [`Predictor::new`].
    pub fn planned(arm: Arc<Arm>, field: &Field) -> Result<Self, SettingError> {
        let (gravity, tare) = (Gravity::Removed, Tare::None);
        Self::new(arm, field, ExternalTorqueConfig { gravity, tare, ..field.touch.clone() })
    }

    /// Starts a touch.
    pub fn begin_touch(&mut self) {
        self.tracker.begin_touch();
        self.elastic.iter_mut().for_each(ElasticTorque::begin_touch);
    }

    /// Predicts the torque of the next sample; `None` while its tare is being taken.
    ///
    /// # Errors
    ///
    /// As [`Tracker::feed`].
    pub fn step(&mut self, sample: &Sample) -> Result<Option<Prediction>, TrackerError> {
        let frame = self.tracker.feed(sample)?;
        let elastic = self.elastic.as_mut();
        let of_body = elastic.map(|elastic| elastic.advance(&frame.poses, sample.time_s));
        let Some(external) = frame.external else { return Ok(None) };
        let robot = &self.tracker.arm().robot;
        let springs = &mut self.springs;
        let observation = springs.build(robot, &frame.poses, &frame.contacts, &external);
        let known = observation.rows().filter(|&row| springs.is_known(row)).count();
        let contacts = observation.n_contacts();
        let spread = springs.spread(&observation);
        let mut predicted = springs.predict(&observation);
        if let Some(of_body) = of_body {
            predicted += of_body;
        }
        Ok(Some(Prediction { contacts, known, predicted, spread, external }))
    }

    /// Ends a touch.
    ///
    /// # Errors
    ///
    /// If the touch has fewer frames than were requested for the tare.
    pub fn end_touch(&mut self) -> Result<(), TrackerError> {
        self.tracker.end_touch()
    }

    /// The contacts of the last sample, for drawing.
    pub fn contacts(&self) -> Contacts {
        self.tracker.contacts()
    }

    /// The elastic body with the largest weight, bent as in the last sample, if the field has one.
    pub fn body(&self) -> Option<&Equilibrium> {
        self.elastic.as_ref()?.body()
    }

    /// The tare of the touch, n_joints, N·m, once it is known.
    pub fn tare(&self) -> Option<&DVector<f64>> {
        self.tracker.tare()
    }
}
