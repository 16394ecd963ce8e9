//! The summary of an evaluation, as text and as JSON.

use std::fmt::Write;
use std::path::PathBuf;

use palpate_learn::evaluation::{
    Evaluation, HeldOutTouch, MeanStd, MethodSummary, PAPER_BASELINES, PAPER_FIELD,
};
use palpate_work::contact_counts::ContactCounts;
use palpate_work::prediction_report::ErrorFigures;
use serde_json::json;

use crate::output::{Output, table};
use crate::predict::bands;

/// An evaluation, and what else its summary needs.
pub(crate) struct EvaluationSummary {
    pub(crate) evaluation: Evaluation,
    pub(crate) simulated: bool,
    pub(crate) folds: usize,
    /// Where the report is, if it could be written.
    pub(crate) folder: Option<PathBuf>,
}

impl EvaluationSummary {
    /// What `--json` prints: the table, and the errors of every touch.
    pub(crate) fn json(&self) -> serde_json::Value {
        let touch = |touch: &HeldOutTouch| {
            let methods = touch.predictions.iter().map(|prediction| {
                let mut method = json!(ErrorFigures::from(prediction.errors));
                method["name"] = json!(prediction.method);
                method
            });
            json!({
                "name": touch.name,
                "fold": touch.fold,
                "frames": touch.external.len(),
                "frames_in_contact": touched(touch).frames_in_contact(),
                "methods": methods.collect::<Vec<_>>(),
            })
        };
        json!({
            "methods": self.evaluation.methods,
            "touches": self.evaluation.touches.iter().map(touch).collect::<Vec<_>>(),
            "against": self.evaluation.against,
            "simulated": self.simulated,
            "folds": self.folds,
            "folder": self.folder,
        })
    }

    /// How the touches were divided.
    fn protocol(&self) -> String {
        match self.folds {
            1 => "Touches of --test, predicted from all others".to_owned(),
            n if n == self.evaluation.touches.len() => "Leave-one-touch-out".to_owned(),
            n => format!("{n} folds"),
        }
    }

    /// The report's heading.
    pub(crate) fn title(&self) -> String {
        format!("{}: {} touches", self.protocol(), self.evaluation.touches.len())
    }

    /// Table I as text, with explanations.
    pub(crate) fn text(&self) -> String {
        let touches = &self.evaluation.touches;
        let frames: usize = touches.iter().map(|touch| touch.external.len()).sum();
        let protocol = self.protocol();
        let torques = if self.evaluation.against == "truth" { "true" } else { "measured" };
        let simulated = if self.simulated { "\nThe touches are simulated." } else { "" };
        let mut text = format!(
            "{protocol}: {} touches, {frames} frames, against {torques} external torques.{simulated}\n\
             Error of the predicted torque, N·m over all joints, and relative on frames of at least\n\
             1 N·m: mean ± standard deviation over touches.\n\n",
            touches.len()
        );
        let head = ["method", "average", "largest", "av. rel.", "max. rel."];
        text += &table(&head, self.evaluation.methods.iter().map(row));
        text.push('\n');
        for method in &self.evaluation.methods {
            let of_others = method.coverage_of_other_objects.as_ref();
            let is_of_others = of_others == method.coverage.as_ref();
            if let Some(coverage) = &method.coverage {
                let from = if is_of_others { ", calibrated on other objects" } else { "" };
                text += &bands(&format!("Bands of {}{from}", method.name), coverage);
            }
            if let Some(others) = of_others.filter(|_| !is_of_others) {
                let _ = writeln!(
                    text,
                    "Bands calibrated on other objects would contain {:.0} % of the torques and {:.0} % of the \
                     largest ones; mean half-width {:.3} N·m.",
                    100.0 * others.torque_share,
                    100.0 * others.peak_share,
                    others.half_width_n_m
                );
            }
        }
        if let Some(ratio) = self.ratio_to_baselines() {
            let _ = writeln!(text, "{ratio}");
        }
        if let Some(folder) = &self.folder {
            let _ = writeln!(text, "The report is in `{}`.", folder.join("report.html").display());
        }
        text
    }

    /// Error of the estimator with the smallest one relative to the best baseline that learns from joint angles, here
    /// and in the paper.
    fn ratio_to_baselines(&self) -> Option<String> {
        let (name, best) = self.evaluation.best_learnt()?;
        let own = self.estimator()?;
        let error = own.avg_relative?.mean;
        Some(format!(
            "{}'s average relative error is {:.2} times that of {name}, the best that learns from \
             joint\nangles alone. In the paper, on a real arm: field {PAPER_FIELD:.2}, its three baselines {:.2}, \
             {:.2} and {:.2},\nso {:.2} times the best.",
            own.name,
            error / best,
            PAPER_BASELINES[0],
            PAPER_BASELINES[1],
            PAPER_BASELINES[2],
            PAPER_FIELD / PAPER_BASELINES[0],
        ))
    }

    /// The method of the report's heading, if it is an estimator.
    fn estimator(&self) -> Option<&MethodSummary> {
        let own = &self.evaluation.methods[self.evaluation.subject()?];
        own.is_estimator().then_some(own)
    }

    /// Notes unusual touches: not scored, without relative error or contact, or worse than zero.
    pub(crate) fn note_oddities(&self, output: &Output) {
        for touch in &self.evaluation.touches {
            let name = &touch.name;
            if touch.external.is_empty() {
                output.note(&format!(
                    "touch `{name}` never leaves its contact-free start: nothing was scored"
                ));
                continue;
            }
            let any = touch.predictions.first().and_then(|prediction| prediction.errors);
            if any.is_some_and(|errors| errors.avg_relative.is_none()) {
                output.note(&format!(
                    "touch `{name}` never reaches 1 N·m: it has no relative error, and is left \
                     out of those two columns"
                ));
            }
            if touched(touch).frames_in_contact() == 0 {
                output.note(&format!("touch `{name}` touches no point of the lattice"));
            }
            if let Some(method) = self.estimator().map(|own| &own.name)
                && let (Some(own), Some(zero)) = (touch.errors(method), touch.zero())
                && own.avg_error > zero.avg_error
            {
                output.note(&format!(
                    "touch `{name}`: {method} is worse than predicting zero, {:.3} against {:.3} N·m \
                     on average: {}",
                    own.avg_error,
                    zero.avg_error,
                    touch.failure_reason(method).unwrap_or_default()
                ));
            }
        }
    }
}

/// How many points a touch displaces in each of its scored frames.
fn touched(touch: &HeldOutTouch) -> ContactCounts {
    touch.contacts.iter().map(|&points| points as usize).collect()
}

fn row(method: &MethodSummary) -> Vec<String> {
    let shown = |figure: Option<MeanStd>, digits: usize| match figure {
        Some(MeanStd { mean, std }) => format!("{mean:.digits$} ± {std:.digits$}"),
        None => "-".to_owned(),
    };
    vec![
        method.name.clone(),
        shown(method.avg_error, 3),
        shown(method.max_error, 3),
        shown(method.avg_relative, 2),
        shown(method.max_relative, 2),
    ]
}
