//! Robots and their skins.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::point;
use palpate::unstable::TriangleMesh;
use palpate::{Arm, ArmError, BakeConfig, Robot};

fn xml(shape: &str) -> String {
    format!(
        r#"<robot name="rod"><link name="base"/><link name="rod">{shape}</link>
           <joint name="turn" type="continuous"><parent link="base"/><child link="rod"/></joint>
           </robot>"#
    )
}

const MESH: &str = r#"<collision><origin xyz="0 0 0.1"/><geometry>
    <mesh filename="package://rod/tetra.stl" scale="0.001 0.001 0.001"/></geometry></collision>"#;
const SPHERE: &str = r#"<collision><geometry><sphere radius="0.05"/></geometry></collision>"#;

/// A corner of a cube, 100 along each edge.
fn tetrahedron() -> TriangleMesh {
    TriangleMesh {
        vertices: vec![
            point![0.0, 0.0, 0.0],
            point![100.0, 0.0, 0.0],
            point![0.0, 100.0, 0.0],
            point![0.0, 0.0, 100.0],
        ],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

fn bake(shape: &str) -> Result<Arm, ArmError> {
    let robot = Robot::from_urdf(&xml(shape)).unwrap();
    let load = |name: &str| match name {
        "package://rod/tetra.stl" => Ok(tetrahedron()),
        _ => Err("no such file".into()),
    };
    Arm::bake(robot, &BakeConfig::default(), load).map(|(arm, _)| arm)
}

#[test]
fn a_mesh_is_placed_by_its_origin_and_scale() {
    let arm = bake(MESH).unwrap();
    assert!(arm.surfaces[0].is_none());
    let grid = arm.surfaces[1].as_ref().unwrap();
    assert!(grid.distance(&point![0.02, 0.02, 0.12]) < -0.015);
    assert!(grid.distance(&point![0.02, 0.02, 0.08]) > 0.015);
}

#[test]
fn a_missing_mesh_is_an_error_with_its_name_and_link() {
    let error = bake(&MESH.replace("tetra", "gone")).unwrap_err().to_string();
    assert_eq!(error, "mesh `package://rod/gone.stl` of link `rod`: no such file");
    let error = bake(&MESH.replace("0.001 0.001 0.001", "1 1 1")).unwrap_err().to_string();
    assert!(error.starts_with("link `rod`: ") && error.contains("0.001"), "{error}");
    assert!(matches!(bake("").unwrap_err(), ArmError::Shapeless { .. }));
}

#[test]
fn the_fingerprint_follows_shapes_and_kinematics_and_nothing_else() {
    let one = bake(SPHERE).unwrap().fingerprint();
    assert_eq!(one, bake(SPHERE).unwrap().fingerprint());
    assert_ne!(one, bake(&SPHERE.replace("0.05", "0.051")).unwrap().fingerprint());

    let (robot, surfaces) = (bake(SPHERE).unwrap().robot, bake(SPHERE).unwrap().surfaces);
    let payload = palpate::Payload::new("rod", 0.1, [0.0; 3]);
    let heavier = Arm::new(robot.with_payload(&payload).unwrap(), surfaces.to_vec()).unwrap();
    assert_ne!(one, heavier.fingerprint());
}

#[test]
fn every_link_with_a_shape_has_a_baked_surface() {
    let robot = Robot::built_in("kinova_gen3").unwrap();
    let shaped: Vec<bool> = robot.links().iter().map(|link| !link.collision.is_empty()).collect();
    if !shaped.contains(&true) {
        return; // The fitted shapes are merged apart from this.
    }
    let (arm, reports) =
        Arm::bake(robot, &BakeConfig::default(), |name| Err(format!("asked for {name}").into()))
            .unwrap();
    assert_eq!(arm.surfaces.iter().map(Option::is_some).collect::<Vec<_>>(), shaped);
    for report in reports {
        assert!(report.report.inside_m3 > 1e-5, "{report:?}");
    }
}
