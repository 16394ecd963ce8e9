//! Result of an evaluation: the numbers of Table I, and all data of its pictures.

use serde::{Deserialize, Serialize};

use crate::bands::{Band, Coverage};
use crate::method::Method;
use crate::torque_errors::{ErrorSum, TorqueErrors};

/// An evaluation of several methods on held-out touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Joints in the order of all torques.
    pub joint_names: Vec<String>,
    /// The torques that predictions are compared with: `"truth"` or `"measured"`.
    pub against: String,
    /// The table, with a row for each method.
    pub methods: Vec<MethodSummary>,
    /// The touches, each predicted while it was held out.
    pub touches: Vec<HeldOutTouch>,
}

/// Average relative error of the paper's field on a real arm (Table I).
pub const PAPER_FIELD: f64 = 0.13;
/// Average relative errors of the paper's three baselines from joint angles, the best one first.
pub const PAPER_BASELINES: [f64; 3] = [0.76, 1.48, 1.20];

/// One method's row of Table I: figures of each touch, averaged over touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodSummary {
    /// Name of the method ([`Method::name`]).
    pub name: String,
    /// Mean error, N·m.
    pub avg_error: Option<MeanStd>,
    /// Largest error, N·m.
    pub max_error: Option<MeanStd>,
    /// Mean relative error, over the touches that reach 1 N·m.
    pub avg_relative: Option<MeanStd>,
    /// Largest relative error, over the same touches.
    pub max_relative: Option<MeanStd>,
    /// Coverage of the bands of `map`, if there were enough touches.
    pub coverage: Option<Coverage>,
    /// Coverage of the bands of other objects ([`palpate::Calibration::of_other_objects`]).
    pub coverage_of_other_objects: Option<Coverage>,
}

/// Mean and sample standard deviation (0 for a single value).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct MeanStd {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation.
    pub std: f64,
}

/// A held-out touch with all predictions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HeldOutTouch {
    /// The touch's name.
    pub name: String,
    /// Index of its fold.
    pub fold: usize,
    /// Times of the frames after the tare, s since the first; frame numbers if the log has no times.
    pub time_s: Vec<f64>,
    /// Number of contacts in each frame.
    pub contacts: Vec<u32>,
    /// Number of contacts in each frame whose cells were touched by a training touch.
    pub known: Vec<u32>,
    /// Joint positions, frames × n_joints, rad.
    pub q: Vec<Vec<f64>>,
    /// The external torque to predict, frames × n_joints, N·m.
    pub external: Vec<Vec<f64>>,
    /// Predictions of the methods, in the order of the table.
    pub predictions: Vec<MethodPrediction>,
}

/// One method's prediction of a touch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MethodPrediction {
    /// The method's name.
    pub method: String,
    /// The four error figures of the touch; `None` without a frame.
    pub errors: Option<TorqueErrors>,
    /// Predicted external torque, frames × n_joints, N·m.
    pub predicted: Vec<Vec<f64>>,
    /// The band around the prediction, for a calibrated estimator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band: Option<Band>,
    /// The band from other objects ([`palpate::Calibration::of_other_objects`]).
    #[serde(skip)]
    pub band_of_other_objects: Option<Band>,
}

impl MeanStd {
    /// Mean and deviation of values; `None` without values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().collect();
        let n = values.len() as f64;
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / n)?;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let std = if values.len() > 1 { (squares / (n - 1.0)).sqrt() } else { 0.0 };
        Some(Self { mean, std })
    }
}

impl MethodPrediction {
    /// A prediction, with its errors against `external`.
    pub fn new(method: &str, predicted: Vec<Vec<f64>>, external: &[Vec<f64>]) -> Self {
        let errors = ErrorSum::of(&predicted, external).errors();
        let method = method.to_owned();
        Self { method, errors, predicted, band: None, band_of_other_objects: None }
    }
}

impl HeldOutTouch {
    /// Errors of a method on this touch.
    pub fn errors(&self, method: &str) -> Option<TorqueErrors> {
        self.predictions.iter().find(|prediction| prediction.method == method)?.errors
    }

    /// Errors of predicting zero on this touch, also if `zero` is not in the table.
    pub fn zero(&self) -> Option<TorqueErrors> {
        ErrorSum::of(&self.external, &self.external).zero()
    }

    /// A sentence on why a method may predict this touch badly: the share of known contacts, and size
    /// and direction of the predicted torque relative to the true or measured one.
    ///
    /// Sums are over all frames, so frames with large torques count most.
    pub fn failure_reason(&self, method: &str) -> Option<String> {
        let prediction = self.predictions.iter().find(|prediction| prediction.method == method)?;
        let (mut both, mut predicted_sq, mut external_sq) = (0.0, 0.0, 0.0);
        for (predicted, external) in prediction.predicted.iter().zip(&self.external) {
            both += predicted.iter().zip(external).map(|(p, e)| p * e).sum::<f64>();
            predicted_sq += predicted.iter().map(|p| p * p).sum::<f64>();
            external_sq += external.iter().map(|e| e * e).sum::<f64>();
        }
        let sum = |counts: &[u32]| counts.iter().map(|&count| f64::from(count)).sum::<f64>();
        let known = 100.0 * sum(&self.known) / sum(&self.contacts).max(1.0);
        let size = (predicted_sq / external_sq.max(f64::MIN_POSITIVE)).sqrt();
        let alike = both / (predicted_sq * external_sq).sqrt().max(f64::MIN_POSITIVE);
        let direction = if alike < 0.5 {
            "in a different direction"
        } else if alike < 0.85 {
            "in about the same direction"
        } else {
            "in the same direction"
        };
        Some(format!(
            "{known:.0} % of its contacts are with cells that other touches reached; the predicted torque is {size:.1} \
             times the actual one, {direction} (cosine {alike:.2})"
        ))
    }
}

impl Evaluation {
    /// Mean over touches of a method's average relative error; `None` if the method has none or is not in the table.
    pub fn relative(&self, method: &str) -> Option<f64> {
        let summary = self.methods.iter().find(|summary| summary.name == method)?;
        Some(summary.avg_relative?.mean)
    }

    /// Index of the method that summaries are about: the estimator with the smallest average relative error (without
    /// relative errors, the smallest average error). Without an estimator, the first method.
    pub fn subject(&self) -> Option<usize> {
        let own = self.methods.iter().enumerate().filter(|(_, method)| method.is_estimator());
        let smallest = |figure: fn(&MethodSummary) -> Option<MeanStd>| {
            let own = own.clone().filter_map(|(at, method)| Some((at, figure(method)?.mean)));
            Some(own.min_by(|a, b| a.1.total_cmp(&b.1))?.0)
        };
        smallest(|method| method.avg_relative)
            .or_else(|| smallest(|method| method.avg_error))
            .or_else(|| Some(own.clone().next()?.0))
            .or_else(|| (!self.methods.is_empty()).then_some(0))
    }

    /// The best baseline that learns from joint angles alone, and its average relative error.
    pub fn best_learnt(&self) -> Option<(&'static str, f64)> {
        let learnt = Method::ALL.iter().filter(|method| method.is_learnt_baseline());
        learnt
            .filter_map(|method| Some((method.name(), self.relative(method.name())?)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

impl MethodSummary {
    /// Whether the method is one of palpate's estimators, not a baseline.
    pub fn is_estimator(&self) -> bool {
        Method::ALL.iter().any(|own| own.is_estimator() && own.name() == self.name)
    }

    /// The row of the method at `index` in the predictions of every touch.
    pub fn new(name: &str, index: usize, touches: &[HeldOutTouch]) -> Self {
        let own = || touches.iter().map(|touch| &touch.predictions[index]);
        let errors: Vec<TorqueErrors> = own().filter_map(|own| own.errors).collect();
        let bands: Vec<&Band> = own().filter_map(|own| own.band.as_ref()).collect();
        let of_other_objects: Vec<&Band> =
            own().filter_map(|own| own.band_of_other_objects.as_ref()).collect();
        Self::of(name, &errors, [&bands, &of_other_objects])
    }

    /// The row of a method, from its errors on touches and its bands: its own, and those of other objects.
    pub fn of(
        name: &str,
        errors: &[TorqueErrors],
        [bands, of_other_objects]: [&[&Band]; 2],
    ) -> Self {
        let errors = || errors.iter();
        Self {
            name: name.to_owned(),
            avg_error: MeanStd::of(errors().map(|errors| errors.avg_error)),
            max_error: MeanStd::of(errors().map(|errors| errors.max_error)),
            avg_relative: MeanStd::of(errors().filter_map(|errors| errors.avg_relative)),
            max_relative: MeanStd::of(errors().filter_map(|errors| errors.max_relative)),
            coverage: Coverage::of(bands),
            coverage_of_other_objects: Coverage::of(of_other_objects),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_deviation_are_as_computed_by_hand() {
        assert_eq!(MeanStd::of([1.0, 2.0, 3.0]), Some(MeanStd { mean: 2.0, std: 1.0 }));
        assert_eq!(MeanStd::of([5.0]), Some(MeanStd { mean: 5.0, std: 0.0 }));
        assert_eq!(MeanStd::of([]), None);
    }

    #[test]
    fn the_subject_is_the_estimator_with_the_smallest_relative_error() {
        let evaluation = |rows: &[(&str, Option<f64>)]| {
            let mean = |mean| MeanStd { mean, std: 0.1 };
            let method = |&(name, relative): &(&str, Option<f64>)| MethodSummary {
                avg_error: Some(mean(if name == "ekf" { 0.1 } else { 0.2 })),
                avg_relative: relative.map(mean),
                ..MethodSummary::of(name, &[], [&[], &[]])
            };
            let methods = rows.iter().map(method).collect();
            let (joint_names, against, touches) = (Vec::new(), String::new(), Vec::new());
            Evaluation { joint_names, against, methods, touches }
        };
        let subject = |rows: &[(&str, Option<f64>)]| evaluation(rows).subject();
        let rows = [("elastic", Some(0.48)), ("map", Some(0.45)), ("gp", Some(0.3))];
        assert_eq!(subject(&rows), Some(1));
        assert_eq!(subject(&[("elastic", Some(0.4)), ("map", Some(0.45))]), Some(0));
        assert_eq!(subject(&[("map", Some(0.5)), ("ekf", Some(0.5))]), Some(0), "equal errors");
        assert_eq!(subject(&[("zero", None), ("map", None), ("ekf", None)]), Some(2), "N·m");
        assert_eq!(subject(&[("gp", Some(0.3)), ("zero", Some(1.0))]), Some(0));
        assert_eq!(subject(&[]), None);
    }

    #[test]
    fn a_touch_without_torque_is_left_out_of_the_relative_figures_alone() {
        let touch = |external: f64| HeldOutTouch {
            name: String::new(),
            fold: 0,
            time_s: vec![0.0],
            contacts: vec![1],
            known: vec![1],
            q: vec![vec![0.0]],
            external: vec![vec![external]],
            predictions: vec![MethodPrediction::new("zero", vec![vec![0.0]], &[vec![external]])],
        };
        let summary = MethodSummary::new("zero", 0, &[touch(2.0), touch(0.5)]);
        assert_eq!(summary.avg_error.unwrap().mean, 1.25);
        assert_eq!(summary.avg_relative, Some(MeanStd { mean: 1.0, std: 0.0 }));
    }
}
