//! Wrenches on links: those that the object exerts on the touching links, predicted by the field, or the one that explains
//! the measured torque.

use nalgebra::{Isometry3, Vector3};
use palpate::unstable::LinkContacts;
use palpate::{LinkWrench, Mapper};

use crate::message::{Header, Stamp, Wrench, WrenchStamped};

/// The wrench on each link in contact, about the origin o of the link and in its frame:
/// `−Σ K (u, (p − o) × u)` over the rest points p that it displaces by u, with stiffness K.
pub(crate) fn wrenches(
    mapper: &Mapper,
    world_from_link: &[Isometry3<f64>],
    stamp: Stamp,
) -> Vec<WrenchStamped> {
    let (lattice, robot) = (&mapper.config().lattice, &mapper.arm().robot);
    let of_link = |contacts: LinkContacts| {
        let pose = &world_from_link[contacts.link.index()];
        let (mut force, mut torque) = (Vector3::zeros(), Vector3::zeros());
        for (cell, u) in contacts.cells.iter().zip(&contacts.displacements_m) {
            let pull = mapper.cell(*cell).stiffness_n_per_m * Vector3::from(*u).cast::<f64>();
            force -= pull;
            torque -= (lattice.point(*cell).coords - pose.translation.vector).cross(&pull);
        }
        let [force, torque] =
            [force, torque].map(|vector| pose.rotation.inverse_transform_vector(&vector).into());
        let frame_id = robot.links()[contacts.link.index()].name.clone();
        WrenchStamped { header: Header { stamp, frame_id }, wrench: Wrench { force, torque } }
    };
    mapper.contacts().links.into_iter().map(of_link).collect()
}

/// A wrench as a message, in the frame of its link, which the header names.
pub(crate) fn stamped(wrench: &LinkWrench, header: Header) -> WrenchStamped {
    let [fx, fy, fz, mx, my, mz] = wrench.in_link.into();
    WrenchStamped { header, wrench: Wrench { force: [fx, fy, fz], torque: [mx, my, mz] } }
}

/// Adds one zero wrench for each link whose contact has ended. `pressed` are the links that were in contact at the
/// last call; it is updated to those in contact now.
pub(crate) fn with_released(
    mut now: Vec<WrenchStamped>,
    pressed: &mut Vec<String>,
    stamp: Stamp,
) -> Vec<WrenchStamped> {
    let pressing: Vec<String> = now.iter().map(|wrench| wrench.header.frame_id.clone()).collect();
    let before = std::mem::replace(pressed, pressing);
    let released = before.into_iter().filter(|link| !pressed.contains(link));
    now.extend(released.map(|frame_id| WrenchStamped {
        header: Header { stamp, frame_id },
        wrench: Wrench::default(),
    }));
    now
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{DVector, Vector6};
    use palpate::{
        Arm, BakeConfig, EstimatorKind, Gravity, Lattice, MapperConfig, PathConfig, Robot, Sample,
        Tare,
    };

    use super::*;

    /// Two revolute links, each with a ball.
    fn arm() -> Arc<Arm> {
        let ball = "<collision><geometry><sphere radius='0.05'/></geometry></collision>";
        let joint = |name: &str, parent: &str, child: &str, axis: &str| {
            format!(
                "<joint name='{name}' type='revolute'><parent link='{parent}'/><child link='{child}'/>\
                 <origin xyz='0.2 0.1 0' rpy='0.3 0 0.4'/><axis xyz='{axis}'/>\
                 <limit lower='-3' upper='3' effort='1' velocity='1'/></joint>"
            )
        };
        let urdf = format!(
            "<robot name='r'><link name='base'/><link name='upper'>{ball}</link><link name='lower'>{ball}</link>{}{}</robot>",
            joint("a", "base", "upper", "0 0 1"),
            joint("b", "upper", "lower", "0 1 0")
        );
        let robot = Robot::from_urdf(&urdf).unwrap();
        let bake = BakeConfig::new(0.005, 0.04);
        Arc::new(Arm::bake(robot, &bake, |_| unreachable!("no meshes")).unwrap().0)
    }

    #[test]
    fn wrenches_on_the_links_make_the_torque_that_the_field_predicts() {
        let mut config = MapperConfig::of(EstimatorKind::Map);
        config.lattice = Lattice::new([-0.3, -0.3, -0.2], 0.02, [40, 40, 25]).unwrap();
        config.contact.known_empty = false;
        (config.touch.gravity, config.touch.tare) = (Gravity::Removed, Tare::None);
        let mut mapper = Mapper::new(arm(), config).unwrap();
        mapper.begin_touch();
        let path: Vec<Vec<f64>> =
            (0..30).map(|n| [0.01, -0.02].map(|x| x * f64::from(n)).to_vec()).collect();
        for q in &path {
            let tau = vec![-3.0 * q[0], 2.0 * q[0]];
            mapper.step(&Sample::new(None, q.clone(), tau)).unwrap();
        }
        let robot = &mapper.arm().robot;
        let poses = robot.forward(&path[29]).unwrap();
        let mut torque = DVector::zeros(2);
        let found = wrenches(&mapper, &poses.world_from_link, Stamp::default());
        assert_eq!(found.len(), 2, "both links touch something");
        for WrenchStamped { header, wrench } in found {
            let link = robot.link_id(&header.frame_id).unwrap();
            let pose = &poses.world_from_link[link.index()];
            let [force, moment] =
                [wrench.force, wrench.torque].map(|v| pose.rotation * Vector3::from(v));
            let about_world = moment + pose.translation.vector.cross(&force);
            let all = Vector6::from_iterator(force.iter().chain(&about_world).copied());
            torque += robot.spatial_jacobian(&poses, link).transpose() * all;
        }
        let asked = mapper.path_predictor().ask(&path[29..], &PathConfig::new(0.0, 1.0)).unwrap();
        assert!(asked.goes_on);
        let predicted = &asked.points[0].torque;
        assert!(predicted.amax() > 0.1, "{predicted}");
        assert!((&torque - predicted).amax() < 1e-9 * predicted.amax(), "{torque} for {predicted}");
    }

    #[test]
    fn the_zero_wrench_of_a_released_link_is_published_once() {
        let of = |link: &str| WrenchStamped {
            header: Header { frame_id: link.to_owned(), ..Header::default() },
            wrench: Wrench { force: [1.0; 3], torque: [0.0; 3] },
        };
        let mut pressed = Vec::new();
        let mut published = |links: &[&str]| -> Vec<(String, bool)> {
            let now = links.iter().map(|link| of(link)).collect();
            let all = with_released(now, &mut pressed, Stamp::default());
            let is_zero = |wrench: &WrenchStamped| wrench.wrench == Wrench::default();
            all.iter().map(|wrench| (wrench.header.frame_id.clone(), is_zero(wrench))).collect()
        };
        let [a, b] = ["a", "b"].map(str::to_owned);
        assert_eq!(published(&["a", "b"]), [(a.clone(), false), (b.clone(), false)]);
        assert_eq!(published(&["b"]), [(b.clone(), false), (a, true)]);
        assert_eq!(published(&[]), [(b, true)]);
        assert_eq!(published(&[]), []);
    }
}
