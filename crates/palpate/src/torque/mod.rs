//! What the joints feel: torques predicted from a stiffness field.
//!
//! This is where stiffness meets torque; [`crate::path_predictor`] sums the same up for whole paths. A
//! spring at rest point p, displaced by u, pushes its link with the force −K u at p + u; as moment
//! about the world's origin that is −K p × u, since u × u = 0. Summed over the contacts of a link
//! this is one wrench, and the link's spatial Jacobian J turns it into joint torques. The other way
//! round, a vector d over the joints, read as joint speeds, moves the link's points with
//! v(p) = (J d)₁ + (J d)₂ × p, and `w·d = −u·v(p)`. So a frame needs only u, the cell and the link of every contact: 16 bytes a contact,
//! in one stream, in place of a column of H. That a force is parallel to its u is what makes this
//! possible: a contact law with other forces needs p + u as well. The rest points are kept once a cell by whoever walks
//! over the frame.
//!
//! | paper | here                     | value                         | shape    | unit    |
//! |-------|--------------------------|-------------------------------|----------|---------|
//! | Eq. 2 | [`lever`]                | `w = −J(q, p+u)ᵀ u`           | n_joints | m²      |
//! | Eq. 3 | [`Stiffness`]            | K of κ, or of z               |          | N/m     |
//! | Eq. 5 | [`Observation::predict`] | `τ̂ = Σ wᵢ Kᵢ`                | n_joints | N·m     |
//! |       | [`Observation::gram`]    | `H P Hᵀ`, P diagonal          | n × n    | (N·m)²  |
//! |       | [`Observation::spread`]  | `Hᵀ d`, contact by contact    |          |         |
//!
//! Here H is made of levers, without the sign of κ: [`crate::ekf`] adds it. The module knows
//! neither time, nor priors, nor how contacts are found. Gravity is not modelled here: the
//! torques it explains are external ones.

mod simd;

use nalgebra::{DMatrix, DVector, DVectorView, Matrix6, Matrix6xX, Point3, Vector3, Vector6};
use prefetch_index::prefetch_index;
use pulp::bytemuck::{cast, cast_slice};

use simd::SimdLevel;

use crate::contact::Contacts;
use crate::lattice::{CellRows, RowsOfRuns};
use crate::robot::{LinkId, Poses, Robot};

/// Torque that a displaced point exerts at unit stiffness: `w = −J(q, p+u)ᵀ u` (Eq. 2).
///
/// This is the definition, one contact at a time; [`Observation`] computes the same by wrenches.
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

/// Contacts in a block, one per lane.
const LANES: usize = 4;

/// Four displaced points, of which millions stream by: u by axis (m, world frame) as the bits of
/// `f32`, then the cells' rows in [`CellRows`]; 64 bytes, a line of the cache.
type Block = [[u32; LANES]; 4];

/// A block of one to four contacts. Lanes without one are not displaced and repeat the last row.
fn block(contacts: impl Iterator<Item = ([f32; 3], u32)>) -> Block {
    let mut block = [[0; LANES]; 4];
    for (lane, (displacement_m, row)) in contacts.take(LANES).enumerate() {
        let [x, y, z] = displacement_m.map(f32::to_bits);
        (block[0][lane], block[1][lane], block[2][lane]) = (x, y, z);
        block[3][lane..].fill(row);
    }
    block
}

/// The rows of the first so many contacts of a block.
#[inline(always)]
fn rows_of(&[_, _, _, rows]: &Block, count: usize) -> impl Iterator<Item = usize> + use<> {
    rows.into_iter().take(count).map(|row| row as usize)
}

/// u of a lane.
fn displacement_m([x, y, z, _]: &Block, lane: usize) -> Vector3<f64> {
    Vector3::new(x[lane], y[lane], z[lane]).map(|bits| f64::from(f32::from_bits(bits)))
}

/// Numbers that a block takes in a frame.
const BLOCK: usize = size_of::<Block>() / size_of::<f64>();

/// A touched cell as sums over contacts need it: its rest point (world frame, m) and its unknown
/// (N/m); 32 bytes, half a line of the cache.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Cell([f64; 4]);

impl Cell {
    /// A cell at a rest point, m.
    pub fn new([x, y, z]: [f64; 3], unknown: f64) -> Self {
        Self([x, y, z, unknown])
    }

    /// The estimator's variable of this cell: z of `map`, κ of `ekf`, K of a finished field; N/m.
    #[inline]
    pub fn unknown(&self) -> f64 {
        self.0[3]
    }

    /// The same, to be changed.
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
pub enum Stiffness {
    /// `K = max(z, 0)`.
    Positive,
    /// `K = |κ|` (Eq. 3).
    Magnitude,
}

/// One frame as the estimators see it: the displacement and row of every contact, the Jacobian of every
/// link that touches, and the torque that they explain. Levers are formed on the fly.
///
/// All of it is one block of memory in the order in which it is walked over, because a remembered
/// frame comes back from far away: every detour would be waited for.
#[derive(Debug, Clone)]
pub struct Observation {
    /// τ; then for every link that touches: the number of its contacts, J column by column, and
    /// the contacts in blocks; then the notes.
    stream: Vec<f64>,
    n_joints: usize,
    n_contacts: usize,
    /// Numbers before the notes.
    n_measured: usize,
}

/// A remembered frame on its way from main memory.
///
/// The walk over a frame does so much for every contact that the processor looks only a few
/// contacts ahead, and would wait for memory. So whoever walks over a frame asks for a little of
/// the next one at every block, and finds it close by when its turn comes.
#[derive(Debug)]
pub(crate) struct Prefetch<'a>(&'a [f64]);

impl Prefetch<'_> {
    /// Numbers by which it goes on at a block: half of one, since a visit walks over a frame twice.
    const STRIDE: usize = BLOCK / 2;

    /// Nothing comes next.
    pub(crate) fn nothing() -> Self {
        Self(&[])
    }

    /// Asks for a little more.
    #[inline(always)]
    fn ask(&mut self) {
        prefetch_index(self.0, 0);
        self.0 = self.0.get(Self::STRIDE..).unwrap_or_default();
    }

    /// Asks for all that is left.
    pub(crate) fn finish(mut self) {
        while !self.0.is_empty() {
            self.ask();
        }
    }
}

/// One link's contacts in an [`Observation`].
struct Run<'a> {
    /// J, 6 × n_joints: wrench on the link, about the world's origin, to joint torques is `Jᵀ`.
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

/// Builds the observation of frame after frame, and numbers their cells.
#[derive(Debug, Clone)]
pub struct ObservationBuilder {
    rows: CellRows,
    runs: RowsOfRuns,
}

impl ObservationBuilder {
    /// A builder whose cells are numbered so far as `rows` says.
    pub fn new(rows: CellRows) -> Self {
        Self { rows, runs: RowsOfRuns::default() }
    }

    /// The cells' numbers so far.
    pub fn rows(&self) -> &CellRows {
        &self.rows
    }

    /// Builds the observation of a step; cells seen for the first time get their rows here.
    ///
    /// `tau` is the external torque of the step, n_joints, N·m. The contacts of successive steps
    /// are best handed to one builder: it finds the rows of cells that stayed without a look-up.
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
        // With room for notes: an estimator keeps a vector and a matrix over the joints, or nothing.
        let mut stream = Vec::with_capacity(n_measured + n_joints * (1 + n_joints));
        stream.extend_from_slice(tau.as_slice());
        for link in &contacts.links {
            stream.push(link.cells.len() as f64);
            stream.extend_from_slice(robot.spatial_jacobian(poses, link.link).as_slice());
            let rows = self.runs.follow(link.link.index(), &link.cells, &mut self.rows);
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

    /// The same contacts with another torque to explain, n_joints, N·m.
    ///
    /// # Panics
    ///
    /// If that has another number of joints, which is a bug in the caller.
    pub fn with_tau(mut self, tau: &DVector<f64>) -> Self {
        self.stream[..self.n_joints].copy_from_slice(tau.as_slice());
        self
    }

    /// The same observation with the torque of each joint counting less: τ_j and the joint's column of every Jacobian,
    /// times a weight. An estimator that takes σ_j for the noise of a torque so takes σ_j / weight_j for this one's.
    ///
    /// # Panics
    ///
    /// If there is not one weight for each joint.
    pub fn weighted(mut self, weights: &[f64]) -> Self {
        let n = self.n_joints;
        assert_eq!(weights.len(), n, "one weight a joint");
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

    /// τ: the external torque to explain, n_joints, N·m.
    pub fn tau(&self) -> DVectorView<'_, f64> {
        DVectorView::from_slice(&self.stream[..self.n_joints], self.n_joints)
    }

    /// Keeps numbers of an estimator with the frame, which come back when it does.
    pub fn note(&mut self, numbers: impl ExactSizeIterator<Item = f64>) {
        // Left to itself, a frame that was copied, and has no room, would take twice its size.
        self.stream.reserve_exact(numbers.len());
        self.stream.extend(numbers);
    }

    /// All numbers noted, in their order.
    pub fn notes(&self) -> &[f64] {
        &self.stream[self.n_measured..]
    }

    /// The same, to be changed.
    pub fn notes_mut(&mut self) -> &mut [f64] {
        &mut self.stream[self.n_measured..]
    }

    /// Joints whose torque it explains.
    pub fn n_joints(&self) -> usize {
        self.n_joints
    }

    /// Contacts of the frame.
    pub fn n_contacts(&self) -> usize {
        self.n_contacts
    }

    /// The contacts' rows in [`CellRows`], link by link.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.runs().flat_map(|run| run.blocks()).flat_map(|(block, count)| rows_of(block, count))
    }

    /// Brings the frame closer, bit by bit, while another is walked over.
    pub(crate) fn prefetch(&self) -> Prefetch<'_> {
        Prefetch(&self.stream)
    }

    /// Memory that the frame holds.
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
    pub fn predict(&self, cells: &[Cell], stiffness: Stiffness) -> DVector<f64> {
        self.predict_prefetching(&mut Prefetch::nothing(), cells, stiffness)
    }

    /// The same, and brings the next frame closer meanwhile.
    pub(crate) fn predict_prefetching(
        &self,
        prefetch: &mut Prefetch<'_>,
        cells: &[Cell],
        stiffness: Stiffness,
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
    pub fn torque_std(&self, cells: &[Cell], variance: impl Fn(usize) -> f64) -> DVector<f64> {
        self.gram(cells, variance).diagonal().map(|own| own.max(0.0).sqrt())
    }

    /// `H P Hᵀ` for a diagonal P, n × n, (N·m)²; `variance` gives P of a row, (N/m)².
    pub fn gram(&self, cells: &[Cell], variance: impl Fn(usize) -> f64) -> DMatrix<f64> {
        let level = SimdLevel::best();
        let mut gram = DMatrix::zeros(self.n_joints, self.n_joints);
        for run in self.runs() {
            let sums = [simd::ZERO; simd::TRIANGLE];
            let sum = simd::Gram { cells, weight: &variance, sums };
            let sum = level.run(run.blocks, run.n_contacts, &mut Prefetch::nothing(), sum);
            // Jᵀ W J, column by column: too small for the machinery of large products.
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
    pub fn spread(
        &self,
        cells: &mut [Cell],
        d: &[f64],
        mut take: impl FnMut(&mut Cell, usize, f64),
    ) {
        let level = SimdLevel::best();
        for run in self.runs() {
            let (cells, twist) = (&mut *cells, simd::Twist(run.twist(d)));
            let sum = simd::Spread { cells, twist, take: &mut take };
            level.run(run.blocks, run.n_contacts, &mut Prefetch::nothing(), sum);
        }
    }

    /// `unknown += Hᵀ d`, cell by cell; brings the next frame closer meanwhile.
    ///
    /// As a cell has one contact in a frame, four can be added at once.
    pub(crate) fn add(&self, prefetch: &mut Prefetch<'_>, cells: &mut [Cell], d: &[f64]) {
        let level = SimdLevel::best();
        for run in self.runs() {
            let (cells, twist) = (&mut *cells, simd::Twist(run.twist(d)));
            level.run(run.blocks, run.n_contacts, prefetch, simd::Add { cells, twist });
        }
    }

    /// `wᵢᵀ M wᵢ` of every contact for a symmetric M (n × n): `take` gets its row and the value.
    pub fn quadratic(&self, cells: &[Cell], m: &DMatrix<f64>, mut take: impl FnMut(usize, f64)) {
        let level = SimdLevel::best();
        for run in self.runs() {
            // S M Sᵀ, as a sum over joints.
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
    pub fn levers(&self, cells: &[Cell]) -> DMatrix<f64> {
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
