//! Whether touches contradict a field that was learnt before, and what has changed since.
//!
//! A touch contradicts the field if it fits worse than the touches that were held out when the field's bands were
//! calibrated. There are two measures of misfit ([`Calibration::misfits`]): one is relative to the scale of the bands,
//! the other to the measured torques, which shows torques that have disappeared. The limit of each is what one
//! unchanged touch in eighty exceeds, if logarithms of misfits are normally distributed. The change is the simplest of
//! these that explains most of the error beyond sensor noise:
//!
//! | change         | explanation                                                             | file      |
//! |----------------|-------------------------------------------------------------------------|-----------|
//! | moved          | the field, shifted and turned about the vertical                        | [`moved`] |
//! | softer, harder | the field's torques times one factor, in the touches that contradict it | this      |
//! | other          | neither                                                                 |           |
//!
//! A touch that repeats a learnt one (`repeated`) contradicts it if its torques differ from the earlier ones by more
//! than a quarter and by more than noise, however well the field predicts either. The difference is explained by a
//! factor on the earlier torques, or by a motion: by the earlier torques at the same place of the object, corrected by
//! the field for the remaining difference in position. Only the motion uses the field and has its errors, so a larger
//! residual is allowed for it. A factor that leaves almost no residual is preferred: an object that becomes softer or
//! harder keeps the shape of its torques over the path.
//!
//! If the arm touches few known cells and repeats no touch, the result is [`Change::Unknown`].

pub mod moved;
mod repeated;

use palpate::{Arm, Calibration, Field};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::calibrate::{PredictedFrame, misfit};
use crate::error::{LearnError, Stop};
use crate::field_estimates::FieldEstimates;
use crate::tracked::{TrackedFrame, TrackedTouch, TrackedTouches};
use moved::{ObjectMotion, Sampler, Wanted};
use repeated::{Learnt, Repeated};

/// With a smaller share of known contacts, touches that repeat nothing give [`Change::Unknown`].
const MIN_KNOWN: f64 = 0.1;
/// Smallest share of known contacts at which a factor is accepted as the change. Below it, touches that contradict a
/// field which predicts part of their torque give [`Change::Unknown`].
const MOSTLY_KNOWN: f64 = 0.6;
/// The field counts as predicting part of a torque if the best factor on its prediction is above this.
const PREDICTS_NOTHING: f64 = 0.25;
/// Largest residual of a motion or a factor, as a fraction of the squared error beyond noise; of a motion also as a
/// fraction of the squared torque.
const LEAVES: f64 = 0.5;
/// Largest residual of a motion, as a fraction of that of the best factor.
const LEAVES_MOVED: f64 = 0.9;
/// [`LEAVES`] and [`LEAVES_MOVED`] of a motion for repeated touches: there a motion is less exact than a factor.
const LEAVES_REPEATED: f64 = 0.7;
const LEAVES_MOVED_REPEATED: f64 = 2.0;
/// For repeated touches, a factor is exact if its residual is at most the first fraction of the squared error, or at
/// most the second of the squared torque and smaller than that of the motion.
const EXACTLY: [f64; 2] = [0.01, 0.05];
/// Smaller misfits count as this.
const MIN_MISFIT: f64 = 1e-3;
/// Fewest held-out touches with known misfits.
const FEWEST: usize = 3;
/// A squared error up to this factor of the noise may be noise, since the tare of a touch determines the noise roughly.
const NOISE: f64 = 1.5;
/// Relative difference of torques above which a repeated touch contradicts the earlier one.
const REPEATS: f64 = 0.25;
/// About the number of frames per touch with which motions are compared.
const FRAMES: usize = 100;

/// What has changed since the field was learnt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "change", rename_all = "lowercase")]
pub enum Change {
    /// The touches show no change.
    Unchanged,
    /// The object was moved.
    Moved(ObjectMotion),
    /// The object is softer where touches contradict the field.
    Softer {
        /// Torque over expected torque, below 1; 0 if nothing is in the way any more.
        factor: f64,
    },
    /// The object is harder where touches contradict the field.
    Harder {
        /// Torque over expected torque, at least 1.
        factor: f64,
    },
    /// Neither a motion nor a factor explains the touches.
    Other,
    /// Too few of the touched cells are known to the field.
    Unknown,
}

impl Change {
    fn by(factor: f64) -> Self {
        match factor < 1.0 {
            true => Self::Softer { factor },
            false => Self::Harder { factor },
        }
    }
}

/// Comparison of one or several touches with a field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Share of the contacts whose cells the field knows.
    pub known: f64,
    /// Misfit of the touches ([`Calibration::misfits`]) over its limit: above 1, they contradict the field. For touches
    /// that repeat learnt ones, relative difference from these over its limit. The larger one, if only some repeat.
    pub contradiction: f64,
    /// Names of the learnt touches that these repeat.
    pub repeats: Vec<String>,
    /// The change.
    #[serde(flatten)]
    pub change: Change,
    /// Errors of the explanations.
    pub error: RelativeErrors,
    /// Where torques are outside of their bands; only for touches that contradict the field.
    pub place: Option<ContradictedRegion>,
}

impl Comparison {
    /// Whether the field knows most of the cells in this comparison of a number of touches, or all of these repeat learnt
    /// ones. Otherwise, touches that do not contradict the field are no evidence that the object is unchanged.
    pub fn is_with_known(&self, touches: usize) -> bool {
        self.known >= MOSTLY_KNOWN || self.repeats.len() == touches
    }
}

/// Errors relative to those of predicting zero, as root mean squares over frames in contact; `None` without torques.
/// `scaled` and `moved` are `None` if nothing contradicts the field. If touches contradict those that they repeat, the
/// factor multiplies the earlier torques, and the motion uses the earlier torques at the same place of the object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RelativeErrors {
    /// Error of the field.
    pub field: Option<f64>,
    /// Error with the best factor in the touches that contradict the field.
    pub scaled: Option<f64>,
    /// Error after the best motion.
    pub moved: Option<f64>,
    /// Error of the torques that were measured in the repeated touches.
    pub repeated: Option<f64>,
}

/// Where the object contradicts the field: the touched cells of frames outside of their bands, weighted by the
/// stiffness in the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContradictedRegion {
    /// Mean position, m, world frame.
    pub centre_m: [f64; 3],
    /// Root mean square distance of the cells from the centre, m.
    pub radius_m: f64,
    /// Number of cells.
    pub cells: usize,
}

/// Compares touches with a field. Returns a comparison of each touch, and one of all touches together.
///
/// `tracked` are the new touches under the field's lattice and contact model, `learnt` those that the field has learnt,
/// if they are available. For a field with an elastic body, `with_body` are its predictions for the frames in contact,
/// by touch; motions, and differences from repeated touches, are judged by the springs alone.
///
/// # Errors
///
/// If the field has no bands for these joints or too few misfits, or on being stopped.
pub fn compare(
    (arm, tracked): (&Arm, &TrackedTouches),
    (field, with_body): (&Field, Option<Vec<Vec<PredictedFrame>>>),
    learnt: Option<&TrackedTouches>,
    stop: Stop<'_>,
) -> Result<(Vec<Comparison>, Comparison), LearnError> {
    let calibration = comparable(field, tracked.n_joints)?;
    let learnt = learnt.map(|own| Learnt::new(arm, own, field, calibration.untouched_std_n_per_m));
    let mut beside =
        Beside::of(tracked, field, calibration).repeating(arm, learnt.as_ref(), stop)?;
    beside.predicted = with_body.unwrap_or(beside.predicted);
    let all: Vec<usize> = (0..tracked.touches.len()).collect();
    let each = all.iter().map(|touch| beside.compare(&[*touch], stop));
    Ok((each.collect::<Result<_, _>>()?, beside.compare(&all, stop)?))
}

/// The calibration with which touches can be compared with a field.
///
/// # Errors
///
/// If the field has no bands for so many joints, or too few misfits.
pub fn comparable(field: &Field, n_joints: usize) -> Result<&Calibration, LearnError> {
    let fits = |own: &&Calibration| own.misfits.len() >= FEWEST && own.check(n_joints).is_ok();
    field.bands().filter(fits).ok_or(LearnError::NoBands)
}

/// New touches and a field, for comparisons.
struct Beside<'a> {
    tracked: &'a TrackedTouches,
    calibration: &'a Calibration,
    sampler: Sampler,
    rows: FieldEstimates,
    /// Predictions of the field for the frames in contact, by touch.
    predicted: Vec<Vec<PredictedFrame>>,
    /// The learnt touch that each touch repeats, if any.
    repeated: Vec<Option<Repeated<'a>>>,
}

impl<'a> Beside<'a> {
    fn of(tracked: &'a TrackedTouches, field: &Field, calibration: &'a Calibration) -> Self {
        let rows = FieldEstimates::of(tracked, field, calibration.untouched_std_n_per_m);
        let of =
            |touch: &TrackedTouch| touch.in_contact().map(|frame| rows.predicted(frame)).collect();
        let predicted = tracked.touches.iter().map(of).collect();
        let repeated = tracked.touches.iter().map(|_| None).collect();
        Self { tracked, calibration, sampler: Sampler::of(field), rows, predicted, repeated }
    }

    /// Finds the learnt touches that the new ones repeat.
    fn repeating(
        mut self,
        arm: &Arm,
        learnt: Option<&'a Learnt>,
        stop: Stop<'_>,
    ) -> Result<Self, LearnError> {
        if let Some(learnt) = learnt {
            let touches = self.tracked.touches.par_iter().zip(&self.predicted);
            let of = |(touch, predicted): (&TrackedTouch, &Vec<PredictedFrame>)| {
                learnt.repeated(arm, touch, predicted, stop)
            };
            self.repeated = touches.map(of).collect::<Result<_, _>>()?;
        }
        Ok(self)
    }

    fn compare(&self, touches: &[usize], stop: Stop<'_>) -> Result<Comparison, LearnError> {
        let in_contact = |touch: &usize| self.tracked.touches[*touch].in_contact();
        let known = self.rows.known(touches.iter().flat_map(in_contact));
        let predicted = |touch: &usize| &self.predicted[*touch];
        let noise = self.tracked.noise_std(touches).iter().map(|std| std * std).sum::<f64>();
        let sums = Sums::of(touches.iter().flat_map(predicted), noise);
        let repeated: Vec<&Repeated<'_>> =
            touches.iter().filter_map(|touch| self.repeated[*touch].as_ref()).collect();
        // Twice the noise: both touches have it.
        let again = Sums::of(repeated.iter().flat_map(|own| &own.frames), 2.0 * noise);
        let others = touches.iter().filter(|touch| self.repeated[**touch].is_none());
        let others: Vec<&Vec<PredictedFrame>> = others.map(predicted).collect();
        let contradictions = [again.differs() / REPEATS, self.contradiction(&others)];
        let contradiction = contradictions[0].max(contradictions[1]);
        let mut comparison = Comparison {
            known,
            contradiction,
            repeats: repeated.iter().map(|repeated| repeated.name().into()).collect(),
            change: Change::Unchanged,
            error: RelativeErrors {
                field: sums.relative(sums.error),
                scaled: None,
                moved: None,
                repeated: again.relative(again.error),
            },
            place: None,
        };
        let predicts = sums.scaled().0 > PREDICTS_NOTHING;
        let is_little =
            known < MIN_KNOWN || (contradiction > 1.0 && known < MOSTLY_KNOWN && predicts);
        if repeated.is_empty() && is_little {
            comparison.change = Change::Unknown;
        } else if contradiction > 1.0 {
            let again = (contradictions[0] > 1.0).then_some(&again);
            self.explain(&mut comparison, (touches, &sums), again, stop)?;
        }
        Ok(comparison)
    }

    /// Finds the change, for touches that contradict the field. `again` are the sums of their differences from the
    /// touches that they repeat, if they contradict these.
    fn explain(
        &self,
        comparison: &mut Comparison,
        (touches, sums): (&[usize], &Sums),
        again: Option<&Sums>,
        stop: Stop<'_>,
    ) -> Result<(), LearnError> {
        let moved = self.moved(touches, again.is_some(), stop)?;
        let sums = again.unwrap_or(sums);
        let scaled = self.scaled(touches, again.is_some(), sums);
        let is_known = again.is_some() || comparison.known >= MOSTLY_KNOWN;
        comparison.change = sums.change(moved, scaled, [is_known, again.is_some()]);
        comparison.error.scaled = sums.relative(scaled.1);
        comparison.error.moved = sums.relative(moved.1);
        let frames = touches.iter().flat_map(|touch| self.tracked.touches[*touch].in_contact());
        let predicted = touches.iter().flat_map(|touch| &self.predicted[*touch]);
        comparison.place = self.place(frames.zip(predicted));
        Ok(())
    }

    /// The best factor on the field's torques (if `repeat`, on the earlier torques) in the touches that contradict
    /// them, and the remaining squared error of all touches. `sums` are those of all touches.
    fn scaled(&self, touches: &[usize], repeat: bool, sums: &Sums) -> (f64, f64) {
        let frames = |touch: &usize| match (repeat, &self.repeated[*touch]) {
            (true, repeated) => Some(&repeated.as_ref()?.frames),
            (false, _) => Some(&self.predicted[*touch]),
        };
        let of = |frames: &[&Vec<PredictedFrame>]| {
            Sums::of(frames.iter().copied().flatten(), sums.of_frame)
        };
        // An object that is softer in one place is unchanged for touches elsewhere.
        let contradicts = |own: &&Vec<PredictedFrame>| match repeat {
            true => of(&[*own]).differs() > REPEATS,
            false => self.contradiction(&[*own]) > 1.0,
        };
        let all: Vec<&Vec<PredictedFrame>> = touches.iter().filter_map(frames).collect();
        let changed: Vec<&Vec<PredictedFrame>> = all.iter().copied().filter(contradicts).collect();
        let own = of(if changed.is_empty() { &all } else { &changed });
        let (factor, left) = own.scaled();
        (factor, left + sums.error - own.error)
    }

    /// The motion that explains the touches best (if `repeat`, their differences from those that they repeat), and the
    /// remaining squared error.
    fn moved(
        &self,
        touches: &[usize],
        repeat: bool,
        stop: Stop<'_>,
    ) -> Result<(ObjectMotion, f64), LearnError> {
        let frames: usize = touches.iter().map(|touch| self.frames(*touch, repeat).count()).sum();
        let every = (frames / (FRAMES * touches.len())).max(1);
        let of = |motion: ObjectMotion| {
            let wanted = touches.iter().flat_map(|touch| self.wanted(*touch, repeat, motion));
            let some: Vec<Wanted<'_>> = wanted.step_by(every).collect();
            let mean = moved::error(self.tracked, &some, &self.sampler, motion) / some.len() as f64;
            mean * frames as f64
        };
        let motion = moved::best(self.sampler.centre_m, &of, stop)?;
        Ok((motion, of(motion)))
    }

    /// The frames of a touch in contact; if `repeat`, none of a touch that repeats no other.
    fn frames(&self, touch: usize, repeat: bool) -> impl Iterator<Item = &TrackedFrame> {
        let counts = !repeat || self.repeated[touch].is_some();
        self.tracked.touches[touch].in_contact().filter(move |_| counts)
    }

    /// The torques that the field of the moved object should predict for these frames: the measured ones; if `repeat`,
    /// minus the residual of the field in the earlier frames that they repeat.
    fn wanted(&self, touch: usize, repeat: bool, motion: ObjectMotion) -> Vec<Wanted<'_>> {
        let frames = self.frames(touch, repeat).map(|frame| &frame.observation);
        match self.repeated[touch].as_ref().filter(|_| repeat) {
            Some(repeated) => frames.zip(repeated.wanted(motion)).collect(),
            None => frames.map(|frame| (frame, frame.tau().into_owned())).collect(),
        }
    }

    /// Geometric mean of the touches' misfits over its limit; the larger one of the two kinds.
    fn contradiction(&self, touches: &[&Vec<PredictedFrame>]) -> f64 {
        let misfits: Vec<[f64; 2]> =
            touches.iter().filter_map(|touch| misfit(self.calibration, touch)).collect();
        let of = |kind: usize| {
            let logs = misfits.iter().map(|own| own[kind].max(MIN_MISFIT).ln());
            (logs.sum::<f64>() / misfits.len() as f64).exp() / self.limit(kind, misfits.len())
        };
        if misfits.is_empty() { 0.0 } else { f64::max(of(0), of(1)) }
    }

    /// Limit of the mean misfit of a kind: one in eighty groups of this many unchanged touches exceeds it, if
    /// logarithms of misfits are normally distributed (a prediction limit from the held-out touches).
    fn limit(&self, kind: usize, touches: usize) -> f64 {
        let logs = self.calibration.misfits.iter().map(|own| own[kind].max(MIN_MISFIT).ln());
        let logs: Vec<f64> = logs.collect();
        let n = logs.len() as f64;
        let mean = logs.iter().sum::<f64>() / n;
        let variance = logs.iter().map(|log| (log - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let std = (variance * (1.0 / touches.max(1) as f64 + 1.0 / n)).sqrt();
        (mean + student(n - 1.0) * std).exp()
    }

    fn place<'f>(
        &self,
        frames: impl Iterator<Item = (&'f TrackedFrame, &'f PredictedFrame)>,
    ) -> Option<ContradictedRegion> {
        let q = self.calibration.at(self.calibration.default_level())?;
        let mut weights = vec![0.0; self.rows.cells.len()];
        for (frame, predicted) in frames {
            let shape = self.calibration.shape(&predicted.scale(self.calibration));
            if predicted.errors().zip(&shape).any(|(error, shape)| error > q.frame * shape) {
                for row in frame.observation.rows() {
                    weights[row] += 1e-6 + self.rows.estimates[row].stiffness_n_per_m;
                }
            }
        }
        let total: f64 = weights.iter().sum();
        let points = || self.tracked.points_m.iter().zip(&weights);
        let centre_m = [0, 1, 2]
            .map(|axis| points().map(|(point, weight)| weight * point[axis]).sum::<f64>() / total);
        let apart = |point: &[f64; 3]| {
            point.iter().zip(&centre_m).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        let square: f64 = points().map(|(point, weight)| weight * apart(point)).sum();
        let cells = weights.iter().filter(|weight| **weight > 0.0).count();
        (cells > 0).then(|| ContradictedRegion {
            centre_m,
            radius_m: (square / total).sqrt(),
            cells,
        })
    }
}

/// Sums of squares over frames and joints, (N·m)².
#[derive(Default)]
struct Sums {
    /// The noise of one frame.
    of_frame: f64,
    // Sums of measured², predicted², measured · predicted, (measured − predicted)², and noise.
    measured: f64,
    predicted: f64,
    both: f64,
    error: f64,
    noise: f64,
}

impl Sums {
    fn of<'f>(frames: impl Iterator<Item = &'f PredictedFrame>, noise: f64) -> Self {
        let mut sums = Self { of_frame: noise, ..Self::default() };
        for frame in frames {
            for (predicted, measured) in frame.torque.iter().zip(&frame.measured) {
                sums.measured += measured * measured;
                sums.predicted += predicted * predicted;
                sums.both += predicted * measured;
                sums.error += (predicted - measured).powi(2);
            }
            sums.noise += noise;
        }
        sums
    }

    /// The best factor on the prediction, at least 0, and the remaining squared error.
    fn scaled(&self) -> (f64, f64) {
        let factor = if self.predicted > 0.0 { (self.both / self.predicted).max(0.0) } else { 1.0 };
        (factor, self.measured - factor * (2.0 * self.both - factor * self.predicted))
    }

    /// Root of a squared error over the sum of the squared measured torques.
    fn relative(&self, error: f64) -> Option<f64> {
        (self.measured > 0.0).then(|| (error.max(0.0) / self.measured).sqrt())
    }

    /// The change that explains a contradiction: a motion whose residual is small enough; otherwise a factor whose
    /// residual is, if most contacts are known; otherwise neither. For repeated touches, an exact factor is preferred
    /// to a motion, and a motion that is too small to be told from none means that nothing has changed. `moved` and
    /// `scaled` are the squared errors that remain with the motion and the factor.
    fn change(
        &self,
        (motion, moved): (ObjectMotion, f64),
        (factor, scaled): (f64, f64),
        [is_known, repeats]: [bool; 2],
    ) -> Change {
        let error = self.beyond(self.error);
        let (moved, scaled) = (self.beyond(moved), self.beyond(scaled));
        // For repeated touches, half of the noise is that of the new touches.
        let torque = self.measured - self.noise * if repeats { 0.5 } else { 1.0 };
        let [of_error, of_torque] = EXACTLY;
        let is_exact =
            scaled <= of_error * error || (scaled <= of_torque * torque && scaled < moved);
        let [most, beside_factor] = match repeats {
            true => [LEAVES_REPEATED, LEAVES_MOVED_REPEATED],
            false => [LEAVES, LEAVES_MOVED],
        };
        let moves = moved < f64::min(beside_factor * scaled, most * error.min(torque));
        if repeats && is_exact {
            Change::by(factor)
        } else if repeats && moves && motion.is_none() {
            Change::Unchanged // learnt touches at the same place had these torques
        } else if moves {
            Change::Moved(motion)
        } else if !is_known || scaled > LEAVES * error {
            Change::Other
        } else {
            Change::by(factor)
        }
    }

    /// Relative difference: root of the squared error beyond noise over the squared predicted torque, which counts as
    /// at least the noise over [`REPEATS`]²; 0 if the error may be noise.
    fn differs(&self) -> f64 {
        let beyond = self.error - NOISE * self.noise;
        if beyond > 0.0 {
            (beyond / self.predicted.max(self.noise / REPEATS.powi(2))).sqrt()
        } else {
            0.0
        }
    }

    /// The part of a squared error beyond noise, at least a twentieth of the noise.
    fn beyond(&self, error: f64) -> f64 {
        (error - self.noise).max(0.05 * self.noise)
    }
}

/// The quantile of Student's t that one in eighty values exceeds, by the expansion of Abramowitz and Stegun (26.7.5).
/// It is 6 % too small for two degrees of freedom, and within 2 % from three on.
fn student(freedom: f64) -> f64 {
    let z: f64 = 2.241_403;
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
    ];
    terms.iter().rev().fold(0.0, |sum, term| (sum + term) / freedom) + z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_may_leave_a_larger_error_than_a_factor_only_where_touches_repeat_others() {
        let sums = Sums { error: 100.0, measured: 60.0, ..Sums::default() };
        let motion = ObjectMotion { shift_m: [0.03, 0.0, 0.0], turn_rad: 0.0, about_m: [0.0; 2] };
        let word = |moved: f64, scaled: f64, repeats: bool| {
            sums.change((motion, moved), (0.4, scaled), [true, repeats])
        };
        let softer = Change::Softer { factor: 0.4 };
        assert_eq!(word(10.0, 6.0, true), Change::Moved(motion));
        assert_eq!(word(10.0, 6.0, false), softer);
        assert_eq!(word(13.0, 6.0, true), softer, "more than twice what the factor leaves");
        assert_eq!(word(43.0, 40.0, true), softer, "more than 0.7 of the torque");
        assert_eq!(word(4.0, 2.5, true), softer, "a twentieth of the torque");
        assert_eq!(word(2.0, 2.5, true), Change::Moved(motion), "less than the factor");
        assert_eq!(word(0.5, 0.8, true), softer, "a hundredth of the error");
        assert_eq!(word(25.0, 28.0, false), Change::Moved(motion));
        assert_eq!(word(31.0, 50.0, false), softer, "more than half of the torque");
        assert_eq!(word(60.0, 90.0, false), Change::Other);
        assert_eq!(word(80.0, 90.0, true), Change::Other);
    }
}
