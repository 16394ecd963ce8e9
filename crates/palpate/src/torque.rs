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

const STRIDE: usize = 64;
/// One displaced point: 16 bytes, of which millions stream by.
#[derive(Debug, Clone, Copy)]
struct Contact {
    /// u, world frame, m.
    displacement_m: [f32; 3],
    /// The cell's row in [`CellRows`].
    row: u32,
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

/// What the joint speeds d do to the points of a link, seen from one of its contacts.
#[derive(Debug, Clone, Copy)]
pub struct Push<'a> {
    displacement_m: [f32; 3],
    /// Linear velocity at the world's origin, and angular.
    twist: &'a [f64; 6],
}

impl Push<'_> {
    /// `w·d = −u·v(p)` for the contact's rest point p, world frame, m.
    #[inline]
    pub fn at(&self, [px, py, pz]: [f64; 3]) -> f64 {
        let [ux, uy, uz] = self.displacement_m.map(f64::from);
        let [lx, ly, lz, ax, ay, az] = *self.twist;
        let vx = lx + (ay * pz - az * py);
        let vy = ly + (az * px - ax * pz);
        let vz = lz + (ax * py - ay * px);
        -(ux * vx + uy * vy + uz * vz)
    }
}

/// A quadratic form over joint torques, seen from one contact.
#[derive(Debug, Clone, Copy)]
pub struct Form<'a> {
    displacement_m: [f32; 3],
    /// The form over wrenches: the triangle of a symmetric matrix, twice what is off its diagonal.
    on_wrenches: &'a [[f64; 6]; 6],
}

impl Form<'_> {
    /// `wᵀ M w` for the contact's rest point, world frame, m.
    #[inline]
    pub fn at(&self, point: [f64; 3]) -> f64 {
        let unit = wrench(point, self.displacement_m);
        let mut value = 0.0;
        for (i, row) in self.on_wrenches.iter().enumerate() {
            let dot: f64 = row[..=i].iter().zip(&unit).map(|(form, part)| form * part).sum();
            value += unit[i] * dot;
        }
        value
    }
}

/// Force and moment about the world's origin of a spring of unit stiffness.
#[inline]
fn wrench([px, py, pz]: [f64; 3], displacement: [f32; 3]) -> [f64; 6] {
    let [ux, uy, uz] = displacement.map(f64::from);
    [-ux, -uy, -uz, pz * uy - py * uz, px * uz - pz * ux, py * ux - px * uy]
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
            observation
                .contacts
                .extend(pairs.map(|(&displacement_m, &row)| Contact { displacement_m, row }));
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
        self.contacts.iter().map(|contact| contact.row as usize)
    }

    /// Asks memory for the whole frame at once.
    ///
    /// A remembered frame comes back from main memory, in pieces that the processor would wait
    /// for one after the other; these reads depend on nothing, so it waits for all together.
    pub fn fetch(&self) {
        let contacts = self.contacts.iter().step_by(STRIDE).map(|contact| contact.row);
        let spatial = self.spatial.iter().step_by(8).map(|column| column[0] as u32);
        let sum = contacts.chain(spatial).chain(self.ends.first().copied());
        std::hint::black_box(sum.fold(self.tau[0] as u32, u32::wrapping_add));
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
    /// `cell` gives the rest point (m) and K (N/m) of a row. Cost: 18 multiply-adds a contact.
    pub fn predict(&self, cell: impl Fn(usize) -> ([f64; 3], f64)) -> DVector<f64> {
        let mut tau = DVector::zeros(self.tau.len());
        for run in self.runs() {
            let (mut force, mut moment) = ([0.0; 3], [0.0; 3]);
            for contact in run.contacts {
                let ([px, py, pz], k) = cell(contact.row as usize);
                let [fx, fy, fz] = contact.displacement_m.map(|u| -k * f64::from(u));
                force[0] += fx;
                force[1] += fy;
                force[2] += fz;
                moment[0] += py * fz - pz * fy;
                moment[1] += pz * fx - px * fz;
                moment[2] += px * fy - py * fx;
            }
            let ([fx, fy, fz], [mx, my, mz]) = (force, moment);
            for (torque, [lx, ly, lz, ax, ay, az]) in tau.iter_mut().zip(run.spatial) {
                *torque += (lx * fx + ly * fy + lz * fz) + (ax * mx + ay * my + az * mz);
            }
        }
        tau
    }

    /// `H S Hᵀ` for several diagonal S at once, n × n each, (N·m)².
    ///
    /// `cell` gives the rest point (m) of a row and its entries of the S, (N/m)².
    pub fn grams<const N: usize>(
        &self,
        cell: impl Fn(usize) -> ([f64; 3], [f64; N]),
    ) -> [DMatrix<f64>; N] {
        let n_joints = self.tau.len();
        let mut grams = [(); N].map(|()| DMatrix::zeros(n_joints, n_joints));
        for run in self.runs() {
            let mut sums = [[[0.0; 6]; 6]; N];
            for contact in run.contacts {
                let (point, weights) = cell(contact.row as usize);
                let unit = wrench(point, contact.displacement_m);
                for i in 0..6 {
                    for j in 0..=i {
                        let product = unit[i] * unit[j];
                        for (sum, weight) in sums.iter_mut().zip(weights) {
                            sum[i][j] += weight * product;
                        }
                    }
                }
            }
            let spatial = run.matrix();
            for (gram, sum) in grams.iter_mut().zip(sums) {
                let wrenches = Matrix6::from_fn(|i, j| sum[i.max(j)][i.min(j)]);
                *gram += spatial.transpose() * (wrenches * &spatial);
            }
        }
        grams
    }

    /// `(Hᵀ d)ᵢ = wᵢ·d` of every contact: `take` gets its row, and what gives `wᵢ·d` at its point.
    ///
    /// A cell has one contact in a frame, so every row comes at most once.
    pub fn spread(&self, d: &DVector<f64>, mut take: impl FnMut(usize, Push<'_>)) {
        for run in self.runs() {
            let twist = run.twist(d);
            for &Contact { displacement_m, row } in run.contacts {
                take(row as usize, Push { displacement_m, twist: &twist });
            }
        }
    }

    /// `wᵢᵀ M wᵢ` of every contact for a symmetric M (n × n): `take` gets its row, and what gives
    /// the value at its point.
    pub fn quadratic(&self, m: &DMatrix<f64>, mut take: impl FnMut(usize, Form<'_>)) {
        for run in self.runs() {
            let spatial = run.matrix();
            let on_wrenches = &spatial * m * spatial.transpose();
            let twice = |i, j| on_wrenches[(i, j)] * if i == j { 1.0 } else { 2.0 };
            let on_wrenches: [[f64; 6]; 6] =
                std::array::from_fn(|i| std::array::from_fn(|j| twice(i, j)));
            for &Contact { displacement_m, row } in run.contacts {
                take(row as usize, Form { displacement_m, on_wrenches: &on_wrenches });
            }
        }
    }

    /// The levers as a matrix, n_joints × n_contacts, m²: for tests and small problems.
    ///
    /// `points_m` are the rest points by row.
    pub fn levers(&self, points_m: &[[f64; 3]]) -> DMatrix<f64> {
        let mut levers = DMatrix::zeros(self.tau.len(), self.contacts.len());
        let mut column = 0;
        for run in self.runs() {
            for contact in run.contacts {
                let unit = wrench(points_m[contact.row as usize], contact.displacement_m);
                let lever = run.matrix().tr_mul(&Vector6::from(unit));
                levers.column_mut(column).copy_from(&lever);
                column += 1;
            }
        }
        levers
    }
}
