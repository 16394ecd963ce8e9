//! Paints balls and translucent solids into pixels, with a depth buffer.
//!
//! A vector file with tens of thousands of circles opens slowly; a pixel image stays small whatever
//! their number. Positions are in pixels: to the right, down, and towards the eye. Painting is done
//! at twice the size of the resulting picture, so that edges are smooth.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use palpate_work::quantile::extremes;

/// Painted pixels per pixel of the picture, along each side.
const FINE: usize = 2;
/// Largest darkening by [`Raster::crease`]: 1 would be black.
const CREASE: f32 = 0.6;
/// Direction to the light: from the upper left and the eye, as usual in drawings.
const LIGHT: [f64; 3] = [-0.43, -0.52, 0.74];
/// Radius of the smallest ball that is shaded, in painted pixels.
const SHADED: f64 = 5.0;
const NOTHING: f32 = f32::NEG_INFINITY;

type Rgb = [u8; 3];

/// A picture that is being painted, white at first.
pub(super) struct Raster {
    width: usize,
    height: usize,
    rgb: Vec<Rgb>,
    /// Depth of the painted pixels, towards the eye.
    depth: Vec<f32>,
}

/// One solid, whose near faces hide its far ones, before it is blended over a picture like glass.
pub(super) struct Glass {
    width: usize,
    depth: Vec<f32>,
    light: Vec<f32>,
}

impl Raster {
    /// A picture of a size, in pixels of the result; painting uses `FINE` times as many along each
    /// side.
    pub(super) fn new([width, height]: [u32; 2]) -> Self {
        let [width, height] = [width, height].map(|side| FINE * side.max(1) as usize);
        let n = width * height;
        Self { width, height, rgb: vec![[255; 3]; n], depth: vec![NOTHING; n] }
    }

    /// Paints a shaded ball; one that is smaller than `SHADED` is a flat dot.
    pub(super) fn ball(&mut self, at: [f64; 3], radius: f64, colour: Rgb) {
        let ([x, y, z], radius) = (at.map(|side| side * FINE as f64), radius * FINE as f64);
        for row in pixels(y - radius, y + radius, self.height) {
            for column in pixels(x - radius, x + radius, self.width) {
                let [right, down] = [column as f64 + 0.5 - x, row as f64 + 0.5 - y];
                let bulge = radius * radius - right * right - down * down;
                let (pixel, depth) = (row * self.width + column, (z + bulge.abs().sqrt()) as f32);
                if bulge >= 0.0 && depth > self.depth[pixel] {
                    let out = [right, down, bulge.sqrt()].map(|side| side / radius);
                    let light = if radius < SHADED { 1.0 } else { lit(out) };
                    self.depth[pixel] = depth;
                    self.rgb[pixel] = colour.map(|part| (f32::from(part) * light) as u8);
                }
            }
        }
    }

    /// Darkens pixels beside something nearer, so that a cloud shows its depth.
    ///
    /// `deep` is the step in depth that darkens most, px; larger ones darken as much.
    pub(super) fn crease(&mut self, deep: f64) {
        let (reach, deep) = (FINE as isize, (deep * FINE as f64) as f32);
        let around: Vec<(isize, isize)> = [(1, 0), (0, 1), (1, 1), (1, -1)]
            .into_iter()
            .flat_map(|(x, y)| [(reach * x, reach * y), (-reach * x, -reach * y)])
            .collect();
        for pixel in 0..self.rgb.len() {
            let depth = self.depth[pixel];
            if depth == NOTHING {
                continue;
            }
            let [x, y] = [pixel % self.width, pixel / self.width].map(|at| at as isize);
            let nearer = around.iter().filter_map(|&(right, down)| {
                let (x, y) = (x + right, y + down);
                let inside =
                    (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
                inside.then(|| self.depth[y as usize * self.width + x as usize])
            });
            let steps: f32 = nearer.map(|near| ((near - depth) / deep).clamp(0.0, 1.0)).sum();
            let left = 1.0 - CREASE * steps / around.len() as f32;
            self.rgb[pixel] = self.rgb[pixel].map(|part| (f32::from(part) * left) as u8);
        }
    }

    /// An empty solid for this picture.
    pub(super) fn glass(&self) -> Glass {
        let n = self.rgb.len();
        Glass { width: self.width, depth: vec![NOTHING; n], light: vec![0.0; n] }
    }

    /// Blends a solid over everything farther than it; `alpha` is the weight of its own colour,
    /// which is larger at its outline.
    pub(super) fn lay(&mut self, glass: &Glass, colour: Rgb, alpha: f32) {
        for pixel in 0..self.rgb.len() {
            if glass.depth[pixel] <= self.depth[pixel] {
                continue;
            }
            let part = if glass.outline(pixel) { 0.5 + 0.5 * alpha } else { alpha };
            let light = if glass.outline(pixel) { 0.62 } else { glass.light[pixel] };
            for (under, own) in self.rgb[pixel].iter_mut().zip(colour) {
                let own = (f32::from(own) * light).min(255.0);
                *under = (f32::from(*under) * (1.0 - part) + own * part).round() as u8;
            }
        }
    }

    /// The picture as a PNG in a data URI, for an SVG.
    pub(super) fn data_uri(&self) -> String {
        let (width, height) = (self.width / FINE, self.height / FINE);
        let mean = |pixel: usize, part: usize| -> u8 {
            let first = pixel / width * FINE * self.width + pixel % width * FINE;
            let fine = (0..FINE * FINE).map(|n| first + n / FINE * self.width + n % FINE);
            let sum: usize = fine.map(|fine| usize::from(self.rgb[fine][part])).sum();
            let mean = (sum / (FINE * FINE)) as u8;
            // Six bits per colour make smaller files without visible loss; white stays white.
            mean & !3 | mean >> 6
        };
        let bytes: Vec<u8> = (0..3 * width * height).map(|at| mean(at / 3, at % 3)).collect();
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(png::Filter::NoFilter);
        let written = encoder.write_header().and_then(|mut out| out.write_image_data(&bytes));
        written.expect("memory takes every picture that has pixels");
        format!("data:image/png;base64,{}", STANDARD.encode(file))
    }
}

impl Glass {
    /// Paints a flat triangle with outward normal `out`; one that faces away is not painted.
    pub(super) fn triangle(&mut self, corners: [[f64; 3]; 3], out: [f64; 3]) {
        let [a, b, c] = corners.map(|corner| corner.map(|side| side * FINE as f64));
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if out[2] <= 0.0 || twice == 0.0 {
            return;
        }
        let height = self.depth.len() / self.width;
        let ends = |axis: usize| extremes([a[axis], b[axis], c[axis]]).expect("three corners");
        let [[left, right], [top, bottom]] = [ends(0), ends(1)];
        for row in pixels(top, bottom, height) {
            for column in pixels(left, right, self.width) {
                let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
                let of_b = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / twice;
                let of_c = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / twice;
                let of_a = 1.0 - of_b - of_c;
                let pixel = row * self.width + column;
                let depth = (of_a * a[2] + of_b * b[2] + of_c * c[2]) as f32;
                if of_a.min(of_b).min(of_c) >= -1e-9 && depth > self.depth[pixel] {
                    self.depth[pixel] = depth;
                    self.light[pixel] = lit(out);
                }
            }
        }
    }

    /// Whether a neighbour of a pixel is outside of the solid.
    fn outline(&self, pixel: usize) -> bool {
        let aside = [pixel.wrapping_sub(1), pixel + 1];
        let above = [pixel.wrapping_sub(self.width), pixel + self.width];
        let end = |at: &usize| self.depth.get(*at).is_none_or(|&depth| depth == NOTHING);
        aside.iter().chain(&above).any(end)
    }
}

/// Brightness of a surface with outward normal `out`.
fn lit(out: [f64; 3]) -> f32 {
    let facing: f64 = out.iter().zip(LIGHT).map(|(out, light)| out * light).sum();
    (0.68 + 0.32 * facing.max(0.0)) as f32
}

/// The pixels of the picture between two positions; the picture has `n`.
fn pixels(from: f64, to: f64, n: usize) -> std::ops::Range<usize> {
    (from.floor().max(0.0) as usize).min(n)..(to.ceil().max(0.0) as usize).min(n)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Rgb = [250, 0, 0];
    const BLUE: Rgb = [0, 0, 250];

    fn middle(raster: &Raster) -> Rgb {
        raster.rgb[raster.height / 2 * raster.width + raster.width / 2]
    }

    #[test]
    fn near_surfaces_hide_far_ones_in_any_order() {
        for order in [[0, 1], [1, 0]] {
            let mut raster = Raster::new([20, 20]);
            for which in order {
                let (depth, colour) = [(1.0, RED), (9.0, BLUE)][which];
                raster.ball([10.0, 10.0, depth], 4.0, colour);
            }
            assert!(middle(&raster)[2] > 100 && middle(&raster)[0] == 0);
        }
    }

    #[test]
    fn glass_is_seen_through_and_hidden_by_what_is_nearer() {
        let seen = |glass_at: f64| {
            let mut raster = Raster::new([20, 20]);
            raster.ball([10.0, 10.0, 5.0], 4.0, RED);
            let mut glass = raster.glass();
            let corners = [[0.0, 0.0, glass_at], [0.0, 60.0, glass_at], [60.0, 0.0, glass_at]];
            glass.triangle(corners, [0.0, 0.0, 1.0]);
            raster.lay(&glass, BLUE, 0.25);
            middle(&raster)
        };
        let (before, behind) = (seen(20.0), seen(-20.0));
        assert!(before[0] > before[2] && before[2] > 30, "{before:?}");
        assert_eq!(behind[2], 0);
    }

    #[test]
    fn a_triangle_that_faces_away_is_not_seen() {
        let raster = Raster::new([4, 4]);
        let mut glass = raster.glass();
        glass.triangle([[0.0; 3], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]], [0.0, 0.0, -1.0]);
        assert!(glass.depth.iter().all(|&depth| depth == NOTHING));
    }

    #[test]
    fn what_lies_outside_is_cut_off() {
        let mut raster = Raster::new([4, 3]);
        for x in [-100.0, 0.0, 4.0, 1e9] {
            raster.ball([x, 1.0, 0.0], 2.0, RED);
        }
        raster.crease(1.0);
        assert!(raster.rgb.iter().any(|&pixel| pixel != [255; 3]));
        assert!(raster.data_uri().starts_with("data:image/png;base64,iVBOR"));
    }
}
