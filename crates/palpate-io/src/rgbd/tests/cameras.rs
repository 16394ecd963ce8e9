//! Every format gives the same camera, and impossible cameras are refused with the reason.

use super::super::camera_file::decode_camera;
use super::super::pose::decode_pose;
use super::super::{CameraFile, Distortion, Intrinsics, RgbdError, pose_from_text};
use nalgebra::Point3;
use std::path::Path;

const OURS: &str = r#"{"width": 640, "height": 480, "fx": 580.0, "fy": 579.0, "cx": 319.5,
    "cy": 239.5, "distortion": "none",
    "camera_to_world": [[0, 0, 1, 0.5], [-1, 0, 0, 0.25], [0, -1, 0, 1.5], [0, 0, 0, 1]]}"#;
const OURS_WITH_K: &str = r#"{"width": 640, "height": 480,
    "K": [[580.0, 0, 319.5], [0, 579.0, 239.5], [0, 0, 1]],
    "camera_to_world": [0, 0, 1, 0.5, -1, 0, 0, 0.25, 0, -1, 0, 1.5, 0, 0, 0, 1]}"#;
const OPEN3D: &str = r#"{"class_name": "PinholeCameraParameters",
    "extrinsic": [0, 0, 1, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0.25, 1.5, -0.5, 1],
    "intrinsic": {"width": 640, "height": 480,
                  "intrinsic_matrix": [580.0, 0, 0, 0, 579.0, 0, 319.5, 239.5, 1]}}"#;
const ROS_FILE: &str = "image_width: 640
image_height: 480
camera_name: wrist
camera_matrix:
  rows: 3
  cols: 3
  data: [580., 0., 319.5, 0., 579.0, 239.5, 0., 0., 1.]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.12, -0.25, 0.001, -0.0015, 0.1]
";
const ROS_MESSAGE: &str = "header:
  stamp:
    sec: 17
    nanosec: 250
  frame_id: camera_color_optical_frame
height: 480
width: 640
distortion_model: rational_polynomial
d:
- 0.5
- -2.6
- 0.0007
- -0.0003
- 1.5
- 0.4
- -2.4
- 1.4
k:
- 580.0
- 0.0
- 319.5
- 0.0
- 579.0
- 239.5
- 0.0
- 0.0
- 1.0
binning_x: 0
roi:
  do_rectify: false
---
header:
  stamp: {}
---
";

fn camera(text: &str) -> Result<CameraFile, RgbdError> {
    decode_camera(text.as_bytes(), Path::new("camera.json"))
}

fn complaint(text: &str) -> String {
    camera(text).unwrap_err().to_string()
}

#[test]
fn the_same_camera_comes_out_of_every_file() {
    let wanted = camera(OURS).unwrap();
    let pose = wanted.world_from_camera.unwrap();
    // The camera looks along x of the world, from (0.5, 0.25, 1.5).
    assert!((pose * Point3::new(0.0, 0.0, 2.0) - Point3::new(2.5, 0.25, 1.5)).norm() < 1e-12);
    for text in [OURS_WITH_K, OPEN3D] {
        let found = camera(text).unwrap();
        assert_eq!(found.intrinsics, wanted.intrinsics, "{text}");
        let off = found.world_from_camera.unwrap().to_homogeneous() - pose.to_homogeneous();
        assert!(off.amax() < 1e-12, "{text}");
    }
    for (text, coefficients) in [
        (ROS_FILE, &[0.12, -0.25, 0.001, -0.0015, 0.1][..]),
        (ROS_MESSAGE, &[0.5, -2.6, 0.0007, -0.0003, 1.5, 0.4, -2.4, 1.4]),
    ] {
        let found = camera(text).unwrap();
        let lens = Distortion::new(coefficients).unwrap();
        let wanted = Intrinsics::new([640, 480], [580.0, 579.0], [319.5, 239.5], lens);
        assert_eq!(Ok(found.intrinsics), wanted);
        assert!(found.at(None).is_none(), "ROS does not say where the camera stands");
        assert_eq!(found.at(Some(pose)).unwrap().world_from_camera, pose);
    }
    let old = ROS_MESSAGE.replace("k:\n", "K:\n").replace("d:\n", "D:\n");
    assert_eq!(camera(&old).unwrap(), camera(ROS_MESSAGE).unwrap());
}

#[test]
fn an_impossible_camera_is_refused_with_what_is_wanted() {
    for (from, to, word) in [
        ("580.0", "-580.0", "fx is -580; wanted a focal length above 0"),
        ("580.0", "0", "above 0"),
        ("580.0", "0.9", "which no lens has"),
        ("319.5", "31950", "far outside"),
        ("\"width\": 640", "\"width\": 0", "0 x 480 pixels"),
        ("\"width\": 640", "\"width\": 6.5", "has the width 6.5"),
        ("\"width\": 640", "\"w\": 640", "has no `width`"),
        ("\"fx\"", "\"f\"", "wanted the intrinsics"),
        ("[0, -1, 0, 1.5]", "[0, 1, 0, 1.5]", "a reflection"),
        ("[0, -1, 0, 1.5]", "[0, -2, 0, 1.5]", "not a rotation"),
        ("[0, 0, 0, 1]", "[0.5, 0, 0, 1]", "written column by column"),
        ("[0, 0, 0, 1]", "[0, 0, 0]", "it holds 15 numbers"),
        ("[0, 0, 0, 1]", "[0, 0, 0, null]", "something else than numbers"),
        ("\"none\"", "\"fisheye\"", "model `fisheye` with 0 coefficients"),
        ("{", "", "camera.json"),
    ] {
        assert!(OURS.contains(from));
        let error = complaint(&OURS.replacen(from, to, 1));
        assert!(error.contains(word) && error.contains("camera.json"), "{from}: {error}");
    }
    let error = complaint(&ROS_FILE.replace("plumb_bob", "equidistant"));
    assert!(error.contains("model `equidistant`") && error.contains("rectify"), "{error}");
    let error = complaint(&ROS_FILE.replace("0., 319.5", "5., 319.5"));
    assert!(error.contains("skewed"), "{error}");
    assert!(complaint("- 1\n- 2\n").contains("no names and values"));
    assert!(complaint(&"[".repeat(100_000)).contains("YAML"));
    assert!(complaint(&"a: {".repeat(100_000)).contains("YAML"));
}

#[test]
fn a_pose_is_the_same_however_it_is_written() {
    let wanted = camera(OURS).unwrap().world_from_camera.unwrap();
    let seven = "0.5 0.25 1.5  -0.5 0.5 -0.5 0.5";
    let rows = "# camera_to_world\n[[0, 0, 1, 0.5],\n [-1, 0, 0, 0.25], # left\n [0, -1, 0, 1.5],\n \
        [0, 0, 0, 1]]";
    let mut npy = Vec::new();
    crate::npy::write_header(&mut npy, "<f8", &[4, 4]).unwrap();
    let numbers = [0., 0., 1., 0.5, -1., 0., 0., 0.25, 0., -1., 0., 1.5, 0., 0., 0., 1.]
        .map(f64::to_le_bytes);
    npy.extend(numbers.concat());
    for bytes in [seven.as_bytes(), rows.as_bytes(), OURS.as_bytes(), &npy] {
        let pose = decode_pose(bytes, Path::new("pose")).unwrap();
        assert!((pose.to_homogeneous() - wanted.to_homogeneous()).amax() < 1e-12, "{pose}");
    }
    let error = pose_from_text("1 2 3 0 0 0 2").unwrap_err().to_string();
    assert!(error.contains("quaternion has the length 2") && error.contains("x y z qx"), "{error}");
    for text in ["1 2 3", "1 2 3 0 0 0 one", "nan 2 3 0 0 0 1", "", &"1 ".repeat(99)] {
        assert!(pose_from_text(text).is_err(), "{text}");
    }
}

#[test]
fn a_pose_that_is_nearly_rigid_is_made_rigid() {
    let text = "0 0 1.0004 0.5 -1 0.0003 0 0.25 0 -1 0 1.5 0 0 0 1";
    let turn = pose_from_text(text).unwrap().rotation.to_rotation_matrix().into_inner();
    assert!((turn.transpose() * turn - nalgebra::Matrix3::identity()).amax() < 1e-12);
}
