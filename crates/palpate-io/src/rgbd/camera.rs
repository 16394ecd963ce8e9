//! Camera model: intrinsics and pose.

use super::distortion::Distortion;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// Longest side of an image, pixels; a larger image is refused.
pub(super) const MAX_SIDE: u32 = 16_384;

/// Intrinsic parameters of a camera: size, focal lengths, centre and lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    width: u32,
    height: u32,
    /// fx and fy, pixels.
    focal: Vector2<f64>,
    /// cx and cy, pixels.
    centre: Vector2<f64>,
    distortion: Distortion,
}

impl Intrinsics {
    /// Checks the parameters: the size, `[fx, fy]` and `[cx, cy]`, all in pixels, and the lens.
    ///
    /// # Errors
    ///
    /// The end of a message, for an impossible value: no or too many pixels, a focal length that is
    /// not positive or seems to be in another unit, a centre far outside of the image.
    pub fn new(
        [width, height]: [u32; 2],
        focal: [f64; 2],
        centre: [f64; 2],
        distortion: Distortion,
    ) -> Result<Self, String> {
        if [width, height].iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(format!(
                "the image is {width} x {height} pixels; wanted 1 to {MAX_SIDE} on each side"
            ));
        }
        let sides = [f64::from(width), f64::from(height)];
        for (axis, name) in ["x", "y"].into_iter().enumerate() {
            let (side, focal, centre) = (sides[axis], focal[axis], centre[axis]);
            if focal.is_nan() || focal <= 0.0 || focal.is_infinite() {
                return Err(format!(
                    "f{name} is {focal}; wanted a focal length above 0, in pixels"
                ));
            }
            if focal < 0.02 * side || focal > 1000.0 * side {
                return Err(format!(
                    "f{name} is {focal} for {side} pixels, which no lens has; wanted the focal \
                     length in pixels"
                ));
            }
            if !(-side..=2.0 * side).contains(&centre) {
                return Err(format!(
                    "c{name} is {centre}, far outside of the {side} pixels; wanted the pixel where \
                     the optical axis meets the image"
                ));
            }
        }
        Ok(Self { width, height, focal: focal.into(), centre: centre.into(), distortion })
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// The ray of a pixel in the camera's frame: a vector with z = 1. `None` where the lens model
    /// has no inverse.
    #[must_use]
    pub(crate) fn ray(&self, pixel: [f64; 2]) -> Option<Vector3<f64>> {
        let seen = (Vector2::from(pixel) - self.centre).component_div(&self.focal);
        self.distortion.undistort(seen).map(|ideal| ideal.push(1.0))
    }

    /// The pixel of a point in the camera's frame; `None` if the point is not in front of the
    /// camera.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        (point.z > 0.0).then(|| {
            let seen = self.distortion.distort(point.xy().coords / point.z);
            (seen.component_mul(&self.focal) + self.centre).into()
        })
    }
}

/// A camera and its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Size, focal lengths, centre and lens.
    pub intrinsics: Intrinsics,
    /// Pose of the camera's frame: x to the right, y down, z forward.
    pub world_from_camera: Isometry3<f64>,
}

impl Camera {
    /// The pixel (u, v), not rounded, of a point in the world frame; `None` if the point is not in
    /// front of the camera.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<[f64; 2]> {
        self.intrinsics.project(&self.world_from_camera.inverse_transform_point(point))
    }
}
