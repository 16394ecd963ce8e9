//! Quantiles, extremes and bounding boxes.

/// Quantile of the numbers at `share`, from 0 to 1, by linear interpolation; `None` if there are
/// none.
pub fn quantile(numbers: &[f64], share: f64) -> Option<f64> {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = share * last as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    Some(sorted[low] + part * (sorted[(low + 1).min(last)] - sorted[low]))
}

/// Median of the numbers; `None` if there are none.
pub fn median(numbers: &[f64]) -> Option<f64> {
    quantile(numbers, 0.5)
}

/// The smallest and the largest number; `None` if there are none.
pub fn extremes(numbers: impl IntoIterator<Item = f64>) -> Option<[f64; 2]> {
    numbers.into_iter().fold(None, |so_far: Option<[f64; 2]>, x| {
        let [low, high] = so_far.unwrap_or([x, x]);
        Some([low.min(x), high.max(x)])
    })
}

/// Lowest and highest corner of the box around some points; `None` if there are none.
pub(crate) fn bounds(points: &[[f64; 3]]) -> Option<[[f64; 3]; 2]> {
    let side = |axis: usize| extremes(points.iter().map(|point| point[axis]));
    let [x, y, z] = [side(0)?, side(1)?, side(2)?];
    Some([0, 1].map(|end| [x[end], y[end], z[end]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_the_extremes_in_proportion() {
        let numbers = [4.0, 1.0, 3.0, 2.0];
        let at = |share| quantile(&numbers, share).unwrap();
        assert_eq!([at(0.0), at(0.5), at(1.0)], [1.0, 2.5, 4.0]);
        assert_eq!((median(&[]), extremes(numbers)), (None, Some([1.0, 4.0])));
    }
}
