//! What the joints feel: torques predicted from a stiffness field.
//!
//! This is the only module where stiffness meets torque. A spring at rest point p, displaced by
//! u, pushes its link with the force −K u at p + u; as moment about the world's origin that is
//! −K p × u, since u × u = 0. Summed over the contacts of a link this is one wrench, and the
//! link's spatial Jacobian S turns it into joint torques. So a frame needs only u, the cell and
//! the link of every contact: 16 bytes a contact in place of a column of H.
//!
//! | paper | here                     | value                         | shape    | unit    |
//! |-------|--------------------------|-------------------------------|----------|---------|
//! | Eq. 2 | [`lever`]                | `w = −J(q, p+u)ᵀ u`           | n_joints | m²      |
//! | Eq. 5 | [`Observation::predict`] | `τ̂ = Σ wᵢ Kᵢ`                | n_joints | N·m     |
//! |       | [`Observation::gram`]    | `H S Hᵀ`, S diagonal          | n × n    | (N·m)²  |
//! |       | [`Observation::spread`]  | `Hᵀ d`, contact by contact    |          |         |
//!
//! Here H is made of levers, without the sign of κ: [`crate::ekf`] adds it. The module knows
//! neither time, nor priors, nor how contacts are found. Gravity is not modelled here: the
//! torques it explains are external ones.

use nalgebra::{DMatrix, DVector, Matrix6, Matrix6xX, Point3, Vector3, Vector6};

use crate::contact::Contacts;
use crate::lattice::CellRows;
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

/// One link's run of contacts in an [`Observation`].
#[derive(Debug, Clone)]
struct Span {
    /// One past the link's last contact.
    end: usize,
    /// S: wrench on the link, about the world's origin, to joint torques is `Sᵀ`.
    spatial: Matrix6xX<f64>,
}

/// One frame as the estimators see it: the contacts' levers, folded, and the torque they explain.
#[derive(Debug, Clone)]
pub struct Observation {
    spans: Vec<Span>,
    rows: Vec<u32>,
    displacements_m: Vec<[f32; 3]>,
    /// τ: external torque, n_joints, N·m.
    pub tau: DVector<f64>,
}

/// Force and moment about the world's origin of a spring of unit stiffness.
#[inline]
fn wrench(rest: [f32; 3], displacement: [f32; 3]) -> [f64; 6] {
    let [px, py, pz] = rest.map(f64::from);
    let [ux, uy, uz] = displacement.map(f64::from);
    [-ux, -uy, -uz, pz * uy - py * uz, px * uz - pz * ux, py * ux - px * uy]
}

#[inline]
fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5]
}

impl Observation {
    /// Folds the contacts of a step; cells seen for the first time get their rows here.
    ///
    /// `tau` is the external torque of the step, n_joints, N·m.
    pub fn new(
        robot: &Robot,
        poses: &Poses,
        contacts: &Contacts,
        rows: &mut CellRows,
        tau: DVector<f64>,
    ) -> Self {
        let n_contacts = contacts.len();
        let mut observation = Self {
            spans: Vec::with_capacity(contacts.links.len()),
            rows: Vec::with_capacity(n_contacts),
            displacements_m: Vec::with_capacity(n_contacts),
            tau,
        };
        for link in &contacts.links {
            observation.rows.extend(link.cells.iter().map(|&cell| rows.row_of(cell)));
            observation.displacements_m.extend_from_slice(&link.displacements_m);
            let spatial = robot.spatial_jacobian(poses, link.link);
            observation.spans.push(Span { end: observation.rows.len(), spatial });
        }
        observation
    }

    /// Contacts of the frame.
    pub fn n_contacts(&self) -> usize {
        self.rows.len()
    }

    /// The contacts' rows in [`CellRows`], link by link.
    pub fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// Memory that the frame holds.
    pub fn bytes(&self) -> usize {
        let joints = self.tau.len() * size_of::<f64>();
        size_of::<Self>()
            + joints
            + self.rows.len() * (size_of::<u32>() + size_of::<[f32; 3]>())
            + self.spans.len() * (size_of::<Span>() + 6 * joints)
    }

    /// Torque that the field exerts: `τ̂ = Σ wᵢ Kᵢ` (Eq. 5), n_joints, N·m.
    ///
    /// `points_m` are the rest points by row, `stiffness` gives K of a row.
    pub fn predict(&self, points_m: &[[f32; 3]], stiffness: impl Fn(usize) -> f64) -> DVector<f64> {
        let mut tau = DVector::zeros(self.tau.len());
        let mut start = 0;
        for span in &self.spans {
            let mut sum = [0.0; 6];
            for contact in start..span.end {
                let row = self.rows[contact] as usize;
                let k = stiffness(row);
                let unit = wrench(points_m[row], self.displacements_m[contact]);
                for (total, part) in sum.iter_mut().zip(unit) {
                    *total += k * part;
                }
            }
            tau.gemv_tr(1.0, &span.spatial, &Vector6::from(sum), 1.0);
            start = span.end;
        }
        tau
    }

    /// `H S Hᵀ` for a diagonal S, n × n, (N·m)²; `variance` gives S of a row, (N/m)².
    pub fn gram(&self, points_m: &[[f32; 3]], variance: impl Fn(usize) -> f64) -> DMatrix<f64> {
        let n_joints = self.tau.len();
        let mut gram = DMatrix::zeros(n_joints, n_joints);
        let mut start = 0;
        for span in &self.spans {
            let mut wrenches = Matrix6::zeros();
            for contact in start..span.end {
                let row = self.rows[contact] as usize;
                let unit = wrench(points_m[row], self.displacements_m[contact]);
                let s = variance(row);
                for j in 0..6 {
                    let scaled = s * unit[j];
                    for i in j..6 {
                        wrenches[(i, j)] += scaled * unit[i];
                    }
                }
            }
            wrenches.fill_upper_triangle_with_lower_triangle();
            gram += span.spatial.transpose() * wrenches * &span.spatial;
            start = span.end;
        }
        gram
    }

    /// `(Hᵀ d)ᵢ = wᵢ·d` of every contact, handed to `take` with the contact's row.
    ///
    /// A cell has one contact in a frame, so every row comes at most once.
    pub fn spread(
        &self,
        points_m: &[[f32; 3]],
        d: &DVector<f64>,
        mut take: impl FnMut(usize, f64),
    ) {
        let mut start = 0;
        for span in &self.spans {
            let twist: [f64; 6] = (&span.spatial * d).fixed_rows::<6>(0).into_owned().into();
            for contact in start..span.end {
                let row = self.rows[contact] as usize;
                let unit = wrench(points_m[row], self.displacements_m[contact]);
                take(row, dot(&unit, &twist));
            }
            start = span.end;
        }
    }

    /// `wᵢᵀ M wᵢ` of every contact for a symmetric M (n × n), handed to `take` with its row.
    pub fn quadratic(
        &self,
        points_m: &[[f32; 3]],
        m: &DMatrix<f64>,
        mut take: impl FnMut(usize, f64),
    ) {
        let mut start = 0;
        for span in &self.spans {
            let on_wrenches = &span.spatial * m * span.spatial.transpose();
            let on_wrenches: Matrix6<f64> = on_wrenches.fixed_view::<6, 6>(0, 0).into_owned();
            for contact in start..span.end {
                let row = self.rows[contact] as usize;
                let unit = wrench(points_m[row], self.displacements_m[contact]);
                let mut value = 0.0;
                for j in 0..6 {
                    let column: [f64; 6] = on_wrenches.column(j).into_owned().into();
                    value += unit[j] * dot(&unit, &column);
                }
                take(row, value);
            }
            start = span.end;
        }
    }

    /// The levers as a matrix, n_joints × n_contacts, m²: for tests and small problems.
    pub fn levers(&self, points_m: &[[f32; 3]]) -> DMatrix<f64> {
        let mut levers = DMatrix::zeros(self.tau.len(), self.rows.len());
        let mut start = 0;
        for span in &self.spans {
            for contact in start..span.end {
                let row = self.rows[contact] as usize;
                let unit = wrench(points_m[row], self.displacements_m[contact]);
                levers.column_mut(contact).gemv_tr(1.0, &span.spatial, &Vector6::from(unit), 0.0);
            }
            start = span.end;
        }
        levers
    }
}
