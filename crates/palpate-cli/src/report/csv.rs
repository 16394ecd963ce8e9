//! Table I for each touch, as CSV.

use palpate_learn::evaluation::Evaluation;
use palpate_work::csv;
use palpate_work::prediction_report::ErrorFigures;

/// One row for each method and touch: the four errors, empty if a touch has none.
pub(crate) fn errors_csv(evaluation: &Evaluation) -> String {
    let head = ["method", "touch", "avg_error", "max_error", "avg_relative", "max_relative"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for (index, method) in evaluation.methods.iter().enumerate() {
        for touch in &evaluation.touches {
            let figures = ErrorFigures::from(touch.predictions[index].errors);
            let ErrorFigures { avg_error, max_error, avg_relative, max_relative } = figures;
            let figures = [avg_error, max_error, avg_relative, max_relative]
                .map(|figure| figure.map(|figure| format!("{figure:.6}")).unwrap_or_default());
            rows.push(
                [method.name.clone(), touch.name.clone()].into_iter().chain(figures).collect(),
            );
        }
    }
    csv::text(rows)
}

#[cfg(test)]
mod tests {
    use palpate_learn::evaluation::{HeldOutTouch, MethodPrediction, MethodSummary};

    use super::*;

    #[test]
    fn a_touch_without_torque_has_no_relative_figures() {
        let external = vec![vec![0.5, 0.0]];
        let touches = vec![HeldOutTouch {
            name: "a,b".to_owned(),
            fold: 0,
            time_s: vec![0.0],
            contacts: vec![0],
            known: vec![0],
            q: vec![vec![0.0; 2]],
            predictions: vec![MethodPrediction::new("zero", vec![vec![0.0; 2]], &external)],
            external,
        }];
        let evaluation = Evaluation {
            joint_names: vec!["one".to_owned(), "two".to_owned()],
            against: "truth".to_owned(),
            methods: vec![MethodSummary::new("zero", 0, &touches)],
            touches,
        };
        let expected = "method,touch,avg_error,max_error,avg_relative,max_relative\n\
                        zero,\"a,b\",0.500000,0.500000,,\n";
        assert_eq!(errors_csv(&evaluation), expected);
    }
}
