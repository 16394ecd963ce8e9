//! Features of seen points: colour, height, and the shape of their surroundings.
//!
//! Light falls unevenly on a plant, so that one leaf has many brightnesses. [`Colour::Chroma`]
//! leaves brightness out: it is the shares of red and green in the light, which do not change when
//! the light is halved.

use nalgebra::{DMatrix, Vector3, matrix};
use rayon::prelude::*;
use serde::Serialize;

use super::cloud::SeenCloud;
use crate::body::principal_axes;

/// Number of neighbours from which the shape at a point is computed.
const ABOUT: usize = 30;

/// The colour features of a point.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum Colour {
    /// No colour.
    None,
    /// Red, green and blue of the picture (as in the paper).
    Rgb,
    /// Lightness and two opponent colours of the perceptually uniform colour space Oklab.
    Oklab,
    /// The shares of red and green in the sum of all three, without brightness.
    #[default]
    Chroma,
}

/// Colours by name.
const COLOURS: [(&str, Colour); 3] =
    [("rgb", Colour::Rgb), ("oklab", Colour::Oklab), ("chroma", Colour::Chroma)];

/// The features on which a regression is done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(into = "String")]
pub struct Features {
    /// The point's colour.
    pub colour: Colour,
    /// Its height above the robot's base.
    pub height: bool,
    /// Linearity and planarity of the points around it, and the vertical part of their normal.
    pub shape: bool,
}

impl std::fmt::Display for Features {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let colour = COLOURS.iter().find(|(_, colour)| *colour == self.colour);
        let colour = colour.map(|(name, _)| *name);
        let (height, shape) = (self.height.then_some("height"), self.shape.then_some("shape"));
        f.write_str(&[colour, height, shape].into_iter().flatten().collect::<Vec<_>>().join("+"))
    }
}

impl From<Features> for String {
    fn from(features: Features) -> Self {
        features.to_string()
    }
}

impl std::str::FromStr for Features {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut features = Self { colour: Colour::None, height: false, shape: false };
        for name in text.split('+').map(str::trim) {
            match (COLOURS.iter().find(|(colour, _)| *colour == name), name) {
                (Some(_), _) if features.colour != Colour::None => {
                    return Err(format!("`{text}` names two colours; wanted at most one"));
                }
                (Some((_, colour)), _) => features.colour = *colour,
                (None, "height") => features.height = true,
                (None, "shape") => features.shape = true,
                _ => {
                    return Err(format!(
                        "`{name}` in `{text}` is no feature; wanted one of rgb, oklab and chroma, \
                         and height or shape, joined by `+`, such as chroma+height"
                    ));
                }
            }
        }
        Ok(features)
    }
}

impl Features {
    /// The features of every seen point, n_features × points, each standardised to mean 0 and
    /// standard deviation 1 over the cloud; a constant feature is 0.
    pub(super) fn of(self, seen: &SeenCloud) -> DMatrix<f64> {
        let shapes: Vec<[f64; 3]> = if self.shape {
            seen.points_m().par_iter().map(|point| shape(seen, point)).collect()
        } else {
            Vec::new()
        };
        let mut numbers = Vec::new();
        for (point, colour) in seen.colours().iter().enumerate() {
            match self.colour {
                Colour::None => {}
                Colour::Rgb => numbers.extend(colour.map(|part| f64::from(part) / 255.0)),
                Colour::Oklab => numbers.extend(oklab(*colour)),
                Colour::Chroma => numbers.extend(chroma(*colour)),
            }
            if self.height {
                numbers.push(seen.points_m()[point][2]);
            }
            if self.shape {
                numbers.extend(shapes[point]);
            }
        }
        let mut features = DMatrix::from_vec(numbers.len() / seen.len(), seen.len(), numbers);
        for mut row in features.row_iter_mut() {
            let (mean, deviation) = (row.mean(), row.variance().sqrt());
            let scale = if deviation > 1e-9 { deviation.recip() } else { 0.0 };
            row.apply(|value| *value = (*value - mean) * scale);
        }
        features
    }
}

/// The shares of red and green. One is added to each value, so that black counts as grey and the
/// rounding of dark colours has little effect.
fn chroma(colour: [u8; 3]) -> [f64; 2] {
    let [red, green, blue] = colour.map(|part| f64::from(part) + 1.0);
    let sum = red + green + blue;
    [red / sum, green / sum]
}

/// Oklab of an sRGB colour (Ottosson, 2020): lightness, green to red, blue to yellow.
fn oklab(colour: [u8; 3]) -> [f64; 3] {
    let linear = Vector3::from(colour.map(|part| {
        let part = f64::from(part) / 255.0;
        if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
    }));
    let cones = matrix![
        0.412_221_470_8, 0.536_332_536_3, 0.051_445_992_9;
        0.211_903_498_2, 0.680_699_545_1, 0.107_396_956_6;
        0.088_302_461_9, 0.281_718_837_6, 0.629_978_700_5
    ] * linear;
    let opponents = matrix![
        0.210_454_255_3, 0.793_617_785_0, -0.004_072_046_8;
        1.977_998_495_1, -2.428_592_205_0, 0.450_593_709_9;
        0.025_904_037_1, 0.782_771_766_2, -0.808_675_766_0
    ] * cones.map(f64::cbrt);
    opponents.into()
}

/// Linearity `(σ₁ − σ₂)/σ₁` and planarity `(σ₂ − σ₃)/σ₁` of the points around a place, where σ are
/// their standard deviations along the principal axes, and the vertical part of the third axis.
fn shape(seen: &SeenCloud, place_m: &[f64; 3]) -> [f64; 3] {
    let about = seen.neighbours(place_m, ABOUT);
    let points = about.iter().map(|&at| seen.points_m()[at].into());
    let (_, [.., normal], [longest, middle, shortest]) = principal_axes(points);
    if longest <= 0.0 {
        return [0.0; 3];
    }
    [(longest - middle) / longest, (middle - shortest) / longest, normal[2].abs()]
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    #[test]
    fn half_the_light_is_the_same_chroma() {
        let [bright, dim] = [chroma([200, 120, 60]), chroma([100, 60, 30])];
        assert!((bright[0] - dim[0]).abs() < 0.005 && (bright[1] - dim[1]).abs() < 0.005);
        assert_eq!(chroma([0, 0, 0]), [1.0 / 3.0; 2]);
    }

    #[test]
    fn oklab_of_white_red_and_grey_is_as_published() {
        let near = |found: [f64; 3], wanted: [f64; 3]| {
            found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-3)
        };
        assert!(near(oklab([255, 255, 255]), [1.0, 0.0, 0.0]));
        assert!(near(oklab([255, 0, 0]), [0.628, 0.225, 0.126]));
        let grey = oklab([120, 120, 120]);
        assert!(grey[1].abs() < 1e-3 && grey[2].abs() < 1e-3);
    }

    #[test]
    fn a_line_is_linear_and_a_plane_planar_and_its_normal_is_found() {
        let line: Vec<_> = (0..40).map(|n| Point3::new(f64::from(n), 0.0, 0.0)).collect();
        let plane: Vec<_> =
            (0..400).map(|n| Point3::new(f64::from(n % 20), f64::from(n / 20), 0.0)).collect();
        let at = |points: &[Point3<f64>], place: [f64; 3]| {
            shape(&SeenCloud::new(points, &vec![[0; 3]; points.len()]).unwrap(), &place)
        };
        let [linear, _, _] = at(&line, [20.0, 0.0, 0.0]);
        assert!(linear > 0.99, "{linear}");
        let [linear, planar, upward] = at(&plane, [10.0, 10.0, 0.0]);
        assert!(linear < 0.2 && planar > 0.8 && upward > 0.999, "{linear} {planar} {upward}");
    }

    #[test]
    fn names_are_written_as_they_are_read_and_others_are_refused() {
        for name in ["rgb", "oklab", "chroma", "chroma+height", "height", "rgb+height+shape"] {
            assert_eq!(name.parse::<Features>().unwrap().to_string(), name);
        }
        assert!("rgb+oklab".parse::<Features>().unwrap_err().contains("two colours"));
        assert!("hue".parse::<Features>().unwrap_err().contains("wanted one of"));
    }

    #[test]
    fn features_are_standardised_and_constant_ones_are_zero() {
        let points: Vec<_> = (0..50).map(|n| Point3::new(f64::from(n), 0.0, 1.0)).collect();
        let colours: Vec<_> = (0..50_u8).map(|n| [4 * n, 100, 50]).collect();
        let seen = SeenCloud::new(&points, &colours).unwrap();
        let features = "rgb+height".parse::<Features>().unwrap().of(&seen);
        assert_eq!(features.shape(), (4, 50));
        assert!(features.row(0).mean().abs() < 1e-12);
        assert!((features.row(0).variance() - 1.0).abs() < 1e-9);
        assert!(features.rows(1, 3).iter().all(|&value| value == 0.0));
    }
}
