//! Rank statistics: area under the ROC curve, and Spearman's correlation.

/// Ranks, from 1; equal values get the mean of their ranks.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    while from < order.len() {
        let alike =
            order[from..].iter().take_while(|&&at| values[at] == values[order[from]]).count();
        let rank = from as f64 + (alike + 1) as f64 / 2.0;
        order[from..from + alike].iter().for_each(|&at| ranks[at] = rank);
        from += alike;
    }
    ranks
}

/// The probability that a positive has a larger score than a negative, where equal scores count
/// half; `None` without a positive or without a negative.
pub fn area_under_roc(scores: &[f64], positive: &[bool]) -> Option<f64> {
    let positives = positive.iter().filter(|positive| **positive).count();
    let negatives = positive.len() - positives;
    if positives == 0 || negatives == 0 {
        return None;
    }
    let ranks = ranks(scores);
    let sum: f64 = ranks.iter().zip(positive).filter(|(_, p)| **p).map(|(rank, _)| rank).sum();
    let (positives, negatives) = (positives as f64, negatives as f64);
    Some((sum - positives * (positives + 1.0) / 2.0) / (positives * negatives))
}

/// Pearson's correlation of the ranks; `None` if one of the two is constant.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    let [a, b] = [ranks(a), ranks(b)];
    let mean = (a.len() + 1) as f64 / 2.0;
    let product =
        |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
    let scale = (product(&a, &a) * product(&b, &b)).sqrt();
    (scale > 0.0).then(|| product(&a, &b) / scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_are_as_computed_by_hand() {
        let positive = [false, false, true, true];
        assert_eq!(area_under_roc(&[1.0, 2.0, 3.0, 4.0], &positive), Some(1.0));
        assert_eq!(area_under_roc(&[4.0, 3.0, 2.0, 1.0], &positive), Some(0.0));
        assert_eq!(area_under_roc(&[1.0, 1.0, 1.0, 1.0], &positive), Some(0.5));
        assert_eq!(area_under_roc(&[1.0, 3.0, 2.0, 4.0], &positive), Some(0.75));
        assert_eq!(area_under_roc(&[1.0], &[true]), None);
    }

    #[test]
    fn rank_correlation_ignores_monotonic_functions_and_ties_share_a_rank() {
        let a = [0.1, 0.5, 0.2, 9.0];
        assert_eq!(spearman(&a, &a.map(f64::exp)), Some(1.0));
        assert_eq!(spearman(&a, &a.map(|x| -x)), Some(-1.0));
        assert_eq!(spearman(&a, &[1.0; 4]), None);
        assert_eq!(ranks(&[2.0, 1.0, 2.0]), [2.5, 1.0, 2.5]);
    }
}
