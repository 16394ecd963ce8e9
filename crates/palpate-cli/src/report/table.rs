//! Table I as HTML and sentences: a one-line verdict, the rows, the paper's ratio, unusual touches.

use std::fmt::Write;

use palpate_learn::evaluation::{
    Evaluation, HeldOutTouch, MeanStd, MethodSummary, PAPER_BASELINES, PAPER_FIELD,
};

/// A column of the table.
type Figure = fn(&MethodSummary) -> Option<MeanStd>;

/// A short description of a method.
pub(super) fn gloss(method: &str) -> &'static str {
    match method {
        "elastic" => "elastic body, and map for the rest of the torque",
        "map" => "stiffness field, exact estimate",
        "ekf" => "stiffness field, the paper's Kalman filter",
        "mlp" => "multilayer perceptron from joint positions",
        "gp" => "Gaussian process from joint positions",
        "knn" => "nearest neighbours of joint positions",
        "zero" => "predicting no torque at all",
        "uniform" => "one stiffness for all points",
        _ => "",
    }
}

/// One line: the error of the report's method, and for comparison those of the best baseline and of zero.
pub(super) fn verdict(evaluation: &Evaluation) -> String {
    let Some(subject) = evaluation.subject().map(|index| &evaluation.methods[index]) else {
        return "No method was evaluated.".to_owned();
    };
    let Some(figure) = subject.avg_relative else {
        let error = subject.avg_error.map_or("none".to_owned(), |error| shown(error, 3) + " N·m");
        return format!(
            "{}: average error {error}; no touch reaches 1 N·m, so there is no relative error",
            subject.name
        );
    };
    let mut text = format!("{}: average relative error {}", subject.name, shown(figure, 2));
    if let Some((name, mean)) = evaluation.best_learnt() {
        let _ = write!(text, "; best learnt baseline {name} {mean:.2}");
    }
    let zero = evaluation.relative("zero").filter(|_| subject.name != "zero");
    if let Some(mean) = zero {
        let _ = write!(text, "; predicting zero {mean:.2}");
    }
    text
}

fn shown(figure: MeanStd, digits: usize) -> String {
    format!("{:.digits$} ± {:.digits$}", figure.mean, figure.std)
}

/// The rows of the table; the best mean of each column is bold.
pub(super) fn html(evaluation: &Evaluation) -> String {
    let columns: [(Figure, usize); 4] = [
        (|method| method.avg_error, 3),
        (|method| method.max_error, 3),
        (|method| method.avg_relative, 2),
        (|method| method.max_relative, 2),
    ];
    let best = columns.map(|(figure, _)| {
        let means = evaluation.methods.iter().filter_map(|m| Some(figure(m)?.mean));
        means.fold(f64::INFINITY, f64::min)
    });
    let mut rows = String::new();
    for method in &evaluation.methods {
        let (name, gloss) = (&method.name, gloss(&method.name));
        let _ = write!(rows, "<tr><th scope=\"row\">{name} <small>{gloss}</small></th>");
        for ((figure, digits), best) in columns.into_iter().zip(best) {
            let cell = figure(method).map_or("–".to_owned(), |MeanStd { mean, std }| {
                let tag = if mean <= best { "strong" } else { "span" };
                format!("<{tag}>{mean:.digits$}</{tag}> <small>±&nbsp;{std:.digits$}</small>")
            });
            let _ = write!(rows, "<td>{cell}</td>");
        }
        rows += "</tr>\n";
    }
    rows
}

/// The ratio of the field's error to the best learnt baseline's, here and in the paper.
pub(super) fn beside_the_paper(evaluation: &Evaluation) -> String {
    let (field, [baseline, second, third]) = (PAPER_FIELD, PAPER_BASELINES);
    let theirs = format!(
        "The paper reports, on real touches, an average relative error of {field:.2} for its \
         volumetric stiffness field against {baseline:.2}, {second:.2} and {third:.2} for its three learnt \
         baselines: a ratio of {field:.2}&nbsp;/&nbsp;{baseline:.2} = <strong>{:.2}</strong> \
         to the best of them.",
        field / baseline
    );
    let own = evaluation.subject().map(|index| &evaluation.methods[index]);
    let own = own.filter(|method| method.is_estimator());
    let ours = own.and_then(|own| Some((own, own.avg_relative?.mean, evaluation.best_learnt()?)));
    let ours = match ours {
        Some((own, error, (name, mean))) => format!(
            "Here the ratio of {} to {name}, the best learnt baseline, is \
             {error:.2}&nbsp;/&nbsp;{mean:.2} = <strong>{:.2}</strong>.",
            own.name,
            error / mean
        ),
        None => "Here there is no such ratio: it needs a method with a stiffness field, a learnt baseline, \
                 and a touch that reaches 1\u{a0}N·m."
            .into(),
    };
    format!("<p>{ours}</p>\n<p>{theirs}</p>")
}

/// Remarks on touches without a score or relative error, and on those predicted worse than by zero.
pub(super) fn remarks(evaluation: &Evaluation) -> Vec<String> {
    let Some(subject) = evaluation.subject() else { return Vec::new() };
    let method = &evaluation.methods[subject].name;
    let touches = &evaluation.touches;
    let of = |touch: &HeldOutTouch| touch.predictions[subject].errors;

    let mut remarks = Vec::new();
    let unscored = names(touches, |touch| of(touch).is_none());
    if !unscored.is_empty() {
        remarks.push(format!("Touches without a frame to score: {unscored}."));
    }
    let faint = names(touches, |touch| of(touch).is_some_and(|e| e.avg_relative.is_none()));
    if !faint.is_empty() {
        remarks.push(format!(
            "Touches that never reach 1\u{a0}N·m, and are without relative error: {faint}."
        ));
    }
    let worse: Vec<String> = touches.iter().filter_map(|touch| worse(touch, method)).collect();
    if method != "zero" {
        remarks.push(match worse.is_empty() {
            true => format!("On no touch is {method} worse than predicting zero."),
            false => format!("Here {method} is worse than predicting zero: {}.", worse.join("; ")),
        });
    }
    remarks
}

/// Names of the touches that `which` selects, separated by commas.
fn names(touches: &[HeldOutTouch], which: impl Fn(&HeldOutTouch) -> bool) -> String {
    let names = touches.iter().filter(|touch| which(touch)).map(|touch| touch.name.as_str());
    names.collect::<Vec<_>>().join(", ")
}

/// If a touch is predicted worse than by zero: its name, by how much, and why.
fn worse(touch: &HeldOutTouch, method: &str) -> Option<String> {
    let (error, zero) = (touch.errors(method)?.avg_error, touch.zero()?.avg_error);
    (error > zero).then(|| {
        let more = 100.0 * (error / zero - 1.0);
        let (name, why) = (&touch.name, touch.failure_reason(method).unwrap_or_default());
        format!("{name} by {more:.0}\u{a0}% ({error:.3} against {zero:.3}\u{a0}N·m): {why}")
    })
}

#[cfg(test)]
mod tests {
    use palpate_learn::evaluation::MethodPrediction;

    use super::*;
    use crate::example;

    #[test]
    fn the_verdict_stands_beside_the_best_baseline_and_zero() {
        let mut evaluation = example::evaluation();
        let relative = |mean| Some(MeanStd { mean, std: 0.09 });
        for (method, mean) in evaluation.methods.iter_mut().zip([0.32, 0.95, 1.2, 1.0]) {
            method.avg_relative = relative(mean);
        }
        assert_eq!(
            verdict(&evaluation),
            "map: average relative error 0.32 ± 0.09; best learnt baseline gp 0.95; \
             predicting zero 1.00"
        );
        assert!(beside_the_paper(&evaluation).contains("0.32&nbsp;/&nbsp;0.95 = <strong>0.34<"));
        let better = MethodSummary { name: "ekf".into(), ..evaluation.methods[0].clone() };
        evaluation.methods.push(MethodSummary { avg_relative: relative(0.3), ..better });
        assert!(verdict(&evaluation).starts_with("ekf: average relative error 0.30 ± 0.09"));
        assert!(beside_the_paper(&evaluation).contains("the ratio of ekf to gp"));
        evaluation.methods.pop();
        evaluation.methods[0].avg_relative = None;
        assert!(verdict(&evaluation).contains("no touch reaches 1 N·m"));
    }

    #[test]
    fn one_mean_of_each_column_is_bold() {
        let html = html(&example::evaluation());
        assert_eq!(html.matches("<strong>").count(), 4);
        assert_eq!(html.matches("<tr>").count(), 4);
    }

    #[test]
    fn faint_touches_and_those_worse_than_zero_are_named() {
        let mut evaluation = example::evaluation();
        let clean = remarks(&evaluation);
        assert_eq!(clean, ["On no touch is map worse than predicting zero."]);

        let touch = &mut evaluation.touches[1];
        touch.external.iter_mut().for_each(|tau| tau.fill(0.1));
        let twice = vec![vec![0.3; 7]; touch.external.len()];
        touch.predictions[0] = MethodPrediction::new("map", twice, &touch.external);
        let text = remarks(&evaluation).join("\n");
        assert!(text.contains("without relative error: second <touch>."), "{text}");
        assert!(text.contains("second <touch> by 100\u{a0}% (0.529 against 0.265"), "{text}");
    }
}
