//! Estimates how an object was moved since its field was learnt: shifted on the ground and turned about the vertical.
//! A small shift up or down is allowed too, since a touch from one side hardly distinguishes down from back.
//!
//! Contacts depend on the motion of the arm alone, so a motion of the object changes only the stiffness of the touched
//! cells: it is that of the field where they were before the motion, by linear interpolation between cells. So trying a
//! motion costs one sum over the contacts. The search evaluates a grid, and refines its best motions along the axes
//! with steps that are halved again and again.

use nalgebra::{DVector, Point3, Rotation2, Vector2, Vector3};
use palpate::unstable::{CellRows, Observation, StiffnessRule};
use palpate::{CellId, Field, Lattice};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{LearnError, Stop, unless_stopped};
use crate::tracked::TrackedTouches;

/// Limits of the search: horizontal shift, m, and turn, rad.
const FARTHEST_M: f64 = 0.06;
const LARGEST_TURN: f64 = 0.3;
/// Limit of the vertical shift, m, up and down.
const HIGHEST_M: f64 = 0.02;
/// Grid steps on each side of 0, number of grid points that are refined, and how often their steps are halved.
const GRID: i32 = 2;
const REFINED: usize = 4;
const HALVINGS: usize = 5;

/// A motion of an object: turned about the vertical through a point, then shifted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ObjectMotion {
    /// Shift, m, world frame.
    pub shift_m: [f64; 3],
    /// Turn about z, rad.
    pub turn_rad: f64,
    /// Centre of the turn, x and y, m, world frame.
    pub about_m: [f64; 2],
}

impl ObjectMotion {
    /// Whether the motion is at the limit of the search, so that the true one may be larger.
    pub fn is_at_search_bound(&self) -> bool {
        let [x, y, _] = self.shift_m;
        x.hypot(y) > 0.97 * FARTHEST_M || self.turn_rad.abs() > 0.97 * LARGEST_TURN
    }

    /// Whether the motion is too small to be told from none: less than 1 mm and 0.2°.
    pub(super) fn is_none(&self) -> bool {
        Vector3::from(self.shift_m).norm() < 1e-3 && self.turn_rad.abs() < 0.2_f64.to_radians()
    }

    /// Where a point of the object was before the motion.
    pub(super) fn back(&self, point: &Point3<f64>) -> Point3<f64> {
        let about = Vector2::from(self.about_m);
        let point = point - Vector3::from(self.shift_m);
        let before = Rotation2::new(-self.turn_rad) * (point.xy().coords - about) + about;
        Point3::new(before.x, before.y, point.z)
    }

    /// Where a point of the object is after the motion.
    fn forth(&self, point: &Point3<f64>) -> Point3<f64> {
        let about = Vector2::from(self.about_m);
        let after = Rotation2::new(self.turn_rad) * (point.xy().coords - about) + about;
        Point3::new(after.x, after.y, point.z) + Vector3::from(self.shift_m)
    }
}

/// Stiffness of a field at any point.
pub(super) struct Sampler {
    rows: CellRows,
    /// By row, N/m.
    stiffness_n_per_m: Vec<f64>,
    untouched_n_per_m: f64,
    /// Mean position of the cells, weighted by stiffness, x and y, m.
    pub(super) centre_m: [f64; 2],
}

impl Sampler {
    pub(super) fn of(field: &Field) -> Self {
        let rows = || field.cells.iter().zip(&field.stiffness_n_per_m);
        let total: f64 = rows().map(|(_, k)| k + 1e-9).sum();
        let mean = |axis: usize| {
            rows().map(|(cell, k)| field.lattice.point(*cell)[axis] * (k + 1e-9)).sum::<f64>()
                / total
        };
        Self {
            centre_m: [mean(0), mean(1)],
            rows: CellRows::of(field.lattice.clone(), &field.cells),
            stiffness_n_per_m: field.stiffness_n_per_m.clone(),
            untouched_n_per_m: field.untouched_n_per_m,
        }
    }

    /// Stiffness at a point, N/m, interpolated linearly between cells.
    fn at(&self, point: &Point3<f64>) -> f64 {
        let k = |cell: CellId| match self.rows.find(cell) {
            Some(row) => self.stiffness_n_per_m[row as usize],
            None => self.untouched_n_per_m,
        };
        corners(self.rows.lattice(), point).map(|(cell, share)| share * k(cell)).sum()
    }
}

/// The up to eight cells around a point, with their weights of linear interpolation; none outside of the lattice.
fn corners(lattice: &Lattice, point: &Point3<f64>) -> impl Iterator<Item = (CellId, f64)> {
    let place = (point - lattice.origin_m()) / lattice.spacing_m();
    let shape = lattice.shape();
    let base = place.map(f64::floor);
    let part = place - base;
    let cell = move |corner: usize| {
        let mut cell = [0; 3];
        let mut share = 1.0;
        for axis in 0..3 {
            let up = (corner >> axis) & 1;
            let number = base[axis] + up as f64;
            if !(0.0..f64::from(shape[axis])).contains(&number) {
                return None;
            }
            cell[axis] = number as u32;
            share *= if up == 1 { part[axis] } else { 1.0 - part[axis] };
        }
        (share > 0.0).then_some((cell, share))
    };
    (0..8).filter_map(cell).map(move |(place, share)| (lattice.cell(place), share))
}

/// The contacts of a frame, and the torque that the moved field should predict there, n_joints, N·m.
pub(super) type Wanted<'a> = (&'a Observation, DVector<f64>);

/// Sum of the squared errors of frames under a motion of the object, (N·m)².
pub(super) fn error(
    tracked: &TrackedTouches,
    frames: &[Wanted<'_>],
    sampler: &Sampler,
    motion: ObjectMotion,
) -> f64 {
    let mut met = vec![false; tracked.cells.len()];
    frames.iter().flat_map(|(frame, _)| frame.rows()).for_each(|row| met[row] = true);
    let cells = tracked.with_stiffness(|row| match met[row] {
        true => sampler.at(&motion.back(&tracked.points_m[row].into())),
        false => 0.0,
    });
    let of = |(frame, torque): &Wanted<'_>| {
        (frame.predict(&cells, StiffnessRule::Positive) - torque).norm_squared()
    };
    frames.iter().map(of).sum()
}

/// The motion with the smallest squared error, (N·m)², given by `of`. `about_m` is the centre of turns, x and y, m.
///
/// # Errors
///
/// On being stopped.
pub(super) fn best(
    about_m: [f64; 2],
    of: &(dyn Fn(ObjectMotion) -> f64 + Sync),
    stop: Stop<'_>,
) -> Result<ObjectMotion, LearnError> {
    let motion =
        |[x, y, z, turn]: [f64; 4]| ObjectMotion { shift_m: [x, y, z], turn_rad: turn, about_m };
    let of = |at: [f64; 4]| of(motion(at));
    let steps =
        [FARTHEST_M, FARTHEST_M, HIGHEST_M, LARGEST_TURN].map(|most| most / f64::from(GRID));
    let side = 2 * GRID + 1;
    let grid: Vec<[f64; 4]> = (0..side.pow(3))
        .map(|n| [n % side, n / side % side, n / side.pow(2)].map(|k| f64::from(k - GRID)))
        .map(|k| [k[0] * steps[0], k[1] * steps[1], 0.0, k[2] * steps[3]])
        .filter(|at| can_be(*at))
        .collect();
    let tried = grid.into_par_iter().map(|at| {
        unless_stopped(stop)?;
        Ok((at, of(at)))
    });
    let mut tried: Vec<([f64; 4], f64)> = tried.collect::<Result<_, LearnError>>()?;
    tried.sort_by(|a, b| a.1.total_cmp(&b.1));
    tried.truncate(REFINED);
    let refined = tried.into_par_iter().map(|start| refine(start, steps, &of, stop));
    let refined: Vec<([f64; 4], f64)> = refined.collect::<Result<_, LearnError>>()?;
    let best = refined.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    Ok(motion(best.expect("the grid holds no motion at all, too").0))
}

fn can_be([x, y, z, turn]: [f64; 4]) -> bool {
    let slack = 1.0 + 1e-9;
    x.hypot(y) <= FARTHEST_M * slack
        && z.abs() <= HIGHEST_M * slack
        && turn.abs() <= LARGEST_TURN * slack
}

/// Steps along the axes while this reduces the error, with steps that are halved [`HALVINGS`] times.
fn refine(
    (mut at, mut least): ([f64; 4], f64),
    mut steps: [f64; 4],
    of: &impl Fn([f64; 4]) -> f64,
    stop: Stop<'_>,
) -> Result<([f64; 4], f64), LearnError> {
    for _ in 0..HALVINGS {
        steps = steps.map(|step| step / 2.0);
        let mut goes_on = true;
        while goes_on {
            unless_stopped(stop)?;
            goes_on = false;
            for (axis, sign) in (0..4).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
                let mut next = at;
                next[axis] += sign * steps[axis];
                let error = if can_be(next) { of(next) } else { f64::INFINITY };
                if error < least {
                    (at, least, goes_on) = (next, error, true);
                }
            }
        }
    }
    Ok((at, least))
}

/// The field of the object after a motion: stiffness and standard deviation by linear interpolation between cells.
/// Cells with less than half of their interpolation weight on known cells are left out.
pub fn moved(field: &Field, motion: ObjectMotion) -> Field {
    let rows = CellRows::of(field.lattice.clone(), &field.cells);
    let mut cells: Vec<CellId> = (field.cells.iter())
        .flat_map(|cell| {
            let point = motion.forth(&field.lattice.point(*cell));
            corners(&field.lattice, &point).map(|(cell, _)| cell).collect::<Vec<_>>()
        })
        .collect();
    cells.sort_unstable();
    cells.dedup();
    let mut moved = field.clone();
    (moved.cells, moved.stiffness_n_per_m) = (Vec::new(), Vec::new());
    (moved.std_n_per_m, moved.counts) = (Vec::new(), Vec::new());
    for cell in cells {
        let before = motion.back(&field.lattice.point(cell));
        let known: Vec<(usize, f64)> = corners(&field.lattice, &before)
            .filter_map(|(cell, share)| Some((rows.find(cell)? as usize, share)))
            .collect();
        let total: f64 = known.iter().map(|(_, share)| share).sum();
        if total < 0.5 {
            continue;
        }
        let mean =
            |of: &[f64]| known.iter().map(|(row, share)| of[*row] * share).sum::<f64>() / total;
        moved.cells.push(cell);
        moved.stiffness_n_per_m.push(mean(&field.stiffness_n_per_m));
        moved.std_n_per_m.push(mean(&field.std_n_per_m));
        let nearest = known.iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("some are known");
        moved.counts.push(field.counts[nearest.0]);
    }
    moved.elastic = None;
    moved
}
