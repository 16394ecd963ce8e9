//! Poses, Jacobians and the torque of gravity.
//!
//! Every moving joint is represented by a *twist*: the velocity of the links that it carries at
//! unit joint speed. A twist consists of the angular velocity and the linear velocity of the point
//! that passes the world origin, so a point `p` moves with `linear + angular × p`, wherever `p` is,
//! and all quantities of this module are sums of that one expression.
//!
//! | here                        | value                             | shape          |
//! |-----------------------------|-----------------------------------|----------------|
//! | [`Robot::forward`]          | `world_from_link`                 | `n_links`      |
//! | [`Robot::jacobian`]         | `∂p/∂q`, p fixed to the link      | `3 × n_joints` |
//! | [`Robot::spatial_jacobian`] | `∂(origin velocity; angular)/∂q̇`  | `6 × n_joints` |
//! | [`Robot::gravity_torque`]   | `Σ_l m_l J_com(l)ᵀ g`             | `n_joints`     |
//!
//! A mimic joint `q_m = a·q + b` adds `a` times its twist to the column of the joint it follows.

use nalgebra::{DVector, Isometry3, Matrix3xX, Matrix6xX, Point3, Translation3, Unit};
use nalgebra::{UnitQuaternion, Vector3};

use super::{LinkId, Robot, RobotError};

/// Gravity in the world frame, m/s².
pub(super) const GRAVITY_M_PER_S2: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A joint that moves, independent or mimic.
#[derive(Debug, Clone)]
pub(super) struct Mover {
    /// Index of the link that it carries.
    pub child: usize,
    /// Axis of rotation or translation, in the frame of the child (URDF).
    pub axis_link: Unit<Vector3<f64>>,
    /// Whether the position is a length, not an angle.
    pub prismatic: bool,
    /// The entry of `q` that drives it, and how: `position = multiplier · q[source] + offset`.
    pub source: usize,
    pub multiplier: f64,
    pub offset: f64,
}

impl Mover {
    /// The motion that the joint adds between its origin and the link.
    pub(super) fn motion(&self, q: &[f64]) -> Isometry3<f64> {
        let position = self.multiplier * q[self.source] + self.offset;
        if self.prismatic {
            Translation3::from(self.axis_link.into_inner() * position).into()
        } else {
            let rotation = UnitQuaternion::from_axis_angle(&self.axis_link, position);
            Isometry3::from_parts(Translation3::identity(), rotation)
        }
    }

    /// The twist of the joint, given the pose of the link that it carries.
    fn twist(&self, world_from_link: &Isometry3<f64>) -> Twist {
        // The joint's own motion moves neither its axis nor, if it turns, the link's origin.
        let axis = world_from_link.rotation * self.axis_link.into_inner();
        if self.prismatic {
            Twist { linear: axis, angular: Vector3::zeros() }
        } else {
            Twist { linear: world_from_link.translation.vector.cross(&axis), angular: axis }
        }
    }
}

/// Velocity of a rigid body per unit joint speed, seen at the world origin.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Twist {
    pub(super) linear: Vector3<f64>,
    pub(super) angular: Vector3<f64>,
}

/// Poses of all links, for one joint vector.
#[derive(Debug, Clone)]
pub struct Poses {
    /// One per link, in the order of [`Robot::links`].
    pub world_from_link: Vec<Isometry3<f64>>,
    /// One per mover, in the order of `Robot::movers`.
    twists: Vec<Twist>,
}

impl Robot {
    /// Poses of all links at joint positions `q`.
    ///
    /// `q` has [`Robot::n_joints`] entries, rad (m where prismatic), in joint order. Limits are
    /// not enforced: sensors overshoot them. Cost: one pose product a link (1 µs for seven
    /// joints), two allocations.
    ///
    /// # Errors
    ///
    /// A wrong number of joints, or a position that is not finite.
    pub fn forward(&self, q: &[f64]) -> Result<Poses, RobotError> {
        if q.len() != self.joints.len() {
            return Err(RobotError::JointCount { expected: self.joints.len(), got: q.len() });
        }
        if let Some(bad) = q.iter().position(|position| !position.is_finite()) {
            let thing = format!("position of joint `{}`", self.joints[bad].name);
            return Err(RobotError::number(thing, q[bad], "a finite number of rad or m"));
        }

        let mut world_from_link: Vec<Isometry3<f64>> = Vec::with_capacity(self.links.len());
        let mut twists = Vec::with_capacity(self.movers.len());
        for (link, mount) in self.links.iter().zip(&self.mounts) {
            let mut pose = match link.parent {
                Some(parent) => world_from_link[parent.index()] * mount.parent_from_link,
                None => mount.parent_from_link,
            };
            if let Some(mover) = mount.mover {
                let mover = &self.movers[mover];
                pose *= mover.motion(q);
                twists.push(mover.twist(&pose));
            }
            world_from_link.push(pose);
        }
        Ok(Poses { world_from_link, twists })
    }

    /// Velocity of a point that is fixed to `link` and now passes `point`, per joint speed.
    ///
    /// Column `j` is `∂p/∂q_j` in m/rad (m/m where prismatic), zero where joint `j` does not carry
    /// the link. The joint torque of a force `f` acting on the link at `point` is `Jᵀf`.
    ///
    /// - `point`: world frame, m; need not lie on the link;
    /// - returns 3 × n_joints.
    ///
    /// # Panics
    ///
    /// If `poses` or `link` belong to another robot.
    pub fn jacobian(&self, poses: &Poses, link: LinkId, point: &Point3<f64>) -> Matrix3xX<f64> {
        let mut jacobian = Matrix3xX::zeros(self.n_joints());
        for &carrier in &self.mounts[link.index()].carriers {
            let (mover, twist) = self.carrier(poses, carrier);
            let mut column = jacobian.column_mut(mover.source);
            column += mover.multiplier * (twist.linear + twist.angular.cross(&point.coords));
        }
        jacobian
    }

    /// Velocity of `link` per joint speed, seen at the world origin.
    ///
    /// Rows 0..3 are the linear velocity of the link-fixed point that now passes the *world
    /// origin* (not the link's own), rows 3..6 the angular velocity. So one 6 × n_joints matrix a
    /// link serves all its contacts: `τ = Sᵀ [Σ f; Σ p × f]`.
    ///
    /// # Panics
    ///
    /// If `poses` or `link` belong to another robot.
    ///
    /// # Example
    ///
    /// ```
    /// use nalgebra::{vector, Vector6};
    /// use palpate::Robot;
    ///
    /// let robot = Robot::from_urdf(
    ///     r#"<robot name="door"><link name="frame"/><link name="leaf"/>
    ///        <joint name="hinge" type="continuous"><parent link="frame"/><child link="leaf"/>
    ///        <axis xyz="0 0 1"/></joint></robot>"#,
    /// )?;
    /// let poses = robot.forward(&[0.0])?;
    /// let spatial = robot.spatial_jacobian(&poses, robot.link_id("leaf").unwrap());
    ///
    /// // A push of 5 N along y at 0.8 m from the hinge.
    /// let (point, force) = (vector![0.8, 0.0, 1.0], vector![0.0, 5.0, 0.0]);
    /// let moment = point.cross(&force);
    /// let wrench = Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z);
    /// assert_eq!((spatial.transpose() * wrench)[0], 4.0); // N·m
    /// # Ok::<(), palpate::RobotError>(())
    /// ```
    pub fn spatial_jacobian(&self, poses: &Poses, link: LinkId) -> Matrix6xX<f64> {
        let mut spatial = Matrix6xX::zeros(self.n_joints());
        for &carrier in &self.mounts[link.index()].carriers {
            let (mover, twist) = self.carrier(poses, carrier);
            let mut linear = spatial.fixed_view_mut::<3, 1>(0, mover.source);
            linear += mover.multiplier * twist.linear;
            let mut angular = spatial.fixed_view_mut::<3, 1>(3, mover.source);
            angular += mover.multiplier * twist.angular;
        }
        spatial
    }

    /// The torque that gravity exerts on the joints, `Σ m_l J_com(l)ᵀ g`, N·m (N if prismatic).
    ///
    /// This is minus the `g(q)` of the manipulator equation, which is the torque that the motors
    /// need to hold the arm. Links without `<inertial>` have no mass. Cost: O(n_links), from the
    /// leaves inwards.
    ///
    /// # Panics
    ///
    /// If `poses` belong to another robot.
    pub fn gravity_torque(&self, poses: &Poses) -> DVector<f64> {
        // Mass, and mass times centre of mass, of each link with all that hangs from it.
        let mut carried: Vec<(f64, Vector3<f64>)> = (self.links.iter())
            .zip(&poses.world_from_link)
            .map(|(link, pose)| (link.mass_kg, link.mass_kg * (pose * link.com_link_m).coords))
            .collect();
        for (index, link) in self.links.iter().enumerate().rev() {
            if let Some(parent) = link.parent {
                let (mass_kg, moment) = carried[index];
                carried[parent.index()].0 += mass_kg;
                carried[parent.index()].1 += moment;
            }
        }

        let mut torque = DVector::zeros(self.n_joints());
        for (mover, twist) in self.movers.iter().zip(&poses.twists) {
            let (mass_kg, moment) = carried[mover.child];
            let power = mass_kg * twist.linear.dot(&GRAVITY_M_PER_S2)
                + twist.angular.dot(&moment.cross(&GRAVITY_M_PER_S2));
            torque[mover.source] += mover.multiplier * power;
        }
        torque
    }

    pub(super) fn carrier(&self, poses: &Poses, carrier: u16) -> (&Mover, Twist) {
        (&self.movers[usize::from(carrier)], poses.twists[usize::from(carrier)])
    }
}
