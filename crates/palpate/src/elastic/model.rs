//! An elastic body that was learnt from touches, and its torque along a motion.

use std::ops::RangeInclusive;
use std::sync::Arc;

use nalgebra::{DVector, Isometry3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::body::{ElasticBody, ElasticBodyError};
use super::contact::ElasticContactConfig;
use super::equilibrium::Equilibrium;
use crate::arm::Arm;
use crate::calibration::Calibration;
use crate::lattice::{CellId, Lattice};
use crate::robot::Poses;

/// Largest number of variants of a model.
const MAX_VARIANTS: usize = 16;

/// An object as an elastic body, learnt from touches.
///
/// The predicted torque is `share` times the weighted sum over the variants of the body, plus that of a field
/// of springs with the stiffness [`ElasticModel::spring_n_per_m`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElasticModel {
    /// The possible bodies of the object.
    pub variants: Vec<ElasticVariant>,
    /// Coefficient of sliding friction between arm and body.
    pub friction: f64,
    /// [`ElasticContactConfig::creep_s`], s.
    pub creep_s: f64,
    /// Largest norm of the weighted sum over all joints, N·m; `None` without a touch.
    pub torque_limit_n_m: Option<f64>,
    /// Weight of the bodies' torque in the prediction, 0 to 1.
    pub share: f64,
    /// Number of learnt touches.
    pub n_touches: usize,
    /// Speed of the arm in the touches, m/s; used for motions without times.
    pub speed_m_per_s: f64,
    /// The touched cells, each once.
    #[serde(skip)]
    pub residual_cells: Vec<CellId>,
    /// K of these cells that explains the residual of the bodies, times its weight, N/m.
    #[serde(skip)]
    pub residual_n_per_m: Vec<f64>,
    /// [`Self::residual_n_per_m`] of all other cells, N/m.
    pub untouched_residual_n_per_m: f64,
    /// Calibration of the bands around the predictions of bodies and springs together, for as many joints as the arm.
    #[serde(default)]
    pub calibration: Option<Calibration>,
}

/// One possible body of an object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ElasticVariant {
    /// The body.
    pub body: ElasticBody,
    /// Weight among the variants; the weights add up to one.
    pub weight: f64,
    /// Factors on the stiffness of its springs, by tree.
    pub stiffness_factors: Vec<f64>,
}

impl ElasticModel {
    /// The possible bodies of the object.
    pub fn bodies(&self) -> Vec<Arc<ElasticBody>> {
        self.variants.iter().map(|variant| Arc::new(variant.body.clone())).collect()
    }

    /// K that explains the residual of the bodies, by cell, N/m.
    pub(crate) fn residual(&self) -> impl Iterator<Item = (CellId, f64)> {
        self.residual_cells.iter().copied().zip(self.residual_n_per_m.iter().copied())
    }

    /// The stiffness of a spring in predictions, N/m: (1 − share) times its K in a field that was learnt from the whole
    /// torque, plus its residual stiffness beside the bodies.
    pub fn spring_n_per_m(&self, field_n_per_m: f64, residual_n_per_m: f64) -> f64 {
        Self::spring_beside(self.share, field_n_per_m, residual_n_per_m)
    }

    /// [`Self::spring_n_per_m`] beside bodies with this share.
    pub fn spring_beside(share: f64, field_n_per_m: f64, residual_n_per_m: f64) -> f64 {
        (1.0 - share) * f64::max(field_n_per_m, 0.0) + residual_n_per_m
    }

    /// Checks that the parts fit each other and a lattice.
    ///
    /// # Errors
    ///
    /// Names the invalid number and its range.
    pub fn check(&self, lattice: &Lattice) -> Result<(), ElasticBodyError> {
        let refused = |thing, found, wanted| Err(ElasticBodyError::Model { thing, found, wanted });
        self.check_variants()?;
        let in_range = |thing, found, range: RangeInclusive<f64>, wanted| {
            if range.contains(&found) { Ok(()) } else { refused(thing, found, wanted) }
        };
        let untouched = self.untouched_residual_n_per_m;
        let torque_limit = self.torque_limit_n_m.unwrap_or(0.0);
        in_range("friction", self.friction, 0.0..=1e3, "a number from 0 to 1000")?;
        in_range("creep_s", self.creep_s, 0.0..=1e3, "a number from 0 to 1000")?;
        in_range("share", self.share, 0.0..=1.0, "a number from 0 to 1")?;
        in_range("untouched_residual_n_per_m", untouched, 0.0..=1e12, "a number from 0 to 1e12")?;
        in_range("torque_limit_n_m", torque_limit, 0.0..=1e9, "a number from 0 to 1e9")?;
        in_range("speed_m_per_s", self.speed_m_per_s, 1e-4..=1e3, "a number from 0.0001 to 1000")?;
        let (cells, found) = (self.residual_cells.len(), self.residual_n_per_m.len());
        if cells != found {
            return refused(
                "the number of residual_n_per_m",
                found as f64,
                "one for each residual cell",
            );
        }
        match self.residual_cells.iter().find(|cell| !lattice.contains(**cell)) {
            Some(cell) => refused("a residual cell", f64::from(cell.0), "a cell of the lattice"),
            None => Ok(()),
        }
    }

    /// Checks weights and stiffness factors of the variants.
    fn check_variants(&self) -> Result<(), ElasticBodyError> {
        let refused = |thing, found, wanted| Err(ElasticBodyError::Model { thing, found, wanted });
        if self.variants.is_empty() {
            return Err(ElasticBodyError::Empty);
        }
        if self.variants.len() > MAX_VARIANTS {
            return refused("the number of variants", self.variants.len() as f64, "at most 16");
        }
        let sum: f64 = self.variants.iter().map(|variant| variant.weight).sum();
        if (sum - 1.0).abs() > 1e-6 {
            return refused("the sum of weights", sum, "1");
        }
        for variant in &self.variants {
            if !(0.0..=1.0).contains(&variant.weight) {
                return refused("weight", variant.weight, "a number from 0 to 1");
            }
            let (n, found) = (variant.body.n_trees(), variant.stiffness_factors.len());
            if n != found {
                return refused(
                    "the number of stiffness_factors",
                    found as f64,
                    "one for each tree",
                );
            }
            let odd = variant.stiffness_factors.iter().find(|f| !(0.0..=1e6).contains(*f));
            if let Some(&found) = odd {
                return refused("a stiffness factor", found, "a number from 0 to 1e6");
            }
        }
        Ok(())
    }

    /// The body with the largest weight, at rest, with the arm that bends it.
    pub fn equilibrium(&self, arm: &Arc<Arm>) -> Equilibrium {
        let body = Arc::new(self.likeliest().body.clone());
        Equilibrium::new(Arc::clone(arm), body, self.contact())
    }

    fn contact(&self) -> ElasticContactConfig {
        let Self { friction, creep_s, speed_m_per_s, .. } = *self;
        ElasticContactConfig { friction, creep_s, speed_m_per_s, ..ElasticContactConfig::default() }
    }

    /// The variant of the largest weight, the first of equals.
    pub fn likeliest(&self) -> &ElasticVariant {
        let by_weight = |a: &&ElasticVariant, b: &&ElasticVariant| a.weight.total_cmp(&b.weight);
        self.variants.iter().rev().max_by(by_weight).expect("a model has a variant")
    }
}

/// The torque of an [`ElasticModel`] along a motion.
#[derive(Debug, Clone)]
pub struct ElasticTorque {
    n_joints: usize,
    /// Weight times stiffness factors, by tree, and the body; in descending order of weight.
    variants: Vec<(DVector<f64>, Equilibrium)>,
    torque_limit_n_m: f64,
    share: f64,
    before_s: Option<f64>,
}

impl ElasticTorque {
    /// The bodies at rest, without those whose torque is always zero.
    pub fn new(arm: &Arc<Arm>, model: &ElasticModel) -> Self {
        let config = model.contact();
        let mut by_weight: Vec<&ElasticVariant> = model.variants.iter().collect();
        by_weight.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let variants = by_weight.into_iter().filter_map(|variant| {
            let factors = DVector::from_column_slice(&variant.stiffness_factors) * variant.weight;
            let body = || Arc::new(variant.body.clone());
            let counts = factors.amax() > 0.0 && model.share > 0.0;
            counts.then(|| (factors, Equilibrium::new(Arc::clone(arm), body(), config)))
        });
        Self {
            n_joints: arm.robot.n_joints(),
            variants: variants.collect(),
            torque_limit_n_m: model.torque_limit_n_m.unwrap_or(f64::INFINITY),
            share: model.share,
            before_s: None,
        }
    }

    /// Begins a touch: the bodies are at rest.
    pub fn begin_touch(&mut self) {
        self.before_s = None;
        self.variants.iter_mut().for_each(|(_, equilibrium)| equilibrium.begin_touch());
    }

    /// Moves the arm to these poses and returns the torque there, n_joints, N·m; `time_s` is the time in the log, s.
    pub fn advance(&mut self, poses: &Poses, time_s: Option<f64>) -> DVector<f64> {
        self.bend(&poses.world_from_link, time_s);
        self.torque(poses)
    }

    /// Moves the arm's links to these poses, which bends the bodies.
    pub fn bend(&mut self, links: &[Isometry3<f64>], time_s: Option<f64>) {
        let passed_s = time_s.zip(self.before_s).map(|(now, before)| now - before);
        self.before_s = time_s;
        self.variants.par_iter_mut().for_each(|(_, equilibrium)| {
            equilibrium.advance(links, passed_s);
        });
    }

    /// The torque at the present position, n_joints, N·m; `poses` are those of the last [`ElasticTorque::bend`].
    pub fn torque(&self, poses: &Poses) -> DVector<f64> {
        let of_each = self.variants.par_iter();
        let of_each = of_each.map(|(factors, equilibrium)| equilibrium.torques(poses) * factors);
        let torques: Vec<DVector<f64>> = of_each.collect();
        let mut torque = DVector::zeros(self.n_joints);
        torques.iter().for_each(|of_one| torque += of_one);
        self.share * limit_norm(torque, self.torque_limit_n_m)
    }

    /// The body with the largest weight as it is bent now; `None` if no body has a torque.
    pub fn body(&self) -> Option<&Equilibrium> {
        self.variants.first().map(|(_, equilibrium)| equilibrium)
    }
}

/// A torque, n_joints, N·m, scaled down if its norm exceeds the limit.
pub fn limit_norm(torque: DVector<f64>, limit_n_m: f64) -> DVector<f64> {
    let size = torque.norm();
    if size > limit_n_m { torque * (limit_n_m / size) } else { torque }
}
