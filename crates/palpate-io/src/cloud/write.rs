//! Writes clouds as PLY and PCD, little-endian, with any further columns.
//!
//! PLY has `double` coordinates, which Open3D, MeshLab and CloudCompare read, so that a cloud reads
//! back exactly. PCD has `float` ones, since PCL's point types support nothing else; at a distance
//! of one metre, the rounding error is 0.06 µm. A colour is `uchar red green blue` in PLY and the
//! bits `0x00rrggbb` of the float `rgb` in PCD, as these programs write it themselves.

use super::points::Cloud;
use crate::atomic::{self, WriteError};
use std::io::{self, Write};
use std::path::Path;

/// A column with one number for each point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Column<'a> {
    /// 32-bit floats.
    F32(&'a [f32]),
    /// 64-bit floats.
    F64(&'a [f64]),
    /// Bytes or flags.
    U8(&'a [u8]),
}

impl Column<'_> {
    fn len(&self) -> usize {
        match self {
            Self::F32(numbers) => numbers.len(),
            Self::F64(numbers) => numbers.len(),
            Self::U8(numbers) => numbers.len(),
        }
    }

    /// PLY's name of the type, PCD's letter, and the size in bytes.
    fn kind(&self) -> (&'static str, char, usize) {
        match self {
            Self::F32(_) => ("float", 'F', 4),
            Self::F64(_) => ("double", 'F', 8),
            Self::U8(_) => ("uchar", 'U', 1),
        }
    }

    fn write(&self, row: usize, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::F32(numbers) => out.write_all(&numbers[row].to_le_bytes()),
            Self::F64(numbers) => out.write_all(&numbers[row].to_le_bytes()),
            Self::U8(numbers) => out.write_all(&[numbers[row]]),
        }
    }
}

/// Writes a PLY file: points, colours if there are any, then `columns` in their order.
///
/// # Errors
///
/// [`WriteError`]; the path is then unchanged.
///
/// # Panics
///
/// If a column does not have one number per point, or its name is already used, empty or not one
/// word.
///
/// # Example
///
/// ```
/// use nalgebra::Point3;
/// use palpate_io::cloud::{self, Cloud, Column};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("leaf.ply");
/// let leaf = Cloud::new(vec![Point3::new(0.5, 0.0, 0.3)], Some(vec![[30, 120, 40]]));
/// let columns = [("K", Column::F64(&[85.0])), ("touched", Column::U8(&[1]))];
/// cloud::write_ply(&path, &leaf, &columns)?;
///
/// assert_eq!(cloud::read(&path)?.cloud, leaf);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_ply(path: &Path, cloud: &Cloud, columns: &[(&str, Column)]) -> Result<(), WriteError> {
    check(cloud, columns);
    atomic::write(path, |out| {
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment world frame, metres")?;
        writeln!(out, "element vertex {}", cloud.len())?;
        writeln!(out, "property double x\nproperty double y\nproperty double z")?;
        if cloud.colours.is_some() {
            writeln!(out, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        }
        for (name, column) in columns {
            writeln!(out, "property {} {name}", column.kind().0)?;
        }
        writeln!(out, "end_header")?;
        for (row, point) in cloud.points.iter().enumerate() {
            for number in point.iter() {
                out.write_all(&number.to_le_bytes())?;
            }
            if let Some(colours) = &cloud.colours {
                out.write_all(&colours[row])?;
            }
            columns.iter().try_for_each(|(_, column)| column.write(row, out))?;
        }
        Ok(())
    })
}

/// Writes a PCD file: `x y z`, `rgb` if there are colours, then `columns` in their order.
///
/// # Errors
///
/// [`WriteError`], also if a coordinate exceeds the range of 32-bit floats; the path is then
/// unchanged.
///
/// # Panics
///
/// As [`write_ply`].
pub fn write_pcd(path: &Path, cloud: &Cloud, columns: &[(&str, Column)]) -> Result<(), WriteError> {
    check(cloud, columns);
    let mut fields: Vec<(&str, char, usize)> = ["x", "y", "z"].map(|axis| (axis, 'F', 4)).into();
    fields.extend(cloud.colours.iter().map(|_| ("rgb", 'F', 4)));
    fields.extend(columns.iter().map(|(name, column)| {
        let (_, letter, size) = column.kind();
        (*name, letter, size)
    }));
    let line = |word: fn(&(&str, char, usize)) -> String| {
        fields.iter().map(|field| format!(" {}", word(field))).collect::<String>()
    };
    atomic::write(path, |out| {
        writeln!(out, "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7")?;
        writeln!(out, "FIELDS{}", line(|field| field.0.to_owned()))?;
        writeln!(out, "SIZE{}", line(|field| field.2.to_string()))?;
        writeln!(out, "TYPE{}", line(|field| field.1.to_string()))?;
        writeln!(out, "COUNT{}", line(|_| "1".to_owned()))?;
        writeln!(out, "WIDTH {}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0", cloud.len())?;
        writeln!(out, "POINTS {}\nDATA binary", cloud.len())?;
        for (row, point) in cloud.points.iter().enumerate() {
            let single = point.map(|number| number as f32);
            if !single.iter().all(|number| number.is_finite()) {
                let what = format!("point {row} is too far away for PCD: {point}");
                return Err(io::Error::new(io::ErrorKind::InvalidData, what));
            }
            for number in single.iter() {
                out.write_all(&number.to_le_bytes())?;
            }
            if let Some(colours) = &cloud.colours {
                let [r, g, b] = colours[row];
                out.write_all(&[b, g, r, 0])?;
            }
            columns.iter().try_for_each(|(_, column)| column.write(row, out))?;
        }
        Ok(())
    })
}

/// Checks that the columns have one number per point and unique names.
fn check(cloud: &Cloud, columns: &[(&str, Column)]) {
    let mut taken = vec!["x", "y", "z", "red", "green", "blue", "rgb", "rgba"];
    for (name, column) in columns {
        assert_eq!(column.len(), cloud.len(), "column `{name}`: one number for each point");
        let is_word = !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_graphic());
        assert!(
            is_word && !taken.contains(name),
            "column `{name}`: wanted a single word that no other column has"
        );
        taken.push(name);
    }
}
