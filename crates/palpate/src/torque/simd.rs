//! Sums over the contacts of a link, four contacts at a time.
//!
//! Contact `i` of a run belongs to lane `i mod 4`, lanes are summed in a fixed order, and a product and its sum are
//! rounded once, everywhere: so the result has the same bits on every machine. With AVX2, four lanes are one register,
//! and a visit takes half the time. The module does not depend on joints and links; [`super`] converts wrenches to
//! torques.
//!
//! The loops are written out because the body of a closure is not compiled for the instruction set of its caller.

use pulp::{Scalar256b, Simd, f32x4, f64x4};

use super::{Block, CellState, LANES, Prefetch, StiffnessRule, rows_of};

/// An instruction set that works on four lanes at once.
pub(super) trait Quads: Simd<f64s = f64x4> {
    /// Rows of a 4 × 4 matrix from its columns.
    fn transpose(self, columns: [&[f64; 4]; 4]) -> [f64x4; 4];

    /// Lanes as `f64`.
    fn widen(self, lanes: f32x4) -> f64x4;
}

impl Quads for Scalar256b {
    #[inline(always)]
    fn transpose(self, [a, b, c, d]: [&[f64; 4]; 4]) -> [f64x4; 4] {
        std::array::from_fn(|row| f64x4(a[row], b[row], c[row], d[row]))
    }

    #[inline(always)]
    fn widen(self, f32x4(a, b, c, d): f32x4) -> f64x4 {
        f64x4(a.into(), b.into(), c.into(), d.into())
    }
}

#[cfg(target_arch = "x86_64")]
impl Quads for pulp::x86::V3 {
    /// Half columns are combined while they are loaded, which halves the number of shuffles; most processors make only
    /// one shuffle at a time.
    #[inline(always)]
    fn transpose(self, [a, b, c, d]: [&[f64; 4]; 4]) -> [f64x4; 4] {
        use pulp::cast;
        let beside = |left: [f64; 2], right: [f64; 2]| {
            let left = self.avx._mm256_castpd128_pd256(cast(left));
            self.avx._mm256_insertf128_pd::<1>(left, cast(right))
        };
        let (ac, bd) = (beside([a[0], a[1]], [c[0], c[1]]), beside([b[0], b[1]], [d[0], d[1]]));
        let (ac_high, bd_high) =
            (beside([a[2], a[3]], [c[2], c[3]]), beside([b[2], b[3]], [d[2], d[3]]));
        [
            cast(self.avx._mm256_unpacklo_pd(ac, bd)),
            cast(self.avx._mm256_unpackhi_pd(ac, bd)),
            cast(self.avx._mm256_unpacklo_pd(ac_high, bd_high)),
            cast(self.avx._mm256_unpackhi_pd(ac_high, bd_high)),
        ]
    }

    #[inline(always)]
    fn widen(self, lanes: f32x4) -> f64x4 {
        pulp::cast(self.avx._mm256_cvtps_pd(pulp::cast(lanes)))
    }
}

/// A sum over contacts.
pub(super) trait Sum {
    /// Its result.
    type Output;

    /// Adds the first `count` contacts of a block; the others have zero displacement.
    fn add<S: Quads>(&mut self, simd: S, block: &Block, count: usize);

    /// The result.
    fn finish(self) -> Self::Output;
}

/// The best instruction set that this processor has.
#[derive(Clone, Copy)]
pub(super) struct SimdLevel {
    #[cfg(target_arch = "x86_64")]
    avx2: Option<pulp::x86::V3>,
}

impl SimdLevel {
    /// Detects the instruction set: a dozen nanoseconds, so once per sum and not once per link.
    #[inline]
    pub(super) fn best() -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: pulp::x86::V3::try_new(),
        }
    }

    /// Computes a sum over `n_contacts` contacts, and prefetches the next frame meanwhile.
    #[inline]
    pub(super) fn run<T: Sum>(
        self,
        blocks: &[Block],
        n_contacts: usize,
        prefetch: &mut Prefetch<'_>,
        sum: T,
    ) -> T::Output {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = self.avx2 {
            return simd.vectorize(
                #[inline(always)]
                || run_on(simd, blocks, n_contacts, prefetch, sum),
            );
        }
        run_on(Scalar256b, blocks, n_contacts, prefetch, sum)
    }
}

/// Adds all contacts; the last block may be filled only in part.
#[inline(always)]
fn run_on<S: Quads, T: Sum>(
    simd: S,
    blocks: &[Block],
    n_contacts: usize,
    prefetch: &mut Prefetch<'_>,
    mut sum: T,
) -> T::Output {
    let (full, rest) = blocks.split_at(n_contacts / LANES);
    for block in full {
        prefetch.ask();
        sum.add(simd, block, LANES);
    }
    if let Some(block) = rest.first() {
        sum.add(simd, block, n_contacts % LANES);
    }
    sum.finish()
}

/// Four contacts: displacements u and rest points p by axis, m, and the unknowns of the cells.
struct Quad {
    u: [f64x4; 3],
    p: [f64x4; 3],
    unknown: f64x4,
}

impl Quad {
    #[inline(always)]
    fn new<S: Quads>(simd: S, block: &Block, cells: &[CellState]) -> Self {
        let [ux, uy, uz, rows] = *block;
        let u = [ux, uy, uz].map(|axis| simd.widen(pulp::cast(axis)));
        let [a, b, c, d] = rows;
        let column = |row: u32| &cells[row as usize].0;
        let [px, py, pz, unknown] = simd.transpose([column(a), column(b), column(c), column(d)]);
        Self { u, p: [px, py, pz], unknown }
    }

    /// Wrenches of springs of unit stiffness: `−u` and `−p × u`, by component.
    #[inline(always)]
    fn wrenches<S: Quads>(&self, simd: S) -> [f64x4; 6] {
        let ([ux, uy, uz], [px, py, pz]) = (self.u, self.p);
        let zero = simd.splat_f64s(0.0);
        [
            simd.sub_f64s(zero, ux),
            simd.sub_f64s(zero, uy),
            simd.sub_f64s(zero, uz),
            cross(simd, pz, uy, py, uz),
            cross(simd, px, uz, pz, ux),
            cross(simd, py, ux, px, uy),
        ]
    }
}

/// `a b − c d`, lane by lane.
#[inline(always)]
fn cross<S: Quads>(simd: S, a: f64x4, b: f64x4, c: f64x4, d: f64x4) -> f64x4 {
    simd.negate_mul_add_f64s(c, d, simd.mul_f64s(a, b))
}

/// `e + a b − c d`, lane by lane.
#[inline(always)]
fn add_cross<S: Quads>(simd: S, e: f64x4, [a, b, c, d]: [f64x4; 4]) -> f64x4 {
    simd.negate_mul_add_f64s(c, d, simd.mul_add_f64s(a, b, e))
}

/// The lanes of a sum, added up.
#[inline(always)]
fn total(f64x4(a, b, c, d): f64x4) -> f64 {
    (a + b) + (c + d)
}

/// `Σ Kᵢ (−uᵢ, −pᵢ × uᵢ)`: the wrench of all springs.
pub(super) struct Wrench<'a> {
    pub(super) cells: &'a [CellState],
    pub(super) stiffness: StiffnessRule,
    pub(super) sums: [f64x4; 6],
}

impl Sum for Wrench<'_> {
    type Output = [f64; 6];

    #[inline(always)]
    fn add<S: Quads>(&mut self, simd: S, block: &Block, _: usize) {
        let Quad { u: [ux, uy, uz], p: [px, py, pz], unknown } = Quad::new(simd, block, self.cells);
        let k = match self.stiffness {
            StiffnessRule::Positive => simd.max_f64s(unknown, simd.splat_f64s(0.0)),
            StiffnessRule::Magnitude => simd.abs_f64s(unknown),
        };
        let (x, y, z) = (simd.mul_f64s(k, ux), simd.mul_f64s(k, uy), simd.mul_f64s(k, uz));
        let sums = &mut self.sums;
        sums[0] = simd.sub_f64s(sums[0], x);
        sums[1] = simd.sub_f64s(sums[1], y);
        sums[2] = simd.sub_f64s(sums[2], z);
        sums[3] = add_cross(simd, sums[3], [pz, y, py, z]);
        sums[4] = add_cross(simd, sums[4], [px, z, pz, x]);
        sums[5] = add_cross(simd, sums[5], [py, x, px, y]);
    }

    #[inline(always)]
    fn finish(self) -> [f64; 6] {
        self.sums.map(total)
    }
}

/// The velocity of a link at given joint speeds: linear at the world's origin, and angular.
pub(super) struct Twist(pub(super) [f64; 6]);

impl Twist {
    /// `u·v(p)`, contact by contact.
    #[inline(always)]
    fn along<S: Quads>(&self, simd: S, quad: &Quad) -> f64x4 {
        let [lx, ly, lz, ax, ay, az] = self.0;
        let (lx, ly, lz) = (simd.splat_f64s(lx), simd.splat_f64s(ly), simd.splat_f64s(lz));
        let (ax, ay, az) = (simd.splat_f64s(ax), simd.splat_f64s(ay), simd.splat_f64s(az));
        let ([ux, uy, uz], [px, py, pz]) = (quad.u, quad.p);
        let x = simd.mul_f64s(ux, add_cross(simd, lx, [ay, pz, az, py]));
        let xy = simd.mul_add_f64s(uy, add_cross(simd, ly, [az, px, ax, pz]), x);
        simd.mul_add_f64s(uz, add_cross(simd, lz, [ax, py, ay, px]), xy)
    }
}

/// `wᵢ·d = −uᵢ·v(pᵢ)` of every contact, where the joint speeds d move the link by `twist`.
pub(super) struct TransposeTimes<'a, T> {
    pub(super) cells: &'a mut [CellState],
    pub(super) twist: Twist,
    /// Called with the cell of a row, the row and the value.
    pub(super) take: T,
}

impl<T: FnMut(&mut CellState, usize, f64)> Sum for TransposeTimes<'_, T> {
    type Output = ();

    #[inline(always)]
    fn add<S: Quads>(&mut self, simd: S, block: &Block, count: usize) {
        let f64x4(a, b, c, d) = self.twist.along(simd, &Quad::new(simd, block, self.cells));
        for (row, value) in rows_of(block, count).zip([a, b, c, d]) {
            (self.take)(&mut self.cells[row], row, -value);
        }
    }

    fn finish(self) {}
}

/// Adds `wᵢ·d` to the unknown of every cell: a fast special case of [`TransposeTimes`].
pub(super) struct Add<'a> {
    pub(super) cells: &'a mut [CellState],
    pub(super) twist: Twist,
}

impl Sum for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn add<S: Quads>(&mut self, simd: S, block: &Block, count: usize) {
        let quad = Quad::new(simd, block, self.cells);
        let f64x4(a, b, c, d) = simd.sub_f64s(quad.unknown, self.twist.along(simd, &quad));
        for (row, unknown) in rows_of(block, count).zip([a, b, c, d]) {
            *self.cells[row].unknown_mut() = unknown;
        }
    }

    fn finish(self) {}
}

/// Number of entries in the lower triangle of a 6 × 6 matrix.
pub(super) const TRIANGLE: usize = 21;

/// Index of entry (i, j ≤ i) in the triangle.
#[inline(always)]
pub(super) const fn entry(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

/// `Σ aᵢ sᵢ sᵢᵀ` over the contacts, with sᵢ = (u, p × u): a lower triangle, row by row; `weight` gives a of a row.
pub(super) struct Gram<'a, F> {
    pub(super) cells: &'a [CellState],
    pub(super) weight: F,
    pub(super) sums: [f64x4; TRIANGLE],
}

impl<F: Fn(usize) -> f64> Sum for Gram<'_, F> {
    type Output = [f64; TRIANGLE];

    #[inline(always)]
    fn add<S: Quads>(&mut self, simd: S, block: &Block, _: usize) {
        let unit = Quad::new(simd, block, self.cells).wrenches(simd);
        let weight: f64x4 = pulp::cast(block[3].map(|row| (self.weight)(row as usize)));
        for i in 0..6 {
            let weighted = simd.mul_f64s(weight, unit[i]);
            for (j, part) in unit[..=i].iter().enumerate() {
                let sum = &mut self.sums[entry(i, j)];
                *sum = simd.mul_add_f64s(weighted, *part, *sum);
            }
        }
    }

    #[inline(always)]
    fn finish(self) -> [f64; TRIANGLE] {
        self.sums.map(total)
    }
}

/// `sᵢᵀ M sᵢ` of every contact, with sᵢ = (u, p × u), for a symmetric M given by its lower triangle, row by row, with
/// doubled off-diagonal entries.
pub(super) struct Quadratic<'a, T> {
    pub(super) cells: &'a [CellState],
    pub(super) form: [f64; TRIANGLE],
    /// Called with a row and the value.
    pub(super) take: T,
}

impl<T: FnMut(usize, f64)> Sum for Quadratic<'_, T> {
    type Output = ();

    #[inline(always)]
    fn add<S: Quads>(&mut self, simd: S, block: &Block, count: usize) {
        let unit = Quad::new(simd, block, self.cells).wrenches(simd);
        let mut value = simd.splat_f64s(0.0);
        for i in 0..6 {
            let mut dot = simd.splat_f64s(0.0);
            for (j, part) in unit[..=i].iter().enumerate() {
                let form = simd.splat_f64s(self.form[entry(i, j)]);
                dot = simd.mul_add_f64s(form, *part, dot);
            }
            value = simd.mul_add_f64s(unit[i], dot, value);
        }
        let f64x4(a, b, c, d) = value;
        for (row, value) in rows_of(block, count).zip([a, b, c, d]) {
            (self.take)(row, value);
        }
    }

    fn finish(self) {}
}

/// A zero sum.
pub(super) const ZERO: f64x4 = f64x4(0.0, 0.0, 0.0, 0.0);

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::super::block;
    use super::*;

    /// Number of contacts; they do not fill the last block.
    const CONTACTS: usize = 43;

    /// Contacts on cells of both signs.
    fn frame() -> (Vec<Block>, Vec<CellState>) {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut uniform = || 2.0 * f64::from(rng.next_u32()) / f64::from(u32::MAX) - 1.0;
        let cells: Vec<CellState> =
            (0..50).map(|_| CellState::new([uniform(), uniform(), uniform()], uniform())).collect();
        let contacts: Vec<_> =
            (0..CONTACTS).map(|row| ([(); 3].map(|()| uniform() as f32), row as u32 + 3)).collect();
        (contacts.chunks(LANES).map(|four| block(four.iter().copied())).collect(), cells)
    }

    /// A way to compute a sum.
    trait Runs {
        fn run<T: Sum>(&self, blocks: &[Block], sum: T) -> T::Output;
    }

    struct Best;

    impl Runs for Best {
        fn run<T: Sum>(&self, blocks: &[Block], sum: T) -> T::Output {
            SimdLevel::best().run(blocks, CONTACTS, &mut Prefetch::nothing(), sum)
        }
    }

    struct Plain;

    impl Runs for Plain {
        fn run<T: Sum>(&self, blocks: &[Block], sum: T) -> T::Output {
            run_on(Scalar256b, blocks, CONTACTS, &mut Prefetch::nothing(), sum)
        }
    }

    /// The bits of the results of all sums.
    fn all_sums(level: &impl Runs) -> Vec<u64> {
        let (blocks, mut cells) = frame();
        let mut out = Vec::new();
        for stiffness in [StiffnessRule::Positive, StiffnessRule::Magnitude] {
            let sum = Wrench { cells: &cells, stiffness, sums: [ZERO; 6] };
            out.extend(level.run(&blocks, sum));
        }
        let weight = |row: usize| 1.0 + row as f64;
        let gram = Gram { cells: &cells, weight, sums: [ZERO; TRIANGLE] };
        out.extend(level.run(&blocks, gram));
        let form = std::array::from_fn(|entry| 0.1 * entry as f64 - 0.7);
        let take = |row: usize, value: f64| out.extend([row as f64, value]);
        level.run(&blocks, Quadratic { cells: &cells, form, take });
        let twist = [0.3, -0.2, 0.5, 0.7, -0.9, 0.1];
        let take = |cell: &mut CellState, _: usize, value: f64| *cell.unknown_mut() += value;
        level.run(&blocks, TransposeTimes { cells: &mut cells, twist: Twist(twist), take });
        level.run(&blocks, Add { cells: &mut cells, twist: Twist(twist) });
        out.extend(cells.iter().map(CellState::unknown));
        out.iter().map(|number| number.to_bits()).collect()
    }

    #[test]
    fn simd_gives_the_same_bits_as_scalar_arithmetic() {
        assert_eq!(all_sums(&Best), all_sums(&Plain));
    }
}
