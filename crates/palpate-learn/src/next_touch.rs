//! Ranks planned motions by how much a touch with each would teach.
//!
//! Contacts follow from the motion of the arm alone, so the levers H of a planned motion are known, and with them how
//! the covariance P of the cells would shrink (Eq. 6 of the paper). P is diagonal in the field; from the first motion
//! on, its correlations are kept. The motions are ranked greedily, each given those before it, by one of
//!
//! | criterion   | value of a motion c                    |
//! |-------------|----------------------------------------|
//! | variance    | decrease of `tr(H P Hᵀ)` of the task   |
//! | information | `½ log det(I + H_c P H_cᵀ / σ²)`, nats |
//!
//! Both are computed from the Gram matrix `G = H P Hᵀ` over some frames of all motions (and cells, if the task is a
//! box): after c it is `G − G_c (G_cc + σ² I)⁻¹ G_cᵀ`. The bound K ≥ 0 is ignored.

use nalgebra::{Cholesky, DMatrix};
use palpate::unstable::CellState;
use palpate::{Calibration, Field};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::calibrate::PredictedFrame;
use crate::error::{LearnError, Stop, unless_stopped};
use crate::field_estimates::FieldEstimates;
use crate::tracked::TrackedTouches;

/// About the most rows of the Gram matrix for frames.
const ROWS: usize = 3000;
/// Lower and upper bound of the frames per motion that are used.
const FRAMES: [usize; 2] = [3, 24];
/// Most cells of a box that are used.
const CELLS: usize = 600;

/// Criterion by which motions are ranked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Criterion {
    /// Decrease of the variance of the task: of its torques, or of the stiffness in its box.
    #[default]
    Variance,
    /// Information gained about all cells that the motion touches, whatever the task.
    Information,
}

/// The quantities that the field should predict well.
#[derive(Debug, Clone, PartialEq)]
pub enum Task {
    /// The torques of these motions, by index.
    Motions(Vec<usize>),
    /// The stiffness of the cells in a box, given by two corners, m, world frame; only cells that some motion touches
    /// count.
    Box([[f64; 3]; 2]),
}

/// A proposed motion; proposals are in the order in which the motions should be made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// Index of the motion.
    #[serde(skip)]
    pub motion: usize,
    /// Remaining share of the task's variance after this motion and all before it.
    pub variance_left: f64,
    /// Information gained by this motion after those before it, nats.
    pub information_nats: f64,
    /// Share of its contacts whose cells the field does not know.
    pub unknown: f64,
    /// Largest predicted torque of a joint, N·m.
    pub torque_n_m: f64,
    /// Largest sum of a predicted torque and the half-width of its band (without bands: twice the spread), N·m.
    pub with_band_n_m: f64,
}

/// Planned motions and a field, for ranking the motions.
pub struct NextTouch<'a> {
    tracked: &'a TrackedTouches,
    field: &'a Field,
    rows: FieldEstimates,
    torque_std: f64,
    /// [`NextTouch::torque_n_m`] of each motion, if it is not that of the springs alone.
    given_n_m: Option<Vec<[f64; 2]>>,
}

impl<'a> NextTouch<'a> {
    /// `tracked` are the motions under the field's lattice and contact model; `untouched_std_n_per_m` is the standard
    /// deviation of cells that the field does not know, and `torque_std` that of a measured torque, N·m: sensor noise
    /// and model error together.
    pub fn new(
        tracked: &'a TrackedTouches,
        field: &'a Field,
        (untouched_std_n_per_m, torque_std): (f64, f64),
    ) -> Self {
        let rows = FieldEstimates::of(tracked, field, untouched_std_n_per_m);
        Self { tracked, field, rows, torque_std, given_n_m: None }
    }

    /// Sets [`NextTouch::torque_n_m`] of all motions, which is otherwise that of the springs alone.
    #[must_use]
    pub fn with_torques(self, torques_n_m: Vec<[f64; 2]>) -> Self {
        Self { given_n_m: Some(torques_n_m), ..self }
    }

    /// Largest torque of a joint along a motion, N·m: predicted, and with the half-width of the band for largest
    /// torques at the default level (without bands: with twice the spread) added.
    pub fn torque_n_m(&self, motion: usize) -> [f64; 2] {
        if let Some(given_n_m) = &self.given_n_m {
            return given_n_m[motion];
        }
        let calibration = self.field.calibration.as_ref();
        let calibration = calibration.filter(|own| own.check(self.tracked.n_joints).is_ok());
        let frames = self.tracked.touches[motion].in_contact();
        largest_torque_n_m(calibration, frames.map(|frame| self.rows.predicted(frame)))
    }

    /// The best `count` candidates in order, each the best given those before it. Candidates that touch nothing are
    /// left out.
    ///
    /// # Errors
    ///
    /// If the variance of the task is zero, or on being stopped.
    pub fn rank(
        &self,
        (candidates, count): (&[usize], usize),
        task: &Task,
        criterion: Criterion,
        stop: Stop<'_>,
    ) -> Result<Vec<Proposal>, LearnError> {
        let mut frames =
            Frames::of(self.tracked, self.rows.estimates.iter().map(|own| own.std_n_per_m));
        let of_task = frames.task(self.tracked, task);
        let mut gram = frames.gram(stop)?;
        let variance =
            |gram: &DMatrix<f64>| of_task.iter().map(|row| gram[(*row, *row)]).sum::<f64>();
        let before = variance(&gram);
        if before <= 0.0 {
            return Err(LearnError::NoTask);
        }
        let mut left: Vec<usize> =
            candidates.iter().copied().filter(|motion| !frames.rows[*motion].is_empty()).collect();
        let mut proposals = Vec::new();
        while proposals.len() < count && !left.is_empty() {
            let judged = left.par_iter().map(|motion| {
                unless_stopped(stop)?;
                Ok(judge((&gram, self.torque_std), &frames.rows[*motion], &of_task))
            });
            let judged: Vec<Judged> = judged.collect::<Result<_, LearnError>>()?;
            let value = |own: &Judged| match criterion {
                Criterion::Variance => own.less_variance,
                Criterion::Information => own.information_nats,
            };
            let best = (0..left.len())
                .max_by(|a, b| value(&judged[*a]).total_cmp(&value(&judged[*b])).then(b.cmp(a)))
                .expect("a candidate is left");
            let motion = left.remove(best);
            let [torque_n_m, with_band_n_m] = self.torque_n_m(motion);
            learn((&mut gram, self.torque_std), &frames.rows[motion]);
            proposals.push(Proposal {
                motion,
                variance_left: (variance(&gram) / before).clamp(0.0, 1.0),
                information_nats: judged[best].information_nats,
                unknown: 1.0 - self.rows.known(self.tracked.touches[motion].in_contact()),
                torque_n_m,
                with_band_n_m,
            });
        }
        Ok(proposals)
    }
}

/// Largest torque of a joint in these frames, N·m: predicted, and with the half-width of the band for largest torques at
/// the default level (without bands: with twice the spread) added.
///
/// # Panics
///
/// If the calibration is for another number of joints ([`Calibration::check`]).
pub fn largest_torque_n_m(
    calibration: Option<&Calibration>,
    frames: impl IntoIterator<Item = PredictedFrame>,
) -> [f64; 2] {
    let mut largest = [0.0_f64; 2];
    for PredictedFrame { torque, spread, contacts, .. } in frames {
        let band = calibration
            .and_then(|own| own.peak_half_width(own.default_level(), &torque, &spread, contacts));
        let widths: Vec<f64> = match band {
            Some(band) => band.data.into(),
            None => spread.iter().map(|spread| 2.0 * spread).collect(),
        };
        for (own, width) in torque.iter().zip(widths) {
            largest = [largest[0].max(own.abs()), largest[1].max(own.abs() + width)];
        }
    }
    largest
}

/// Some frames of all motions, and cells of the task, with their levers.
struct Frames {
    /// Rows of the Gram matrix, by motion.
    rows: Vec<Vec<usize>>,
    n_rows: usize,
    /// By cell: rows of the Gram matrix, and their levers.
    levers: Vec<Vec<(usize, f64)>>,
    std_n_per_m: Vec<f64>,
}

impl Frames {
    fn of(tracked: &TrackedTouches, std_n_per_m: impl Iterator<Item = f64>) -> Self {
        let motions = tracked.touches.len().max(1);
        let of_motion = (ROWS / (tracked.n_joints.max(1) * motions)).clamp(FRAMES[0], FRAMES[1]);
        let mut cells = tracked.with_stiffness(|_| 0.0);
        let mut levers = vec![Vec::new(); cells.len()];
        let (mut rows, mut n_rows) = (Vec::new(), 0);
        for touch in &tracked.touches {
            let every = touch.frames_in_contact().div_ceil(of_motion).max(1);
            let mut own = Vec::new();
            for frame in touch.in_contact().step_by(every) {
                for joint in 0..tracked.n_joints {
                    let mut unit = vec![0.0; tracked.n_joints];
                    unit[joint] = 1.0;
                    let take = |_: &mut CellState, cell: usize, lever: f64| {
                        levers[cell].push((n_rows, lever))
                    };
                    frame.observation.transpose_times(&mut cells, &unit, take);
                    own.push(n_rows);
                    n_rows += 1;
                }
            }
            rows.push(own);
        }
        Self { rows, n_rows, levers, std_n_per_m: std_n_per_m.collect() }
    }

    /// Rows of the Gram matrix that belong to the task; adds rows for the cells of a box.
    fn task(&mut self, tracked: &TrackedTouches, task: &Task) -> Vec<usize> {
        match task {
            Task::Motions(motions) => {
                motions.iter().flat_map(|motion| self.rows[*motion].clone()).collect()
            }
            Task::Box([low, high]) => {
                let is_inside = |cell: &usize| {
                    let point = &tracked.points_m[*cell];
                    (0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
                };
                let inside: Vec<usize> = (0..tracked.points_m.len()).filter(is_inside).collect();
                let some = inside.iter().step_by(inside.len().div_ceil(CELLS).max(1));
                let start = self.n_rows;
                for cell in some {
                    self.levers[*cell].push((self.n_rows, 1.0));
                    self.n_rows += 1;
                }
                (start..self.n_rows).collect()
            }
        }
    }

    /// G = H P Hᵀ.
    fn gram(&self, stop: Stop<'_>) -> Result<DMatrix<f64>, LearnError> {
        let mut gram = DMatrix::zeros(self.n_rows, self.n_rows);
        for (levers, std) in self.levers.iter().zip(&self.std_n_per_m) {
            unless_stopped(stop)?;
            for (a, by_a) in levers {
                let own = std * std * by_a;
                levers.iter().for_each(|(b, by_b)| gram[(*b, *a)] += own * by_b);
            }
        }
        Ok(gram)
    }
}

/// Values of a motion under the two criteria.
struct Judged {
    less_variance: f64,
    information_nats: f64,
}

/// Cholesky factor of `G_cc + σ² I`.
fn innovation(
    (gram, torque_std): (&DMatrix<f64>, f64),
    own: &[usize],
) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    let variance = torque_std * torque_std;
    let mut inner = DMatrix::from_fn(own.len(), own.len(), |i, j| gram[(own[i], own[j])]);
    // Rounding may leave a variance slightly below zero.
    (0..own.len()).for_each(|i| inner[(i, i)] = inner[(i, i)].max(0.0) + variance);
    inner.cholesky()
}

fn judge((gram, torque_std): (&DMatrix<f64>, f64), own: &[usize], task: &[usize]) -> Judged {
    let Some(inner) = innovation((gram, torque_std), own) else {
        return Judged { less_variance: 0.0, information_nats: 0.0 };
    };
    let lower = inner.l_dirty();
    let mut cross = DMatrix::from_fn(own.len(), task.len(), |i, j| gram[(own[i], task[j])]);
    lower.solve_lower_triangular_mut(&mut cross);
    let diagonal = (0..own.len()).map(|i| (lower[(i, i)] / torque_std).ln());
    Judged { less_variance: cross.norm_squared(), information_nats: diagonal.sum() }
}

/// Updates the Gram matrix as if the motion had been made.
fn learn((gram, torque_std): (&mut DMatrix<f64>, f64), own: &[usize]) {
    let Some(inner) = innovation((gram, torque_std), own) else { return };
    let mut cross = DMatrix::from_fn(own.len(), gram.ncols(), |i, j| gram[(own[i], j)]);
    inner.l_dirty().solve_lower_triangular_mut(&mut cross);
    gram.gemm_tr(-1.0, &cross, &cross, 1.0);
}
