//! Inverse dynamics, and its regressor: the matrix that gives it when multiplied by the inertial parameters.
//!
//! The torque that the motors need is `τ = Y(q, q̇, q̈) π` (Atkeson, An and Hollerbach 1986), where `π` has ten numbers
//! for each *body*: the links between one moving joint and the next, which are rigidly connected. The frame of a body
//! is that of the link that its joint carries:
//!
//! ```text
//! π = [m, m·c (3), I_xx, I_xy, I_xz, I_yy, I_yz, I_zz]      I about the origin of the body's frame
//! ```
//!
//! Velocities and accelerations are twists at the world origin as in [`super::kinematics`]; gravity is an upward
//! acceleration of the base. At rest, `τ` is minus [`Robot::gravity_torque`].

use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix3xX, Vector3};

use super::kinematics::{GRAVITY_M_PER_S2, Twist};
use super::{Link, LinkId, Poses, Robot};

/// Number of inertial parameters of a body: mass, mass times centre of mass, inertia about the origin of its frame.
pub const N_INERTIAL_PARAMETERS: usize = 10;

impl Robot {
    /// The bodies: for each moving joint, mimic joints too, the link that it carries.
    pub fn bodies(&self) -> impl ExactSizeIterator<Item = LinkId> {
        self.movers.iter().map(|mover| LinkId(mover.child as u16)) // no link has a larger index
    }

    /// The body that a link belongs to, as an index into [`Robot::bodies`]; `None` if no joint moves it.
    pub fn body_of(&self, link: LinkId) -> Option<usize> {
        self.mounts[link.index()].carriers.last().map(|mover| usize::from(*mover))
    }

    /// Inertial parameters of all bodies, from those of the links, 10 × n_bodies numbers, body by body: kg, kg·m and
    /// kg·m².
    pub fn inertial_parameters(&self) -> DVector<f64> {
        let mut parameters = DVector::zeros(N_INERTIAL_PARAMETERS * self.movers.len());
        for (index, link) in self.links.iter().enumerate() {
            let id = LinkId(index as u16);
            let (Some(body), Some(pose)) = (self.body_of(id), self.body_from_link(id)) else {
                continue;
            };
            let rotation = pose.rotation.to_rotation_matrix();
            let com = (pose * link.com_link_m).coords;
            let about_com = rotation * link.inertia_com_kg_m2 * rotation.transpose();
            let about_origin = about_com + link.mass_kg * about(&com);
            let mut own = parameters.rows_mut(N_INERTIAL_PARAMETERS * body, N_INERTIAL_PARAMETERS);
            own += DVector::from_column_slice(&[
                link.mass_kg,
                link.mass_kg * com.x,
                link.mass_kg * com.y,
                link.mass_kg * com.z,
                about_origin[(0, 0)],
                about_origin[(0, 1)],
                about_origin[(0, 2)],
                about_origin[(1, 1)],
                about_origin[(1, 2)],
                about_origin[(2, 2)],
            ]);
        }
        parameters
    }

    /// Sets the inertial parameters of all bodies (10 × n_bodies): those of a body are given to the link that its joint
    /// carries, and the links that are fixed to this link get zero mass.
    ///
    /// # Panics
    ///
    /// If there are not ten numbers for each body.
    pub fn with_inertial_parameters(mut self, parameters: &DVector<f64>) -> Robot {
        assert_eq!(parameters.len(), N_INERTIAL_PARAMETERS * self.movers.len());
        for index in 0..self.links.len() {
            let Some(body) = self.body_of(LinkId(index as u16)) else { continue };
            let link = &mut self.links[index];
            (link.mass_kg, link.inertia_com_kg_m2) = (0.0, Matrix3::zeros());
            if index == self.movers[body].child {
                set_inertia(
                    link,
                    parameters.rows(N_INERTIAL_PARAMETERS * body, N_INERTIAL_PARAMETERS).as_slice(),
                );
            }
        }
        self
    }

    /// `Y`, n_joints × (10 · n_bodies): the motors' torque at these joint speeds and accelerations (n_joints each,
    /// rad/s and rad/s², or m) is `Y π`, N·m (N where prismatic).
    ///
    /// # Panics
    ///
    /// If `poses` belong to another robot, or there is not one speed and one acceleration for each joint.
    pub fn regressor(&self, poses: &Poses, speed: &[f64], acceleration: &[f64]) -> DMatrix<f64> {
        let n = self.n_joints();
        assert!(
            speed.len() == n && acceleration.len() == n,
            "one speed and one acceleration for each joint"
        );
        let mut regressor = DMatrix::zeros(n, N_INERTIAL_PARAMETERS * self.movers.len());
        for (body, mover) in self.movers.iter().enumerate() {
            let link = mover.child;
            let carriers = &self.mounts[link].carriers;
            let mut velocity = Twist::default();
            let mut change = Twist { linear: -GRAVITY_M_PER_S2, angular: Vector3::zeros() };
            for &carrier in carriers {
                let (mover, twist) = self.carrier(poses, carrier);
                let rate = mover.multiplier * speed[mover.source];
                change.add(&twist, mover.multiplier * acceleration[mover.source]);
                change.add(&velocity.cross(&twist), rate);
                velocity.add(&twist, rate);
            }
            let (force, moment) =
                wrench_regressor(&poses.world_from_link[link], &velocity, &change);
            for &carrier in carriers {
                let (mover, twist) = self.carrier(poses, carrier);
                let power = twist.linear.transpose() * &force + twist.angular.transpose() * &moment;
                let mut row = regressor.view_mut(
                    (mover.source, N_INERTIAL_PARAMETERS * body),
                    (1, N_INERTIAL_PARAMETERS),
                );
                row += mover.multiplier * power;
            }
        }
        regressor
    }

    /// The torque that the motors need, n_joints, N·m: gravity, inertia, Coriolis; no friction.
    ///
    /// # Panics
    ///
    /// As [`Robot::regressor`].
    pub fn inverse_dynamics(
        &self,
        poses: &Poses,
        speed: &[f64],
        acceleration: &[f64],
    ) -> DVector<f64> {
        self.regressor(poses, speed, acceleration) * self.inertial_parameters()
    }

    /// Pose of a link in the frame of its body: the joints between are fixed. `None` if no joint moves it.
    pub fn body_from_link(&self, link: LinkId) -> Option<Isometry3<f64>> {
        let first = self.movers[self.body_of(link)?].child;
        let (mut pose, mut link) = (Isometry3::identity(), link.index());
        while link != first {
            pose = self.mounts[link].parent_from_link * pose;
            link = self.links[link].parent.expect("a body's links hang from its first").index();
        }
        Some(pose)
    }
}

impl Twist {
    fn add(&mut self, other: &Twist, factor: f64) {
        self.linear += factor * other.linear;
        self.angular += factor * other.angular;
    }

    /// Rate of change of `other` when it moves with `self`: the cross product of motions.
    fn cross(&self, other: &Twist) -> Twist {
        Twist {
            linear: self.angular.cross(&other.linear) + self.linear.cross(&other.angular),
            angular: self.angular.cross(&other.angular),
        }
    }
}

/// Force and moment about the world origin that a body needs, as matrices to be multiplied by its ten parameters.
fn wrench_regressor(
    pose: &Isometry3<f64>,
    velocity: &Twist,
    change: &Twist,
) -> (Matrix3xX<f64>, Matrix3xX<f64>) {
    let (origin, omega, alpha) = (pose.translation.vector, velocity.angular, change.angular);
    let speed = velocity.linear + omega.cross(&origin);
    let acceleration = change.linear + alpha.cross(&origin) + omega.cross(&speed);

    let rotation = pose.rotation.to_rotation_matrix().into_inner();
    let to_body = rotation.transpose();
    let (omega, alpha, acceleration) = (to_body * omega, to_body * alpha, to_body * acceleration);
    let turning = alpha.cross_matrix() + omega.cross_matrix() * omega.cross_matrix();

    let mut force = Matrix3xX::zeros(N_INERTIAL_PARAMETERS);
    force.set_column(0, &acceleration);
    force.fixed_view_mut::<3, 3>(0, 1).copy_from(&turning);
    let mut moment = Matrix3xX::zeros(N_INERTIAL_PARAMETERS);
    moment.fixed_view_mut::<3, 3>(0, 1).copy_from(&-acceleration.cross_matrix());
    let turned = tensor_times(&alpha) + omega.cross_matrix() * tensor_times(&omega);
    moment.fixed_view_mut::<3, 6>(0, 4).copy_from(&turned);

    let force = rotation * force;
    let moment = rotation * moment + origin.cross_matrix() * &force;
    (force, moment)
}

/// `L` such that `I w = L [I_xx, I_xy, I_xz, I_yy, I_yz, I_zz]`.
fn tensor_times(w: &Vector3<f64>) -> nalgebra::Matrix3x6<f64> {
    let (x, y, z) = (w.x, w.y, w.z);
    nalgebra::matrix![
        x, y, z, 0.0, 0.0, 0.0;
        0.0, x, 0.0, y, z, 0.0;
        0.0, 0.0, x, 0.0, y, z
    ]
}

/// Inertia about the origin of a unit mass at `point`.
pub(super) fn about(point: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::identity() * point.norm_squared() - point * point.transpose()
}

/// Sets the ten parameters of a link, in its own frame. Without mass, the centre of mass is set to zero.
fn set_inertia(link: &mut Link, parameters: &[f64]) {
    let &[mass_kg, mx, my, mz, xx, xy, xz, yy, yz, zz] = parameters else {
        unreachable!("ten numbers for each body")
    };
    let com = if mass_kg == 0.0 { Vector3::zeros() } else { Vector3::new(mx, my, mz) / mass_kg };
    let about_origin = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    link.mass_kg = mass_kg;
    link.com_link_m = com.into();
    link.inertia_com_kg_m2 = about_origin - mass_kg * about(&com);
}
