//! Which frames of a touch a page draws: long touches are thinned evenly, since a screen cannot show
//! more.

use palpate_learn::evaluation::Evaluation;

/// Largest number of frames drawn of a touch.
const FRAMES: usize = 400;
/// Largest number of frames drawn of all touches together, as long as each has [`FRAMES_AT_LEAST`].
const FRAMES_IN_ALL: usize = 5_000;
/// Number of frames that a touch keeps even if there are many touches.
const FRAMES_AT_LEAST: usize = 40;

/// Largest number of frames drawn of each touch.
pub(super) fn frames_per_touch(evaluation: &Evaluation) -> usize {
    (FRAMES_IN_ALL / evaluation.touches.len().max(1)).clamp(FRAMES_AT_LEAST, FRAMES)
}

/// The frames drawn of a touch that has this number of `frames`.
pub(super) fn drawn(frames: usize, at_most: usize) -> impl Iterator<Item = usize> {
    (0..frames).step_by(stride(frames, at_most))
}

/// The number n such that every n-th frame is drawn.
pub(super) fn stride(frames: usize, at_most: usize) -> usize {
    frames.div_ceil(at_most).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example;

    #[test]
    fn long_touches_are_thinned_and_short_ones_are_not() {
        assert_eq!(drawn(400, 400).count(), 400);
        assert_eq!(drawn(1000, 400).collect::<Vec<_>>()[..3], [0, 3, 6]);
        assert!(drawn(1000, 400).count() <= 400);
        assert_eq!(drawn(0, 400).count(), 0);
        let mut evaluation = example::evaluation();
        evaluation.touches = evaluation.touches.iter().cycle().take(30).cloned().collect();
        assert!(30 * frames_per_touch(&evaluation) <= FRAMES_IN_ALL);
    }
}
