//! Reads PLY: the element `vertex`; the elements before it are skipped.
//!
//! Data after the vertices are not read: a mesh whose faces are truncated still gives its points.

use std::path::Path;

use super::error::CloudError;
use super::points::CloudFile;
use super::rows::{Collector, Layout};
use super::table::{Body, Content, Format, Property, Rows, header};
use crate::npy::Number;

/// The name of an element, and its rows.
type Element = (String, Rows);

/// Reads the vertices.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<CloudFile, CloudError> {
    let (mut format, mut elements) = (None, Vec::<Element>::new());
    let (body, lines) = header(bytes, "`end_header`", path, |words| {
        match *words {
            ["end_header"] if format.is_none() => {
                return Err("there is no line `format` before `end_header`".to_owned());
            }
            ["end_header"] => return Ok(true),
            ["format", name, _version] => format = Some(format_named(name)?),
            ["element", name, count] => {
                let count =
                    count.parse().map_err(|_| format!("`{count}` is not a number of elements"))?;
                let unit = format!("rows of the element `{name}`");
                elements.push((name.to_owned(), Rows { unit, count, properties: Vec::new() }));
            }
            ["property", ref words @ ..] => {
                let property = property_named(words)?;
                let (_, rows) =
                    elements.last_mut().ok_or("this property comes before the first `element`")?;
                rows.properties.push(property);
            }
            [] | ["ply" | "comment" | "obj_info", ..] => {}
            [word, ..] => return Err(format!("`{word}` is not a keyword of PLY")),
        }
        Ok(false)
    })?;
    let vertices = elements.iter().position(|(name, _)| name == "vertex");
    let layout = vertices.and_then(|place| Layout::find(&elements[place].1.properties));
    let Some(((format, place), layout)) = format.zip(vertices).zip(layout) else {
        return Err(no_positions(path, &elements));
    };
    let mut body = Body::new(path, format, body, lines);
    for (_, rows) in &elements[..place] {
        body.walk(rows, |_| {})?;
    }
    let mut collector = Collector::new(layout);
    body.walk(&elements[place].1, |row| collector.push(row))?;
    collector.finish(path)
}

fn no_positions(path: &Path, elements: &[Element]) -> CloudError {
    let vertex = elements.iter().find(|(name, _)| name == "vertex");
    let names: Vec<&str> = match vertex {
        Some((_, rows)) => rows.properties.iter().map(|p| p.name.as_str()).collect(),
        None => elements.iter().map(|(name, _)| name.as_str()).collect(),
    };
    let listed = names.iter().take(40).map(|name| format!("`{name}`")).collect::<Vec<_>>();
    let found = match (vertex, listed.join(", ")) {
        (_, listed) if listed.is_empty() => "nothing".to_owned(),
        (Some(_), listed) => format!("its properties {listed}"),
        (None, listed) => format!("the elements {listed}"),
    };
    CloudError::NoPositions { path: path.to_owned(), of: "the element `vertex`", found }
}

fn format_named(name: &str) -> Result<Format, String> {
    match name {
        "ascii" => Ok(Format::Text),
        "binary_little_endian" => Ok(Format::Binary { big_endian: false }),
        "binary_big_endian" => Ok(Format::Binary { big_endian: true }),
        _ => Err(format!(
            "format `{name}` is unknown; wanted ascii, binary_little_endian or binary_big_endian"
        )),
    }
}

/// Parses the words after `property`.
fn property_named(words: &[&str]) -> Result<Property, String> {
    let (kind, name, holds) = match *words {
        ["list", length, kind, name] => (kind, name, Content::List(kind_named(length)?)),
        [kind, name] => (kind, name, Content::One),
        _ => return Err("wanted `property <type> <name>` or a list".to_owned()),
    };
    Ok(Property { name: name.to_owned(), kind: kind_named(kind)?, holds })
}

fn kind_named(name: &str) -> Result<Number, String> {
    Ok(match name {
        "char" | "int8" => Number::Signed(1),
        "uchar" | "uint8" => Number::Unsigned(1),
        "short" | "int16" => Number::Signed(2),
        "ushort" | "uint16" => Number::Unsigned(2),
        "int" | "int32" => Number::Signed(4),
        "uint" | "uint32" => Number::Unsigned(4),
        "float" | "float32" => Number::Float(4),
        "double" | "float64" => Number::Float(8),
        _ => return Err(format!("`{name}` is not a type of PLY")),
    })
}
