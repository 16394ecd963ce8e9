//! A question about a planned path and its answer, as JSON; [`crate::query_server`] documents them.

use std::fmt::{self, Formatter};
use std::marker::PhantomData;
use std::time::Instant;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use nalgebra::DVector;
use palpate::{PathPoint, PathPrediction};
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// Largest number of points of a path.
pub(crate) const MAX_POINTS: usize = 100_000;
/// Largest number of values of a point while parsing; the number of joints is checked later.
const MAX_JOINTS: usize = 64;

/// A question: one line of JSON.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PathRequest {
    path: Option<Points>,
    path_f64: Option<String>,
    /// Level of the band, 0 to 1; the default level of the field if absent.
    pub(crate) level: Option<f64>,
    #[serde(default)]
    pub(crate) exact: bool,
    #[serde(default)]
    pub(crate) tare: bool,
}

/// Number format of a path and of the torques in its answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Form {
    /// One JSON list of numbers for each point.
    Lists,
    /// The bytes of all numbers (float64, little-endian) as base64.
    F64,
}

/// The answer about a path.
#[derive(Debug, Serialize)]
pub(crate) struct PathReply {
    #[serde(flatten)]
    torques: TorqueLists,
    contacts: Vec<usize>,
    known: Vec<usize>,
    goes_on: bool,
    /// The band, if the field has bands.
    #[serde(flatten)]
    band: Option<Band>,
    /// Time to compute the answer, ms.
    ms: f64,
}

/// Half-widths of the band around the torques (N × n_joints, N·m), and its level.
#[derive(Debug, Serialize)]
struct Band {
    level: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    half_width: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    half_width_f64: Option<String>,
    /// Half-widths of the band for the largest torque of the path.
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_half_width: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    peak_half_width_f64: Option<String>,
}

/// Torques and their standard deviations, N·m, in the number format of the path.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum TorqueLists {
    Lists { torque: Vec<Vec<f64>>, torque_std: Vec<Vec<f64>> },
    F64 { torque_f64: String, torque_std_f64: String },
}

impl PathRequest {
    /// The path of the question, and its number format.
    pub(crate) fn path(&mut self, n_joints: usize) -> Result<(Vec<Vec<f64>>, Form), String> {
        match (self.path.take(), self.path_f64.take()) {
            (Some(path), None) => Ok((path.0, Form::Lists)),
            (None, Some(base64)) => Ok((path_from(&base64, n_joints)?, Form::F64)),
            (None, None) => Err("neither a path nor a tare is asked for".to_owned()),
            (Some(_), Some(_)) => {
                Err("both `path` and `path_f64` are given; give only one".to_owned())
            }
        }
    }
}

/// A path of lists, whose number of points is limited while parsing: an empty list takes three bytes
/// in the line and ten times as many in memory.
#[derive(Debug)]
struct Points(Vec<Vec<f64>>);

/// The values of one point of a path.
struct Numbers(Vec<f64>);

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let points: Vec<Numbers> = deserializer.deserialize_seq(AtMost::new(MAX_POINTS))?;
        Ok(Self(points.into_iter().map(|point| point.0).collect()))
    }
}

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_seq(AtMost::new(MAX_JOINTS)).map(Self)
    }
}

/// Parses a list of limited length.
struct AtMost<T>(usize, PhantomData<T>);

impl<T> AtMost<T> {
    fn new(most: usize) -> Self {
        Self(most, PhantomData)
    }
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for AtMost<T> {
    type Value = Vec<T>;

    fn expecting(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "a list of at most {}", self.0)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Vec<T>, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element()? {
            if items.len() == self.0 {
                return Err(A::Error::invalid_length(self.0 + 1, &self));
            }
            items.push(item);
        }
        Ok(items)
    }
}

/// Decodes the points of a path from base64.
fn path_from(base64: &str, n_joints: usize) -> Result<Vec<Vec<f64>>, String> {
    const WANTED: &str = "wanted the path as float64, little-endian, point by point";
    if base64.len() / 4 * 3 > MAX_POINTS * 8 * n_joints.max(1) + 2 {
        return Err(format!(
            "the path has more than {MAX_POINTS} points; divide it and ask about each part"
        ));
    }
    let bytes = BASE64_STANDARD.decode(base64);
    let bytes = bytes.map_err(|error| format!("`path_f64` is not base64 ({error}); {WANTED}"))?;
    let (numbers, rest) = bytes.as_chunks::<8>();
    let n_joints = n_joints.max(1); // chunks must not be empty; a robot without joints has no path
    if !rest.is_empty() || !numbers.len().is_multiple_of(n_joints) {
        return Err(format!(
            "`path_f64` has {} bytes, which is not a multiple of the {} bytes of a point of {n_joints} joints; \
             {WANTED}",
            bytes.len(),
            8 * n_joints
        ));
    }
    let point =
        |point: &[[u8; 8]]| point.iter().map(|number| f64::from_le_bytes(*number)).collect();
    Ok(numbers.chunks_exact(n_joints).map(point).collect())
}

impl PathReply {
    /// The answer to a question received at `started`, with the band at `level`, or at the default level
    /// of the field if `level` is `None`.
    ///
    /// # Errors
    ///
    /// If a level is given and the field has no band at that level.
    pub(crate) fn new(
        answer: &PathPrediction,
        (form, level): (Form, Option<f64>),
        started: Instant,
    ) -> Result<Self, String> {
        let points = &answer.points;
        let band = match (&answer.calibration, level) {
            (None, Some(_)) => {
                return Err("these predictions have no bands".to_owned());
            }
            (None, None) => None,
            (Some(own), level) => {
                let level = level.unwrap_or(own.default_level());
                let lowest = own.quantiles.first().map_or(0.0, |first| first.level);
                let no = || {
                    format!(
                        "`level` is {level}; the field has bands from {lowest} to {}",
                        own.highest_level()
                    )
                };
                Some(Band::of(answer, form, level).ok_or_else(no)?)
            }
        };
        Ok(Self {
            torques: TorqueLists::of(points, form),
            band,
            contacts: points.iter().map(|point| point.contacts).collect(),
            known: points.iter().map(|point| point.known).collect(),
            goes_on: answer.goes_on,
            ms: started.elapsed().as_secs_f64() * 1e3,
        })
    }
}

impl Band {
    fn of(answer: &PathPrediction, form: Form, level: f64) -> Option<Self> {
        let written = |widths: Vec<DVector<f64>>| match form {
            Form::Lists => (Some(lists(&widths)), None),
            Form::F64 => (None, Some(base64(&widths))),
        };
        let (half_width, half_width_f64) = written(answer.half_width(level)?);
        let (peak_half_width, peak_half_width_f64) = written(answer.peak_half_width(level)?);
        Some(Self { level, half_width, half_width_f64, peak_half_width, peak_half_width_f64 })
    }
}

impl TorqueLists {
    /// The torques at the points of an answer.
    fn of(points: &[PathPoint], form: Form) -> Self {
        match form {
            Form::Lists => Self::Lists {
                torque: lists(points.iter().map(|point| &point.torque)),
                torque_std: lists(points.iter().map(|point| &point.torque_std)),
            },
            Form::F64 => Self::F64 {
                torque_f64: base64(points.iter().map(|point| &point.torque)),
                torque_std_f64: base64(points.iter().map(|point| &point.torque_std)),
            },
        }
    }
}

/// The values of every point, rounded to 1e-6: parsing all 17 digits would take the reader 1 ms.
fn lists<'a>(points: impl IntoIterator<Item = &'a DVector<f64>>) -> Vec<Vec<f64>> {
    let rounded = |number: &f64| (number * 1e6).round() / 1e6;
    points.into_iter().map(|point| point.iter().map(rounded).collect()).collect()
}

/// The bytes of all values (float64, little-endian) as base64.
fn base64<'a>(points: impl IntoIterator<Item = &'a DVector<f64>>) -> String {
    let numbers = points.into_iter().flat_map(|point| point.iter());
    BASE64_STANDARD.encode(numbers.flat_map(|number| number.to_le_bytes()).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_of_too_many_points_or_numbers_is_refused_while_it_is_read() {
        let read = |line: String| serde_json::from_str::<PathRequest>(&line).map(|_| ());
        let path = |count| format!("{{\"path\": [{}[]]}}", "[],".repeat(count));
        assert!(read(path(MAX_POINTS - 1)).is_ok());
        let error = read(path(MAX_POINTS)).unwrap_err().to_string();
        assert!(error.contains("expected a list of at most 100000"), "{error}");
        let error =
            read(format!("{{\"path\": [[{}0]]}}", "0,".repeat(64))).unwrap_err().to_string();
        assert!(error.contains("expected a list of at most 64"), "{error}");
        let mut all = "A".repeat(MAX_POINTS * 8 * 3 / 3 * 4);
        assert_eq!(path_from(&all, 3).unwrap().len(), MAX_POINTS);
        all.push_str("AAAA");
        assert!(path_from(&all, 3).unwrap_err().contains("more than 100000 points"));
    }

    #[test]
    fn lists_and_base64_hold_the_same_numbers() {
        let path = vec![vec![0.1, -1e-300, 3.0], vec![f64::MAX, 0.25, -7.5]];
        let bytes: Vec<u8> = path.concat().iter().flat_map(|number| number.to_le_bytes()).collect();
        assert_eq!(path_from(&BASE64_STANDARD.encode(bytes), 3).unwrap(), path);
        assert!(path_from("", 0).unwrap().is_empty());
        let points: Vec<PathPoint> = (0..5)
            .map(|n| {
                let mut point = PathPoint::default();
                point.torque = DVector::from_vec(vec![f64::from(n) / 3.0, -40.0]);
                point.torque_std = DVector::from_vec(vec![0.0, 1e-7 + f64::from(n)]);
                point
            })
            .collect();
        let [lists, bytes] = [Form::Lists, Form::F64]
            .map(|form| serde_json::to_value(TorqueLists::of(&points, form)).unwrap());
        for name in ["torque", "torque_std"] {
            let of = |point: &PathPoint| match name {
                "torque" => point.torque.as_slice().to_vec(),
                _ => point.torque_std.as_slice().to_vec(),
            };
            let wanted: Vec<Vec<f64>> = points.iter().map(of).collect();
            let base64 = bytes[format!("{name}_f64")].as_str().unwrap();
            assert_eq!(path_from(base64, 2).unwrap(), wanted);
            let rows: Vec<Vec<f64>> = serde_json::from_value(lists[name].clone()).unwrap();
            assert_eq!(rows.len(), wanted.len());
            let off = rows.concat().into_iter().zip(wanted.concat()).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 5.1e-7);
        }
    }
}
