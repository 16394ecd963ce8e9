//! Converts pixels to points in the world frame, and counts the pixels that are left out.

use super::camera::Camera;
use super::dropped::DroppedPixels;
use super::error::RgbdError;
use super::flying::FlyingPixels;
use super::images::{ColourImage, DepthImage};
use crate::cloud::Cloud;
use nalgebra::Point3;

/// Smallest and largest plausible median depth, m; outside, the unit is reported as wrong.
const PLAUSIBLE_MEDIAN_M: [f64; 2] = [0.02, 50.0];

/// Settings that decide which pixels become points.
#[derive(Debug, Clone, PartialEq)]
pub struct BackProjectionConfig {
    /// Smallest and largest depth that is kept, m along the optical axis.
    pub depth_range_m: [f64; 2],
    /// Lower and upper corner of the box that is kept, m, world frame; `None` keeps all points.
    pub crop: Option<[Point3<f64>; 2]>,
    /// Criterion for flying pixels, which are dropped; `None` keeps them.
    pub flying: Option<FlyingPixels>,
}

impl Default for BackProjectionConfig {
    fn default() -> Self {
        let flying = Some(FlyingPixels::default());
        Self { depth_range_m: [0.0, 1000.0], crop: None, flying }
    }
}

/// The cloud of an image.
#[derive(Debug, Clone, PartialEq)]
pub struct BackProjection {
    /// One point for each pixel that was kept, row by row.
    pub cloud: Cloud,
    /// The pixel (u, v) of each point.
    pub pixels: Vec<[u32; 2]>,
    /// Numbers of the other pixels.
    pub dropped: DroppedPixels,
}

/// Converts each pixel that has a depth, and that `config` keeps, to a point in the world frame.
///
/// Depth is along the optical axis; the centre of the first pixel is at (0, 0). Flying pixels are
/// detected in the whole image, before it is cropped.
///
/// Cost: O(pixels), with a few Newton steps per pixel if the lens distorts.
///
/// # Errors
///
/// If images and camera differ in size, the median depth is implausible, or no pixel is left.
///
/// # Panics
///
/// If a bound of `config` is NaN, or an upper bound is below the lower one.
pub fn back_project(
    colour: &ColourImage,
    depth: &DepthImage,
    camera: &Camera,
    config: &BackProjectionConfig,
) -> Result<BackProjection, RgbdError> {
    check_config(config);
    check_size("the colour image", [colour.width(), colour.height()], depth)?;
    check_size("the camera", camera.intrinsics.size(), depth)?;
    check_unit(depth)?;

    let (mut points, mut colours, mut pixels) = (Vec::new(), Vec::new(), Vec::new());
    let mut dropped = DroppedPixels::default();
    for v in 0..depth.height() {
        for u in 0..depth.width() {
            match point_at(depth, camera, config, [u, v]) {
                Ok(point) => {
                    points.push(point);
                    colours.push(colour.at(u, v));
                    pixels.push([u, v]);
                }
                Err(reason) => *reason(&mut dropped) += 1,
            }
        }
    }
    if points.is_empty() {
        let remedy = dropped.remedy();
        return Err(RgbdError::Nothing { dropped, remedy });
    }
    Ok(BackProjection { cloud: Cloud::new(points, Some(colours)), pixels, dropped })
}

/// Selects a count of [`DroppedPixels`].
type Reason = fn(&mut DroppedPixels) -> &mut usize;

/// The point of a pixel, or the reason why it is left out.
fn point_at(
    depth: &DepthImage,
    camera: &Camera,
    config: &BackProjectionConfig,
    [u, v]: [u32; 2],
) -> Result<Point3<f64>, Reason> {
    let z = depth.at(u, v).ok_or::<Reason>(|dropped| &mut dropped.without_depth)?;
    let [nearest, farthest] = config.depth_range_m;
    if !(nearest..=farthest).contains(&z) {
        return Err(|dropped| &mut dropped.out_of_range);
    }
    if config.flying.is_some_and(|flying| flying.is_flying(depth, u, v)) {
        return Err(|dropped| &mut dropped.flying);
    }
    let ray = camera.intrinsics.ray([f64::from(u), f64::from(v)]);
    let ray = ray.ok_or::<Reason>(|dropped| &mut dropped.outside_lens_model)?;
    let point = camera.world_from_camera * Point3::from(ray * z);
    if let Some([low, high]) = config.crop
        && !(0..3).all(|axis| (low[axis]..=high[axis]).contains(&point[axis]))
    {
        return Err(|dropped| &mut dropped.outside_box);
    }
    Ok(point)
}

fn check_config(config: &BackProjectionConfig) {
    let [nearest, farthest] = config.depth_range_m;
    assert!(nearest <= farthest, "the depth range has its lower end first");
    if let Some([low, high]) = config.crop {
        assert!((0..3).all(|axis| low[axis] <= high[axis]), "the box has its lower corner first");
    }
}

fn check_size(what: &'static str, found: [u32; 2], depth: &DepthImage) -> Result<(), RgbdError> {
    let (width, height) = (depth.width(), depth.height());
    let [found_width, found_height] = found;
    if found == [width, height] {
        return Ok(());
    }
    Err(RgbdError::Size { what, found_width, found_height, width, height })
}

fn check_unit(depth: &DepthImage) -> Result<(), RgbdError> {
    let Some(median_m) = depth.median_m() else { return Ok(()) };
    let [nearest, farthest] = PLAUSIBLE_MEDIAN_M;
    let beyond = match median_m {
        median if median < nearest => "nearer",
        median if median > farthest => "farther",
        _ => return Ok(()),
    };
    Err(RgbdError::DepthUnit { beyond, median_m, unit_m: depth.unit_m() })
}
