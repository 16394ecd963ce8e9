//! The bounded memory of past frames, and the order in which they are replayed.
//!
//! The number of frames and their bytes are limited; when either limit is reached, randomly chosen frames are removed,
//! so that old touches are thinned out gradually. Draws come from a seeded generator that is the same on every platform
//! and can be saved and continued. Frames may be of any type.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use crate::estimator::FrameId;

/// Limits of the memory of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct MemoryLimits {
    /// Number of frames.
    pub frames: usize,
    /// Bytes of all frames together.
    pub bytes: usize,
}

/// State of a random generator, enough to continue it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct RngState {
    /// Its seed.
    pub seed: u64,
    /// Number of words drawn so far.
    pub drawn: u64,
}

/// Identity, size and score of a frame.
#[derive(Debug, Clone, Copy)]
struct Note {
    id: FrameId,
    bytes: usize,
    score: f64,
}

/// Frames that may be replayed, each with its identity, its bytes and a score.
#[derive(Debug, Clone)]
pub(crate) struct ReplayMemory<T> {
    frames: Vec<T>,
    /// One for each frame.
    notes: Vec<Note>,
    bytes: usize,
    limits: MemoryLimits,
    rng: ChaCha8Rng,
    seed: u64,
}

impl<T> ReplayMemory<T> {
    /// An empty memory.
    pub(crate) fn new(limits: MemoryLimits, seed: u64) -> Self {
        Self::resume(limits, RngState { seed, drawn: 0 })
    }

    /// An empty memory whose random generator continues from a saved state.
    pub(crate) fn resume(limits: MemoryLimits, state: RngState) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(state.seed);
        rng.set_word_pos(u128::from(state.drawn));
        Self { frames: Vec::new(), notes: Vec::new(), bytes: 0, limits, rng, seed: state.seed }
    }

    /// The limits.
    pub(crate) fn limits(&self) -> MemoryLimits {
        self.limits
    }

    /// State of the random generator.
    pub(crate) fn rng_state(&self) -> RngState {
        RngState { seed: self.seed, drawn: self.rng.get_word_pos() as u64 }
    }

    /// Adds a frame of a given size and score, unless it is larger than the whole memory; randomly drawn frames are
    /// removed to make room.
    pub(crate) fn push(&mut self, frame: T, id: FrameId, bytes: usize, score: f64) {
        if self.limits.frames == 0 || bytes > self.limits.bytes {
            return;
        }
        while self.frames.len() >= self.limits.frames || self.bytes + bytes > self.limits.bytes {
            let victim = self.draw().expect("a memory that is too full holds a frame");
            self.remove(victim);
        }
        self.frames.push(frame);
        self.notes.push(Note { id, bytes, score });
        self.bytes += bytes;
    }

    /// Draws the index of a frame, uniformly; `None` if there is no frame.
    pub(crate) fn draw(&mut self) -> Option<usize> {
        let n = self.frames.len() as u64;
        // Multiply and shift maps 32 random bits onto 0..n; its bias is below n / 2³².
        (n > 0).then(|| ((u64::from(self.rng.next_u32()) * n) >> 32) as usize)
    }

    /// Draws `tries` frames and returns the index of the one with the highest score; `None` if there is no frame.
    pub(crate) fn draw_best(&mut self, tries: u32) -> Option<usize> {
        let mut best = self.draw()?;
        for _ in 1..tries {
            let other = self.draw()?;
            if self.notes[other].score > self.notes[best].score {
                best = other;
            }
        }
        Some(best)
    }

    /// Removes a frame; the last frame gets its index.
    ///
    /// # Panics
    ///
    /// If there is no such frame, which is a bug in the caller.
    pub(crate) fn remove(&mut self, frame: usize) -> T {
        self.bytes -= self.notes.swap_remove(frame).bytes;
        self.frames.swap_remove(frame)
    }

    /// Removes all frames of a touch.
    pub(crate) fn remove_touch(&mut self, touch: u32) {
        let kept: Vec<bool> = self.notes.iter().map(|note| note.id.touch != touch).collect();
        let mut keep = kept.iter();
        self.frames.retain(|_| keep.next().is_some_and(|keep| *keep));
        self.notes.retain(|note| note.id.touch != touch);
        self.bytes = self.notes.iter().map(|note| note.bytes).sum();
    }

    /// About `most` frames, evenly chosen, with their identities.
    pub(crate) fn some(&self, most: usize) -> impl Iterator<Item = (FrameId, &T)> {
        let every = self.frames.len().div_ceil(most.max(1)).max(1);
        self.ids().zip(&self.frames).step_by(every)
    }

    /// The frames in their present order.
    pub(crate) fn frames(&self) -> &[T] {
        &self.frames
    }

    /// The frames, to be changed in place; their sizes must stay.
    pub(crate) fn frames_mut(&mut self) -> &mut [T] {
        &mut self.frames
    }

    /// The frames' identities in the same order.
    pub(crate) fn ids(&self) -> impl Iterator<Item = FrameId> {
        self.notes.iter().map(|note| note.id)
    }

    /// The frames' scores in the same order.
    pub(crate) fn scores(&self) -> impl Iterator<Item = f64> {
        self.notes.iter().map(|note| note.score)
    }

    /// Sets the score of a frame.
    ///
    /// # Panics
    ///
    /// If there is no such frame, which is a bug in the caller.
    pub(crate) fn set_score(&mut self, frame: usize, score: f64) {
        self.notes[frame].score = score;
    }

    /// Bytes that the frames hold.
    pub(crate) fn bytes(&self) -> usize {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: FrameId = FrameId { touch: 0, sample: 0 };

    #[test]
    fn memory_stays_within_both_limits_and_holds_the_latest_frame() {
        let mut memory = ReplayMemory::new(MemoryLimits { frames: 10, bytes: 100 }, 7);
        for frame in 0..1000_usize {
            memory.push(frame, ID, 1 + frame % 30, 0.0);
            assert!(memory.frames().len() <= 10 && memory.bytes() <= 100);
            assert_eq!(memory.bytes(), memory.frames().iter().map(|n| 1 + n % 30).sum::<usize>());
            assert_eq!(memory.frames().last(), Some(&frame));
        }
    }

    #[test]
    fn a_frame_larger_than_the_memory_evicts_no_other() {
        let mut memory = ReplayMemory::new(MemoryLimits { frames: 10, bytes: 100 }, 7);
        memory.push('a', ID, 60, 0.0);
        memory.push('b', ID, 101, 0.0);
        assert_eq!(memory.frames(), ['a']);
    }

    #[test]
    fn removing_a_touch_frees_its_bytes() {
        let mut memory = ReplayMemory::new(MemoryLimits { frames: 10, bytes: 100 }, 7);
        for frame in 0..6 {
            memory.push(frame, FrameId { touch: frame as u32 % 2, sample: 0 }, 1 + frame, 0.0);
        }
        memory.remove_touch(0);
        assert_eq!((memory.frames(), memory.bytes()), (&[1, 3, 5][..], 2 + 4 + 6));
    }

    #[test]
    fn the_best_of_many_draws_has_the_highest_score_in_memory() {
        let mut memory = ReplayMemory::new(MemoryLimits { frames: 10, bytes: 100 }, 7);
        assert_eq!(memory.draw_best(3), None);
        for frame in [3, 9, 1] {
            memory.push(frame, ID, 1, f64::from(frame));
        }
        assert_eq!(memory.draw_best(100), Some(1));
        memory.set_score(2, 10.0);
        assert_eq!(memory.draw_best(100), Some(2));
        let single: Vec<_> = (0..100).map(|_| memory.draw_best(1).unwrap()).collect();
        assert!((0..3).all(|frame| single.contains(&frame)));
    }

    #[test]
    fn draws_are_uniform_and_continue_from_a_saved_generator() {
        let mut memory = ReplayMemory::new(MemoryLimits { frames: 8, bytes: 8 }, 7);
        for frame in 0..8 {
            memory.push(frame, ID, 1, f64::from(frame));
        }
        let mut counts = [0_u32; 8];
        for _ in 0..8000 {
            counts[memory.draw().unwrap()] += 1;
        }
        assert!(counts.iter().all(|&n| (800..1200).contains(&n)), "{counts:?}");

        let mut resumed =
            ReplayMemory::resume(MemoryLimits { frames: 8, bytes: 8 }, memory.rng_state());
        for frame in 0..8 {
            resumed.push(frame, ID, 1, 0.0);
        }
        let draws =
            |memory: &mut ReplayMemory<i32>| (0..50).map(|_| memory.draw()).collect::<Vec<_>>();
        assert_eq!(draws(&mut memory), draws(&mut resumed));
    }
}
