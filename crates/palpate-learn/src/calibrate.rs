//! Calibration of prediction bands ([`palpate::Calibration`]) on held-out touches, or, with too few of them, bands of
//! other objects.
//!
//! Each training touch is predicted after learning the others, with the same settings except for fewer replays. The
//! half-width is the root of a sum that is linear in the predicted torque and its spread. Its coefficients minimise the
//! check loss of the 0.9 quantile (quantile regression, Koenker and Bassett 1978). The factors of the levels are
//! quantiles of the held-out errors divided by these roots, with the same weight for each touch (conformal prediction
//! with frames grouped by touch, Dunn, Wasserman and Ramdas 2022); those of largest torques are plain quantiles.

use nalgebra::DVector;
use palpate::unstable::{CellState, Estimator, spring_variance};
use palpate::{BandQuantiles, Calibration, LearntTorques, MapperConfig};
use rayon::prelude::*;

use crate::error::{LearnError, Stop};
use crate::folds::{FEWEST, inner_folds};
use crate::method;
use crate::study::for_thinned;
use crate::tracked::{TrackedFrame, TrackedTouches};

/// The level of tables. If there are too few touches for it, the bands of other objects are used.
pub(crate) const LEVEL: f64 = 0.9;
/// Levels of the calibration, as far as there are enough touches for them.
const LEVELS: [f64; 9] = [0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99];
/// The level for which the coefficients of the half-width are fitted.
const SHAPE: f64 = 0.9;
/// Most replays after each frame.
const REPLAYS: u32 = 3;
/// The error on learnt frames is taken from every N-th of them.
const LEARNT_EVERY: usize = 10;
/// Most frames of a touch that are predicted.
const FRAMES: usize = 400;
/// Exponent g of the bands: of 1, 0.8, ⅔ and ½ the one with the narrowest bands on five simulated objects.
const EXPONENT: f64 = 0.5;
/// ρ of the bands: of 0, 1, 2, 3, 5, 10 and 30 the one with the narrowest bands on four simulated objects. Values from
/// 5 on are equally good.
const RELATIVE_STD: f64 = 10.0;
/// Steps of the quantile regression, and sweeps over the coefficients in each.
const STEPS: usize = 40;
const SWEEPS: usize = 30;
/// Torques and spreads below this are almost zero, N·m.
const ALMOST_ZERO: f64 = 1e-3;

/// Predicted and measured torques of a frame, n_joints each, N·m.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedFrame {
    /// Predicted torque τ̂.
    pub torque: Vec<f64>,
    /// Spread s of [`Calibration::half_width`].
    pub spread: Vec<f64>,
    /// Measured external torque τ_ext.
    pub measured: Vec<f64>,
    /// Number of contacts, and of contacts whose cells are known.
    pub contacts: [usize; 2],
}

impl PredictedFrame {
    /// Predicts a frame. `cells` are by row; `of_row` gives the [variance](Calibration::spring_variance) of a row and
    /// whether it is known.
    pub(crate) fn of(
        frame: &TrackedFrame,
        cells: &[CellState],
        of_row: impl Fn(usize) -> (f64, bool),
    ) -> Self {
        let observation = &frame.observation;
        let spread = observation.torque_std(cells, |row| of_row(row).0);
        let known = observation.rows().filter(|&row| of_row(row).1).count();
        Self {
            torque: frame.predict(cells),
            spread: spread.as_slice().to_vec(),
            measured: observation.tau().as_slice().to_vec(),
            contacts: [observation.n_contacts(), known],
        }
    }

    /// [`Calibration::scale`] of this frame, n_joints, N·m.
    pub(crate) fn scale(&self, calibration: &Calibration) -> DVector<f64> {
        calibration.scale(&self.torque, &self.spread, self.contacts)
    }

    /// |τ_ext − τ̂| by joint.
    pub(crate) fn errors(&self) -> impl Iterator<Item = f64> {
        self.torque.iter().zip(&self.measured).map(|(torque, measured)| (measured - torque).abs())
    }
}

/// Learns touches: [`learn_springs`] or [`crate::elastic::learn_with_body`].
pub(crate) type Learn = for<'a> fn(
    &'a TrackedTouches,
    &[usize],
    &MapperConfig,
    Stop<'_>,
) -> Result<FramePredictor<'a>, LearnError>;

/// The calibration on training touches; `None` with fewer than three. With fewer than nine, the bands are those of
/// other objects, and only the misfits come from these touches.
///
/// Learns from all frames, since the standard deviations depend on their number, but with few replays, since these take
/// most of the time. `step` is called after each of the [`inner_folds`].
///
/// # Errors
///
/// If a setting is out of its range, or a frame cannot be used; or on being stopped.
pub(crate) fn calibrate(
    learn: Learn,
    tracked: &TrackedTouches,
    train: &[usize],
    config: &MapperConfig,
    (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
) -> Result<Option<Calibration>, LearnError> {
    let folds = inner_folds(train);
    if folds.is_empty() {
        return Ok(None);
    }
    let mut config = for_thinned(config, tracked.thinning);
    config.estimator.replays = config.estimator.replays.min(REPLAYS);
    let held_out: Vec<Vec<Vec<PredictedFrame>>> = folds
        .par_iter()
        .map(|fold| {
            let predicted = learn(tracked, &fold.train, &config, stop)?;
            step();
            Ok(fold.test.iter().map(|touch| predicted.touch(*touch)).collect())
        })
        .collect::<Result<_, LearnError>>()?;
    let held_out: Vec<Vec<PredictedFrame>> = held_out.into_iter().flatten().collect();
    let untouched_std = config.estimator(tracked.n_joints)?.std(usize::MAX);
    let own = of_held_out(&held_out, tracked.n_joints, untouched_std);
    if own.as_ref().is_some_and(|own| own.highest_level() < LEVEL) {
        let others = of_other_objects(&learn(tracked, train, &config, stop)?, train);
        let with_misfits = |mut others: Calibration| {
            let touches = held_out.iter().filter(|touch| !touch.is_empty());
            others.misfits = touches.filter_map(|touch| misfit(&others, touch)).collect();
            others
        };
        return Ok(others.map(with_misfits).or(own));
    }
    Ok(own)
}

/// [`Calibration::of_other_objects`] after learning the touches `train`; `None` if these touch nothing.
pub(crate) fn of_other_objects(
    predicted: &FramePredictor<'_>,
    train: &[usize],
) -> Option<Calibration> {
    let touched = || {
        let in_contact = |&touch: &usize| {
            let frames = &predicted.tracked.touches[touch].frames;
            let touched = move |at: &usize| frames[*at].observation.n_contacts() > 0;
            (0..frames.len()).filter(touched).map(move |at| (touch, at))
        };
        train.iter().map(in_contact).filter(|frames| frames.clone().next().is_some())
    };
    let sample = |(touch, at): (usize, usize)| {
        let frame = predicted.frame(touch, at);
        [frame.errors().collect(), frame.measured]
    };
    let samples = touched().flat_map(|frames| frames.step_by(LEARNT_EVERY)).map(sample);
    let (learnt, touches) = (LearntTorques::of(samples)?, touched().count() as u32);
    Calibration::of_other_objects(&learnt, touches, predicted.untouched_std_n_per_m)
}

/// What was learnt from touches, for predictions of frames: the springs, and the torque of an elastic body.
pub(crate) struct FramePredictor<'a> {
    tracked: &'a TrackedTouches,
    cells: Vec<CellState>,
    /// By row, the spring variance for the spread, (N/m)², and whether the cell was touched.
    of_rows: Vec<(f64, bool)>,
    untouched_std_n_per_m: f64,
    of_body: Option<BodyTorque<'a>>,
}

/// The torque of an elastic body by touch and frame, n_joints, N·m.
type BodyTorque<'a> = Box<dyn Fn(usize, usize) -> DVector<f64> + 'a>;

/// Learns touches as springs alone.
pub(crate) fn learn_springs<'a>(
    tracked: &'a TrackedTouches,
    touches: &[usize],
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<FramePredictor<'a>, LearnError> {
    let estimator = method::learn(tracked, touches, config, &[], stop)?;
    Ok(FramePredictor::by(tracked, &*estimator, |row| estimator.stiffness(row)))
}

impl<'a> FramePredictor<'a> {
    /// With the standard deviations of an estimator, and a stiffness by row, N/m.
    pub(crate) fn by(
        tracked: &'a TrackedTouches,
        estimator: &dyn Estimator,
        stiffness: impl Fn(usize) -> f64,
    ) -> Self {
        let of_row = |row| {
            let variance =
                spring_variance(RELATIVE_STD, stiffness(row), estimator.std(row).powi(2));
            (variance, estimator.count(row) > 0)
        };
        Self {
            tracked,
            cells: tracked.with_stiffness(&stiffness),
            of_rows: (0..tracked.cells.len()).map(of_row).collect(),
            untouched_std_n_per_m: estimator.std(usize::MAX),
            of_body: None,
        }
    }

    /// Adds the torque of an elastic body.
    pub(crate) fn with_body(self, of_body: impl Fn(usize, usize) -> DVector<f64> + 'a) -> Self {
        Self { of_body: Some(Box::new(of_body)), ..self }
    }

    /// Predicts a frame of a touch.
    pub(crate) fn frame(&self, touch: usize, at: usize) -> PredictedFrame {
        let frame = &self.tracked.touches[touch].frames[at];
        let mut predicted = PredictedFrame::of(frame, &self.cells, |row| self.of_rows[row]);
        if let Some(of_body) = &self.of_body {
            let of_body = of_body(touch, at);
            predicted.torque.iter_mut().zip(&of_body).for_each(|(torque, body)| *torque += body);
        }
        predicted
    }

    /// Predicts all frames of a touch.
    pub(crate) fn frames(&self, touch: usize) -> impl Iterator<Item = PredictedFrame> {
        (0..self.tracked.touches[touch].frames.len()).map(move |at| self.frame(touch, at))
    }

    /// Predicts at most [`FRAMES`] frames of a touch, evenly chosen.
    fn touch(&self, touch: usize) -> Vec<PredictedFrame> {
        let frames = self.tracked.touches[touch].frames.len();
        let every = frames.div_ceil(FRAMES).max(1);
        (0..frames).step_by(every).map(|at| self.frame(touch, at)).collect()
    }
}

fn of_held_out(
    held_out: &[Vec<PredictedFrame>],
    n_joints: usize,
    untouched_std_n_per_m: f64,
) -> Option<Calibration> {
    let touches: Vec<&[PredictedFrame]> =
        held_out.iter().map(Vec::as_slice).filter(|touch| !touch.is_empty()).collect();
    if touches.len() < FEWEST {
        return None;
    }
    let mut calibration = Calibration {
        floor_n_m: vec![0.0; n_joints],
        by_torque: 0.0,
        by_std: 0.0,
        relative_std: RELATIVE_STD,
        by_unknown_n_m: Vec::new(),
        exponent: EXPONENT,
        untouched_std_n_per_m,
        touches: touches.len() as u32,
        of_other_objects: false,
        quantiles: Vec::new(),
        misfits: Vec::new(),
    };
    fit_shape(&touches, &mut calibration);
    let highest = touches.len() as f64 / (touches.len() as f64 + 1.0);
    let levels: Vec<f64> = LEVELS.into_iter().filter(|level| *level <= highest).collect();
    calibration.quantiles = quantiles(&touches, &calibration, &levels);
    calibration.misfits = touches.iter().filter_map(|touch| misfit(&calibration, touch)).collect();
    calibration.check(n_joints).is_ok().then_some(calibration)
}

/// A row of the quantile regression: one joint in one frame.
struct Row {
    joint: usize,
    /// |τ̂|, N·m.
    torque: f64,
    /// Spread s, N·m.
    spread: f64,
    /// |τ_ext − τ̂|, N·m.
    error: f64,
    /// Sums to the same total for each touch.
    weight: f64,
}

fn rows(touches: &[&[PredictedFrame]]) -> Vec<Row> {
    let mut rows = Vec::new();
    for touch in touches {
        let weight = 1.0 / touch.len() as f64;
        for frame in *touch {
            rows.extend(frame.errors().enumerate().map(|(joint, error)| {
                let (torque, spread) = (frame.torque[joint].abs(), frame.spread[joint]);
                Row { joint, torque, spread, error, weight }
            }));
        }
    }
    rows
}

/// Fits the coefficients of the half-width, none below zero, which minimise the check loss at [`SHAPE`]. Uses
/// majorisation (Hunter and Lange 2000), a weighted least squares in each step.
fn fit_shape(touches: &[&[PredictedFrame]], calibration: &mut Calibration) {
    let rows = rows(touches);
    let n = calibration.floor_n_m.len();
    let total: f64 = rows.iter().map(|row| row.weight).sum();
    let mean = rows.iter().map(|row| row.error * row.weight).sum::<f64>() / total;
    // Regressors are divided by their largest value, so that all coefficients are of similar size. One that is always
    // almost zero is left out: its coefficient could be any number.
    let largest = |of: fn(&Row) -> f64| rows.iter().map(of).fold(0.0, f64::max);
    let largest = [largest(|row| row.torque), largest(|row| row.spread)];
    let scales = largest.map(|largest| if largest < ALMOST_ZERO { f64::INFINITY } else { largest });
    let mut found = vec![mean; n + 2];
    let smallest = 1e-3 * mean + 1e-9;
    for _ in 0..STEPS {
        let mut gram = vec![vec![0.0; n + 2]; n + 2];
        let mut right = vec![0.0; n + 2];
        for &Row { joint, torque, spread, error, weight } in &rows {
            let own = [(joint, 1.0), (n, torque / scales[0]), (n + 1, spread / scales[1])];
            let width: f64 = own.iter().map(|(k, factor)| found[*k] * factor).sum();
            let pull = weight / (smallest + (error - width).abs());
            for (a, by_a) in own {
                right[a] += by_a * (pull * error + (2.0 * SHAPE - 1.0) * weight);
                for (b, by_b) in own {
                    gram[a][b] += pull * by_a * by_b;
                }
            }
        }
        for _ in 0..SWEEPS {
            for k in 0..n + 2 {
                let all: f64 = gram[k].iter().zip(&found).map(|(entry, own)| entry * own).sum();
                if gram[k][k] > 0.0 {
                    found[k] = (found[k] + (right[k] - all) / gram[k][k]).max(0.0);
                }
            }
        }
    }
    // The constant term stays above zero for every joint.
    calibration.floor_n_m =
        found[..n].iter().map(|floor| floor.max(1e-3 * mean).max(1e-9)).collect();
    (calibration.by_torque, calibration.by_std) = (found[n] / scales[0], found[n + 1] / scales[1]);
}

/// The quantiles of held-out errors over half-widths.
fn quantiles(
    touches: &[&[PredictedFrame]],
    calibration: &Calibration,
    levels: &[f64],
) -> Vec<BandQuantiles> {
    let (mut frame, mut peak) = (Vec::new(), Vec::new());
    for touch in touches {
        let weight = 1.0 / touch.len() as f64;
        let scales = scales(calibration, touch);
        for (own, scale) in touch.iter().zip(&scales) {
            let shape = calibration.shape(scale);
            frame.extend(own.errors().zip(&shape).map(|(error, shape)| (error / shape, weight)));
        }
        peak.extend(peak_errors(touch, &scales).into_iter().map(|error| (error, 1.0)));
    }
    // A quantile of few touches is uncertain, so that of a slightly higher level is taken; not for peaks: with it,
    // bands of 90 % contained 95 % of the peaks of nine simulated objects, and 91 % without.
    let count = touches.len() as f64;
    let of = |level: &f64| BandQuantiles {
        level: *level,
        frame: quantile(&mut frame, level + (1.0 - level) / count),
        peak: quantile(&mut peak, *level),
    };
    levels.iter().map(of).collect()
}

/// [`Calibration::scale`] of each frame, n_joints, N·m.
pub(crate) fn scales(calibration: &Calibration, touch: &[PredictedFrame]) -> Vec<DVector<f64>> {
    touch.iter().map(|frame| frame.scale(calibration)).collect()
}

/// The misfit of a touch ([`Calibration::misfits`]), from its frames in contact; `None` without any.
pub(crate) fn misfit(calibration: &Calibration, touch: &[PredictedFrame]) -> Option<[f64; 2]> {
    let (mut scaled, mut count) = (0.0, 0.0);
    let (mut errors, mut measured) = (0.0, 0.0);
    for frame in touch.iter().filter(|frame| frame.contacts[0] > 0) {
        let scale = frame.scale(calibration);
        for (error, scale) in frame.errors().zip(&scale) {
            scaled += (error / scale).powi(2);
            errors += error * error;
        }
        count += scale.len() as f64;
        let known = frame.measured.iter().chain(&calibration.floor_n_m);
        measured += known.map(|own| own * own).sum::<f64>();
    }
    (count > 0.0).then(|| [(scaled / count).sqrt(), (errors / measured).sqrt()])
}

/// For each joint, the difference between its largest measured and its largest predicted torque in a touch, over the
/// scale where the prediction is largest.
pub(crate) fn peak_errors(touch: &[PredictedFrame], scales: &[DVector<f64>]) -> Vec<f64> {
    let of_joint = |joint: usize| {
        let largest = |of: fn(&PredictedFrame) -> &Vec<f64>| {
            let each = touch.iter().map(|frame| of(frame)[joint].abs()).enumerate();
            each.fold((0, 0.0), |most, own| if own.1 > most.1 { own } else { most })
        };
        let (at, predicted) = largest(|frame| &frame.torque);
        let (_, measured) = largest(|frame| &frame.measured);
        (measured - predicted).abs() / scales[at][joint]
    };
    (0..scales.first().map_or(0, DVector::len)).map(of_joint).collect()
}

/// Weighted quantile of `(value, weight)`: the smallest value up to which the weights sum to `level` of their total; 0
/// without values. Sorts the values.
pub(crate) fn quantile(values: &mut [(f64, f64)], level: f64) -> f64 {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = values.iter().map(|(_, weight)| weight).sum();
    let mut sum = 0.0;
    for (value, weight) in values.iter() {
        sum += weight;
        if sum >= level * total - 1e-9 {
            return *value;
        }
    }
    values.last().map_or(0.0, |last| last.0)
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    fn uniform(rng: &mut ChaCha8Rng) -> f64 {
        f64::from(rng.next_u32()) / f64::from(u32::MAX)
    }

    /// Touches whose errors are uniform in ±(0.1 + 0.3 |τ̂| + 2 s).
    fn touches(count: usize, seed: u64) -> Vec<Vec<PredictedFrame>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let touch = |_| {
            let frame = |_| {
                let mut frame = PredictedFrame {
                    torque: vec![],
                    spread: vec![],
                    measured: vec![],
                    contacts: [1, 1],
                };
                for _ in 0..2 {
                    let (torque, spread) = (4.0 * uniform(&mut rng) - 2.0, 0.5 * uniform(&mut rng));
                    let bound = 0.1 + 0.3 * f64::abs(torque) + 2.0 * spread;
                    frame.torque.push(torque);
                    frame.spread.push(spread);
                    frame.measured.push(torque + bound * (2.0 * uniform(&mut rng) - 1.0));
                }
                frame
            };
            (0..200).map(frame).collect()
        };
        (0..count).map(touch).collect()
    }

    #[test]
    fn the_shape_of_errors_is_found_and_new_touches_are_covered() {
        let learnt = touches(20, 1);
        let calibration = of_held_out(&learnt, 2, 5.0).unwrap();
        // The 0.9 quantile of a uniform error is 0.9 of its bound.
        let [torque, spread] = [calibration.by_torque / 0.27, calibration.by_std / 1.8];
        assert!((torque - 1.0).abs() < 0.1 && (spread - 1.0).abs() < 0.1, "{calibration:?}");
        assert!(calibration.floor_n_m.iter().all(|floor| (floor - 0.09).abs() < 0.03));
        for level in [0.5, 0.8, 0.9, 0.95] {
            let q = calibration.at(level).unwrap();
            let (mut inside, mut all) = (0.0, 0.0);
            for frame in touches(20, 2).iter().flatten() {
                let shape = calibration.shape(&frame.scale(&calibration));
                for (error, shape) in frame.errors().zip(&shape) {
                    inside += f64::from(error <= q.frame * shape);
                    all += 1.0;
                }
            }
            let covered: f64 = inside / all;
            // Slightly above the level, since twenty touches are few.
            let wanted = level + (1.0 - level) / 20.0;
            assert!((covered - wanted).abs() < 0.02, "{covered} of {level}");
        }
    }

    #[test]
    fn bands_of_earlier_versions_keep_their_spread() {
        let calibration = of_held_out(&touches(20, 1), 2, 5.0).unwrap();
        let (stiffness, std) = (0.2, 1.5);
        assert_eq!(calibration.spring_variance(stiffness, std), 2.25 + 4.0);
        let mut saved = serde_json::to_value(&calibration).unwrap();
        saved.as_object_mut().unwrap().remove("relative_std").unwrap();
        let earlier: Calibration = serde_json::from_value(saved).unwrap();
        assert_eq!(earlier.spring_variance(stiffness, std), 2.25);
    }

    #[test]
    fn few_touches_have_no_high_levels() {
        let calibration = of_held_out(&touches(4, 3), 2, 5.0).unwrap();
        assert_eq!(calibration.highest_level(), 0.8);
        assert!(calibration.at(0.9).is_none());
        assert!(of_held_out(&touches(2, 3), 2, 5.0).is_none());
    }
}
