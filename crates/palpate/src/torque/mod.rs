//! Joint torques predicted from a stiffness field.
//!
//! This is the module that converts stiffness to torque; [`crate::path_predictor`] does it for whole paths. A spring at
//! rest point p, displaced by u, pushes its link with the force −K u at p + u; its moment about the world's origin is
//! −K p × u, since u × u = 0. The sum over the contacts of a link is one wrench, which the link's spatial Jacobian J
//! converts to joint torques. Conversely, a vector d over the joints, taken as joint speeds, moves the link's points
//! with v(p) = (J d)₁ + (J d)₂ × p, and `w·d = −u·v(p)`. So a frame stores only u, the cell and the link of every
//! contact: 16 bytes per contact, in one stream, instead of a column of H. The rest points are stored once per cell, by
//! the caller. This is exact because the force is parallel to u. With Coulomb friction it is an
//! approximation: u is then −force/K, and the force is taken to act at the rest point in place of the anchor.
//!
//! | paper | here                             | value                      | shape    | unit   |
//! |-------|----------------------------------|----------------------------|----------|--------|
//! | Eq. 2 | [`lever`]                        | `w = −J(q, p+u)ᵀ u`        | n_joints | m²     |
//! | Eq. 3 | [`StiffnessRule`]                | K of κ, or of z            |          | N/m    |
//! | Eq. 5 | [`Observation::predict`]         | `τ̂ = Σ wᵢ Kᵢ`              | n_joints | N·m    |
//! |       | [`Observation::weighted_gram`]   | `H P Hᵀ`, P diagonal       | n × n    | (N·m)² |
//! |       | [`Observation::transpose_times`] | `Hᵀ d`, contact by contact |          |        |
//!
//! Here H consists of levers, without the sign of κ: [`crate::ekf`] adds it. The module depends neither on time, nor on
//! priors, nor on how contacts are found. Gravity is not modelled here: all torques are external ones.

mod simd;

use nalgebra::{DMatrix, DVector, DVectorView, Matrix6, Matrix6xX, Point3, Vector3, Vector6};
use prefetch_index::prefetch_index;
use pulp::bytemuck::{cast, cast_slice};

use simd::SimdLevel;

use crate::contact::Contacts;
use crate::lattice::{CellRows, RowCache};
use crate::robot::{LinkId, Poses, Robot};

/// Torque that a displaced point exerts at unit stiffness: `w = −J(q, p+u)ᵀ u` (Eq. 2).
///
/// This is the definition, for one contact; [`Observation`] computes the same from wrenches.
///
/// # Shapes and units
///
/// - `rest`: p, world frame, m; `displacement`: u, world frame, m;
/// - returns `w`: n_joints, m² (N·m per N/m).
pub fn lever(
    robot: &Robot,
    poses: &Poses,
    link: LinkId,
    rest: &Point3<f64>,
    displacement: &Vector3<f64>,
) -> DVector<f64> {
    -robot.jacobian(poses, link, &(rest + displacement)).transpose() * displacement
}

/// Number of contacts in a block, one per lane.
const LANES: usize = 4;

/// Four displaced points: u by axis (m, world frame) as the bits of `f32`, then the cells' rows in [`CellRows`]; 64
/// bytes, one cache line.
type Block = [[u32; LANES]; 4];

/// A block of one to four contacts. Unused lanes have zero displacement and repeat the last row.
fn block(contacts: impl Iterator<Item = ([f32; 3], u32)>) -> Block {
    let mut block = [[0; LANES]; 4];
    for (lane, (displacement_m, row)) in contacts.take(LANES).enumerate() {
        let [x, y, z] = displacement_m.map(f32::to_bits);
        (block[0][lane], block[1][lane], block[2][lane]) = (x, y, z);
        block[3][lane..].fill(row);
    }
    block
}

/// The rows of the first `count` contacts of a block.
#[inline(always)]
fn rows_of(&[_, _, _, rows]: &Block, count: usize) -> impl Iterator<Item = usize> + use<> {
    rows.into_iter().take(count).map(|row| row as usize)
}

/// u of a lane.
fn displacement_m([x, y, z, _]: &Block, lane: usize) -> Vector3<f64> {
    Vector3::new(x[lane], y[lane], z[lane]).map(|bits| f64::from(f32::from_bits(bits)))
}

/// Size of a block in a frame, as a number of `f64`.
const BLOCK: usize = size_of::<Block>() / size_of::<f64>();

/// A touched cell, as used in sums over contacts: its rest point (world frame, m) and its unknown (N/m); 32 bytes, half
/// a cache line.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct CellState([f64; 4]);

impl CellState {
    /// A cell at a rest point, m.
    pub fn new([x, y, z]: [f64; 3], unknown: f64) -> Self {
        Self([x, y, z, unknown])
    }

    /// The estimator's variable of this cell: z of `map`, κ of `ekf`, K of a finished field; N/m.
    #[inline]
    pub fn unknown(&self) -> f64 {
        self.0[3]
    }

    /// Mutable access to [`Self::unknown`].
    #[inline]
    pub fn unknown_mut(&mut self) -> &mut f64 {
        &mut self.0[3]
    }

    fn rest_point(&self) -> Vector3<f64> {
        let [x, y, z, _] = self.0;
        Vector3::new(x, y, z)
    }
}

/// How K follows from the unknown of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StiffnessRule {
    /// `K = max(z, 0)`.
    Positive,
    /// `K = |κ|` (Eq. 3).
    Magnitude,
}

/// One frame as the estimators use it: the displacement and row of every contact, the Jacobian of every link with
/// contacts, and the external torque. Levers are computed when they are needed.
///
/// All data are in one block of memory, in the order of access, because a remembered frame is loaded from main memory:
/// every jump would cost a wait.
#[derive(Debug, Clone)]
pub struct Observation {
    /// τ; then for every link that touches: the number of its contacts, J column by column, and
    /// the contacts in blocks; then the notes.
    stream: Vec<f64>,
    n_joints: usize,
    n_contacts: usize,
    /// Length of `stream` before the notes.
    n_measured: usize,
}

/// Prefetches a remembered frame from main memory.
///
/// The computation for each contact is so long that the processor looks only a few contacts ahead, and would wait for
/// memory. So with every block of a frame, a part of the next frame is prefetched, which is then in the cache when it
/// is visited.
#[derive(Debug)]
pub(crate) struct Prefetch<'a>(&'a [f64]);

impl Prefetch<'_> {
    /// Number of `f64` prefetched with each block: half a block, since a visit reads a frame twice.
    const STRIDE: usize = BLOCK / 2;

    /// There is no next frame.
    pub(crate) fn nothing() -> Self {
        Self(&[])
    }

    /// Prefetches the next [`Self::STRIDE`] numbers.
    #[inline(always)]
    fn ask(&mut self) {
        prefetch_index(self.0, 0);
        self.0 = self.0.get(Self::STRIDE..).unwrap_or_default();
    }

    /// Prefetches the rest.
    pub(crate) fn finish(mut self) {
        while !self.0.is_empty() {
            self.ask();
        }
    }
}

/// One link's contacts in an [`Observation`].
struct Run<'a> {
    /// J, 6 × n_joints: `Jᵀ` converts a wrench on the link, about the world's origin, to joint torques.
    spatial: &'a [[f64; 6]],
    n_contacts: usize,
    blocks: &'a [Block],
}

impl<'a> Run<'a> {
    /// The blocks, each with the number of its contacts.
    fn blocks(&self) -> impl Iterator<Item = (&'a Block, usize)> + use<'a> {
        let left = (0..self.n_contacts).rev().step_by(LANES).map(|last| last + 1);
        self.blocks.iter().zip(left.map(|left| left.min(LANES)))
    }

    /// `J d`: linear velocity at the world's origin, and angular.
    fn twist(&self, d: &[f64]) -> [f64; 6] {
        let mut twist = [0.0; 6];
        for (column, speed) in self.spatial.iter().zip(d) {
            for (sum, part) in twist.iter_mut().zip(column) {
                *sum += speed * part;
            }
        }
        twist
    }

    /// J as a matrix.
    fn matrix(&self) -> Matrix6xX<f64> {
        Matrix6xX::from_column_slice(self.spatial.as_flattened())
    }
}

/// Builds the observations of consecutive frames, and numbers their cells.
#[derive(Debug, Clone)]
pub struct ObservationBuilder {
    rows: CellRows,
    row_cache: RowCache,
}

impl ObservationBuilder {
    /// A builder that continues the numbering of cells in `rows`.
    pub fn new(rows: CellRows) -> Self {
        Self { rows, row_cache: RowCache::default() }
    }

    /// The numbering of cells so far.
    pub fn rows(&self) -> &CellRows {
        &self.rows
    }

    /// Builds the observation of a step; cells seen for the first time get their rows here.
    ///
    /// `tau` is the external torque of the step, n_joints, N·m. Use one builder for successive steps: it finds the rows
    /// of cells that stay in contact without a look-up.
    pub fn build(
        &mut self,
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        tau: &DVector<f64>,
    ) -> Observation {
        let (n_joints, n_contacts) = (tau.len(), contacts.len());
        let n_blocks: usize =
            contacts.links.iter().map(|link| link.cells.len().div_ceil(LANES)).sum();
        let n_measured = n_joints + contacts.links.len() * (1 + 6 * n_joints) + BLOCK * n_blocks;
        // With capacity for notes: an estimator adds a vector and a matrix over the joints, or nothing.
        let mut stream = Vec::with_capacity(n_measured + n_joints * (1 + n_joints));
        stream.extend_from_slice(tau.as_slice());
        for link in &contacts.links {
            stream.push(link.cells.len() as f64);
            stream.extend_from_slice(robot.spatial_jacobian(poses, link.link).as_slice());
            let rows = self.row_cache.follow(link.link.index(), &link.cells, &mut self.rows);
            for (four, rows) in link.displacements_m.chunks(LANES).zip(rows.chunks(LANES)) {
                let numbers: [f64; BLOCK] =
                    cast(block(four.iter().copied().zip(rows.iter().copied())));
                stream.extend_from_slice(&numbers);
            }
        }
        Observation { stream, n_joints, n_contacts, n_measured }
    }
}

impl Observation {
    /// Builds the observation of a single step, as [`ObservationBuilder::build`] does.
    pub fn new(
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        rows: &mut CellRows,
        tau: &DVector<f64>,
    ) -> Self {
        let fresh = CellRows::new(rows.lattice().clone());
        let mut observations = ObservationBuilder::new(std::mem::replace(rows, fresh));
        let observation = observations.build(robot, poses, contacts, tau);
        *rows = observations.rows;
        observation
    }

    /// The same contacts with another external torque, n_joints, N·m.
    ///
    /// # Panics
    ///
    /// If that has another number of joints, which is a bug in the caller.
    pub fn with_tau(mut self, tau: &DVector<f64>) -> Self {
        self.stream[..self.n_joints].copy_from_slice(tau.as_slice());
        self
    }

    /// Multiplies τ_j and the column of joint j in every Jacobian by a weight. An estimator with torque noise σ_j then
    /// uses σ_j / weight_j for this observation.
    ///
    /// # Panics
    ///
    /// If there is not one weight for each joint.
    pub fn weighted(mut self, weights: &[f64]) -> Self {
        let n = self.n_joints;
        assert_eq!(weights.len(), n, "one weight for each joint");
        for (tau, weight) in self.stream.iter_mut().zip(weights) {
            *tau *= weight;
        }
        let mut at = n;
        while at < self.n_measured {
            let n_contacts = self.stream[at] as usize;
            let spatial = &mut self.stream[at + 1..at + 1 + 6 * n];
            for (column, weight) in spatial.chunks_mut(6).zip(weights) {
                column.iter_mut().for_each(|entry| *entry *= weight);
            }
            at += 1 + 6 * n + BLOCK * n_contacts.div_ceil(LANES);
        }
        self
    }

    /// τ: the external torque of the frame, n_joints, N·m.
    pub fn tau(&self) -> DVectorView<'_, f64> {
        DVectorView::from_slice(&self.stream[..self.n_joints], self.n_joints)
    }

    /// Appends *notes*: numbers of an estimator that are stored with the frame.
    pub fn note(&mut self, numbers: impl ExactSizeIterator<Item = f64>) {
        // Without this, a copied frame, which has no spare capacity, would grow to twice its size.
        self.stream.reserve_exact(numbers.len());
        self.stream.extend(numbers);
    }

    /// All notes, in their order.
    pub fn notes(&self) -> &[f64] {
        &self.stream[self.n_measured..]
    }

    /// Mutable access to [`Self::notes`].
    pub fn notes_mut(&mut self) -> &mut [f64] {
        &mut self.stream[self.n_measured..]
    }

    /// Number of joints.
    pub fn n_joints(&self) -> usize {
        self.n_joints
    }

    /// Number of contacts of the frame.
    pub fn n_contacts(&self) -> usize {
        self.n_contacts
    }

    /// The contacts' rows in [`CellRows`], link by link.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.runs().flat_map(|run| run.blocks()).flat_map(|(block, count)| rows_of(block, count))
    }

    /// Prefetches the frame step by step, while another is visited.
    pub(crate) fn prefetch(&self) -> Prefetch<'_> {
        Prefetch(&self.stream)
    }

    /// Memory of the frame, bytes.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.stream.capacity() * size_of::<f64>()
    }

    /// The links' runs of contacts.
    fn runs(&self) -> impl Iterator<Item = Run<'_>> {
        let mut left = &self.stream[self.n_joints..self.n_measured];
        std::iter::from_fn(move || {
            let (count, rest) = left.split_first()?;
            let n_contacts = *count as usize;
            let (spatial, rest) = rest.split_at(6 * self.n_joints);
            let (blocks, rest) = rest.split_at(BLOCK * n_contacts.div_ceil(LANES));
            left = rest;
            Some(Run { spatial: spatial.as_chunks().0, n_contacts, blocks: cast_slice(blocks) })
        })
    }

    /// Torque that the field exerts: `τ̂ = Σ wᵢ Kᵢ` (Eq. 5), n_joints, N·m.
    ///
    /// `cells` are the touched cells by row.
    pub fn predict(&self, cells: &[CellState], stiffness: StiffnessRule) -> DVector<f64> {
        self.predict_prefetching(&mut Prefetch::nothing(), cells, stiffness)
    }

    /// [`Self::predict`], and prefetches the next frame meanwhile.
    pub(crate) fn predict_prefetching(
        &self,
        prefetch: &mut Prefetch<'_>,
        cells: &[CellState],
        stiffness: StiffnessRule,
    ) -> DVector<f64> {
        let level = SimdLevel::best();
        let mut tau = DVector::zeros(self.n_joints);
        for Run { spatial, n_contacts, blocks } in self.runs() {
            let sum = simd::Wrench { cells, stiffness, sums: [simd::ZERO; 6] };
            let [fx, fy, fz, mx, my, mz] = level.run(blocks, n_contacts, prefetch, sum);
            for (torque, [lx, ly, lz, ax, ay, az]) in tau.iter_mut().zip(spatial) {
                *torque += (lx * fx + ly * fy + lz * fz) + (ax * mx + ay * my + az * mz);
            }
        }
        tau
    }

    /// `√ diag(H P Hᵀ)` for a diagonal P, n_joints, N·m; `variance` gives P of a row, (N/m)².
    pub fn torque_std(&self, cells: &[CellState], variance: impl Fn(usize) -> f64) -> DVector<f64> {
        self.weighted_gram(cells, variance).diagonal().map(|own| own.max(0.0).sqrt())
    }

    /// `H P Hᵀ` for a diagonal P, n × n, (N·m)²; `variance` gives P of a row, (N/m)².
    pub fn weighted_gram(
        &self,
        cells: &[CellState],
        variance: impl Fn(usize) -> f64,
    ) -> DMatrix<f64> {
        let level = SimdLevel::best();
        let mut gram = DMatrix::zeros(self.n_joints, self.n_joints);
        for run in self.runs() {
            let sums = [simd::ZERO; simd::TRIANGLE];
            let sum = simd::Gram { cells, weight: &variance, sums };
            let sum = level.run(run.blocks, run.n_contacts, &mut Prefetch::nothing(), sum);
            // Jᵀ W J, column by column: too small for a general matrix product.
            let wrenches = Matrix6::from_fn(|i, j| sum[simd::entry(i.max(j), i.min(j))]);
            for (j, column) in run.spatial.iter().enumerate() {
                let pushed = wrenches * Vector6::from(*column);
                for (i, other) in run.spatial.iter().enumerate() {
                    gram[(i, j)] += Vector6::from(*other).dot(&pushed);
                }
            }
        }
        gram
    }

    /// `(Hᵀ d)ᵢ = wᵢ·d` of every contact: `take` gets the cell, its row and the value.
    ///
    /// A cell has one contact in a frame, so every row comes at most once.
    pub fn transpose_times(
        &self,
        cells: &mut [CellState],
        d: &[f64],
        mut take: impl FnMut(&mut CellState, usize, f64),
    ) {
        let level = SimdLevel::best();
        for run in self.runs() {
            let (cells, twist) = (&mut *cells, simd::Twist(run.twist(d)));
            let sum = simd::TransposeTimes { cells, twist, take: &mut take };
            level.run(run.blocks, run.n_contacts, &mut Prefetch::nothing(), sum);
        }
    }

    /// `unknown += Hᵀ d`, cell by cell; prefetches the next frame meanwhile.
    ///
    /// As a cell has one contact in a frame, four can be added at once.
    pub(crate) fn add(&self, prefetch: &mut Prefetch<'_>, cells: &mut [CellState], d: &[f64]) {
        let level = SimdLevel::best();
        for run in self.runs() {
            let (cells, twist) = (&mut *cells, simd::Twist(run.twist(d)));
            level.run(run.blocks, run.n_contacts, prefetch, simd::Add { cells, twist });
        }
    }

    /// `wᵢᵀ M wᵢ` of every contact for a symmetric M (n × n): `take` gets its row and the value.
    pub fn quadratic(
        &self,
        cells: &[CellState],
        m: &DMatrix<f64>,
        mut take: impl FnMut(usize, f64),
    ) {
        let level = SimdLevel::best();
        for run in self.runs() {
            // J M Jᵀ, as a sum over joints.
            let mut on_wrenches = Matrix6::zeros();
            for (j, column) in run.spatial.iter().enumerate() {
                let row = m.column(j);
                let turned = Vector6::from(run.twist(row.as_slice()));
                on_wrenches += turned * Vector6::from(*column).transpose();
            }
            let mut form = [0.0; simd::TRIANGLE];
            for i in 0..6 {
                for j in 0..=i {
                    let twice = if i == j { 1.0 } else { 2.0 };
                    form[simd::entry(i, j)] = twice * on_wrenches[(i, j)];
                }
            }
            let sum = simd::Quadratic { cells, form, take: &mut take };
            level.run(run.blocks, run.n_contacts, &mut Prefetch::nothing(), sum);
        }
    }

    /// The levers as a matrix, n_joints × n_contacts, m²: for tests and small problems.
    pub fn levers(&self, cells: &[CellState]) -> DMatrix<f64> {
        let mut levers = DMatrix::zeros(self.n_joints, self.n_contacts);
        let mut column = 0;
        for run in self.runs() {
            for (block, count) in run.blocks() {
                for (lane, row) in rows_of(block, count).enumerate() {
                    let (p, u) = (cells[row].rest_point(), displacement_m(block, lane));
                    let wrench = -Vector6::from_iterator(u.iter().chain(&p.cross(&u)).copied());
                    levers.column_mut(column).copy_from(&run.matrix().tr_mul(&wrench));
                    column += 1;
                }
            }
        }
        levers
    }
}
