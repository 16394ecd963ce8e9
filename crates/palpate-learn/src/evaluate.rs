//! Leave-one-touch-out: every touch is predicted from a field learnt on all the others.
//!
//! The touch under test is never learnt from. Folds are independent and run in parallel; the
//! figures are the same on one thread or many.

use std::sync::Arc;

use nalgebra::DVector;
use palpate::arm::Arm;
use palpate::field::{Field, Predictor};
use palpate::mapper::{Config, Mapper, MapperError};
use palpate::touch::Sample;
use rayon::prelude::*;

use crate::errors::ErrorSum;

/// A touch as a log holds it, with what is known of the truth.
#[derive(Debug, Clone)]
pub struct Touch {
    /// Its name.
    pub name: String,
    /// Its samples in order.
    pub samples: Vec<Sample>,
    /// True external torque of every sample, n_joints, N·m, where a log has it.
    pub truth: Option<Vec<Vec<f64>>>,
}

/// Errors on one touch.
#[derive(Debug, Clone)]
pub struct Score {
    /// The touch's name.
    pub name: String,
    /// Errors of the field.
    pub field: ErrorSum,
    /// Errors of predicting zero, on the same frames.
    pub zero: ErrorSum,
}

/// What can go wrong in an evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum EvaluateError {
    /// Nothing to learn from, or nothing to test on.
    #[error("leave-one-touch-out needs at least two touches, got {got}")]
    TooFewTouches { got: usize },
    /// Samples that cannot be used.
    #[error("touch `{touch}`, sample {sample}: {source}")]
    Sample { touch: String, sample: usize, source: MapperError },
    /// Settings that cannot be used.
    #[error(transparent)]
    Settings(#[from] MapperError),
    /// A truth of another length than its touch.
    #[error("the truth of touch `{touch}` has {got} rows, the touch has {expected} samples")]
    TruthLength { touch: String, got: usize, expected: usize },
}

/// Learns a field from touches.
///
/// # Errors
///
/// Names the touch and the sample that cannot be used.
pub fn learn<'a>(
    arm: &Arc<Arm>,
    config: &Config,
    touches: impl IntoIterator<Item = &'a Touch>,
) -> Result<Mapper, EvaluateError> {
    let mut mapper = Mapper::new(Arc::clone(arm), config.clone())?;
    for touch in touches {
        let at =
            |sample, source| EvaluateError::Sample { touch: touch.name.clone(), sample, source };
        mapper.begin_touch();
        for (number, sample) in touch.samples.iter().enumerate() {
            mapper.step(sample).map_err(|source| at(number, source))?;
        }
        mapper.end_touch().map_err(|source| at(touch.samples.len(), source))?;
    }
    Ok(mapper)
}

/// Scores a field on a touch, from the tare on, against the truth if the touch has it and
/// against the measured external torque otherwise.
///
/// # Errors
///
/// Names the sample that cannot be used, or a truth of the wrong length.
pub fn score(
    arm: &Arc<Arm>,
    config: &Config,
    field: &Field,
    touch: &Touch,
) -> Result<Score, EvaluateError> {
    if let Some(got) = touch.truth.as_ref().map(Vec::len).filter(|n| *n != touch.samples.len()) {
        let (touch, expected) = (touch.name.clone(), touch.samples.len());
        return Err(EvaluateError::TruthLength { touch, got, expected });
    }
    let at = |sample: usize, source: MapperError| EvaluateError::Sample {
        touch: touch.name.clone(),
        sample,
        source,
    };
    let mut predictor =
        Predictor::new(Arc::clone(arm), field, config.touch.clone()).map_err(MapperError::from)?;
    predictor.begin_touch();
    let (mut errors, mut zero) = (ErrorSum::default(), ErrorSum::default());
    for (number, sample) in touch.samples.iter().enumerate() {
        let step = predictor.step(sample).map_err(|error| at(number, error.into()))?;
        let Some(prediction) = step else { continue };
        let truth = match &touch.truth {
            Some(truth) => DVector::from_column_slice(&truth[number]),
            None => prediction.external,
        };
        errors.add(&prediction.predicted, &truth);
        zero.add(&DVector::zeros(truth.len()), &truth);
    }
    Ok(Score { name: touch.name.clone(), field: errors, zero })
}

/// Predicts every touch from a field learnt on all the others.
///
/// `done` is told after every fold, from any thread.
///
/// # Errors
///
/// The first fold's, in the order of the touches.
pub fn leave_one_touch_out(
    arm: &Arc<Arm>,
    config: &Config,
    touches: &[Touch],
    done: impl Fn() + Sync,
) -> Result<Vec<Score>, EvaluateError> {
    if touches.len() < 2 {
        return Err(EvaluateError::TooFewTouches { got: touches.len() });
    }
    let fold = |out: usize| {
        let others = touches.iter().enumerate().filter(|(n, _)| *n != out).map(|(_, touch)| touch);
        let field = learn(arm, config, others)?.field();
        let scored = score(arm, config, &field, &touches[out]);
        done();
        scored
    };
    let folds: Vec<_> = (0..touches.len()).into_par_iter().map(fold).collect();
    folds.into_iter().collect()
}
