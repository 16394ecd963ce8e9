//! The lower bound: the least time that this machine needs to visit one contact.
//!
//! A *visit* of `map` reads the data of each contact in a remembered frame, predicts with them and
//! corrects. With the memory layout of the core, these bytes must be read from memory or written to it:
//!
//! | of       | what                               | bytes |
//! |----------|------------------------------------|-------|
//! | a frame  | displacement, row                  | 12, 4 |
//! | a cell   | rest point, its unknown z          | 24, 8 |
//! | a cell   | z, written back                    | 8     |
//!
//! Divided by the bandwidth at which one thread reads a buffer larger than the caches, they give the
//! lower bound. If the cells stay in the cache, only the 16 bytes of the frame come from memory: a
//! visit may be faster than the first bound, but never faster than this second one. `ekf` moves more
//! bytes (also a variance and its step) and is compared with the same bounds.
//!
//! Arithmetic is measured as fused multiply-adds in the registers that the sums over contacts use.

use std::hint::black_box;
use std::time::Instant;

use pulp::bytemuck::cast_slice;
use pulp::{Arch, Simd, WithSimd};
use serde::Serialize;

use crate::rounds::middle;

/// Bytes of one contact in a remembered frame: displacement (12) and row (4).
const FRAME_BYTES: f64 = 16.0;
/// Bytes of one cell: rest point (24) and unknown (8).
const CELL_BYTES: f64 = 32.0;
/// Bytes of the unknown, which is written back.
const WRITTEN_BYTES: f64 = 8.0;
/// Bytes that a visit of one contact moves.
const VISIT_BYTES: f64 = FRAME_BYTES + CELL_BYTES + WRITTEN_BYTES;
/// Fused multiply-adds of a visit of one contact: to predict, K (1), the force (3), its sum (3) and
/// that of its moment (6); to correct, the velocity (6), its product with the displacement (3) and
/// z (1).
const VISIT_OPERATIONS: f64 = 23.0;

/// Size of the buffer that is read, bytes: far larger than the caches of most machines.
const BUFFER_BYTES: usize = 256 << 20;
/// Smallest size of the buffer that is tried if memory is short, bytes.
const MIN_BUFFER_BYTES: usize = 16 << 20;
/// Number of runs of each measurement; their median counts.
const SWEEPS: usize = 15;
/// Number of independent sums, so that the memory limits the time and not the additions.
const LANES: usize = 16;

/// Number of independent chains of multiply-adds, which leaves registers for factor and summand.
const CHAINS: usize = 12;
/// Length of each chain in one measurement.
const ROUNDS: u32 = 1_000_000;

/// The measured speed of the machine, and the lower bounds that follow from it.
#[derive(Debug, Serialize)]
pub(crate) struct LowerBound {
    /// Sequential reads of one thread, 10⁹ bytes per second.
    pub(crate) bandwidth_gb_per_s: f64,
    /// Fused multiply-adds of one thread in registers, f64, 10⁹ per second.
    pub(crate) goperations_per_s: f64,
    /// Time of a visit of one contact at this bandwidth, ns.
    pub(crate) ns_per_visit: f64,
    /// Time of a visit if only the frame comes from memory, ns.
    pub(crate) frame_only_ns_per_visit: f64,
    /// Time of a visit of one contact at this rate of arithmetic, ns.
    pub(crate) arithmetic_ns_per_visit: f64,
}

impl LowerBound {
    /// Measures the machine, which takes less than a second and 256 MiB of memory.
    pub(crate) fn measure() -> Self {
        Self::of(bandwidth_gb_per_s(), goperations_per_s())
    }

    /// The bounds of a machine.
    fn of(bandwidth_gb_per_s: f64, goperations_per_s: f64) -> Self {
        // 10⁹ per second is one per nanosecond.
        Self {
            bandwidth_gb_per_s,
            goperations_per_s,
            ns_per_visit: VISIT_BYTES / bandwidth_gb_per_s,
            frame_only_ns_per_visit: FRAME_BYTES / bandwidth_gb_per_s,
            arithmetic_ns_per_visit: VISIT_OPERATIONS / goperations_per_s,
        }
    }

    /// The bounds as two lines of text.
    pub(crate) fn text(&self) -> String {
        format!(
            "the least that memory allows      {:.2} ns: {VISIT_BYTES} bytes at {:.1} GB/s ({:.2} \
             ns if only the frame moves)\n\
             the least that arithmetic allows  {:.2} ns: {VISIT_OPERATIONS} operations at {:.1} \
             billion per second\n",
            self.ns_per_visit,
            self.bandwidth_gb_per_s,
            self.frame_only_ns_per_visit,
            self.arithmetic_ns_per_visit,
            self.goperations_per_s
        )
    }
}

/// Bandwidth of sequential reads of one thread, 10⁹ bytes per second.
fn bandwidth_gb_per_s() -> f64 {
    let buffer = buffer();
    let bytes = size_of_val(buffer.as_slice()) as f64;
    median_rate(bytes, || {
        black_box(sum(black_box(&buffer)));
    })
}

/// A buffer, smaller if memory is short, with every page written.
fn buffer() -> Vec<u64> {
    let mut buffer = Vec::new();
    let mut bytes = BUFFER_BYTES;
    while buffer.try_reserve_exact(bytes / size_of::<u64>()).is_err() && bytes > MIN_BUFFER_BYTES {
        bytes /= 2;
    }
    // Pages that were never written all map to the same page of zeros, which stays in a cache.
    buffer.extend(1..=(bytes / size_of::<u64>()) as u64);
    buffer
}

fn sum(buffer: &[u64]) -> u64 {
    let mut lanes = [0_u64; LANES];
    for group in buffer.chunks_exact(LANES) {
        for (lane, number) in lanes.iter_mut().zip(group) {
            *lane = lane.wrapping_add(*number);
        }
    }
    lanes.iter().fold(0, |total, lane| total.wrapping_add(*lane))
}

/// Fused multiply-adds of one thread, 10⁹ per second.
fn goperations_per_s() -> f64 {
    let arch = Arch::new();
    let work = MultiplyAdd { factor: 0.999, summand: 1e-3 };
    let lanes = arch.dispatch(work).len();
    median_rate(lanes as f64 * f64::from(ROUNDS), || {
        black_box(arch.dispatch(black_box(work)));
    })
}

/// Independent chains of `x ← a x + b`, which end at `b / (1 − a)`.
#[derive(Clone, Copy)]
struct MultiplyAdd {
    factor: f64,
    summand: f64,
}

impl WithSimd for MultiplyAdd {
    /// The last value of every lane of every chain.
    type Output = Vec<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<f64> {
        let (factor, summand) = (simd.splat_f64s(self.factor), simd.splat_f64s(self.summand));
        let mut chains = [simd.splat_f64s(0.5); CHAINS];
        for _ in 0..ROUNDS {
            for x in &mut chains {
                *x = simd.mul_add_f64s(*x, factor, summand);
            }
        }
        cast_slice(&chains).to_vec()
    }
}

/// The median rate over several runs of some work, 10⁹ units per second.
fn median_rate(units: f64, work: impl Fn()) -> f64 {
    let run = |_| {
        let start = Instant::now();
        work();
        units / start.elapsed().as_nanos().max(1) as f64
    };
    let rates: Vec<f64> = (0..SWEEPS).map(run).collect();
    rates[middle(&rates)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_sum_to_what_one_sum_gives() {
        let numbers: Vec<u64> = (0..LANES as u64 * 10).map(|n| n * n).collect();
        assert_eq!(sum(&numbers), numbers.iter().sum::<u64>());
    }

    #[test]
    fn a_visit_moves_56_bytes_16_of_them_the_frames() {
        let bound = LowerBound::of(8.0, 11.5);
        assert_eq!(bound.ns_per_visit, 7.0);
        assert_eq!(bound.frame_only_ns_per_visit, 2.0);
        assert_eq!(bound.arithmetic_ns_per_visit, 2.0);
    }

    #[test]
    fn chains_of_multiply_adds_end_at_their_fixed_point() {
        let chains = Arch::new().dispatch(MultiplyAdd { factor: 0.999, summand: 1e-3 });
        assert!(chains.iter().all(|x| (x - 1.0).abs() < 1e-9));
    }
}
