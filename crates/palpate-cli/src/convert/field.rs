//! A field in another format.

use std::path::Path;

use nalgebra::Point3;
use palpate_io::atomic::{self, IfExists};
use palpate_io::body;
use palpate_io::cloud::{self, Cloud, Column};
use palpate_io::field::npz::{read_npz, write_npz};
use palpate_io::field::{self, FieldFile, write_vti};
use palpate_io::log::bag_write::{Compression, write_field};

use crate::error::CliError;
use crate::output::Output;
use crate::place;

/// Frame of the points in a message: that of the robot's base, as ROS calls it.
const FRAME: &str = "base_link";

/// Reads a field and writes it as the ending says.
pub(super) fn convert(
    (input, path, to): (&Path, &Path, &str),
    compression: Compression,
    output: &Output,
) -> Result<(), CliError> {
    if ["json", "xml"].contains(&to) {
        write_body((input, path), to)?;
        return output.result(&format!("The elastic body is in `{}`.\n", path.display()));
    }
    let arrays = read_npz(input).map_err(CliError::file)?;
    let field = FieldFile::from_arrays(&arrays).map_err(CliError::file)?;
    let replace = IfExists::Replace;
    let written = match to {
        "npz" => write_npz(path, &field.to_arrays(), replace).map_err(CliError::file),
        "ply" => write_ply(path, &field),
        "vti" => write_vti(path, replace, &field).map_err(CliError::file),
        "mcap" => atomic::write(path, replace, |out| write_field(out, &field, FRAME, compression))
            .map_err(CliError::file),
        _ => Err(CliError::Usage(format!(
            "`{}`: a field becomes .npz, .ply, .vti or .mcap, its elastic body .json or .xml; give the \
             output one of these endings",
            path.display()
        ))),
    };
    written?;
    let (points, path) = (field.points.len(), path.display());
    output.result(&format!("{points} points are in `{path}`.\n"))
}

/// Writes the most likely elastic body.
fn write_body((input, path): (&Path, &Path), to: &str) -> Result<(), CliError> {
    let field = field::load(input).map_err(CliError::file)?.field;
    let model = field.elastic.ok_or_else(|| {
        CliError::from(format!(
            "`{}` has no elastic body; `palpate map --cloud` makes fields that have one",
            input.display()
        ))
    })?;
    let variant = model.likeliest();
    if to == "json" {
        return place::write(path, &body::json(&variant.body));
    }
    if variant.stiffness_factors.iter().all(|&factor| factor == 0.0) {
        return Err(CliError::from(format!(
            "the touches of `{}` have rejected its elastic body: its stiffness factor is 0; .json has the \
             body as it was made from the cloud",
            input.display()
        )));
    }
    place::write(path, &body::mujoco_xml(variant, model.friction))
}

fn write_ply(path: &Path, field: &FieldFile) -> Result<(), CliError> {
    let points = field.points.iter().map(|&point| Point3::from(point)).collect();
    let columns = field.columns();
    let columns: Vec<_> =
        columns.iter().map(|(name, numbers)| (*name, Column::F64(numbers))).collect();
    let cloud = Cloud::new(points, None);
    cloud::write_ply(path, IfExists::Replace, &cloud, &columns).map_err(CliError::file)
}
