//! Converts rows of named numbers to points and colours.
//!
//! A header names the numbers of a row; [`Layout::find`] selects coordinates and colours, and
//! [`Collector`] collects the rows. Float colours may range from 0 to 1 or from 0 to 255, so their
//! scale is known only after the last row.

use std::path::Path;

use nalgebra::Point3;
use palpate::unstable::MAX_COORDINATE_M;

use super::error::CloudError;
use super::points::{Cloud, CloudFile};
use super::table::{Content, Property};
use crate::npy::Number;

/// Indices in a row of the point and its colour.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    xyz: [usize; 3],
    colour: Colour,
}

/// Representation of the colour in a row.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Colour {
    None,
    /// Indices of three numbers, and their type.
    Channels([usize; 3], Number),
    /// Index of one number `0xaarrggbb`.
    Packed(usize),
}

impl Layout {
    /// Finds coordinates and colours among the numbers of a row; `None` without coordinates.
    pub(super) fn find(properties: &[Property]) -> Option<Self> {
        let place = |wanted: &str| {
            properties.iter().position(|property| {
                matches!(property.holds, Content::One | Content::Packed)
                    && property.name.eq_ignore_ascii_case(wanted)
            })
        };
        let three = |[a, b, c]: [&str; 3]| Some([place(a)?, place(b)?, place(c)?]);
        let channels = three(["red", "green", "blue"])
            .or_else(|| three(["r", "g", "b"]))
            .or_else(|| three(["diffuse_red", "diffuse_green", "diffuse_blue"]));
        let colour = match channels {
            Some(places) => match places.map(|place| properties[place].kind) {
                [r, g, b] if r == g && g == b => Colour::Channels(places, r),
                _ => Colour::None,
            },
            None => place("rgb").or_else(|| place("rgba")).map_or(Colour::None, Colour::Packed),
        };
        Some(Self { xyz: three(["x", "y", "z"])?, colour })
    }
}

/// Collects rows to a cloud.
#[derive(Debug)]
pub(super) struct Collector {
    layout: Layout,
    points: Vec<Point3<f64>>,
    /// Colours of the points that are kept, with the values of the file.
    colours: Vec<[f64; 3]>,
    dropped: Vec<usize>,
    rows: usize,
}

impl Collector {
    pub(super) fn new(layout: Layout) -> Self {
        Self { layout, points: vec![], colours: vec![], dropped: vec![], rows: 0 }
    }

    /// Adds the numbers of the next row.
    pub(super) fn push(&mut self, row: &[f64]) {
        let point = Point3::from(self.layout.xyz.map(|place| row[place]));
        self.rows += 1;
        if !point.iter().all(|number| number.is_finite()) {
            self.dropped.push(self.rows - 1);
            return;
        }
        self.points.push(point);
        match self.layout.colour {
            Colour::None => {}
            Colour::Channels(places, _) => self.colours.push(places.map(|place| row[place])),
            Colour::Packed(place) => {
                let [b, g, r, _a] = (row[place] as u32).to_le_bytes();
                self.colours.push([r, g, b].map(f64::from));
            }
        }
    }

    /// The cloud of all rows; checks distances and colours.
    pub(super) fn finish(self, path: &Path) -> Result<CloudFile, CloudError> {
        if self.points.is_empty() {
            return Err(CloudError::Empty { path: path.to_owned(), dropped: self.dropped.len() });
        }
        let is_far = |point: &Point3<f64>| point.iter().any(|x| x.abs() > MAX_COORDINATE_M);
        if let Some(far) = self.points.iter().position(is_far) {
            return Err(CloudError::Value {
                path: path.to_owned(),
                place: format!("the finite point {far} (from 0)"),
                found: format!("{:?} m", <[f64; 3]>::from(self.points[far])),
                wanted: "coordinates of at most 1000 m; are they in millimetres?",
            });
        }
        let colours = match self.layout.colour {
            Colour::None => None,
            Colour::Packed(_) => Some(self.bytes(path, 1.0)?),
            Colour::Channels(_, kind) => Some(self.bytes(path, self.scale(kind))?),
        };
        Ok(CloudFile { cloud: Cloud::new(self.points, colours), dropped: self.dropped })
    }

    /// Factor that scales a colour channel to 0 to 255.
    fn scale(&self, kind: Number) -> f64 {
        let highest = self.colours.iter().flatten().fold(0.0, |a: f64, &b| a.max(b));
        match kind {
            Number::Float(_) if highest <= 1.0 => 255.0,
            Number::Unsigned(2) => 255.0 / 65_535.0,
            _ => 1.0,
        }
    }

    fn bytes(&self, path: &Path, scale: f64) -> Result<Vec<[u8; 3]>, CloudError> {
        let byte = |number: f64| {
            let scaled = (number * scale).round();
            (0.0..=255.0).contains(&scaled).then_some(scaled as u8)
        };
        let colour = |(place, colour): (usize, &[f64; 3])| match colour.map(byte) {
            [Some(r), Some(g), Some(b)] => Ok([r, g, b]),
            _ => Err(CloudError::Value {
                path: path.to_owned(),
                place: format!("the colour of the finite point {place} (from 0)"),
                found: format!("{colour:?}"),
                wanted: "three numbers from 0 to 1, from 0 to 255, or from 0 to 65535 as ushort",
            }),
        };
        self.colours.iter().enumerate().map(colour).collect()
    }
}
