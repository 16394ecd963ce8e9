//! What the joints feel: torques predicted from a stiffness field.
//!
//! This is the only module where stiffness meets torque. A spring at rest point p, displaced by
//! u, pushes its link with the force −K u at p + u; as moment about the world's origin that is
//! −K p × u, since u × u = 0. Summed over the contacts of a link this is one wrench, and the
//! link's spatial Jacobian S turns it into joint torques. The other way round, joint speeds d move
//! the link's points with v(p) = (S d)₁ + (S d)₂ × p, and `w·d = −u·v(p)`. So a frame needs only
//! u, the cell and the link of every contact: 16 bytes a contact, in one stream, in place of a
//! column of H. The rest points are kept once a cell by whoever walks over the frame.
//!
//! | paper | here                     | value                         | shape    | unit    |
//! |-------|--------------------------|-------------------------------|----------|---------|
//! | Eq. 2 | [`lever`]                | `w = −J(q, p+u)ᵀ u`           | n_joints | m²      |
//! | Eq. 5 | [`Observation::predict`] | `τ̂ = Σ wᵢ Kᵢ`                | n_joints | N·m     |
//! |       | [`Observation::grams`]   | `H S Hᵀ`, S diagonal          | n × n    | (N·m)²  |
//! |       | [`Observation::spread`]  | `Hᵀ d`, contact by contact    |          |         |
//!
//! Here H is made of levers, without the sign of κ: [`crate::ekf`] adds it. The module knows
//! neither time, nor priors, nor how contacts are found. Gravity is not modelled here: the
//! torques it explains are external ones.

mod lanes;

use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Point3, Vector3, Vector6};

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

/// One displaced point, of which millions stream by: u (m, world frame) as the bits of three
/// `f32`, and the cell's row in [`CellRows`]; 16 bytes.
#[derive(Debug, Clone, Copy)]
struct Contact([u32; 4]);

impl Contact {
    fn new(displacement_m: [f32; 3], row: u32) -> Self {
        let [x, y, z] = displacement_m.map(f32::to_bits);
        Self([x, y, z, row])
    }

    fn displacement_m(&self) -> Vector3<f64> {
        let [x, y, z, _] = self.0;
        Vector3::new(x, y, z).map(|bits| f64::from(f32::from_bits(bits)))
    }

    #[inline]
    fn row(&self) -> u32 {
        self.0[3]
    }
}

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

    /// z of `map`, κ of `ekf`, K of a field; N/m.
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

/// One frame as the estimators see it: the contacts' levers, folded, and the torque they explain.
#[derive(Debug, Clone)]
pub struct Observation {
    /// One past the last contact of each link that touches.
    ends: Vec<u32>,
    /// S of those links, column by column, link after link: n_joints columns each.
    spatial: Vec<[f64; 6]>,
    contacts: Vec<Contact>,
    /// τ: external torque, n_joints, N·m.
    pub tau: DVector<f64>,
}

/// One link's contacts in an [`Observation`].
struct Run<'a> {
    /// S, 6 × n_joints: wrench on the link, about the world's origin, to joint torques is `Sᵀ`.
    spatial: &'a [[f64; 6]],
    contacts: &'a [Contact],
}

impl Run<'_> {
    /// `S d`: linear velocity at the world's origin, and angular.
    fn twist(&self, d: &DVector<f64>) -> [f64; 6] {
        let mut twist = [0.0; 6];
        for (column, speed) in self.spatial.iter().zip(d) {
            for (sum, part) in twist.iter_mut().zip(column) {
                *sum += speed * part;
            }
        }
        twist
    }

    /// S as a matrix.
    fn matrix(&self) -> Matrix6xX<f64> {
        Matrix6xX::from_column_slice(self.spatial.as_flattened())
    }
}

/// Folds frame after frame, and numbers their cells.
#[derive(Debug, Clone)]
pub struct Folder {
    rows: CellRows,
    runs: RowsOfRuns,
}

impl Folder {
    /// A folder whose cells are numbered so far as `rows` says.
    pub fn new(rows: CellRows) -> Self {
        Self { rows, runs: RowsOfRuns::default() }
    }

    /// The cells' numbers so far.
    pub fn rows(&self) -> &CellRows {
        &self.rows
    }

    /// Folds the contacts of a step; cells seen for the first time get their rows here.
    ///
    /// `tau` is the external torque of the step, n_joints, N·m. The contacts of successive steps
    /// are best handed to one folder: it finds the rows of cells that stayed without a look-up.
    pub fn fold(
        &mut self,
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        tau: DVector<f64>,
    ) -> Observation {
        let mut observation = Observation {
            ends: Vec::with_capacity(contacts.links.len()),
            spatial: Vec::with_capacity(contacts.links.len() * tau.len()),
            contacts: Vec::with_capacity(contacts.len()),
            tau,
        };
        for link in &contacts.links {
            let rows = self.runs.follow(link.link.index(), &link.cells, &mut self.rows);
            let pairs = link.displacements_m.iter().zip(rows);
            observation.contacts.extend(pairs.map(|(&u, &row)| Contact::new(u, row)));
            observation.ends.push(observation.contacts.len() as u32);
            let spatial = robot.spatial_jacobian(poses, link.link);
            observation.spatial.extend(spatial.column_iter().map(|column| {
                let column: [f64; 6] = column.into_owned().into();
                column
            }));
        }
        observation
    }
}

impl Observation {
    /// Folds the contacts of a single step, as [`Folder::fold`] does.
    pub fn new(
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        rows: &mut CellRows,
        tau: DVector<f64>,
    ) -> Self {
        let fresh = CellRows::new(rows.lattice().clone());
        let mut folder = Folder::new(std::mem::replace(rows, fresh));
        let observation = folder.fold(robot, poses, contacts, tau);
        *rows = folder.rows;
        observation
    }

    /// Contacts of the frame.
    pub fn n_contacts(&self) -> usize {
        self.contacts.len()
    }

    /// The contacts' rows in [`CellRows`], link by link.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = usize> {
        self.contacts.iter().map(|contact| contact.row() as usize)
    }

    /// Memory that the frame holds.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&*self.ends)
            + size_of_val(&*self.spatial)
            + size_of_val(&*self.contacts)
            + size_of_val(self.tau.as_slice())
    }

    /// The links' runs of contacts.
    fn runs(&self) -> impl Iterator<Item = Run<'_>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        let bounds = starts.zip(&self.ends).map(|(start, &end)| start as usize..end as usize);
        let spatial = self.spatial.chunks(self.tau.len().max(1));
        bounds.zip(spatial).map(|(run, spatial)| Run { spatial, contacts: &self.contacts[run] })
    }

    /// Torque that the field exerts: `τ̂ = Σ wᵢ Kᵢ` (Eq. 5), n_joints, N·m.
    ///
    /// `cells` are the touched cells by row.
    pub fn predict(&self, cells: &[Cell], stiffness: Stiffness) -> DVector<f64> {
        let mut tau = DVector::zeros(self.tau.len());
        for Run { spatial, contacts } in self.runs() {
            let sum = lanes::Wrench { cells, stiffness, sums: [lanes::ZERO; 6] };
            let [fx, fy, fz, mx, my, mz] = lanes::run(contacts, sum);
            for (torque, [lx, ly, lz, ax, ay, az]) in tau.iter_mut().zip(spatial) {
                *torque += (lx * fx + ly * fy + lz * fz) + (ax * mx + ay * my + az * mz);
            }
        }
        tau
    }

    /// `H S Hᵀ` for a diagonal S, n × n, (N·m)²; `variance` gives S of a row, (N/m)².
    pub fn gram(&self, cells: &[Cell], variance: impl Fn(usize) -> f64) -> DMatrix<f64> {
        let n_joints = self.tau.len();
        let mut gram = DMatrix::zeros(n_joints, n_joints);
        for run in self.runs() {
            let sums = [lanes::ZERO; lanes::TRIANGLE];
            let sum = lanes::run(run.contacts, lanes::Gram { cells, weight: &variance, sums });
            let wrenches = Matrix6::from_fn(|i, j| sum[lanes::entry(i.max(j), i.min(j))]);
            let spatial = run.matrix();
            gram += spatial.transpose() * (wrenches * &spatial);
        }
        gram
    }

    /// `(Hᵀ d)ᵢ = wᵢ·d` of every contact: `take` gets the cell, its row and the value.
    ///
    /// A cell has one contact in a frame, so every row comes at most once.
    pub fn spread(
        &self,
        cells: &mut [Cell],
        d: &DVector<f64>,
        mut take: impl FnMut(&mut Cell, usize, f64),
    ) {
        for run in self.runs() {
            let (cells, twist) = (&mut *cells, run.twist(d));
            lanes::run(run.contacts, lanes::Spread { cells, twist, take: &mut take });
        }
    }

    /// `wᵢᵀ M wᵢ` of every contact for a symmetric M (n × n): `take` gets its row and the value.
    pub fn quadratic(&self, cells: &[Cell], m: &DMatrix<f64>, mut take: impl FnMut(usize, f64)) {
        for run in self.runs() {
            let spatial = run.matrix();
            let on_wrenches = &spatial * m * spatial.transpose();
            let mut form = [0.0; lanes::TRIANGLE];
            for i in 0..6 {
                for j in 0..=i {
                    let twice = if i == j { 1.0 } else { 2.0 };
                    form[lanes::entry(i, j)] = twice * on_wrenches[(i, j)];
                }
            }
            lanes::run(run.contacts, lanes::Quadratic { cells, form, take: &mut take });
        }
    }

    /// The levers as a matrix, n_joints × n_contacts, m²: for tests and small problems.
    pub fn levers(&self, cells: &[Cell]) -> DMatrix<f64> {
        let mut levers = DMatrix::zeros(self.tau.len(), self.contacts.len());
        let mut column = 0;
        for run in self.runs() {
            for contact in run.contacts {
                let (p, u) = (cells[contact.row() as usize].rest_point(), contact.displacement_m());
                let wrench = -Vector6::from_iterator(u.iter().chain(&p.cross(&u)).copied());
                levers.column_mut(column).copy_from(&run.matrix().tr_mul(&wrench));
                column += 1;
            }
        }
        levers
    }
}
