//! A motion that determines an arm's masses and friction: a Fourier series for each joint, which begins and ends at
//! rest and keeps to the joint limits, above the ground and free of self-collisions. Its coefficients make the
//! regression of [`crate::identify`] well conditioned (Swevers et al. 1997).
//!
//! ```text
//! q_j(t) = c_j + e(t) Σ_k [ a_jk sin(k ω t) + b_jk cos(k ω t) ]        e: from 0 to 1 and back, twice differentiable
//! ```
//!
//! Coefficients are drawn at random and scaled down until every limit holds. Then those of one joint at a time are
//! drawn again, and kept if the condition number is smaller.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, Point3};
use palpate::Arm;
use palpate::unstable::{Joint, LinkId};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::error::{LearnError, Stop, unless_stopped};
use crate::identify::inertial_scales;

/// Settings and limits of an excitation.
#[derive(Debug, Clone, PartialEq)]
pub struct ExciteConfig {
    /// Joint positions at start and end, rad or m; `None`: the middle of the joints' ranges.
    pub around: Option<Vec<f64>>,
    /// Duration of the motion, s.
    pub duration_s: f64,
    /// Points per second of the result.
    pub rate_hz: f64,
    /// Largest speed of a joint, as a fraction of the URDF's limit.
    pub speed_share: f64,
    /// Largest torque of a joint, as a fraction of the URDF's limit.
    pub torque_share: f64,
    /// Lowest height of the arm without its first moving link, m in the base frame; `None`: no ground.
    pub ground_m: Option<f64>,
    /// Least distance between links that are not neighbours, m.
    pub clearance_m: f64,
    /// Largest travel of a joint from its start position, rad or m.
    pub reach: f64,
    /// Seed of the random coefficients.
    pub seed: u64,
    /// Number of motions that are tried.
    pub tries: usize,
}

impl Default for ExciteConfig {
    fn default() -> Self {
        Self {
            around: None,
            duration_s: 20.0,
            rate_hz: 100.0,
            speed_share: 0.5,
            torque_share: 0.8,
            ground_m: Some(0.05),
            clearance_m: 0.03,
            reach: 1.2,
            seed: 0,
            tries: 150,
        }
    }
}

/// An exciting motion and its figures.
#[derive(Debug, Clone, PartialEq)]
pub struct Excitation {
    /// Times of the points, s.
    pub times_s: Vec<f64>,
    /// Positions, speeds and accelerations at these times, n_joints each.
    pub points: Vec<[Vec<f64>; 3]>,
    /// Condition number of the regression.
    pub condition: f64,
    /// Condition number of the first motion that kept to the limits.
    pub first_condition: f64,
    /// Largest speed, as a fraction of the joint's limit; 0 if no limit is known.
    pub speed_share: f64,
    /// Largest torque, as a fraction of the joint's limit; 0 if no limit is known.
    pub torque_share: f64,
    /// Lowest point of the arm without its first moving link, m, if its links have surfaces.
    pub lowest_m: Option<f64>,
    /// Least distance between links that are not neighbours, m; `None` without pairs to check.
    pub nearest_m: Option<f64>,
}

/// Harmonics of the series, and its longest period, s.
const HARMONICS: usize = 5;
const PERIOD_S: f64 = 10.0;
/// Duration of the ramps at start and end, over which the amplitude goes from 0 to 1 and back, s.
const RAMP_S: f64 = 2.0;
/// Rates at which limits are checked: during the search, and for the result.
const COARSE_HZ: f64 = 10.0;
const FINE_HZ: f64 = 50.0;
/// Number of random points from which the determinable combinations of masses are counted.
const ANY_POINTS: usize = 60;
/// Most points of a link's surface that are checked.
const SURFACE: usize = 150;
/// Margin at each end of a joint's range, as a fraction of the range.
const RANGE_MARGIN: f64 = 0.05;
/// Speed limit of a joint whose URDF gives none, rad/s.
const USUAL_SPEED: f64 = 1.0;

/// Coefficients: by joint, harmonic, sine and cosine.
type Series = Vec<[[f64; 2]; HARMONICS]>;

/// Finds a motion with a small condition number. `done` is called before each try, for a progress bar.
///
/// # Errors
///
/// If the start is out of the joints' ranges or too near the ground, or no motion around it keeps to the limits; or on
/// being stopped.
pub fn excite(
    arm: &Arm,
    config: &ExciteConfig,
    stop: Stop<'_>,
    done: &dyn Fn(),
) -> Result<Excitation, LearnError> {
    let search = Search::new(arm, config)?;
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut best: Option<(f64, Series)> = None;
    let mut first = f64::NAN;
    for attempt in 0..config.tries {
        unless_stopped(stop)?;
        done();
        let mut series = match &best {
            // The first quarter is drawn at random, the others change the best one.
            Some((_, series)) if attempt > config.tries / 4 => series.clone(),
            _ => vec![[[0.0; 2]; HARMONICS]; arm.robot.n_joints()],
        };
        let fresh = series.iter().flatten().flatten().all(|own| *own == 0.0);
        let joint = (rng.next_u32() as usize) % series.len();
        for (j, own) in series.iter_mut().enumerate() {
            if fresh || j == joint {
                search.draw(j, own, &mut rng);
            }
        }
        let Some(series) = search.shrunk(series, COARSE_HZ) else { continue };
        let condition = search.condition(&series);
        if first.is_nan() {
            first = condition;
        }
        if best.as_ref().is_none_or(|(least, _)| condition < *least) {
            best = Some((condition, series));
        }
    }
    let none = || {
        LearnError::Excite(
            "no motion around the start was found that keeps all limits; give another start"
                .to_owned(),
        )
    };
    let (_, series) = best.ok_or_else(none)?;
    let series = search.shrunk(series, FINE_HZ).ok_or_else(none)?;
    Ok(search.motion(&series, first))
}

struct Search<'a> {
    arm: &'a Arm,
    config: &'a ExciteConfig,
    around: Vec<f64>,
    /// Points of each link's surface.
    surfaces: Vec<Vec<Point3<f64>>>,
    /// Pairs of links that may collide.
    pairs: Vec<(usize, usize)>,
    /// Scales of the inertial parameters, for the condition number.
    scales: Vec<f64>,
    /// Number of combinations of inertial parameters that motion can determine.
    determined: usize,
}

impl<'a> Search<'a> {
    fn new(arm: &'a Arm, config: &'a ExciteConfig) -> Result<Self, LearnError> {
        let robot = &arm.robot;
        let wrong = |what: String| Err(LearnError::Excite(what));
        let middle = || robot.joints().iter().map(|joint| joint.middle()).collect();
        let around: Vec<f64> = config.around.clone().unwrap_or_else(middle);
        if around.len() != robot.n_joints() {
            let (found, wanted) = (around.len(), robot.n_joints());
            let names: Vec<&str> = robot.joint_names().collect();
            return wrong(format!(
                "the start has {found} joint positions; wanted {wanted}, for {}; a joint that stands still is left out \
                 with --hold JOINT=POSITION",
                names.join(", ")
            ));
        }
        for (joint, at) in robot.joints().iter().zip(&around) {
            if let Some([low, high]) = joint.range
                && !(low..=high).contains(at)
            {
                let name = &joint.name;
                return wrong(format!(
                    "the start of joint `{name}` is {at}; its range is {low} to {high}"
                ));
            }
        }
        let surfaces: Vec<Vec<Point3<f64>>> = (arm.surfaces.iter())
            .map(|surface| {
                let points =
                    surface.as_ref().map(|surface| surface.surface_points()).unwrap_or_default();
                let every = points.len().div_ceil(SURFACE).max(1);
                points.into_iter().step_by(every).collect()
            })
            .collect();
        let scales = inertial_scales(&robot.inertial_parameters()).as_slice().to_vec();
        let (pairs, determined) = (Vec::new(), 0);
        let mut search = Self { arm, config, around, surfaces, pairs, scales, determined };
        search.determined = search.determined_by_any_motion();
        // Links closer than the clearance at the start count as neighbours: shells of one housing overlap.
        let links = 0..robot.links().len();
        let pairs: Vec<(usize, usize)> = links
            .clone()
            .flat_map(|a| links.clone().map(move |b| (a, b)))
            .filter(|(a, b)| a != b)
            .collect();
        let poses =
            robot.forward(&search.around).map_err(|error| LearnError::Excite(error.to_string()))?;
        search.pairs = pairs
            .into_iter()
            .filter(|(a, b)| search.moves_apart(*a, *b))
            .filter(|pair| search.distance(&poses.world_from_link, *pair) > config.clearance_m)
            .collect();
        if let Some(ground_m) = config.ground_m
            && search.lowest(&poses.world_from_link) < ground_m
        {
            let lowest = search.lowest(&poses.world_from_link);
            return wrong(format!(
                "at the start the arm reaches down to {lowest:.3} m; wanted above {ground_m} m; give another \
                 start (--start) or another height of the ground (--ground-m)"
            ));
        }
        Ok(search)
    }

    /// Whether at least two joints lie between two links. Neighbours are not checked for collisions.
    fn moves_apart(&self, a: usize, b: usize) -> bool {
        // Joints between the links move one of them and not the other.
        let moves =
            |joint: &&Joint, link: usize| self.arm.robot.carries(joint, LinkId(link as u16));
        let between = |joint: &&Joint| moves(joint, a) != moves(joint, b);
        self.arm.robot.joints().iter().filter(between).count() >= 2
    }

    /// Least distance of the surface points of link `a` from the surface of link `b`, m.
    fn distance(&self, poses: &[nalgebra::Isometry3<f64>], (a, b): (usize, usize)) -> f64 {
        let Some(surface) = &self.arm.surfaces[b] else { return f64::INFINITY };
        let to_b = poses[b].inverse() * poses[a];
        let each = self.surfaces[a].iter().map(|point| surface.distance(&(to_b * point)));
        each.fold(f64::INFINITY, f64::min)
    }

    /// Height of the lowest point of the arm, m, without fixed links and the first moving body.
    fn lowest(&self, poses: &[nalgebra::Isometry3<f64>]) -> f64 {
        let robot = &self.arm.robot;
        let links =
            self.surfaces.iter().zip(poses).enumerate().filter(|(link, _)| {
                robot.body_of(LinkId(*link as u16)).is_some_and(|body| body > 0)
            });
        let heights =
            links.flat_map(|(_, (points, pose))| points.iter().map(move |point| (pose * point).z));
        heights.fold(f64::INFINITY, f64::min)
    }

    /// Largest travel of a joint from its start position, in both directions.
    fn room(&self, j: usize) -> f64 {
        let joint = &self.arm.robot.joints()[j];
        let Some([low, high]) = joint.range else { return self.config.reach };
        let margin = RANGE_MARGIN * (high - low);
        let at = self.around[j];
        (at - low - margin).min(high - margin - at).clamp(0.0, self.config.reach)
    }

    fn draw(&self, j: usize, own: &mut [[f64; 2]; HARMONICS], rng: &mut ChaCha8Rng) {
        let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0;
        for (k, harmonic) in own.iter_mut().enumerate() {
            // Amplitudes fall with the frequency, so that all harmonics have similar speeds.
            *harmonic = [uniform(), uniform()].map(|part| part * self.room(j) / (k as f64 + 1.0));
        }
    }

    /// Position, speed and acceleration of all joints at a time.
    fn at(&self, series: &Series, time_s: f64) -> [Vec<f64>; 3] {
        let (envelope, slope, bend) = envelope(time_s, self.config.duration_s);
        let omega = TAU / PERIOD_S;
        let mut point = [Vec::new(), Vec::new(), Vec::new()];
        for (own, around) in series.iter().zip(&self.around) {
            let [mut value, mut speed, mut acceleration] = [0.0; 3];
            for (k, [a, b]) in own.iter().enumerate() {
                let w = omega * (k as f64 + 1.0);
                let (sin, cos) = (w * time_s).sin_cos();
                value += a * sin + b * cos;
                speed += w * (a * cos - b * sin);
                acceleration -= w * w * (a * sin + b * cos);
            }
            point[0].push(around + envelope * value);
            point[1].push(envelope * speed + slope * value);
            point[2].push(envelope * acceleration + 2.0 * slope * speed + bend * value);
        }
        point
    }

    /// Evenly spaced times over the motion, at about this rate, with both ends.
    fn times(&self, rate_hz: f64) -> impl Iterator<Item = f64> {
        let points = (self.config.duration_s * rate_hz).round() as usize + 1;
        let step = self.config.duration_s / (points - 1) as f64;
        (0..points).map(move |k| k as f64 * step)
    }

    /// The series scaled down until it keeps to the limits: each joint to its range and speed, then all joints together
    /// to torques, ground and clearance. `None` if a tenth of it still violates a limit.
    fn shrunk(&self, mut series: Series, rate_hz: f64) -> Option<Series> {
        let motion: Vec<[Vec<f64>; 3]> =
            self.times(rate_hz).map(|time| self.at(&series, time)).collect();
        for (j, own) in series.iter_mut().enumerate() {
            let joint = &self.arm.robot.joints()[j];
            let fastest = self.config.speed_share * joint.velocity.unwrap_or(USUAL_SPEED);
            let largest = |of: usize, less: f64| {
                motion.iter().map(|point| (point[of][j] - less).abs()).fold(1e-12, f64::max)
            };
            let factor =
                (self.room(j) / largest(0, self.around[j])).min(fastest / largest(1, 0.0)).min(1.0);
            scale(own, factor);
        }
        for _ in 0..12 {
            if self.keeps_to_limits(&series, rate_hz) {
                return Some(series);
            }
            series.iter_mut().for_each(|own| scale(own, 0.82));
        }
        None
    }

    fn keeps_to_limits(&self, series: &Series, rate_hz: f64) -> bool {
        let robot = &self.arm.robot;
        self.times(rate_hz).all(|time| {
            let [q, speed, acceleration] = self.at(series, time);
            let Ok(poses) = robot.forward(&q) else { return false };
            let torque = robot.inverse_dynamics(&poses, &speed, &acceleration);
            let is_weak = robot.joints().iter().zip(torque.iter()).all(|(joint, torque)| {
                joint.effort.is_none_or(|most| torque.abs() <= self.config.torque_share * most)
            });
            let poses = &poses.world_from_link;
            is_weak
                && self.config.ground_m.is_none_or(|ground_m| self.lowest(poses) >= ground_m)
                && self
                    .pairs
                    .iter()
                    .all(|pair| self.distance(poses, *pair) >= self.config.clearance_m)
        })
    }

    /// Condition number of the regression of the inertial parameters, over the combinations that motion can determine.
    /// It is large for a motion that hardly moves the arm.
    fn condition(&self, series: &Series) -> f64 {
        let points = self.times(COARSE_HZ).map(|time| self.at(series, time));
        let eigenvalues = self.eigenvalues(points);
        let least = eigenvalues[self.determined.max(1) - 1].max(1e-16 * eigenvalues[0]);
        (eigenvalues[0] / least).sqrt()
    }

    /// Number of combinations of inertial parameters that random motion without limits determines: the largest
    /// possible.
    fn determined_by_any_motion(&self) -> usize {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0;
        let mut draw = |size: f64| -> Vec<f64> {
            let moves = (0..self.around.len()).map(|j| self.room(j) > 0.0);
            moves.map(|moves| if moves { size * uniform() } else { 0.0 }).collect()
        };
        let points = (0..ANY_POINTS).map(|_| {
            let q = self.around.iter().zip(draw(1.0)).map(|(around, way)| around + way).collect();
            [q, draw(1.0), draw(3.0)]
        });
        let eigenvalues = self.eigenvalues(points);
        eigenvalues.iter().take_while(|value| **value > 1e-10 * eigenvalues[0]).count()
    }

    /// Eigenvalues of the regression's Gram matrix over points of a motion, in falling order.
    fn eigenvalues(&self, points: impl Iterator<Item = [Vec<f64>; 3]>) -> Vec<f64> {
        let robot = &self.arm.robot;
        let size = self.scales.len();
        let mut gram = DMatrix::zeros(size, size);
        for [q, speed, acceleration] in points {
            let Ok(poses) = robot.forward(&q) else { continue };
            let mut regressor = robot.regressor(&poses, &speed, &acceleration);
            for (mut column, scale) in regressor.column_iter_mut().zip(&self.scales) {
                column *= *scale;
            }
            gram += regressor.transpose() * regressor;
        }
        let mut eigenvalues: Vec<f64> = gram.symmetric_eigenvalues().iter().copied().collect();
        eigenvalues.sort_by(|a, b| b.total_cmp(a));
        eigenvalues
    }

    fn motion(&self, series: &Series, first: f64) -> Excitation {
        let robot = &self.arm.robot;
        let times_s: Vec<f64> = self.times(self.config.rate_hz).collect();
        let points: Vec<[Vec<f64>; 3]> =
            times_s.iter().map(|time| self.at(series, *time)).collect();
        let mut found = Excitation {
            condition: self.condition(series),
            first_condition: first,
            speed_share: 0.0,
            torque_share: 0.0,
            lowest_m: None,
            nearest_m: None,
            times_s,
            points,
        };
        for [q, speed, acceleration] in &found.points {
            let Ok(poses) = robot.forward(q) else { continue };
            let torque = robot.inverse_dynamics(&poses, speed, acceleration);
            for ((joint, speed), torque) in robot.joints().iter().zip(speed).zip(torque.iter()) {
                let share = |most: Option<f64>, of: f64| most.map_or(0.0, |most| of.abs() / most);
                found.speed_share = found.speed_share.max(share(joint.velocity, *speed));
                found.torque_share = found.torque_share.max(share(joint.effort, *torque));
            }
        }
        let (mut lowest_m, mut nearest_m) = (f64::INFINITY, f64::INFINITY);
        for time in self.times(FINE_HZ) {
            let Ok(poses) = robot.forward(&self.at(series, time)[0]) else { continue };
            lowest_m = lowest_m.min(self.lowest(&poses.world_from_link));
            let apart = self.pairs.iter().map(|pair| self.distance(&poses.world_from_link, *pair));
            nearest_m = apart.fold(nearest_m, f64::min);
        }
        let known = |height: f64| height.is_finite().then_some(height);
        (found.lowest_m, found.nearest_m) = (known(lowest_m), known(nearest_m));
        found
    }
}

fn scale(own: &mut [[f64; 2]; HARMONICS], factor: f64) {
    own.iter_mut().flatten().for_each(|part| *part *= factor);
}

/// Envelope e(t), from 0 at the ends to 1 after [`RAMP_S`], with its first and second derivative.
fn envelope(time_s: f64, duration_s: f64) -> (f64, f64, f64) {
    let ramp = RAMP_S.min(0.5 * duration_s);
    let smooth = |t: f64| {
        let x = (t / ramp).clamp(0.0, 1.0);
        let value = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
        let slope = 30.0 * x * x * (1.0 - x) * (1.0 - x) / ramp;
        let bend = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp / ramp;
        (value, slope, bend)
    };
    if time_s < 0.5 * duration_s {
        smooth(time_s)
    } else {
        let (value, slope, bend) = smooth(duration_s - time_s);
        (value, -slope, bend)
    }
}
