//! Evidence for the unit of times that a log does not name: the rate of the samples and the speed of the arm.

use std::f64::consts::TAU;

use palpate::Sample;

use super::options::{AngleUnit, TimeUnit};

/// Median time steps, s, that a log of a robot may have; outside of this range, the unit is not s.
const BELIEVABLE_PERIOD_S: [f64; 2] = [1e-5, 5.0];
/// Times are not in s either if the median step is at least this, and joints are rarely faster than [`SLOW_SPEED`], rad/s
/// or m/s, although the log has [`MOVES_FRAMES`] frames and a joint moves by [`MOVES`], rad or m.
const SLOW_PERIOD_S: f64 = 0.5;
const SLOW_SPEED: f64 = 0.02;
const MOVES_FRAMES: usize = 200;
const MOVES: f64 = 0.1;
/// In the unit that is taken, the median step has one of these lengths, s: 10 kHz to 5 Hz.
const PLAUSIBLE_PERIOD_S: [f64; 2] = [1e-4, 0.2];
/// In the unit that is taken, the joints are rarely faster than this, rad/s: not in one of `1 / RARE` steps.
const FASTEST: f64 = 4.0;
const RARE: usize = 100;
/// Fewer steps than these do not decide the unit.
const FEWEST_STEPS: usize = 10;
/// Positions are degrees, if in half of the samples one is beyond two turns, rad.
const LARGEST_RAD: f64 = 2.0 * TAU;

/// What samples show of their clock.
#[derive(Debug, Clone, Default)]
pub struct ClockEvidence {
    /// Time steps that are above 0, and the speed of the fastest joint in each.
    steps: Vec<f64>,
    speeds: Vec<f64>,
    /// The largest position of each sample.
    largest: Vec<f64>,
    /// Lowest and highest position of each joint.
    ranges: Vec<[f64; 2]>,
    before: Option<(f64, Vec<f64>)>,
}

/// A clock that is probably not in s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OddClock {
    /// Median time step, if times are s.
    pub period_s: f64,
    /// Whether the arm moves, but hardly, if times are s.
    pub crawls: bool,
    steps: usize,
    /// Speed that joints rarely exceed, rad/s.
    speed: f64,
    /// Whether the arm moves.
    moves: bool,
}

impl OddClock {
    /// The smaller unit in which rate and speeds are plausible, if there is one. The times that counted as s have
    /// `guess_per_s` ticks per second, if the size of the first one is right about it.
    pub fn unit(&self, guess_per_s: f64) -> Option<TimeUnit> {
        let [least, most] = PLAUSIBLE_PERIOD_S;
        let faster = |unit: TimeUnit| unit.per_s() / guess_per_s;
        let is_plausible = |unit: &TimeUnit| {
            let faster = faster(*unit);
            let period_s = self.period_s / faster;
            faster > 1.0 && (least..=most).contains(&period_s) && self.speed * faster <= FASTEST
        };
        let units = [TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns];
        let mut plausible = units.into_iter().filter(is_plausible);
        let first = plausible.next().filter(|_| self.steps >= FEWEST_STEPS)?;
        // 5 to 10 Hz in one unit is 5 to 10 kHz in the next.
        let still_crawls = self.moves && self.speed * faster(first) < SLOW_SPEED;
        plausible.next().filter(|_| still_crawls).or(Some(first))
    }
}

impl ClockEvidence {
    /// A touch starts: the time since the sample before it is no step.
    pub fn touch_starts(&mut self) {
        self.before = None;
    }

    /// Takes the next sample, whose positions have this unit; its time counts as s.
    pub fn add(&mut self, sample: &Sample, unit: AngleUnit) {
        let mut q_now = sample.q.clone();
        unit.into_rad(&mut q_now);
        self.largest.push(q_now.iter().fold(0.0, |largest, q| q.abs().max(largest)));
        if self.ranges.is_empty() {
            self.ranges = q_now.iter().map(|q| [*q, *q]).collect();
        }
        for ([low, high], q) in self.ranges.iter_mut().zip(&q_now) {
            (*low, *high) = (low.min(*q), high.max(*q));
        }
        let Some(now_s) = sample.time_s else {
            self.before = None;
            return;
        };
        if let Some((before_s, q)) = &self.before
            && now_s > *before_s
        {
            let ways = q.iter().zip(&q_now).map(|(a, b)| (b - a).abs());
            self.steps.push(now_s - before_s);
            self.speeds.push(ways.fold(0.0, f64::max) / (now_s - before_s));
        }
        self.before = Some((now_s, q_now));
    }

    /// What is odd about the clock, if times are s; `None` if nothing is.
    pub fn odd(&self) -> Option<OddClock> {
        let period_s = ranked(&self.steps, 2)?;
        // Degrees, if the unit of angles is not known yet.
        let in_degrees = ranked(&self.largest, 2)? > LARGEST_RAD;
        let angle = if in_degrees { 1_f64.to_radians() } else { 1.0 };
        let way = self.ranges.iter().map(|[low, high]| angle * (high - low)).fold(0.0, f64::max);
        let moves = self.largest.len() >= MOVES_FRAMES && way > MOVES;
        // A turn of a sensor from 360° to 0° is a rare step.
        let speed = angle * ranked(&self.speeds, RARE)?;
        let crawls = period_s >= SLOW_PERIOD_S && moves && speed < SLOW_SPEED;
        let [least, most] = BELIEVABLE_PERIOD_S;
        if !crawls && (least..=most).contains(&period_s) {
            return None;
        }
        Some(OddClock { period_s, crawls, steps: self.steps.len(), speed, moves })
    }
}

/// The number that one in `share` of the numbers exceeds, the upper median for 2; `None` if there are none.
fn ranked(numbers: &[f64], share: usize) -> Option<f64> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len().saturating_sub(1 + sorted.len() / share.max(1))).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is odd about 300 samples, each `step` after the one before, in which a joint swings by `way` at `speed` per
    /// unit of time.
    fn odd_for(step: f64, speed: f64, way: f64) -> Option<OddClock> {
        let mut evidence = ClockEvidence::default();
        for row in 0..300 {
            let time = f64::from(row) * step;
            let q = ((speed * time) % (2.0 * way) - way).abs();
            evidence.add(&Sample::new(Some(time), vec![q], vec![0.0]), AngleUnit::Rad);
        }
        evidence.odd()
    }

    fn odd(step: f64, speed: f64) -> Option<OddClock> {
        odd_for(step, speed, 1.0)
    }

    #[test]
    fn rate_and_speed_decide_the_unit() {
        let unit = |step, speed| odd(step, speed).map(|odd| odd.unit(1.0));
        for (step, speed) in [(0.001, 1.0), (0.1, 0.1), (2.0, 0.5), (1.0, 0.03)] {
            assert_eq!(unit(step, speed), None, "{step} s is a step of a robot's log");
        }
        assert_eq!(unit(1.0, 1e-3), Some(Some(TimeUnit::Ms)), "1 kHz");
        assert_eq!(unit(125.0, 1e-3), Some(Some(TimeUnit::Ms)), "8 Hz");
        assert_eq!(unit(125.0, 3e-6), Some(Some(TimeUnit::Us)), "8 kHz");
        assert_eq!(unit(2e3, 0.0), Some(Some(TimeUnit::Us)), "500 Hz, at rest");
        assert_eq!(unit(1e6, 1e-9), Some(Some(TimeUnit::Ns)));
        let in_degrees = odd_for(1.0, 0.1, 57.0).and_then(|odd| odd.unit(1.0));
        assert_eq!(in_degrees, Some(TimeUnit::Ms), "100 degrees per s");
        assert_eq!(unit(5e-6, 1.0), Some(None), "larger units than s are left");
        assert_eq!(unit(10.0, 0.05), Some(None), "50 rad/s in ms");
        let mut turns = ClockEvidence::default();
        for row in 0..300 {
            let (time, whole) = (f64::from(row), if row < 150 { 0.0 } else { TAU });
            turns.add(
                &Sample::new(Some(time), vec![1e-3 * time + whole], vec![0.0]),
                AngleUnit::Rad,
            );
        }
        assert_eq!(turns.odd().and_then(|odd| odd.unit(1.0)), Some(TimeUnit::Ms), "a whole turn");
        assert_eq!(odd(0.0, 0.0), None, "a clock that stands still has another warning");
        // Nanoseconds after half an hour look like milliseconds since 1970.
        assert_eq!(odd(5e3, 1e-6).unwrap().unit(1e3), Some(TimeUnit::Ns));
    }
}
