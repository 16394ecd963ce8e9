//! Predicted and measured torque of every frame, and the error.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::LoggedTouch;
use palpate::{Arm, ExternalTorqueConfig, Field, Predictor, Sample, Snapshot};
use palpate_io::log::external_truth;
use palpate_learn::bands::Band;
use palpate_learn::calibrate::PredictedFrame;
use palpate_learn::torque_errors::ErrorSum;

use crate::error::WorkError;
use crate::forget;
use crate::inspect::log::LogCheck;
use crate::progress::Progress;
use crate::settings::SettingsError;
use crate::touches::{TouchEvent, Touches};

/// The torque with which predictions are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReferenceTorque {
    /// The measured external torque, with noise.
    Measured,
    /// The true external torque, which only simulated logs have.
    Truth,
}

impl ReferenceTorque {
    /// The word for it in messages.
    pub fn word(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Truth => "true",
        }
    }
}

/// The true external torques of a touch of a simulated log, frames × n_joints, N·m.
///
/// # Errors
///
/// If the log has none, or they cannot be read.
pub(crate) fn truth(log: &Path, touch: &str) -> Result<Vec<Vec<f64>>, WorkError> {
    external_truth(log, touch)?.ok_or_else(|| {
        WorkError::from(format!(
            "`{}` holds no truth of touch `{touch}`: there is no truth/{touch}_external.npy; \
             leave out --truth to compare with the measured torques",
            log.display()
        ))
    })
}

/// One scored frame.
pub struct FrameResult {
    /// Number of the frame in its touch, from 0.
    pub frame: u64,
    /// Time of the frame, s, if the log has times.
    pub time_s: Option<f64>,
    /// Number of touched points.
    pub contacts: usize,
    /// Number of touched points that the field knows.
    pub known: usize,
    /// τ̂, n_joints, N·m.
    pub predicted: DVector<f64>,
    /// Spread, s of `Calibration::half_width`, n_joints, N·m, if the field is calibrated.
    pub spread: Option<DVector<f64>>,
    /// τ_ext with which the prediction is compared, measured or true, n_joints, N·m.
    pub external: DVector<f64>,
}

/// One predicted touch.
pub struct TouchResult {
    /// Name of the touch.
    pub name: String,
    /// The log with the touch.
    pub log: PathBuf,
    /// The learnt touch of the field with the same samples, by number and name, if there is one.
    pub learnt_as: Option<String>,
    /// Number of frames in the log.
    pub frames_in_log: u64,
    /// The scored frames: all after the tare.
    pub frames: Vec<FrameResult>,
    truth: Option<Vec<Vec<f64>>>,
}

impl TouchResult {
    fn begin(name: String, log: &Path, against: ReferenceTorque) -> Result<Self, WorkError> {
        let truth = match against {
            ReferenceTorque::Measured => None,
            ReferenceTorque::Truth => Some(truth(log, &name)?),
        };
        let (log, frames) = (log.to_owned(), Vec::new());
        Ok(Self { name, log, learnt_as: None, frames_in_log: 0, frames, truth })
    }

    /// The torque with which a frame is compared: the true one, or `measured` if the truth is not asked for.
    fn reference(&self, frame: u64, measured: DVector<f64>) -> Result<DVector<f64>, WorkError> {
        let Some(truth) = &self.truth else { return Ok(measured) };
        let row = usize::try_from(frame).ok().and_then(|frame| truth.get(frame));
        match row.filter(|row| row.len() == measured.len()) {
            Some(row) => Ok(DVector::from_column_slice(row)),
            None => Err(format!(
                "the truth of touch `{}` is {} x {}, which does not contain frame {frame} with {} \
                 joints; it belongs to another log",
                self.name,
                truth.len(),
                truth.first().map_or(0, Vec::len),
                measured.len()
            )
            .into()),
        }
    }

    /// Errors of the field, and of predicting zero.
    pub(crate) fn errors(&self) -> ErrorSum {
        let predicted = self.frames.iter().map(|frame| frame.predicted.as_slice());
        ErrorSum::of(predicted, self.frames.iter().map(|frame| frame.external.as_slice()))
    }

    /// The band around the prediction, if the field is calibrated for this robot.
    pub fn band(&self, field: &Field) -> Option<Band> {
        let n_joints = self.frames.first()?.predicted.len();
        let calibration = field.bands().filter(|own| own.check(n_joints).is_ok())?;
        let frame = |frame: &FrameResult| {
            Some(PredictedFrame {
                torque: frame.predicted.as_slice().to_vec(),
                spread: frame.spread.as_ref()?.as_slice().to_vec(),
                measured: frame.external.as_slice().to_vec(),
                contacts: [frame.contacts, frame.known],
            })
        };
        let frames: Vec<PredictedFrame> = self.frames.iter().map(frame).collect::<Option<_>>()?;
        Band::of((calibration, calibration.default_level()), &frames)
    }

    /// Number of scored frames that meet a condition.
    pub(crate) fn count(&self, are: impl Fn(&FrameResult) -> bool) -> u64 {
        self.frames.iter().filter(|frame| are(frame)).count() as u64
    }
}

/// The learnt touches of a field, and the samples of the touch that is predicted, to find out whether it is one of them.
struct LearntTouches<'a> {
    learnt: &'a [LoggedTouch],
    n_joints: usize,
    q: Vec<f64>,
    tau: Vec<f64>,
}

impl<'a> LearntTouches<'a> {
    fn of(snapshot: Option<&'a Snapshot>) -> Self {
        let learnt = snapshot.map_or(&[][..], |snapshot| &snapshot.sample_log);
        Self { learnt, n_joints: 0, q: Vec::new(), tau: Vec::new() }
    }

    fn add(&mut self, sample: &Sample) {
        if !self.learnt.is_empty() {
            self.n_joints = sample.q.len();
            self.q.extend(&sample.q);
            self.tau.extend(&sample.tau);
        }
    }

    /// The learnt touch with the samples that were added, by number and name; the next sample starts a touch.
    fn take(&mut self) -> Option<String> {
        let (q, tau) = (std::mem::take(&mut self.q), std::mem::take(&mut self.tau));
        let n_joints = self.n_joints.max(1);
        self.learnt.iter().find(|touch| touch.is_start_of(&q, &tau, n_joints)).map(forget::name)
    }
}

/// Predicts all touches; `touch` is the convention of the logged torques. With the `snapshot` of the field, touches that
/// it has learnt are recognised ([`TouchResult::learnt_as`]).
///
/// # Errors
///
/// If a log is broken, a sample cannot be used, the truth is asked for and missing, or the progress stops it.
pub fn score(
    arm: &Arc<Arm>,
    (field, snapshot): (&Field, Option<&Snapshot>),
    touch: ExternalTorqueConfig,
    against: ReferenceTorque,
    (touches, progress): (&mut Touches, &dyn Progress),
) -> Result<Vec<TouchResult>, WorkError> {
    let place = (field.lattice.clone(), field.contact.clone());
    let mut check = touches.check(arm, place, &touch);
    let learnt = LearntTouches::of(snapshot);
    match score_all(arm, (field, touch, against), (&mut *touches, &mut check, learnt), progress) {
        Ok(results) => {
            touches.report_warnings(progress);
            check.check(progress)?;
            Ok(results)
        }
        Err(error) => {
            check.explain(progress);
            Err(error)
        }
    }
}

fn score_all(
    arm: &Arc<Arm>,
    (field, touch, against): (&Field, ExternalTorqueConfig, ReferenceTorque),
    (touches, check, mut learnt): (&mut Touches, &mut LogCheck, LearntTouches<'_>),
    progress: &dyn Progress,
) -> Result<Vec<TouchResult>, WorkError> {
    let mut predictor =
        Predictor::new(Arc::clone(arm), field, touch).map_err(SettingsError::value)?;
    let bar = progress.begin(touches.samples(), "frames", "predicting");
    let mut results: Vec<TouchResult> = Vec::new();
    while let Some(event) = touches.advance()? {
        if progress.stopped() {
            let kept = format!(" at {}; nothing was written", touches.place());
            return Err(WorkError::Interrupted { kept });
        }
        match event {
            TouchEvent::Touch(name) => {
                end(&mut predictor, &mut learnt, results.last_mut())?;
                check.begin(&name, touches, progress)?;
                predictor.begin_touch();
                bar.at(&name);
                results.push(TouchResult::begin(name, touches.log(), against)?);
            }
            TouchEvent::Sample(sample) => {
                let result = results.last_mut().expect("samples come after a touch's start");
                let frame = result.frames_in_log;
                learnt.add(&sample);
                let step = predictor.step(&sample).map_err(|error| touches.fault(error))?;
                check.add(&sample, step.as_ref().map_or(0, |step| step.contacts));
                result.frames_in_log += 1;
                if let Some(step) = step {
                    let external = result.reference(frame, step.external)?;
                    result.frames.push(FrameResult {
                        frame,
                        time_s: sample.time_s,
                        contacts: step.contacts,
                        known: step.known,
                        predicted: step.predicted,
                        spread: step.spread,
                        external,
                    });
                }
                bar.step();
            }
        }
    }
    end(&mut predictor, &mut learnt, results.last_mut())?;
    Ok(results)
}

/// Predicted torque τ̂ at every point of a planned motion, points × n_joints, N·m.
///
/// The motion starts without contact, as a touch does. Every point is simulated, since contacts depend on the motion
/// before.
///
/// # Errors
///
/// If a point does not fit the robot, or the progress stops it.
pub fn planned(
    arm: &Arc<Arm>,
    field: &Field,
    path: &[Vec<f64>],
    progress: &dyn Progress,
) -> Result<Vec<DVector<f64>>, WorkError> {
    if field.elastic.as_ref().is_some_and(|model| model.creep_s > 0.0 && model.share > 0.0) {
        progress.note(
            "the path has no times: creep of contacts with the elastic body is computed for the speed of the learnt \
             touches",
        );
    }
    let mut predictor = Predictor::planned(Arc::clone(arm), field).map_err(SettingsError::value)?;
    predictor.begin_touch();
    let bar = progress.begin(Some(path.len() as u64), "points", "predicting");
    let mut torques = Vec::with_capacity(path.len());
    for (point, q) in path.iter().enumerate() {
        if progress.stopped() {
            return Err(WorkError::Interrupted { kept: format!(" at point {point} of the path") });
        }
        let sample = Sample::new(None, q.clone(), vec![0.0; q.len()]);
        let step = predictor.step(&sample).map_err(|error| {
            WorkError::touch(Path::new("path"), format!("point {point} (from 0)"), error)
        })?;
        torques.push(step.expect("there is no tare to wait for").predicted);
        bar.step();
    }
    Ok(torques)
}

/// Ends the touch that was begun last, if any was.
fn end(
    predictor: &mut Predictor,
    learnt: &mut LearntTouches<'_>,
    last: Option<&mut TouchResult>,
) -> Result<(), WorkError> {
    let Some(result) = last else { return Ok(()) };
    result.learnt_as = learnt.take();
    let place = || format!("touch `{}`", result.name);
    predictor.end_touch().map_err(|error| WorkError::touch(&result.log, place(), error))
}
