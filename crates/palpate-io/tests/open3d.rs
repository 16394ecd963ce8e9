//! Files written by Open3D are read, and golden files for Open3D are written.
//!
//! `scripts/open3d_round_trip.py` is the counterpart that runs Open3D. After an intended change,
//! `PALPATE_UPDATE_GOLDEN=1` rewrites the two files that Open3D reads in the script's `--check`.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

use nalgebra::{Matrix4, Point3};
use palpate_io::cloud::{self, Cloud, Column};
use palpate_io::rgbd::{Distortion, Intrinsics, read_camera, read_colour};
use serde::Deserialize;
use std::fs;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
struct Expected {
    points: Vec<[f64; 3]>,
    colours: Vec<[u8; 3]>,
    camera_to_world: [[f64; 4]; 4],
    width: u32,
    height: u32,
    focal: [f64; 2],
    centre: [f64; 2],
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/open3d").join(name)
}

fn expected() -> Expected {
    serde_json::from_str(&fs::read_to_string(fixture("expected.json")).unwrap()).unwrap()
}

#[test]
fn clouds_of_open3d_are_read_with_their_points_and_colours() {
    let wanted = expected();
    let rounded = |point: &[f64; 3]| Point3::from(point.map(|number| f64::from(number as f32)));
    let double: Vec<_> = wanted.points.iter().map(|&point| Point3::from(point)).collect();
    let single: Vec<_> = wanted.points.iter().map(rounded).collect();
    for (name, points, error_m) in [
        ("binary.ply", &double, 0.0),
        ("mesh.ply", &double, 0.0),
        ("text.ply", &double, 1e-5), // six digits
        ("tensor.ply", &single, 0.0),
        ("binary.pcd", &single, 0.0),
        ("compressed.pcd", &single, 0.0),
        ("tensor.pcd", &single, 0.0),
        ("text.pcd", &double, 1e-9),
    ] {
        let read = cloud::read(&fixture(name)).unwrap();
        assert_eq!(read.cloud.len(), points.len(), "{name}");
        for (found, point) in read.cloud.points().iter().zip(points) {
            assert!((found - point).amax() <= error_m, "{name}: {found} instead of {point}");
        }
        assert_eq!(read.cloud.colours().unwrap(), wanted.colours, "{name}");
        assert!(read.dropped.is_empty(), "{name}");
    }
}

#[test]
fn cameras_of_open3d_keep_their_pose() {
    let wanted = expected();
    for name in ["intrinsic.json", "parameters.json"] {
        let camera = read_camera(&fixture(name)).unwrap();
        let (size, lens) = ([wanted.width, wanted.height], Distortion::default());
        let intrinsics = Intrinsics::new(size, wanted.focal, wanted.centre, lens);
        assert_eq!(Ok(camera.intrinsics), intrinsics, "{name}");
        assert_eq!(camera.world_from_camera.is_some(), name == "parameters.json");
        if let Some(pose) = camera.world_from_camera {
            let wanted = Matrix4::from_fn(|row, column| wanted.camera_to_world[row][column]);
            assert!((pose.to_homogeneous() - wanted).amax() < 1e-12, "{pose}");
        }
    }
}

#[test]
fn a_jpeg_has_its_colours_where_they_were() {
    let picture = read_colour(&fixture("halves.jpg")).unwrap();
    assert_eq!((picture.width(), picture.height()), (32, 16));
    for (u, wanted) in [(4, [250, 0, 0]), (28, [0, 0, 200])] {
        for (found, wanted) in picture.at(u, 8).into_iter().zip(wanted) {
            assert!(found.abs_diff(wanted) < 4, "{found} instead of {wanted}");
        }
    }
}

#[test]
fn written_files_equal_those_that_open3d_has_read() {
    let wanted = expected();
    let points = wanted.points.into_iter().map(Point3::from).collect();
    let cloud = Cloud::new(points, Some(wanted.colours));
    let rows = 0..cloud.len();
    let stiffness: Vec<f64> = rows.clone().map(|row| 10.0 + row as f64).collect();
    let deviation: Vec<f32> = rows.clone().map(|row| 0.25 * row as f32).collect();
    let touched: Vec<u8> = rows.map(|row| (row % 2) as u8).collect();
    let columns = [
        ("K", Column::F64(&stiffness)),
        ("K_std", Column::F32(&deviation)),
        ("touched", Column::U8(&touched)),
    ];
    let folder = tempfile::tempdir().unwrap();
    for name in ["palpate.ply", "palpate.pcd"] {
        let path = folder.path().join(name);
        let write = if name == "palpate.ply" { cloud::write_ply } else { cloud::write_pcd };
        write(&path, &cloud, &columns).unwrap();
        if std::env::var_os("PALPATE_UPDATE_GOLDEN").is_some() {
            fs::copy(&path, fixture(name)).unwrap();
        }
        assert!(fs::read(&path).unwrap() == fs::read(fixture(name)).unwrap(), "{name}");
    }
}
