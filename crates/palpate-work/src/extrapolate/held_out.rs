//! The error of an extrapolation on held-out touches, by which its method is chosen.

use palpate_learn::evaluation::MeanStd;
use palpate_learn::extrapolate::ExtrapolationMethod;
use palpate_learn::extrapolate::compare::{ComparisonPlan, VariantErrors};

/// Fewest touches for a comparison on halves.
pub(super) const MIN_TOUCHES: usize = 4;

/// Another method is chosen if its error is smaller by more than this share; extrapolation does not help if it
/// increases the error by more than half of this share.
const MARGIN: f64 = 0.02;

/// Torque errors of one half of the touches, predicted from the other half; mean and spread over random halves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOutErrors {
    /// Error of the field alone.
    pub without: MeanStd,
    /// Error of the field with the extrapolated stiffness in untouched cells.
    pub with: MeanStd,
    /// Whether the errors are relative (1 is that of predicting zero), or in N·m.
    pub relative: bool,
}

impl HeldOutErrors {
    /// The best method of a comparison by [`ComparisonPlan::methods`], and its errors. If none helps, the first that is
    /// better than predicting zero: on simulated plants, the first had the better order of stiffness even so.
    pub(super) fn of(
        plan: &ComparisonPlan,
        rows: &[VariantErrors],
    ) -> Option<(ExtrapolationMethod, Self)> {
        let relative = rows.iter().all(|row| !row.avg_relative.is_empty());
        let error = |row: &VariantErrors| {
            let by_half = if relative { &row.avg_relative } else { &row.avg_error };
            MeanStd::of(by_half.iter().copied())
        };
        let errors: Vec<MeanStd> = rows.iter().filter_map(error).collect();
        let [zero, without, _again, with_each @ ..] = &errors[..] else { return None };
        let mut found: Option<(ExtrapolationMethod, MeanStd)> = None;
        for (variant, &error) in plan.variants.iter().zip(with_each) {
            if found.is_none_or(|(_, best)| error.mean < (1.0 - MARGIN) * best.mean) {
                found = Some((variant.method, error));
            }
        }
        let (method, with) = found?;
        let best = Self { without: *without, with, relative };
        if !best.helps() {
            let mut each = plan.variants.iter().zip(with_each);
            if let Some((first, &with)) = each.find(|(_, error)| error.mean < zero.mean) {
                return Some((first.method, Self { with, ..best }));
            }
        }
        Some((method, best))
    }

    /// Whether predictions with the extrapolated stiffness are about as good as without, or better.
    pub(crate) fn helps(&self) -> bool {
        self.with.mean <= (1.0 + MARGIN / 2.0) * self.without.mean
    }

    /// What to say if they do not help; `fills`: whether the expected stiffness is to be written into the field.
    pub(super) fn warning(&self, fills: bool) -> String {
        let (with, without, relative) = (self.with.mean, self.without.mean, self.relative);
        let unit = if relative { " of that of predicting zero" } else { " N·m" };
        let so = if fills {
            "so the field gets no extrapolated stiffness (give --method to add it in any case)"
        } else {
            "so even the order of the stiffness in the cloud may be wrong"
        };
        format!(
            "one half of the touches was predicted from the other half: with the extrapolated stiffness, the error is \
             {with:.3}{unit}, without it {without:.3}; {so}"
        )
    }
}

#[cfg(test)]
mod tests {
    use palpate_learn::extrapolate::ExtrapolationConfig;

    use super::*;

    /// Rows of a comparison: predicting zero, without prior, learnt again from the first method, then with each method.
    fn rows(errors: [f64; 5]) -> Vec<VariantErrors> {
        let row = |error| VariantErrors {
            name: String::new(),
            avg_error: vec![error],
            avg_relative: vec![error],
        };
        errors.map(row).to_vec()
    }

    #[test]
    fn the_first_method_is_left_only_for_one_that_is_clearly_better() {
        let plan = ComparisonPlan::methods(&ExtrapolationConfig::default());
        for (errors, method, with) in [
            ([1.0, 0.8, 0.5, 0.600, 0.595], ExtrapolationMethod::Torque, 0.600),
            ([1.0, 0.8, 0.5, 0.600, 0.580], ExtrapolationMethod::Cells, 0.580),
            ([1.0, 0.8, 0.5, 0.600, 0.900], ExtrapolationMethod::Torque, 0.600),
        ] {
            let (chosen, found) = HeldOutErrors::of(&plan, &rows(errors)).unwrap();
            assert_eq!((chosen, found.with.mean, found.without.mean), (method, with, 0.8));
        }
    }

    #[test]
    fn a_method_that_predicts_worse_than_the_field_alone_does_not_help() {
        let plan = ComparisonPlan::methods(&ExtrapolationConfig::default());
        for (without, method, helps) in [
            (0.9, ExtrapolationMethod::Cells, true),
            (0.6, ExtrapolationMethod::Cells, true),
            (0.5, ExtrapolationMethod::Torque, false),
        ] {
            let (chosen, found) =
                HeldOutErrors::of(&plan, &rows([1.0, without, 0.1, 0.7, 0.6])).unwrap();
            assert_eq!((chosen, found.helps()), (method, helps), "{without}");
        }
        // Worse than predicting zero, a method says nothing about the stiffness.
        for (errors, method) in [
            ([1.0, 0.8, 0.8, 1.2, 0.9], ExtrapolationMethod::Cells),
            ([1.0, 0.8, 0.8, 1.3, 1.2], ExtrapolationMethod::Cells),
        ] {
            let (chosen, found) = HeldOutErrors::of(&plan, &rows(errors)).unwrap();
            assert_eq!((chosen, found.helps()), (method, false));
        }
    }

    #[test]
    fn faint_touches_are_compared_by_their_errors_in_newton_metres() {
        let plan = ComparisonPlan::methods(&ExtrapolationConfig::default());
        let mut faint = rows([0.4, 0.3, 0.2, 0.2, 0.1]);
        for row in &mut faint {
            row.avg_relative.clear();
            let first = row.avg_error[0];
            row.avg_error = vec![first - 0.05, first + 0.05];
        }
        let (method, found) = HeldOutErrors::of(&plan, &faint).unwrap();
        assert_eq!((method, found.relative), (ExtrapolationMethod::Cells, false));
        let MeanStd { mean, std } = found.with;
        assert!((mean - 0.1).abs() < 1e-9 && (std - 0.05 * 2_f64.sqrt()).abs() < 1e-9, "{std}");
        assert!(found.warning(true).contains("0.100 N·m"), "{found:?}");
    }
}
