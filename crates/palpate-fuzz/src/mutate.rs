//! Random mutations without coverage, reproducible by a random seed.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Numbers at the limits of integer types, which often cause errors in parsers.
const ODD: [u64; 12] = [
    0,
    1,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0xffff_ffff,
    1 << 40,
    i64::MAX as u64,
    1 << 63,
    u64::MAX,
];
const ODD_FLOATS: [f64; 8] = [f64::NAN, f64::INFINITY, -1e308, 5e-324, 1e30, 1e18, -0.0, -1e9];
const ODD_TEXTS: [&[u8]; 12] = [
    b"nan",
    b"-inf",
    b"1e308",
    b"99999999999999999999",
    b"-1",
    b"",
    b"\"",
    b"\0",
    b"\xff\xfe",
    b"\n\n",
    b"[[[[",
    b"4294967296",
];
/// Largest length of an input, bytes; longer ones are truncated.
const LONGEST: usize = 1 << 16;

/// Creates inputs by mutating seeds.
pub struct Mutator {
    random: ChaCha8Rng,
    seeds: Vec<Vec<u8>>,
}

impl Mutator {
    /// A mutator of `seeds`, of which there must be at least one; `seed` is that of the random
    /// numbers.
    pub fn new(seeds: Vec<Vec<u8>>, seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), seeds }
    }

    /// The next input.
    pub fn next_input(&mut self) -> Vec<u8> {
        let which = self.below(self.seeds.len());
        let mut bytes = self.seeds[which].clone();
        for _ in 0..1 << self.below(4) {
            self.change(&mut bytes);
        }
        bytes.truncate(LONGEST);
        bytes
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.random.next_u64() % bound.max(1) as u64) as usize
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            bytes.push(0);
        }
        // Half of the changes are in the first 256 bytes, which decide how the rest is read.
        let reach = if self.below(2) == 0 { bytes.len().min(256) } else { bytes.len() };
        let at = self.below(reach);
        let end = |length: usize| (at + length).min(bytes.len());
        match self.below(9) {
            0 => bytes[at] ^= 1 << self.below(8),
            1 => bytes[at] = self.below(256) as u8,
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..end([1, 2, 4, 8, 64, 1000][self.below(6)]))),
            4 => {
                let number = ODD[self.below(ODD.len())].to_le_bytes();
                let width = [1, 2, 4, 8][self.below(4)];
                bytes.splice(at..end(width), number[..width].iter().copied());
            }
            5 => {
                let number = ODD_FLOATS[self.below(ODD_FLOATS.len())];
                let (wide, narrow) = (number.to_le_bytes(), (number as f32).to_le_bytes());
                let number = if self.below(2) == 0 { &wide[..] } else { &narrow[..] };
                bytes.splice(at..end(number.len()), number.iter().copied());
            }
            6 => {
                let (from, length) = (self.below(bytes.len()), [1, 8, 32, 200][self.below(4)]);
                let copy = bytes[from..(from + length).min(bytes.len())].to_vec();
                bytes.splice(at..at, copy);
            }
            7 => {
                let text = ODD_TEXTS[self.below(ODD_TEXTS.len())];
                let replaced = end(self.below(8));
                bytes.splice(at..replaced, text.iter().copied());
            }
            _ => {
                let other = self.below(self.seeds.len());
                let from = self.below(self.seeds[other].len());
                let tail = self.seeds[other][from..].to_vec();
                bytes.truncate(at);
                bytes.extend(tail);
            }
        }
    }
}
