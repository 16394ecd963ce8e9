//! Numbers of pixels of an image that did not become points, by reason.

use std::fmt;

/// Numbers of pixels that were left out; each is counted once, for the first reason that applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DroppedPixels {
    /// Without a depth: zero, negative or not finite.
    pub without_depth: usize,
    /// Outside of the depth range.
    pub out_of_range: usize,
    /// Flying between an object and its background.
    pub flying: usize,
    /// Where the lens model has no inverse.
    pub outside_lens_model: usize,
    /// Outside of the crop box.
    pub outside_box: usize,
}

impl fmt::Display for DroppedPixels {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { without_depth, out_of_range, flying, outside_lens_model, outside_box } = self;
        write!(
            out,
            "{without_depth} have no depth, {out_of_range} are out of range, {flying} fly \
             between object and background, {outside_lens_model} are where the lens model has no \
             inverse, {outside_box} are outside of the box"
        )
    }
}

impl DroppedPixels {
    /// Advice for the case that no pixel is left, by the most frequent reason.
    pub(super) fn remedy(&self) -> &'static str {
        let of_most = [
            (self.without_depth, "look at the depth image: it may be the wrong file"),
            (self.out_of_range, "widen the depth range"),
            (self.outside_box, "widen the box, or look at the camera's pose"),
            (self.outside_lens_model, "look at the distortion coefficients"),
            (
                self.flying,
                "the depth is too noisy to distinguish edges from objects; keep the flying pixels",
            ),
        ];
        // `max_by_key` takes the last of equal counts: with `rev`, the first in the list.
        of_most.into_iter().rev().max_by_key(|(count, _)| *count).map_or("", |(_, remedy)| remedy)
    }
}
