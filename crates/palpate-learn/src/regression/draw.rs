//! Subsets and random order of frames.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

/// `wanted` of `0..n`, evenly spread; all of them if there are no more.
pub(super) fn thinned(n: usize, wanted: usize) -> Vec<usize> {
    let wanted = wanted.min(n);
    (0..wanted).map(|index| index * n / wanted).collect()
}

/// Puts items into random order (Fisher and Yates).
pub(crate) fn shuffle(items: &mut [usize], rng: &mut ChaCha8Rng) {
    for last in (1..items.len()).rev() {
        // Multiply and shift maps 32 random bits onto 0..=last; its bias is below n / 2³².
        let other = (u64::from(rng.next_u32()) * (last as u64 + 1)) >> 32;
        items.swap(last, other as usize);
    }
}
