//! Cameras as everybody writes them, pictures of every kind, and the way from pixels to points.

use super::camera_file::decode_camera;
use super::images::{decode_colour, decode_depth};
use super::pose::decode_pose;
use super::*;
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;
use std::path::Path;
use tiff::encoder::{TiffEncoder, colortype};

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
    // It looks along x of the world, from (0.5, 0.25, 1.5).
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
        assert_eq!(found.intrinsics.focal(), [580.0, 579.0]);
        assert_eq!(found.intrinsics.distortion(), &Distortion::new(coefficients).unwrap());
        assert!(found.at(None).is_none(), "ROS does not say where the camera stands");
        assert_eq!(found.at(Some(pose)).unwrap().world_from_camera, pose);
    }
    let old = ROS_MESSAGE.replace("k:\n", "K:\n").replace("d:\n", "D:\n");
    assert_eq!(camera(&old).unwrap(), camera(ROS_MESSAGE).unwrap());
}

#[test]
fn a_camera_that_cannot_be_is_refused_with_what_it_should_be() {
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
        ("[0, -1, 0, 1.5]", "[0, -2, 0, 1.5]", "no rotation"),
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

/// A PNG of one row, its samples as they are stored.
fn png(width: u32, colour: png::ColorType, bits: png::BitDepth, samples: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, 1);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    encoder.write_header().unwrap().write_image_data(samples).unwrap();
    bytes
}

/// A TIFF of one row.
fn tiff<C: colortype::ColorType>(samples: &[C::Inner]) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).unwrap();
    encoder.write_image::<C>(samples.len() as u32, 1, samples).unwrap();
    file.into_inner()
}

#[test]
fn every_png_gives_red_green_and_blue() {
    use png::{BitDepth, ColorType};
    let path = Path::new("colour.png");
    for (colour, bits, samples, wanted) in [
        (ColorType::Rgb, BitDepth::Eight, &[9u8, 8, 7, 1, 2, 3][..], [[9, 8, 7], [1, 2, 3]]),
        (ColorType::Rgba, BitDepth::Eight, &[9, 8, 7, 0, 1, 2, 3, 255], [[9, 8, 7], [1, 2, 3]]),
        (ColorType::Grayscale, BitDepth::Eight, &[9, 1], [[9; 3], [1; 3]]),
        (ColorType::Grayscale, BitDepth::One, &[0x40], [[0; 3], [255; 3]]),
        (ColorType::GrayscaleAlpha, BitDepth::Sixteen, &[9; 8], [[9; 3], [9; 3]]),
        (
            ColorType::Rgb,
            BitDepth::Sixteen,
            &[9, 9, 8, 8, 7, 7, 1, 1, 2, 2, 3, 3],
            [[9, 8, 7], [1, 2, 3]],
        ),
    ] {
        let picture = decode_colour(&png(2, colour, bits, samples), path).unwrap();
        assert_eq!([picture.at(0, 0), picture.at(1, 0)], wanted, "{colour:?} {bits:?}");
    }
    let mut huge = png(2, ColorType::Grayscale, BitDepth::Eight, &[0, 0]);
    huge[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]); // 65536 x 65536, checksum wrong
    assert!(decode_colour(&huge, path).is_err());
    assert!(decode_colour(b"BM", path).unwrap_err().to_string().contains("wanted a PNG or JPEG"));
}

#[test]
fn depths_are_metres_whatever_they_were() {
    let path = Path::new("depth");
    let wanted = DepthImage::new(3, 1, vec![0.0, 1.5, 0.25], 0.0005);
    let units = [0u16, 3000, 500];
    let stored = units.map(u16::to_be_bytes).concat();
    let png16 = png(3, png::ColorType::Grayscale, png::BitDepth::Sixteen, &stored);
    let tiff16 = tiff::<colortype::Gray16>(&units);
    let metres = [f32::NAN, 1.5, 0.25];
    let tiff32 = tiff::<colortype::Gray32Float>(&metres);
    let npy = |descr: &str, shape: &[usize], data: Vec<u8>| {
        let mut bytes = Vec::new();
        crate::npy::write_header(&mut bytes, descr, shape).unwrap();
        [bytes, data].concat()
    };
    let npy16 = npy("<u2", &[1, 3], units.map(u16::to_le_bytes).concat());
    let npy32 = npy("<f4", &[1, 3, 1], metres.map(f32::to_le_bytes).concat());
    for bytes in [&png16, &tiff16, &tiff32, &npy16, &npy32] {
        let depth = decode_depth(bytes, path, 0.0005).unwrap();
        assert_eq!((depth.width(), depth.height()), (3, 1));
        for u in 0..3 {
            assert_eq!(depth.at(u, 0), wanted.at(u, 0));
        }
    }
    let eight = png(3, png::ColorType::Grayscale, png::BitDepth::Eight, &[0, 1, 2]);
    let error = decode_depth(&eight, path, 0.001).unwrap_err().to_string();
    assert!(error.contains("wanted grey with 16 bits"), "{error}");
    let flat = decode_depth(&npy("<f4", &[3], vec![0; 12]), path, 0.001).unwrap_err();
    assert!(flat.to_string().contains("wanted height x width"), "{flat}");
    let cut = decode_depth(&npy("<f4", &[480, 640], vec![0; 12]), path, 0.001).unwrap_err();
    assert!(cut.to_string().contains("truncated"), "{cut}");
}

fn black(width: u32, height: u32) -> ColourImage {
    ColourImage::new(width, height, vec![[0; 3]; (width * height) as usize])
}

/// A camera of the given size that stands in the origin of the world and looks along its z.
fn ahead(width: u32, height: u32) -> Camera {
    let centre = [f64::from(width) / 2.0, f64::from(height) / 2.0];
    let focal = [f64::from(width); 2];
    let intrinsics =
        Intrinsics::new([width, height], focal, centre, Distortion::default()).unwrap();
    Camera { intrinsics, world_from_camera: Isometry3::identity() }
}

#[test]
fn what_is_cut_away_is_counted_once() {
    let metres = [0.0, -1.0, f32::NAN, f32::INFINITY, 1.0, 1.0, 3.0, 9.0, 9.0, 9.0];
    let depth = DepthImage::new(10, 1, metres.to_vec(), 0.001);
    let crop = Some([Point3::new(-0.3, -9.0, 0.0), Point3::new(0.1, 9.0, 99.0)]);
    let config = Config { depth_range_m: [0.5, 4.0], crop, ..Config::default() };
    let found = back_project(&black(10, 1), &depth, &ahead(10, 1), &config).unwrap();
    let wanted = Dropped { without_depth: 4, out_of_range: 3, flying: 1, ..Dropped::default() };
    assert_eq!(found.dropped, wanted, "the one at 3 m hangs between 1 m and 9 m");
    assert_eq!(found.pixels, [[4, 0], [5, 0]]);
    let crop = Some([Point3::new(-0.05, -9.0, 0.0), Point3::new(0.1, 9.0, 99.0)]);
    let config = Config { crop, flying: None, ..config };
    let found = back_project(&black(10, 1), &depth, &ahead(10, 1), &config).unwrap();
    assert_eq!((found.dropped.flying, found.dropped.outside_box), (0, 2));
    assert_eq!(found.pixels, [[5, 0]]);
}

#[test]
fn pictures_that_make_no_cloud_are_refused_with_a_way_out() {
    let flat = |metres: f32| DepthImage::new(4, 4, vec![metres; 16], 0.001);
    let config = Config::default();
    let refused = |depth: &DepthImage, colour: &ColourImage, camera: &Camera, config: &Config| {
        back_project(colour, depth, camera, config).unwrap_err().to_string()
    };
    let error = refused(&flat(1.0), &black(8, 4), &ahead(4, 4), &config);
    assert!(error.contains("the colour image is 8 x 4 pixels, the depth image 4 x 4"), "{error}");
    let error = refused(&flat(1.0), &black(4, 4), &ahead(8, 8), &config);
    assert!(error.contains("the camera is 8 x 8"), "{error}");
    let error = refused(&flat(1200.0), &black(4, 4), &ahead(4, 4), &config);
    assert!(error.contains("1200 m, farther than") && error.contains("0.001 m each"), "{error}");
    assert!(refused(&flat(0.0012), &black(4, 4), &ahead(4, 4), &config).contains("nearer"));
    let error = refused(&flat(0.0), &black(4, 4), &ahead(4, 4), &config);
    assert!(error.contains("16 have no depth") && error.contains("wrong file"), "{error}");
    let far = Config { depth_range_m: [2.0, 3.0], ..config };
    assert!(refused(&flat(1.0), &black(4, 4), &ahead(4, 4), &far).contains("widen the depth"));
}

/// Cameras with lenses that bend a little, anywhere, turned any way.
fn cameras() -> impl Strategy<Value = Camera> {
    let lens = (-0.2f64..0.2, -0.1f64..0.1, -0.002f64..0.002, -0.002f64..0.002);
    let pose = (prop::array::uniform3(-3.0f64..3.0), prop::array::uniform3(-1.8f64..1.8));
    (40.0f64..400.0, 1u32..40, 1u32..40, lens, pose).prop_map(|(focal, w, h, lens, pose)| {
        let lens = Distortion::new(&[lens.0, lens.1, lens.2, lens.3]).unwrap();
        let centre = [f64::from(w) * 0.45, f64::from(h) * 0.55];
        let intrinsics = Intrinsics::new([w, h], [focal, focal * 1.01], centre, lens).unwrap();
        let pose = Isometry3::new(Vector3::from(pose.0), Vector3::from(pose.1));
        Camera { intrinsics, world_from_camera: pose }
    })
}

proptest! {
    #[test]
    fn a_point_projects_to_the_pixel_it_came_from(camera in cameras(), seed in any::<u32>()) {
        let [width, height] = camera.intrinsics.size();
        let noise = |place: u32| seed.wrapping_add(place).wrapping_mul(2_654_435_761) >> 16;
        let metres: Vec<f32> =
            (0..width * height).map(|place| 0.3 + noise(place) as f32 / 65_536.0).collect();
        let depth = DepthImage::new(width, height, metres, 0.001);
        let config = Config { flying: None, ..Config::default() };
        let found = back_project(&black(width, height), &depth, &camera, &config).unwrap();
        prop_assert_eq!(found.pixels.len(), (width * height) as usize);
        for (point, &[u, v]) in found.cloud.points().iter().zip(&found.pixels) {
            let [x, y] = camera.project(point).unwrap();
            prop_assert!((x - f64::from(u)).hypot(y - f64::from(v)) < 1e-6, "{x} {y} for {u} {v}");
            let ahead = camera.world_from_camera.inverse_transform_point(point);
            prop_assert!((ahead.z - depth.at(u, v).unwrap()).abs() < 1e-9);
        }
    }

    #[test]
    fn no_bytes_make_a_reader_panic(
        start in 0usize..9, bytes in prop::collection::vec(any::<u8>(), 0..300),
    ) {
        let starts: [&[u8]; 9] = [
            b"", b"{", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", b"\xff\xd8\xff\xe0", b"II*\0\x08\0\0\0",
            b"MM\0*\0\0\0\x08", b"\x93NUMPY\x01\0", b"K: [", b"---\nk:\n- ",
        ];
        let bytes = [starts[start], &bytes].concat();
        let path = Path::new("noise");
        let _ = (decode_camera(&bytes, path), decode_pose(&bytes, path));
        let _ = (decode_colour(&bytes, path), decode_depth(&bytes, path, 0.001));
    }

    #[test]
    fn no_changed_byte_makes_a_reader_panic(
        which in 0usize..8, at in any::<prop::sample::Index>(), to in any::<u8>(),
    ) {
        let grey = png::ColorType::Grayscale;
        let mut bytes = match which {
            0 => OURS.into(),
            1 => OPEN3D.into(),
            2 => ROS_FILE.into(),
            3 => ROS_MESSAGE.into(),
            4 => png(3, grey, png::BitDepth::Sixteen, &[1, 2, 3, 4, 5, 6]),
            5 => include_bytes!("../../testdata/open3d/halves.jpg").to_vec(),
            6 => tiff::<colortype::Gray32Float>(&[1.0, 2.0]),
            _ => b"0 0 1 0.5 -1 0 0 0.25 0 -1 0 1.5 0 0 0 1".to_vec(),
        };
        let at = at.index(bytes.len());
        bytes[at] = to;
        let path = Path::new("mutant");
        for bytes in [&bytes[..], &bytes[..at]] {
            let _ = (decode_camera(bytes, path), decode_pose(bytes, path));
            let _ = (decode_colour(bytes, path), decode_depth(bytes, path, 0.001));
        }
    }
}
