//! Images of every format, and the conversion of their pixels to points.

use super::super::image_files::{decode_colour, decode_depth};
use super::super::*;
use nalgebra::{Isometry3, Point3, Vector3};
use proptest::prelude::*;
use std::path::Path;
use tiff::encoder::{TiffEncoder, colortype};

const JPEG: &[u8] = include_bytes!("../../../testdata/open3d/halves.jpg");

/// A PNG of one row, from its encoded samples.
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
    let cut = decode_colour(&JPEG[..JPEG.len() / 2], path).unwrap_err().to_string();
    assert!(cut.contains("cannot be read"), "{cut}");
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

/// A camera of the given size at the origin of the world that looks along z.
fn ahead(width: u32, height: u32) -> Camera {
    let centre = [f64::from(width) / 2.0, f64::from(height) / 2.0];
    let focal = [f64::from(width); 2];
    let intrinsics =
        Intrinsics::new([width, height], focal, centre, Distortion::default()).unwrap();
    Camera { intrinsics, world_from_camera: Isometry3::identity() }
}

#[test]
fn a_dropped_pixel_is_counted_for_one_reason_only() {
    let metres = [0.0, -1.0, f32::NAN, f32::INFINITY, 1.0, 1.0, 3.0, 9.0, 9.0, 9.0];
    let depth = DepthImage::new(10, 1, metres.to_vec(), 0.001);
    let crop = Some([Point3::new(-0.3, -9.0, 0.0), Point3::new(0.1, 9.0, 99.0)]);
    let config =
        BackProjectionConfig { depth_range_m: [0.5, 4.0], crop, ..BackProjectionConfig::default() };
    let found = back_project(&black(10, 1), &depth, &ahead(10, 1), &config).unwrap();
    let wanted =
        DroppedPixels { without_depth: 4, out_of_range: 3, flying: 1, ..DroppedPixels::default() };
    assert_eq!(found.dropped, wanted, "the one at 3 m hangs between 1 m and 9 m");
    assert_eq!(found.pixels, [[4, 0], [5, 0]]);
    let crop = Some([Point3::new(-0.05, -9.0, 0.0), Point3::new(0.1, 9.0, 99.0)]);
    let config = BackProjectionConfig { crop, flying: None, ..config };
    let found = back_project(&black(10, 1), &depth, &ahead(10, 1), &config).unwrap();
    assert_eq!((found.dropped.flying, found.dropped.outside_box), (0, 2));
    assert_eq!(found.pixels, [[5, 0]]);
}

#[test]
fn pictures_that_give_no_point_are_refused_with_a_remedy() {
    let flat = |metres: f32| DepthImage::new(4, 4, vec![metres; 16], 0.001);
    let config = BackProjectionConfig::default();
    let refused = |depth: &DepthImage,
                   colour: &ColourImage,
                   camera: &Camera,
                   config: &BackProjectionConfig| {
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
    let far = BackProjectionConfig { depth_range_m: [2.0, 3.0], ..config };
    assert!(refused(&flat(1.0), &black(4, 4), &ahead(4, 4), &far).contains("widen the depth"));
}

/// Cameras with slightly distorting lenses and random poses.
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
        let config = BackProjectionConfig { flying: None, ..BackProjectionConfig::default() };
        let found = back_project(&black(width, height), &depth, &camera, &config).unwrap();
        prop_assert_eq!(found.pixels.len(), (width * height) as usize);
        for (point, &[u, v]) in found.cloud.points().iter().zip(&found.pixels) {
            let [x, y] = camera.project(point).unwrap();
            prop_assert!((x - f64::from(u)).hypot(y - f64::from(v)) < 1e-6, "{x} {y} for {u} {v}");
            let ahead = camera.world_from_camera.inverse_transform_point(point);
            prop_assert!((ahead.z - depth.at(u, v).unwrap()).abs() < 1e-9);
        }
    }
}
