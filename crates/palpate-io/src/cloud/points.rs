//! A cloud in memory.

use nalgebra::Point3;

/// Points in the world frame, with a colour for each point or without colours.
///
/// Every coordinate is finite.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Cloud {
    pub(super) points: Vec<Point3<f64>>,
    pub(super) colours: Option<Vec<[u8; 3]>>,
}

impl Cloud {
    /// A cloud of points, m, and their colours (red, green, blue).
    ///
    /// # Panics
    ///
    /// If the numbers of colours and points differ, or a coordinate is not finite; the caller must
    /// check that. [`super::read()`] drops such points and lists their rows.
    #[must_use]
    pub fn new(points: Vec<Point3<f64>>, colours: Option<Vec<[u8; 3]>>) -> Self {
        assert!(
            colours.as_ref().is_none_or(|c| c.len() == points.len()),
            "one colour for each point"
        );
        let is_finite = |point: &Point3<f64>| point.iter().all(|number| number.is_finite());
        assert!(points.iter().all(is_finite), "every coordinate is finite");
        Self { points, colours }
    }

    /// The points, m, world frame.
    #[must_use]
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Red, green and blue of each point, if the cloud has colours.
    #[must_use]
    pub fn colours(&self) -> Option<&[[u8; 3]]> {
        self.colours.as_deref()
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// A cloud that was read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudFile {
    /// The finite points, in the order of the file.
    pub cloud: Cloud,
    /// Rows of the file, counted from 0, whose point is not finite and was dropped: organised
    /// clouds have such rows for pixels without depth.
    pub dropped: Vec<usize>,
}
