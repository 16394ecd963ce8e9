//! Predicting the torque of a path: how long it takes, and what fewer springs cost in accuracy.
//!
//! A mapper that has learnt all passes predicts the torques of touches: of each whole touch, and of
//! its push alone, each resampled to [`POINTS`] points. Coarse answers, as `palpate live` gives
//! them, are compared with exact ones: at every point, with every spring of the same field. The
//! error of the field itself is measured by `palpate evaluate`.

use std::ops::Range;
use std::time::Instant;

use nalgebra::DVector;
use palpate::{CLUSTER_WEIGHT, Mapper, PathConfig, PathError, PathPoint, PathPrediction, Robot};
use palpate_learn::torque_errors::RELATIVE_FROM_N_M;
use palpate_work::Progress;
use palpate_work::quantile::{extremes, median};
use palpate_work::touches::RecordedTouch;
use serde::{Serialize, Serializer};

use super::recording::{cut_short, milliseconds};
use crate::error::CliError;
use crate::output::Output;

/// Number of points of a path.
const POINTS: usize = 200;
/// Number of coarse answers about each path.
const TIMES: usize = 9;

/// Times and errors of the answers about the paths of some touches.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Answers {
    points: usize,
    times: usize,
    /// Time for which a question blocks the mapper, ms: the medians of the whole touches.
    handover_ms: Option<Extent>,
    whole: Asked,
    /// From the last point without contact to the largest torque.
    push: Asked,
}

/// Times and errors for paths of one kind, one number for each path; each list is written as its
/// [`Extent`], an empty one as `null`.
#[derive(Debug, Clone, Default, Serialize)]
struct Asked {
    /// Number of paths with contact.
    paths: usize,
    #[serde(skip)]
    handover_ms: Vec<f64>,
    /// Median time of a coarse answer, including the copy that it needs of the mapper, ms.
    #[serde(serialize_with = "extent")]
    coarse_ms: Vec<f64>,
    /// Time of the exact answer, which is computed once, ms.
    #[serde(serialize_with = "extent")]
    exact_ms: Vec<f64>,
    /// Relative error of a coarse answer: mean over the points of the path with a torque of at
    /// least [`RELATIVE_FROM_N_M`].
    #[serde(serialize_with = "extent")]
    torque_off: Vec<f64>,
    /// The same for [`PathPoint::torque_std`].
    #[serde(serialize_with = "extent")]
    std_off: Vec<f64>,
    /// The same for [`PathPoint::torque_rss`], on which bands depend.
    #[serde(serialize_with = "extent")]
    rss_off: Vec<f64>,
}

fn extent<S: Serializer>(numbers: &[f64], serializer: S) -> Result<S::Ok, S::Error> {
    Extent::of(numbers).serialize(serializer)
}

/// Median, smallest and largest value over paths.
#[derive(Debug, Clone, Copy, Serialize)]
struct Extent {
    median: f64,
    least: f64,
    most: f64,
}

/// Measures the answers about every touch.
pub(super) fn measure(
    mapper: &Mapper,
    asked: &[RecordedTouch],
    output: &Output,
) -> Result<Answers, CliError> {
    let robot = &mapper.arm().robot;
    let bar = output.begin(Some(asked.len() as u64), "paths", "predicting");
    let (mut whole, mut push) = (Asked::default(), Asked::default());
    for touch in asked.iter().filter(|touch| !touch.samples.is_empty()) {
        bar.at(&touch.name);
        let fault = |error: PathError| {
            CliError::from(format!(
                "torques along touch `{}` cannot be predicted: {error}",
                touch.name
            ))
        };
        let path: Vec<&[f64]> = touch.samples.iter().map(|sample| &sample.q[..]).collect();
        let path = resampled(robot, &path);
        let pushed = push_of(&whole.ask(mapper, &path).map_err(fault)?);
        if pushed.len() > 1 {
            let path: Vec<&[f64]> = path[pushed].iter().map(Vec::as_slice).collect();
            push.ask(mapper, &resampled(robot, &path)).map_err(fault)?;
        }
        bar.step();
        if output.stopped() {
            return Err(cut_short());
        }
    }
    let handover_ms = Extent::of(&whole.handover_ms);
    Ok(Answers { points: POINTS, times: TIMES, handover_ms, whole, push })
}

/// A path resampled to [`POINTS`] points at equal intervals, with linear interpolation of the
/// joints.
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

/// The points of a path from the last one without contact to the largest torque; what is in contact
/// at the first point of a path counts as empty space.
fn push_of(answer: &PathPrediction) -> Range<usize> {
    let Some(touches) = answer.points.iter().position(|point| point.contacts > 0) else {
        return 0..0;
    };
    let norms = answer.points.iter().map(|point| point.torque.norm()).enumerate();
    let largest = norms.max_by(|a, b| a.1.total_cmp(&b.1));
    touches.saturating_sub(1)..largest.map_or(0, |(point, _)| point + 1)
}

impl Asked {
    /// Measures the answers about one path, and returns the exact one.
    fn ask(&mut self, mapper: &Mapper, path: &[Vec<f64>]) -> Result<PathPrediction, PathError> {
        let config = PathConfig::default();
        let start = Instant::now();
        let every_point = PathConfig::new(0.0, config.start_cells);
        let exact = mapper.path_predictor().ask(path, &every_point)?;
        let exact_ms = milliseconds(start.elapsed());
        if exact.points.iter().all(|point| point.contacts == 0) {
            return Ok(exact);
        }
        self.paths += 1;
        self.exact_ms.push(exact_ms);
        let (mut handover_ms, mut coarse_ms, mut answers) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..TIMES {
            let start = Instant::now();
            let predictor = mapper.coarse_path_predictor(CLUSTER_WEIGHT);
            handover_ms.push(milliseconds(start.elapsed()));
            answers.push(predictor.ask(path, &config)?); // all are equal
            coarse_ms.push(milliseconds(start.elapsed()));
        }
        self.handover_ms.extend(median(&handover_ms));
        self.coarse_ms.extend(median(&coarse_ms));
        self.torque_off.extend(off_by(&answers[0], &exact, |point| &point.torque));
        self.std_off.extend(off_by(&answers[0], &exact, |point| &point.torque_std));
        self.rss_off.extend(off_by(&answers[0], &exact, |point| &point.torque_rss));
        Ok(exact)
    }
}

/// Mean relative error of a coarse answer over the points whose exact torque is at least
/// [`RELATIVE_FROM_N_M`]; `None` if there is no such point.
fn off_by(
    coarse: &PathPrediction,
    exact: &PathPrediction,
    of: fn(&PathPoint) -> &DVector<f64>,
) -> Option<f64> {
    let points = coarse.points.iter().zip(&exact.points);
    let large = points.filter(|(_, exact)| exact.torque.norm() >= RELATIVE_FROM_N_M);
    let off: Vec<f64> =
        large.map(|(coarse, exact)| (of(coarse) - of(exact)).norm() / of(exact).norm()).collect();
    (!off.is_empty()).then(|| off.iter().sum::<f64>() / off.len() as f64)
}

impl Extent {
    /// The extent of some numbers, if there are any.
    fn of(numbers: &[f64]) -> Option<Self> {
        let [least, most] = extremes(numbers.iter().copied())?;
        Some(Self { median: median(numbers)?, least, most })
    }

    /// The median and the range as text, with numbers multiplied by `factor`.
    fn text(self, factor: f64, digits: usize, unit: &str) -> String {
        let [median, least, most] = [self.median, self.least, self.most].map(|n| n * factor);
        format!("{median:.digits$} {unit} ({least:.digits$} to {most:.digits$})")
    }
}

impl Answers {
    /// Rows of a table: what, and how much; only those that have values.
    pub(super) fn rows(&self) -> Vec<(String, String)> {
        let mut rows = Vec::new();
        let mut row = |name: String, extent: Option<Extent>, (factor, digits, unit)| {
            rows.extend(extent.map(|extent| (name, extent.text(factor, digits, unit))));
        };
        row("copying the springs".to_owned(), self.handover_ms, (1.0, 2, "ms"));
        for (kind, asked) in [("a whole touch", &self.whole), ("a push", &self.push)] {
            row(format!("prediction of {kind}"), Extent::of(&asked.coarse_ms), (1.0, 1, "ms"));
            row(format!("exact prediction of {kind}"), Extent::of(&asked.exact_ms), (1.0, 0, "ms"));
            row("  error of the torque".to_owned(), Extent::of(&asked.torque_off), (100.0, 1, "%"));
            row("  error of its std".to_owned(), Extent::of(&asked.std_off), (100.0, 0, "%"));
            row(
                "  error of its band's spread".to_owned(),
                Extent::of(&asked.rss_off),
                (100.0, 0, "%"),
            );
        }
        rows
    }

    /// What was measured, and how.
    pub(super) fn heading(&self) -> String {
        format!(
            "Predictions along paths of {} points: {} whole touches with contact, and their {} \
             pushes,\n{} times each, with copying the springs; exact ones once. Median over paths, \
             and in brackets the\nsmallest and the largest; errors are relative to the exact \
             prediction, where its torque is at least {RELATIVE_FROM_N_M} N·m.",
            self.points, self.whole.paths, self.push.paths, self.times
        )
    }
}
