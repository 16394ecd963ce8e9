//! Folds of cross-validation: which touches are learnt from, and which are predicted.

/// One division of the touches, by index, into test and training touches.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fold {
    /// Predicted, and never learnt from.
    pub test: Vec<usize>,
    /// Learnt from, in this order.
    pub train: Vec<usize>,
}

impl Fold {
    /// The fold that predicts the touches `test` and learns from all others of `touches`.
    pub fn testing(test: Vec<usize>, touches: usize) -> Self {
        let train = (0..touches).filter(|touch| !test.contains(touch)).collect();
        Self { test, train }
    }
}

/// Every touch is predicted once, in `folds` groups of about the same size: touch `i` is in fold
/// `i mod folds`. With as many folds as touches this is leave-one-touch-out.
pub fn folds(touches: usize, folds: usize) -> Vec<Fold> {
    let group = |fold: usize| (fold..touches).step_by(folds.max(1)).collect();
    (0..folds.min(touches)).map(|fold| Fold::testing(group(fold), touches)).collect()
}

/// [`folds`] of a subset of the touches, given by their indices.
pub(crate) fn among(touches: &[usize], n: usize) -> Vec<Fold> {
    let named = |places: Vec<usize>| places.into_iter().map(|place| touches[place]).collect();
    let inner = |fold: Fold| Fold { test: named(fold.test), train: named(fold.train) };
    folds(touches.len(), n).into_iter().map(inner).collect()
}

/// Fewest touches for a calibration of bands.
pub(crate) const FEWEST: usize = 3;
/// Most folds of a calibration; with more touches, groups of them are held out.
const MAX_FOLDS: usize = 16;

/// The folds on which bands are calibrated; none with fewer than [`FEWEST`] touches.
pub(crate) fn inner_folds(train: &[usize]) -> Vec<Fold> {
    if train.len() < FEWEST { Vec::new() } else { among(train, train.len().min(MAX_FOLDS)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_touch_is_tested_once_and_never_learnt_from_in_its_fold() {
        for (touches, n) in [(11, 11), (11, 3), (2, 2), (5, 9), (7, 1)] {
            let folds = folds(touches, n);
            let mut tested: Vec<usize> = folds.iter().flat_map(|fold| fold.test.clone()).collect();
            tested.sort_unstable();
            assert_eq!(tested, (0..touches).collect::<Vec<_>>());
            for fold in &folds {
                assert!(fold.test.iter().all(|touch| !fold.train.contains(touch)));
                assert_eq!(fold.test.len() + fold.train.len(), touches);
            }
        }
    }
}
