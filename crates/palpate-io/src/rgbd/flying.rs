//! Flying pixels: wrong depths between an object and its background.
//!
//! At the edge of an object a pixel sees object and background, and many cameras report a depth in
//! between. A pixel counts as flying if, among its eight neighbours, one is nearer, one is farther,
//! and fewer than two have its depth. Both conditions are needed. A twig one pixel wide has few
//! neighbours of the same depth, two along its length and one at its end, but all others are
//! *behind* it; a leaf seen at a grazing angle has nearer and farther neighbours, but two of the
//! same depth across the slope.
//!
//! The tolerance for equal depth is proportional to the depth, as are the noise and the distance
//! between pixels. In the bundled image of a plant, whose depths are noisy but not mixed at edges,
//! 121 of 201,477 pixels are taken for flying; if depths are mixed at edges, 5 of 1,421 such pixels
//! are kept.

use super::images::DepthImage;

/// Criterion for flying pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlyingPixels {
    /// Largest difference between neighbours on the same surface, m per metre of depth.
    pub same_m_per_m: f64,
    /// Smallest number of neighbours of the same depth of a pixel that is not flying.
    pub enough: usize,
}

impl Default for FlyingPixels {
    /// Ten millimetres at one metre: several times the noise of depth cameras, and the step between
    /// pixels of a leaf seen at 10° by a camera of 640 pixels. Two neighbours form a line.
    fn default() -> Self {
        Self { same_m_per_m: 0.01, enough: 2 }
    }
}

impl FlyingPixels {
    /// Whether a pixel is flying; false if it has no depth.
    pub(super) fn is_flying(&self, depth: &DepthImage, u: u32, v: u32) -> bool {
        let Some(here) = depth.at(u, v) else { return false };
        let same_m = self.same_m_per_m * here;
        let (mut same, mut is_nearer, mut is_farther) = (0, false, false);
        for dv in -1..=1 {
            for du in -1..=1 {
                let there = (u.checked_add_signed(du)).zip(v.checked_add_signed(dv));
                let Some(there) = there.and_then(|(u, v)| depth.at(u, v)) else { continue };
                is_nearer |= there < here - same_m;
                is_farther |= there > here + same_m;
                same += usize::from((there - here).abs() <= same_m);
            }
        }
        // `same` also counts the pixel itself.
        is_nearer && is_farther && same - 1 < self.enough
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A depth image of `rows`, one digit per pixel: its depth is 1 m plus 0.1 m times the digit.
    fn picture(rows: &[&str]) -> DepthImage {
        let metres = rows.iter().flat_map(|row| row.bytes()).map(|digit| match digit {
            b'.' => 0.0,
            digit => 1.0 + 0.1 * f32::from(digit - b'0'),
        });
        let (width, height) = (rows[0].len() as u32, rows.len() as u32);
        DepthImage::new(width, height, metres.collect(), 0.001)
    }

    fn hanging(rows: &[&str]) -> Vec<[u32; 2]> {
        let depth = picture(rows);
        let pixels = (0..depth.height()).flat_map(|v| (0..depth.width()).map(move |u| [u, v]));
        pixels.filter(|&[u, v]| FlyingPixels::default().is_flying(&depth, u, v)).collect()
    }

    #[test]
    fn a_depth_between_two_sides_of_an_edge_hangs() {
        assert_eq!(hanging(&["00999", "00599", "00999"]), [[2, 1]]);
        // A whole edge of flying pixels, with different depths.
        assert_eq!(hanging(&["00299", "00599", "00799"]), [[2, 0], [2, 1], [2, 2]]);
    }

    #[test]
    fn twigs_of_one_pixel_survive_with_their_ends() {
        assert!(hanging(&["99099", "99099", "99099", "99999"]).is_empty());
        assert!(hanging(&["90999", "99099", "99909", "99999"]).is_empty());
        // Between a leaf in front and a wall behind, the twig is kept, but not its ends.
        assert_eq!(hanging(&["03999", "03999", "03999", "09999"]), [[1, 0], [1, 2]]);
    }

    #[test]
    fn steep_leaves_and_holes_survive() {
        // At the border of the image one of the two neighbours across the slope is missing.
        let steep = hanging(&["01234", "01234", "01234", "01234"]);
        assert!(steep.iter().all(|&[_, v]| v == 0 || v == 3), "{steep:?}");
        assert!(hanging(&["0.9", "0.9", "0.9"]).is_empty());
        assert!(hanging(&["0"]).is_empty());
    }
}
