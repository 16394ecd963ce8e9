//! What torque a path would meet: how long an answer takes, and what thinning costs it.
//!
//! Asked is about touches, as a whole and about the push alone, each resampled to [`POINTS`]
//! points, by a mapper that has learnt all passes. Thinned answers, as `palpate live` gives them,
//! are compared with that at every point with every spring of the same field: what the field
//! itself gets wrong is for `palpate evaluate` to say.

use std::time::Instant;

use nalgebra::DVector;
use palpate::mapper::Mapper;
use palpate::outlook::{Answer, Config, ONE_IN, PathPoint};
use palpate::robot::Robot;
use serde::{Deserialize, Serialize};

use super::recording::Recording;
use super::whole::milliseconds;
use crate::error::CliError;
use crate::interrupt;
use crate::output::Output;
use crate::quantile::{extremes, median};

/// Points of a path.
const POINTS: usize = 200;
/// Thinned answers about each path.
const TIMES: usize = 9;
/// A torque whose relative error says something, N·m over all joints.
const FELT_N_M: f64 = 1.0;

/// What was found of the paths of some touches.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Answers {
    pub points: usize,
    pub times: usize,
    /// What keeps the mapper busy with a question: handing out its springs, ms.
    pub outlook_ms: Extent,
    pub whole: Asked,
    /// From the first contact to the largest torque.
    pub push: Asked,
}

/// What was found of paths of one kind.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Asked {
    /// Paths: touches that meet anything.
    pub paths: usize,
    /// The thinned answer, ms; of each path the median counts.
    pub thinned_ms: Extent,
    /// The answer at every point with every spring, ms.
    pub exact_ms: Extent,
    /// What a thinned answer is off by in the mean over a path where that has at least
    /// [`FELT_N_M`], relative.
    pub torque_off: Extent,
    pub std_off: Extent,
}

/// The median over paths, the least and the most.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct Extent {
    pub median: f64,
    pub least: f64,
    pub most: f64,
}

/// What was found of single paths, path by path.
#[derive(Debug, Default)]
struct Found {
    thinned_ms: Vec<f64>,
    exact_ms: Vec<f64>,
    torque_off: Vec<f64>,
    std_off: Vec<f64>,
}

/// Asks about every touch.
pub(super) fn measure(
    mapper: &Mapper,
    asked: &Recording,
    output: &Output,
) -> Result<Answers, CliError> {
    let robot = &mapper.arm().robot;
    let bar = output.progress_of(Some(asked.touches() as u64), "paths", "asking");
    let (mut outlook_ms, mut whole, mut push) = (Vec::new(), Found::default(), Found::default());
    for touch in asked.each() {
        bar.set_message(touch.name.clone());
        if touch.samples.is_empty() {
            continue;
        }
        let path: Vec<&[f64]> = touch.samples.iter().map(|sample| &sample.q[..]).collect();
        let fault = |error: &dyn std::fmt::Display| {
            CliError::from(format!("touch `{}` cannot be asked about: {error}", touch.name))
        };
        let path = resampled(robot, &path);
        let answer = whole.ask(mapper, &path, &mut outlook_ms).map_err(|error| fault(&error))?;
        let pushed = push_of(&answer);
        if pushed.len() > 1 {
            let path: Vec<&[f64]> = path[pushed].iter().map(Vec::as_slice).collect();
            let path = resampled(robot, &path);
            push.ask(mapper, &path, &mut outlook_ms).map_err(|error| fault(&error))?;
        }
        bar.inc(1);
        if interrupt::pressed() {
            bar.finish_and_clear();
            let kept = "; a measurement cut short says nothing".to_owned();
            return Err(CliError::Interrupted { kept });
        }
    }
    bar.finish_and_clear();
    let outlook_ms = Extent::of(&outlook_ms);
    Ok(Answers {
        points: POINTS,
        times: TIMES,
        outlook_ms,
        whole: whole.asked(),
        push: push.asked(),
    })
}

/// A path in [`POINTS`] points, equal times apart; joints go straight in between.
fn resampled(robot: &Robot, path: &[&[f64]]) -> Vec<Vec<f64>> {
    let last = path.len().saturating_sub(1) as f64;
    let point = |point: usize| {
        let at = point as f64 / (POINTS - 1) as f64 * last;
        let (from, part) = (at.floor(), at.fract());
        let to = (from + 1.0).min(last);
        robot.interpolate(path[from as usize], path[to as usize], part)
    };
    (0..POINTS).map(point).collect()
}

/// The points of a path from the first contact to the largest torque.
fn push_of(answer: &Answer) -> std::ops::Range<usize> {
    let norms = answer.points.iter().map(|point| point.torque.norm());
    let largest = norms.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
    let first = answer.points.iter().position(|point| point.contacts > 0);
    first.unwrap_or(0)..largest.map_or(0, |(point, _)| point + 1)
}

impl Found {
    /// Asks about one path, and returns the exact answer.
    fn ask(
        &mut self,
        mapper: &Mapper,
        path: &[Vec<f64>],
        outlook_ms: &mut Vec<f64>,
    ) -> Result<Answer, palpate::outlook::PathError> {
        let config = Config::default();
        let (mut took_ms, mut thinned) = (Vec::new(), None);
        for _ in 0..TIMES {
            let start = Instant::now();
            let outlook = mapper.thinned_outlook(ONE_IN);
            outlook_ms.push(milliseconds(start.elapsed()));
            thinned = Some(outlook.ask(path, &config)?);
            took_ms.push(milliseconds(start.elapsed()));
        }
        let start = Instant::now();
        let every_point = Config { resolution_cells: 0.0, ..config };
        let exact = mapper.outlook().ask(path, &every_point)?;
        let exact_ms = milliseconds(start.elapsed());
        let off = |of| thinned.as_ref().and_then(|thinned| off_by(thinned, &exact, of));
        if let (Some(torque_off), Some(std_off)) =
            (off(|point| &point.torque), off(|point| &point.torque_std))
        {
            self.thinned_ms.extend(median(&took_ms));
            self.exact_ms.push(exact_ms);
            self.torque_off.push(torque_off);
            self.std_off.push(std_off);
        }
        Ok(exact)
    }

    fn asked(&self) -> Asked {
        Asked {
            paths: self.thinned_ms.len(),
            thinned_ms: Extent::of(&self.thinned_ms),
            exact_ms: Extent::of(&self.exact_ms),
            torque_off: Extent::of(&self.torque_off),
            std_off: Extent::of(&self.std_off),
        }
    }
}

/// What a thinned answer is off by, relative, in the mean over the points where the exact torque is
/// worth it; `None` where it nowhere is.
fn off_by(thinned: &Answer, exact: &Answer, of: fn(&PathPoint) -> &DVector<f64>) -> Option<f64> {
    let points = thinned.points.iter().zip(&exact.points);
    let felt = points.filter(|(_, exact)| exact.torque.norm() >= FELT_N_M);
    let off: Vec<f64> =
        felt.map(|(thinned, exact)| (of(thinned) - of(exact)).norm() / of(exact).norm()).collect();
    (!off.is_empty()).then(|| off.iter().sum::<f64>() / off.len() as f64)
}

impl Extent {
    /// Of some paths; all zeros if there are none.
    fn of(numbers: &[f64]) -> Self {
        let [least, most] = extremes(numbers.iter().copied()).unwrap_or_default();
        Self { median: median(numbers).unwrap_or_default(), least, most }
    }

    /// The median and what lies about it, in some unit.
    fn text(&self, factor: f64, digits: usize, unit: &str) -> String {
        let [median, least, most] = [self.median, self.least, self.most].map(|n| n * factor);
        format!("{median:.digits$} {unit} ({least:.digits$} to {most:.digits$})")
    }
}

impl Answers {
    /// Rows of a table: what, and how much.
    pub(super) fn rows(&self) -> Vec<(String, String)> {
        let mut rows =
            vec![("handing out the springs".to_owned(), self.outlook_ms.text(1.0, 2, "ms"))];
        for (kind, asked) in [("a whole touch", &self.whole), ("a push", &self.push)] {
            let of = |what: &str| format!("{what} about {kind}");
            rows.extend([
                (of("answer"), asked.thinned_ms.text(1.0, 1, "ms")),
                (of("exact answer"), asked.exact_ms.text(1.0, 0, "ms")),
                ("  torque off from that by".to_owned(), asked.torque_off.text(100.0, 1, "%")),
                ("  its std off by".to_owned(), asked.std_off.text(100.0, 0, "%")),
            ]);
        }
        rows
    }

    /// What was asked, and how.
    pub(super) fn heading(&self) -> String {
        format!(
            "Answers about paths of {} points, {} about each of {} touches and {} pushes, on all \
             threads:\nmedians over paths, the least and the most.",
            self.points, self.times, self.whole.paths, self.push.paths
        )
    }
}
