//! Images in memory: colours of 8 bits and depths in metres, row by row.

/// A colour image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColourImage {
    width: u32,
    pixels: Vec<[u8; 3]>,
}

impl ColourImage {
    /// An image from its pixels, row by row.
    ///
    /// # Panics
    ///
    /// If there are no pixels, or their number is not `width` times `height`.
    #[must_use]
    pub fn new(width: u32, height: u32, pixels: Vec<[u8; 3]>) -> Self {
        let n = u64::from(width) * u64::from(height);
        assert!(
            n > 0 && n == pixels.len() as u64,
            "one colour for each pixel, and at least one pixel"
        );
        Self { width, pixels }
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        (self.pixels.len() / self.width as usize) as u32
    }

    /// Red, green and blue of a pixel inside of the image.
    #[must_use]
    pub fn at(&self, u: u32, v: u32) -> [u8; 3] {
        self.pixels[v as usize * self.width as usize + u as usize]
    }
}

/// A depth image, m along the optical axis.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthImage {
    width: u32,
    metres: Vec<f32>,
    /// Length of one unit of the file, m.
    unit_m: f64,
}

impl DepthImage {
    /// An image from its depths in metres, row by row; zero, negative and not finite mean no depth.
    /// `unit_m` is the length of one unit of the source, m, for messages.
    ///
    /// # Panics
    ///
    /// If there are no pixels, or their number is not `width` times `height`.
    #[must_use]
    pub fn new(width: u32, height: u32, metres: Vec<f32>, unit_m: f64) -> Self {
        let n = u64::from(width) * u64::from(height);
        assert!(
            n > 0 && n == metres.len() as u64,
            "one depth for each pixel, and at least one pixel"
        );
        Self { width, metres, unit_m }
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        (self.metres.len() / self.width as usize) as u32
    }

    /// Length of one unit of the source, m.
    #[must_use]
    pub fn unit_m(&self) -> f64 {
        self.unit_m
    }

    /// The depth of a pixel, m; `None` if it has none or is outside of the image.
    #[must_use]
    pub fn at(&self, u: u32, v: u32) -> Option<f64> {
        if u >= self.width {
            return None;
        }
        let metres = self.metres.get(v as usize * self.width as usize + u as usize);
        metres.copied().filter(is_depth).map(f64::from)
    }

    /// Median over the pixels with a depth, m; `None` if there are none.
    #[must_use]
    pub(crate) fn median_m(&self) -> Option<f64> {
        let mut valid: Vec<f32> = self.metres.iter().copied().filter(is_depth).collect();
        if valid.is_empty() {
            return None;
        }
        let middle = valid.len() / 2;
        let (_, median, _) = valid.select_nth_unstable_by(middle, f32::total_cmp);
        Some(f64::from(*median))
    }
}

fn is_depth(metres: &f32) -> bool {
    metres.is_finite() && *metres > 0.0
}
