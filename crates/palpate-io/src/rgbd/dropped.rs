//! An account of the pixels of a picture that did not become points.

use std::fmt;

/// How many pixels were left out; each is counted once, for the first reason that applies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// No depth: zero, negative or not finite.
    pub without_depth: usize,
    /// Nearer or farther than wanted.
    pub out_of_range: usize,
    /// Hanging between an object and what is behind it.
    pub flying: usize,
    /// Where the lens, as calibrated, cannot show anything.
    pub beyond_lens: usize,
    /// Outside of the box.
    pub outside_box: usize,
}

impl fmt::Display for Dropped {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { without_depth, out_of_range, flying, beyond_lens, outside_box } = self;
        write!(
            out,
            "{without_depth} have no depth, {out_of_range} are out of range, {flying} hang in the \
             air, {beyond_lens} lie beyond the lens, {outside_box} outside of the box"
        )
    }
}

impl Dropped {
    /// What to do if nothing is left, by what took most.
    pub(super) fn remedy(&self) -> &'static str {
        let of_most = [
            (self.without_depth, "look at the depth image: it may be the wrong file"),
            (self.out_of_range, "widen the depth range"),
            (self.outside_box, "widen the box, or look at the camera's pose"),
            (self.beyond_lens, "look at the distortion coefficients"),
            (
                self.flying,
                "the depth is too noisy to distinguish edges from objects; keep flying pixels",
            ),
        ];
        // Of equal counts the first one counts.
        of_most.into_iter().rev().max_by_key(|(count, _)| *count).map_or("", |(_, remedy)| remedy)
    }
}
