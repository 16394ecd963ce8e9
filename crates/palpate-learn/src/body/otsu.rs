//! A threshold that separates numbers into two classes (Otsu 1979).

/// The threshold with the largest variance between the two classes.
pub(super) fn otsu(values: &[f64]) -> f64 {
    const BINS: usize = 256;
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let width = (high - low) / BINS as f64;
    if width.is_nan() || width <= 0.0 {
        return low - 1.0;
    }
    let mut counts = [0.0; BINS];
    for value in values {
        counts[(((value - low) / width) as usize).min(BINS - 1)] += 1.0;
    }
    let middle = |bin: usize| low + (bin as f64 + 0.5) * width;
    let total = values.len() as f64;
    let total_sum = counts.iter().enumerate().map(|(bin, n)| n * middle(bin)).sum::<f64>();
    let (mut below, mut sum, mut best) = (0.0, 0.0, (f64::NEG_INFINITY, low));
    for (bin, count) in counts.iter().enumerate() {
        below += count;
        sum += count * middle(bin);
        let between =
            (total_sum * below / total - sum).powi(2) / (below * (total - below)).max(1.0);
        if between > best.0 {
            best = (between, middle(bin));
        }
    }
    best.1
}
