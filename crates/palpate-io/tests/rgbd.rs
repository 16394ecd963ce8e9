//! Compares back-projected images of the simulated plants with the clouds of the simulation.
//!
//! Runs on the bundled set, and on every set of the folder in `PALPATE_DATA` if that is given.
//! `object.ply` holds one point for each pixel of the object, rounded to single precision.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod common;

use nalgebra::Point3;
use palpate_io::cloud;
use palpate_io::rgbd::{
    self, BackProjection, BackProjectionConfig, Camera, ColourImage, DepthImage,
};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Folders with images and a cloud of the object.
fn sets() -> Vec<PathBuf> {
    common::sets("rgbd/camera.json")
}

fn images(set: &Path) -> (Camera, ColourImage, DepthImage) {
    let rgbd = set.join("rgbd");
    let camera = rgbd::read_camera(&rgbd.join("camera.json")).unwrap().at(None).unwrap();
    let colour = rgbd::read_colour(&rgbd.join("color.png")).unwrap();
    (camera, colour, rgbd::read_depth(&rgbd.join("depth.png"), 0.001).unwrap())
}

fn seen(set: &Path, config: &BackProjectionConfig) -> (Camera, BackProjection) {
    let (camera, colour, depth) = images(set);
    (camera, rgbd::back_project(&colour, &depth, &camera, config).unwrap())
}

#[test]
fn the_image_of_a_plant_gives_the_cloud_of_the_plant() {
    for set in sets() {
        let (camera, seen) = seen(&set, &BackProjectionConfig::default());
        let by_pixel: HashMap<[u32; 2], usize> =
            seen.pixels.iter().enumerate().map(|(row, &pixel)| (pixel, row)).collect();
        let object = cloud::read(&set.join("object.ply")).unwrap().cloud;
        let mut distances = Vec::new();
        for (point, colour) in object.points().iter().zip(object.colours().unwrap()) {
            let pixel = camera.project(point).unwrap();
            let nearest = pixel.map(f64::round);
            assert!((0..2).all(|axis| (pixel[axis] - nearest[axis]).abs() < 1e-3));
            if let Some(&row) = by_pixel.get(&nearest.map(|side| side as u32)) {
                distances.push((seen.cloud.points()[row] - point).norm());
                assert_eq!(&seen.cloud.colours().unwrap()[row], colour);
            }
        }
        distances.sort_by(f64::total_cmp);
        let largest_m = distances[distances.len() - 1];
        let kept = distances.len() as f64 / object.len() as f64;
        println!(
            "{}: {} of {} points of the object are kept, {} in all; off by at most {:.1e} m, 99.9 % \
             by {:.1e} m; {}",
            set.file_name().unwrap().display(),
            distances.len(),
            object.len(),
            seen.cloud.len(),
            largest_m,
            distances[distances.len() * 999 / 1000],
            seen.dropped
        );
        assert!(largest_m < 1e-3, "{largest_m} m");
        assert!(kept > 0.99, "{kept}");
    }
}

#[test]
fn a_box_around_the_plant_keeps_the_plant_and_nothing_outside() {
    let set = &sets()[0];
    let object = cloud::read(&set.join("object.ply")).unwrap().cloud;
    let corner = |start: f64, pick: fn(f64, f64) -> f64| {
        let along = |axis: usize| object.points().iter().map(move |point| point[axis]);
        Point3::from([0, 1, 2].map(|axis| along(axis).fold(start, pick)))
    };
    let margin = Point3::new(1e-6, 1e-6, 1e-6).coords;
    let [low, high] = [corner(f64::MAX, f64::min) - margin, corner(f64::MIN, f64::max) + margin];
    let config = BackProjectionConfig {
        crop: Some([low, high]),
        flying: None,
        ..BackProjectionConfig::default()
    };
    let (_, seen) = seen(set, &config);
    assert!(seen.cloud.len() >= object.len());
    assert!(seen.cloud.points().iter().all(|p| p >= &low && p <= &high));
    assert!(seen.dropped.outside_box > 100_000, "{}", seen.dropped);
}

/// Depths of a camera whose pixels at edges see both sides: some of the pixels in front of an edge
/// get a depth between the two sides. Returns the depth image and these pixels.
fn with_mixed_edges(depth: &DepthImage) -> (DepthImage, Vec<[u32; 2]>) {
    let (width, height) = (depth.width(), depth.height());
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut share = || f64::from(random.next_u32()) / f64::from(u32::MAX);
    let (mut metres, mut mixed) = (Vec::new(), Vec::new());
    for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
        let here = depth.at(u, v).unwrap_or(0.0);
        let around = (0..9)
            .filter_map(|i| depth.at((u + i % 3).checked_sub(1)?, (v + i / 3).checked_sub(1)?));
        let behind = around.fold(0.0, f64::max);
        let front = 0.1 + 0.8 * share();
        let between = front * here + (1.0 - front) * behind;
        let is_edge = here > 0.0 && (between - here).min(behind - between) > 0.03 * here;
        let is_mixed = is_edge && share() < 0.3;
        metres.push(if is_mixed { between as f32 } else { here as f32 });
        mixed.extend(is_mixed.then_some([u, v]));
    }
    (DepthImage::new(width, height, metres, depth.unit_m()), mixed)
}

#[test]
fn of_depths_mixed_at_edges_nearly_all_are_dropped_and_little_else() {
    let (camera, colour, depth) = images(&sets()[0]);
    let (depth, mixed) = with_mixed_edges(&depth);
    let seen =
        rgbd::back_project(&colour, &depth, &camera, &BackProjectionConfig::default()).unwrap();
    let kept: HashSet<[u32; 2]> = seen.pixels.into_iter().collect();
    let missed = mixed.iter().filter(|pixel| kept.contains(*pixel)).count();
    let others = seen.dropped.flying - (mixed.len() - missed);
    println!("{} mixed, {missed} of them kept, {others} others dropped", mixed.len());
    assert!(mixed.len() > 500 && missed * 20 < mixed.len(), "{missed} of {}", mixed.len());
    assert!(others * 200 < kept.len(), "{others} of {}", kept.len());
}
