//! A median that needs no sorted copy.

/// The median; of an even count, the upper of the two in the middle. `None` if there are none. Reorders the numbers.
pub(crate) fn upper_median(numbers: &mut [f64]) -> Option<f64> {
    let middle = numbers.len() / 2;
    (!numbers.is_empty()).then(|| *numbers.select_nth_unstable_by(middle, f64::total_cmp).1)
}
