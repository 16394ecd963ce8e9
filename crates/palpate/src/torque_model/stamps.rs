//! Times at which joints were read, if the time stamps of a log differ from them.
//!
//! A node that publishes joint states with its own timer stamps the last state that it received from the robot: some
//! samples come twice, and others have stamps that are nearly a period too late. All joints that move show the same
//! time error δ,
//!
//! ```text
//! e_j(t_k) = q̇_j(t_k) δ_k,    so δ_k = Σ_j q̇_j e_j / Σ_j q̇_j²
//! ```
//!
//! where `e_j` is the residual of a polynomial that is fitted to the positions around `t_k`. The time of each sample is
//! then `t_k + δ_k`, and the polynomial is fitted again, until nothing changes.
//!
//! An error that is the same for all samples cannot be found in this way, and does no harm.
//!
//! If joints move along a straight line in joint space, acceleration looks like a time error. So the corrected times
//! are used only if they explain the positions far better than the stamps do, which does not happen in such motion.
//! Positions of prismatic joints, m, are treated like those of other joints, rad.

use rayon::prelude::*;

use super::{LocalPolynomial, TouchMotion, Window};
use crate::robot::Robot;
use crate::tracker::Sample;

/// Number of samples before and after each to which a polynomial is fitted. With more, longer lasting time errors are
/// found; with fewer, errors in faster motion.
const HALF: f64 = 8.0;
/// Largest number of fits.
const FITS: usize = 30;
/// Root mean square change of the times at which the iteration ends, in intervals between samples.
const SETTLED: f64 = 0.002;
/// Speed, rad/s or m/s, below which a joint gives no information about the time.
const SLOW: f64 = 0.03;
/// Stamps are tested in *fast* samples: those faster than this share of the top speed in the log.
const FAST: f64 = 0.3;
/// Least number of fast samples for a correction.
const MIN_SAMPLES: usize = 50;
/// Time error above which a stamp counts as wrong, in intervals.
const OFF: f64 = 0.15;
/// Least share of fast samples with wrong stamps for a correction.
const OFF_PART: f64 = 0.01;
/// Least number of fast samples with wrong stamps for a correction.
const OFF_SAMPLES: f64 = 5.0;
/// For a correction, the squared residuals from a cubic must fall below this share with time errors that are estimated
/// from the other joints.
const UNEXPLAINED: f64 = 0.2;
/// Corrected times are used only if the squared residuals from polynomials fall below this share of those with stamps.
/// Behind a relay, 0.003 to 0.12 were seen; in straight motion with true stamps at least 0.18.
const KEPT: f64 = 0.1;
/// Largest share of samples whose times are a whole interval from their stamps.
const AT_BOUND: f64 = 0.02;

/// The samples of a touch with the times at which the joints were read; `None` unless the stamps clearly differ.
pub fn with_read_times(robot: &Robot, samples: &[Sample]) -> Option<Vec<Sample>> {
    let motion = TouchMotion::of(robot, samples, vec![0.0; robot.n_joints()]);
    let times = read_times(motion.clock()?, motion.positions())?;
    let with_time =
        |(sample, time_s): (&Sample, f64)| Sample { time_s: Some(time_s), ..sample.clone() };
    Some(samples.iter().zip(times).map(with_time).collect())
}

/// Times at which joints were read, s, in non-descending order, for stamps, s, and positions, n_joints each; `None` if
/// the stamps may be right.
fn read_times(stamps_s: &[f64], positions: &[Vec<f64>]) -> Option<Vec<f64>> {
    if !are_wrong(stamps_s, positions) {
        return None;
    }
    let interval_s = interval(stamps_s);
    let half_s = HALF * interval_s;
    // The joints were read within an interval of the stamp.
    let is_near = |times: &Vec<f64>| {
        times.iter().zip(stamps_s).all(|(time, stamp)| (time - stamp).abs() <= interval_s)
    };
    let mut times = stamps_s.to_vec();
    let mut left = Misfit::of(&times, positions, half_s);
    let with_stamps = left.squares;
    if let Some(even) = even_times(stamps_s, positions).filter(is_near) {
        let left_then = Misfit::of(&even, positions, half_s);
        if left_then.squares < left.squares {
            (times, left) = (even, left_then);
        }
    }
    for _ in 0..FITS {
        let mut last = f64::NEG_INFINITY;
        for ((time, step), stamp) in times.iter_mut().zip(&left.steps_s).zip(stamps_s) {
            last = (*time + step).clamp(stamp - interval_s, stamp + interval_s).max(last);
            *time = last;
        }
        let squares = left.steps_s.iter().map(|step| step * step).sum::<f64>();
        if (squares / times.len() as f64).sqrt() < SETTLED * interval_s {
            break;
        }
        left = Misfit::of(&times, positions, half_s);
    }
    let is_at_bound = |(time, stamp): &(&f64, &f64)| (**time - **stamp).abs() > 0.999 * interval_s;
    let at_bound = times.iter().zip(stamps_s).filter(is_at_bound).count() as f64;
    let are_sure = left.squares < KEPT * with_stamps && at_bound <= AT_BOUND * times.len() as f64;
    are_sure.then_some(times)
}

/// Residuals of positions from polynomials.
struct Misfit {
    /// Sum of squares.
    squares: f64,
    /// Time errors that explain the residuals best, s.
    steps_s: Vec<f64>,
}

impl Misfit {
    fn of(times_s: &[f64], positions: &[Vec<f64>], half_s: f64) -> Self {
        let fits = LocalPolynomial::new(times_s, positions, half_s, Window::Centred);
        let (first_s, last_s) = (times_s[0], times_s[times_s.len() - 1]);
        let each = times_s.par_iter().zip(positions).map(|(time_s, q)| {
            let fit = fits.at(*time_s);
            let left = q.iter().zip(&fit.value).map(|(q, value)| q - value);
            // At the ends, a parabola with samples on one side is not accurate enough.
            let is_inside = time_s - first_s >= half_s && last_s - time_s >= half_s;
            let squares = left.clone().map(|left| left * left).sum::<f64>();
            if is_inside { (squares, delay(left.zip(fit.first))) } else { (0.0, 0.0) }
        });
        let (squares, steps_s): (Vec<f64>, Vec<f64>) = each.unzip();
        Self { squares: squares.iter().sum(), steps_s }
    }
}

/// Times for a robot that sends at a constant rate, if some samples are equal to the one before; `None` if none are.
fn even_times(stamps_s: &[f64], positions: &[Vec<f64>]) -> Option<Vec<f64>> {
    let mut number = 0;
    let each = positions.iter().enumerate().map(|(k, q)| {
        number += u32::from(k > 0 && *q != positions[k - 1]);
        f64::from(number)
    });
    let numbers: Vec<f64> = each.collect();
    let (first, last) = (stamps_s[0], stamps_s[stamps_s.len() - 1]);
    let step = (last - first) / f64::from(number.max(1));
    let early = stamps_s.iter().zip(&numbers).map(|(stamp, number)| stamp - first - step * number);
    let early = early.sum::<f64>() / stamps_s.len() as f64;
    let is_any = (number as usize) + 1 < positions.len();
    is_any.then(|| numbers.iter().map(|number| first + early + step * number).collect())
}

/// Whether stamps seem to differ from the times of reading, by the residual of each sample from a cubic through its
/// four neighbours.
fn are_wrong(stamps_s: &[f64], positions: &[Vec<f64>]) -> bool {
    let residuals: Vec<Residual> = (2..stamps_s.len().saturating_sub(2))
        .filter_map(|k| Residual::at(k, stamps_s, positions))
        .collect();
    let mut speeds: Vec<f64> = residuals.iter().map(Residual::speed).collect();
    if speeds.is_empty() {
        return false;
    }
    // The 99th percentile, which excludes jumps.
    let fastest = speeds.len() * 99 / 100;
    let fast = FAST * *speeds.select_nth_unstable_by(fastest, f64::total_cmp).1;
    let residuals: Vec<&Residual> =
        residuals.iter().filter(|own| own.speed() >= fast.max(SLOW)).collect();
    let off_s = OFF * interval(stamps_s);
    let off = residuals.iter().filter(|own| delay(own.joints()).abs() > off_s).count() as f64;
    let (mut before, mut after) = (0.0, 0.0);
    for own in &residuals {
        for (j, (left, speed)) in own.joints().enumerate() {
            let others = own.joints().enumerate().filter(|(other, _)| *other != j);
            before += left * left;
            after += (left - speed * delay(others.map(|(_, own)| own))).powi(2);
        }
    }
    residuals.len() >= MIN_SAMPLES
        && off >= (OFF_PART * residuals.len() as f64).max(OFF_SAMPLES)
        && after < UNEXPLAINED * before
}

/// Residual of a sample from a cubic through its neighbours.
struct Residual {
    /// Position minus that of the cubic, n_joints.
    left: Vec<f64>,
    /// Speed, n_joints.
    speeds: Vec<f64>,
}

impl Residual {
    /// `None` where two of the neighbours have the same stamp.
    fn at(k: usize, stamps_s: &[f64], positions: &[Vec<f64>]) -> Option<Self> {
        let neighbours = [k - 2, k - 1, k + 1, k + 2];
        let times = neighbours.map(|index| stamps_s[index] - stamps_s[k]);
        let weight = |own: usize| -> f64 {
            let others = (0..4).filter(|other| *other != own);
            others.map(|other| times[other] / (times[other] - times[own])).product()
        };
        let weights = [0, 1, 2, 3].map(weight);
        if times.windows(2).any(|pair| pair[0] >= pair[1]) {
            return None;
        }
        let joints = 0..positions[k].len();
        let left = |j: usize| {
            let cubic =
                neighbours.iter().zip(weights).map(|(index, own)| own * positions[*index][j]);
            positions[k][j] - cubic.sum::<f64>()
        };
        let speed = |j: usize| (positions[k + 1][j] - positions[k - 1][j]) / (times[2] - times[1]);
        Some(Self { left: joints.clone().map(left).collect(), speeds: joints.map(speed).collect() })
    }

    fn joints(&self) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
        self.left.iter().copied().zip(self.speeds.iter().copied())
    }

    fn speed(&self) -> f64 {
        self.speeds.iter().map(|speed| speed * speed).sum::<f64>().sqrt()
    }
}

/// Time error that explains residuals at these speeds best (least squares), s.
fn delay(joints: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (product, square) = joints.fold((0.0, SLOW * SLOW), |(product, square), (left, speed)| {
        (product + left * speed, square + speed * speed)
    });
    product / square
}

/// Median time between samples, s.
fn interval(stamps_s: &[f64]) -> f64 {
    let steps = stamps_s.windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps: Vec<f64> = steps.filter(|step_s| *step_s > 0.0).collect();
    let middle = steps.len() / 2;
    if steps.is_empty() { 0.0 } else { *steps.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four joints that swing with different frequencies.
    fn swing(time_s: f64) -> Vec<f64> {
        (0..4).map(|j| 0.7 * ((1.9 + 0.6 * f64::from(j)) * time_s + f64::from(j)).sin()).collect()
    }

    /// Four joints that start and stop together, with constant accelerations, `way_s` for each way, with pauses of
    /// `pause_s`.
    fn trapezoid(time_s: f64, way_s: f64, pause_s: f64) -> Vec<f64> {
        let phase = time_s % (2.0 * (way_s + pause_s));
        let forth = (phase / way_s).min(1.0);
        let back = ((phase - way_s - pause_s) / way_s).clamp(0.0, 1.0);
        let part = forth - back;
        let way = if part < 0.2 {
            3.125 * part * part
        } else if part < 0.8 {
            1.25 * part - 0.125
        } else {
            1.0 - 3.125 * (1.0 - part).powi(2)
        };
        [0.9, -0.4, 0.2, 0.6].map(|range| range * way).to_vec()
    }

    fn noise(k: usize) -> f64 {
        1e-5 * (12.9898 * (k * k % 9973) as f64).sin()
    }

    #[test]
    fn a_relays_stamps_are_replaced_by_the_times_at_which_joints_were_read() {
        let stamps: Vec<f64> = (0..900).map(|k| f64::from(k) / 30.0).collect();
        // The robot sends every 34 ms.
        let read: Vec<f64> = stamps.iter().map(|stamp| (stamp / 0.034).floor() * 0.034).collect();
        let positions: Vec<Vec<f64>> = read
            .iter()
            .enumerate()
            .map(|(k, time)| swing(*time).into_iter().map(|q| q + noise(k)).collect())
            .collect();
        let found = read_times(&stamps, &positions).expect("every fiftieth sample comes twice");
        assert!(found.windows(2).all(|pair| pair[0] <= pair[1]), "times rise");
        let speed = |times: &[f64], k: usize| {
            LocalPolynomial::new(times, &positions, 0.1, Window::Centred).at(times[k]).second[0]
        };
        let true_acceleration = |time: f64| -0.7 * 1.9_f64.powi(2) * (1.9 * time).sin();
        let error = |times: &[f64]| -> f64 {
            (30..870).map(|k| (speed(times, k) - true_acceleration(read[k])).powi(2)).sum()
        };
        let (before, after) = (error(&stamps), error(&found));
        assert!(after < 0.1 * before, "{after} of {before}");
    }

    #[test]
    fn stamps_that_may_be_right_stay() {
        let ways: Vec<(f64, f64)> =
            [0.3, 0.5, 1.0, 2.0].iter().flat_map(|way| [(*way, 0.0), (*way, 0.3)]).collect();
        let straight =
            |(way_s, pause_s): (f64, f64)| move |time_s: f64| trapezoid(time_s, way_s, pause_s);
        let mut motions: Vec<Box<dyn Fn(f64) -> Vec<f64>>> = vec![Box::new(swing)];
        motions.extend(
            ways.into_iter().map(|way| Box::new(straight(way)) as Box<dyn Fn(f64) -> Vec<f64>>),
        );
        for motion in motions {
            for rate in [10.0, 17.0, 30.0, 50.0, 100.0, 1000.0] {
                let stamps: Vec<f64> = (0..900).map(|k| f64::from(k) / rate).collect();
                let noisy = |(k, time): (usize, &f64)| {
                    let joints = motion(*time).into_iter().enumerate();
                    joints.map(|(j, q)| q + noise(7 * k + j)).collect()
                };
                let positions: Vec<Vec<f64>> = stamps.iter().enumerate().map(noisy).collect();
                assert_eq!(read_times(&stamps, &positions), None, "{rate} Hz");
            }
        }
    }

    #[test]
    fn stamps_of_a_single_moving_joint_are_not_corrected() {
        let positions: Vec<Vec<f64>> = (0..900)
            .map(|k| {
                let time = f64::from(k) / 30.0 + 0.01 * (12.9898 * f64::from(k * k % 997)).sin();
                vec![swing(time)[0], 0.3, -0.2]
            })
            .collect();
        let stamps: Vec<f64> = (0..900).map(|k| f64::from(k) / 30.0).collect();
        assert_eq!(read_times(&stamps, &positions), None);
    }

    #[test]
    fn few_samples_and_still_arms_keep_their_stamps() {
        assert_eq!(read_times(&[0.0], &[vec![0.1]]), None);
        let stamps: Vec<f64> = (0..200).map(|k| f64::from(k) / 30.0).collect();
        assert_eq!(read_times(&stamps, &vec![vec![0.1, 0.2]; 200]), None);
    }
}
