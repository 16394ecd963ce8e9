//! A joint that is held is the same arm at that position, with an entry less.

use palpate::Robot;

/// A turntable, an arm on it that slides, and a gripper of two fingers, one of which mimics the other.
const URDF: &str = r#"<robot name="gripper"><link name="base"/>
<link name="table"><inertial><mass value="2"/><origin xyz="0.1 0 0.2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="arm"><inertial><mass value="1"/><origin xyz="0.2 0.1 0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="left"><inertial><mass value="0.3"/><origin xyz="0 0.1 0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="right"><inertial><mass value="0.3"/><origin xyz="0 0.1 0"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="table"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="table"/><child link="arm"/><origin xyz="0.1 0 0.3" rpy="0.2 0 0.4"/><axis xyz="1 0 0"/><limit lower="0" upper="0.4" effort="9" velocity="1"/></joint>
<joint name="finger" type="prismatic"><parent link="arm"/><child link="left"/><axis xyz="0 1 0"/><limit lower="0" upper="0.08" effort="9" velocity="1"/></joint>
<joint name="mimic" type="prismatic"><parent link="arm"/><child link="right"/><axis xyz="0 -1 0"/><limit lower="0" upper="0.08" effort="9" velocity="1"/><mimic joint="finger" multiplier="1.5" offset="0.01"/></joint>
</robot>"#;

#[test]
fn a_held_joint_leaves_poses_jacobians_and_gravity_as_they_are_there() {
    let whole = Robot::from_urdf(URDF).unwrap();
    for (held, position) in [(0, 0.3), (1, 0.2), (2, 0.05)] {
        let name = whole.joint_names().nth(held).unwrap().to_owned();
        let less = whole.clone().with_fixed_joint(&name, position).unwrap();
        assert_eq!(less.n_joints(), 2);
        let mut q = vec![0.4, 0.1, 0.03];
        q[held] = position;
        let mut short = q.clone();
        short.remove(held);
        let (a, b) = (whole.forward(&q).unwrap(), less.forward(&short).unwrap());
        for (a, b) in a.world_from_link.iter().zip(&b.world_from_link) {
            assert!((a.to_matrix() - b.to_matrix()).amax() < 1e-12, "{name}");
        }
        let entries = |j: &usize| *j != held;
        let (gravity, of_less) = (whole.gravity_torque(&a), less.gravity_torque(&b));
        for (place, joint) in (0..3).filter(entries).enumerate() {
            assert!((gravity[joint] - of_less[place]).abs() < 1e-12, "{name}");
        }
        for link in ["arm", "left", "right"] {
            let link = whole.link_id(link).unwrap();
            let (j, of_less) = (whole.spatial_jacobian(&a, link), less.spatial_jacobian(&b, link));
            for (place, joint) in (0..3).filter(entries).enumerate() {
                assert!((j.column(joint) - of_less.column(place)).amax() < 1e-12, "{name}");
            }
        }
    }
    assert_eq!(whole.joints()[2].middle(), 0.04);
    let [turn, finger] = [0, 2].map(|joint| &whole.joints()[joint]);
    let left = whole.link_id("left").unwrap();
    assert!(whole.carries(turn, left) && whole.carries(finger, left));
    assert!(!whole.carries(finger, whole.link_id("arm").unwrap()));
}

#[test]
fn a_joint_that_cannot_be_fixed_is_refused() {
    let whole = Robot::from_urdf(URDF).unwrap();
    let refused = |robot: Robot, joint: &str, position| {
        robot.with_fixed_joint(joint, position).unwrap_err().to_string()
    };
    assert!(refused(whole.clone(), "mimic", 0.0).contains("`mimic`"));
    assert!(refused(whole.clone(), "finger", f64::NAN).contains("`finger`"));
    let last =
        whole.with_fixed_joint("finger", 0.0).unwrap().with_fixed_joint("slide", 0.0).unwrap();
    assert!(refused(last, "turn", 0.0).contains("`turn`"));
}
