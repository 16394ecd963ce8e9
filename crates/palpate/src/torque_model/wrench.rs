//! The wrench at a link that explains an external torque.

use nalgebra::{DMatrix, Matrix6xX, Vector3, Vector6};

use super::ExternalTorque;
use crate::robot::{LinkId, Poses, Robot};

/// Singular values of the weighted Jacobian below this part of the largest are zero: the torques do not determine the
/// wrench in these directions.
const DETERMINED: f64 = 1e-3;
/// Most iterations of the singular value decomposition, which has no others if a standard deviation is not finite.
const MAX_ITERATIONS: usize = 500;

/// Force, N, and moment, N·m, at the origin of a link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkWrench {
    /// Force, then moment, along the axes of the robot's base.
    pub in_base: Vector6<f64>,
    /// Force, then moment, along the axes of the link.
    pub in_link: Vector6<f64>,
}

impl ExternalTorque {
    /// The wrench w at the origin of a link with the least `‖S⁻¹(Jᵀw − τ)‖`, where S are the standard deviations;
    /// components that the torques do not determine are zero. NaN if a standard deviation is zero or not finite.
    ///
    /// # Panics
    ///
    /// If the torques are of another robot.
    pub fn wrench_at(&self, robot: &Robot, poses: &Poses, link: LinkId) -> LinkWrench {
        let pose = &poses.world_from_link[link.index()];
        let mut jacobian: Matrix6xX<f64> = robot.spatial_jacobian(poses, link);
        for mut column in jacobian.column_iter_mut() {
            let angular: Vector3<f64> = column.fixed_rows::<3>(3).into();
            let mut linear = column.fixed_rows_mut::<3>(0);
            linear += angular.cross(&pose.translation.vector);
        }
        let weights = self.std.map(|std| 1.0 / std);
        let weighted = DMatrix::from_diagonal(&weights) * jacobian.transpose();
        let torque = self.torque.component_mul(&weights);
        let decomposed = weighted.try_svd(true, true, 5.0 * f64::EPSILON, MAX_ITERATIONS);
        let found = decomposed.and_then(|decomposed| {
            let smallest = DETERMINED * decomposed.singular_values.max();
            decomposed.solve(&torque, smallest).ok()
        });
        let in_base =
            found.map_or(Vector6::repeat(f64::NAN), |w| Vector6::from_column_slice(w.as_slice()));
        let turned = |from: usize| {
            pose.rotation.inverse_transform_vector(&in_base.fixed_rows::<3>(from).into())
        };
        let [force, moment] = [turned(0), turned(3)];
        let in_link = Vector6::from_iterator(force.iter().chain(&moment).copied());
        LinkWrench { in_base, in_link }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DVector, vector};

    use super::*;

    #[test]
    fn a_wrench_at_a_link_is_found_from_its_torques() {
        let robot = Robot::built_in("kinova_gen3").unwrap();
        let poses = robot.forward(&[0.1, 0.7, -0.4, 1.1, 0.3, -0.8, 0.5]).unwrap();
        let link = robot.link_id("EndEffector_Link").unwrap();
        let (force, moment) = (vector![3.0, -2.0, 7.0], vector![0.3, 0.1, -0.2]);
        // About the world's origin, as the spatial Jacobian has it.
        let pose = &poses.world_from_link[link.index()];
        let about_origin = moment + pose.translation.vector.cross(&force);
        let pushed = Vector6::from_iterator(force.iter().chain(&about_origin).copied());
        let torque = robot.spatial_jacobian(&poses, link).transpose() * pushed;
        let std = DVector::from_fn(torque.len(), |j, _| 0.1 + 0.05 * j as f64);
        let mut external = ExternalTorque { torque, std };
        let found = external.wrench_at(&robot, &poses, link);
        let wanted = Vector6::from_iterator(force.iter().chain(&moment).copied());
        assert!((found.in_base - wanted).amax() < 1e-9, "{found:?}");
        let turned = pose.rotation * found.in_link.fixed_rows::<3>(0).into_owned();
        assert!((turned - force).amax() < 1e-9, "{found:?}");
        for std in [0.0, f64::NAN] {
            external.std[2] = std;
            assert!(external.wrench_at(&robot, &poses, link).in_base.iter().all(|x| x.is_nan()));
        }
    }
}
