//! PLY: elements of named properties, of which `vertex` is read and the others are stepped over.
//!
//! What comes after the vertices is not looked at: a mesh whose faces are cut off still has its
//! points. A property may be a list of any length, so that rows have no fixed size; each is walked.

use super::rows::{Collector, Layout, Words, number};
use super::{CloudError, Reading};
use crate::npy::Number;
use std::path::Path;

/// Longest header believed.
const MAX_HEADER_BYTES: usize = 1 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Text,
    Binary { big_endian: bool },
}

#[derive(Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

#[derive(Debug)]
struct Property {
    name: String,
    kind: Number,
    /// For a list, the kind of its length.
    length: Option<Number>,
}

#[derive(Debug)]
struct Header {
    format: Format,
    elements: Vec<Element>,
    /// Lines, the last being `end_header`.
    lines: usize,
}

/// Reads the vertices.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Reading, CloudError> {
    let (header, body) = Header::read(bytes).map_err(|(line, reason)| CloudError::Header {
        path: path.to_owned(),
        line,
        reason,
    })?;
    let vertices = header.elements.iter().position(|element| element.name == "vertex");
    let layout = vertices.and_then(|place| header.elements[place].layout());
    let Some((place, layout)) = vertices.zip(layout) else {
        return Err(header.no_positions(path));
    };
    let mut body = Body {
        path,
        words: Words::new(body, header.lines + 1),
        bytes: body,
        format: header.format,
    };
    let mut row = Vec::new();
    for element in &header.elements[..place] {
        body.walk(element, |_| {}, &mut row)?;
    }
    let mut collector = Collector::new(layout);
    body.walk(&header.elements[place], |row| collector.push(row), &mut row)?;
    collector.finish(path)
}

impl Header {
    /// Reads up to `end_header`; what comes after it is the body. An error is a line and a reason.
    fn read(bytes: &[u8]) -> Result<(Self, &[u8]), (usize, String)> {
        let (mut format, mut elements) = (None, Vec::<Element>::new());
        let (mut rest, mut lines) = (bytes, 0);
        loop {
            let window = &rest[..rest.len().min(MAX_HEADER_BYTES)];
            let wrong = |reason: &str| (lines + 1, reason.to_owned());
            let end = window.iter().position(|&byte| byte == b'\n');
            let end = end.ok_or_else(|| wrong("there is no `end_header`"))?;
            let text = std::str::from_utf8(&rest[..end]).map_err(|_| wrong("it is not text"))?;
            rest = &rest[end + 1..];
            if bytes.len() - rest.len() > MAX_HEADER_BYTES {
                return Err(wrong("the header is longer than 1 MiB"));
            }
            lines += 1;
            let failed = |reason| (lines, reason);
            match text.split_ascii_whitespace().collect::<Vec<_>>()[..] {
                ["end_header"] => break,
                ["format", name, _version] => format = Some(Format::named(name).map_err(failed)?),
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| failed(no_count(count)))?;
                    let (name, properties) = (name.to_owned(), Vec::new());
                    elements.push(Element { name, count, properties });
                }
                ["property", ref words @ ..] => {
                    let property = Property::named(words).map_err(failed)?;
                    let element = elements.last_mut();
                    let element = element.ok_or_else(|| failed("it is of no element".into()))?;
                    element.properties.push(property);
                }
                [] | ["ply" | "comment" | "obj_info", ..] => {}
                [word, ..] => return Err(failed(format!("`{word}` is no word of PLY's"))),
            }
        }
        let format = format.ok_or_else(|| (lines, "there is no `format` before it".to_owned()))?;
        Ok((Self { format, elements, lines }, rest))
    }

    fn no_positions(&self, path: &Path) -> CloudError {
        let vertex = self.elements.iter().find(|element| element.name == "vertex");
        let names: Vec<&str> = match vertex {
            Some(element) => element.properties.iter().map(|p| p.name.as_str()).collect(),
            None => self.elements.iter().map(|element| element.name.as_str()).collect(),
        };
        let listed = names.iter().take(40).map(|name| format!("`{name}`")).collect::<Vec<_>>();
        let found = match (vertex, listed.join(", ")) {
            (_, listed) if listed.is_empty() => "nothing".to_owned(),
            (Some(_), listed) => format!("its properties {listed}"),
            (None, listed) => format!("the elements {listed}"),
        };
        CloudError::NoPositions { path: path.to_owned(), of: "the element `vertex`", found }
    }
}

fn no_count(found: &str) -> String {
    format!("`{found}` is no count of elements")
}

impl Format {
    fn named(name: &str) -> Result<Self, String> {
        match name {
            "ascii" => Ok(Self::Text),
            "binary_little_endian" => Ok(Self::Binary { big_endian: false }),
            "binary_big_endian" => Ok(Self::Binary { big_endian: true }),
            _ => Err(format!(
                "format `{name}` is unknown; wanted ascii, binary_little_endian or \
                 binary_big_endian"
            )),
        }
    }
}

impl Property {
    /// What stands behind the word `property`.
    fn named(words: &[&str]) -> Result<Self, String> {
        match words {
            ["list", length, kind, name] => Ok(Self {
                name: (*name).to_owned(),
                kind: kind_named(kind)?,
                length: Some(kind_named(length)?),
            }),
            [kind, name] => {
                Ok(Self { name: (*name).to_owned(), kind: kind_named(kind)?, length: None })
            }
            _ => Err("wanted `property <type> <name>` or a list".to_owned()),
        }
    }
}

fn kind_named(name: &str) -> Result<Number, String> {
    Ok(match name {
        "char" | "int8" => Number::I8,
        "uchar" | "uint8" => Number::U8,
        "short" | "int16" => Number::I16,
        "ushort" | "uint16" => Number::U16,
        "int" | "int32" => Number::I32,
        "uint" | "uint32" => Number::U32,
        "float" | "float32" => Number::F32,
        "double" | "float64" => Number::F64,
        _ => return Err(format!("`{name}` is no type of PLY's")),
    })
}

impl Element {
    fn layout(&self) -> Option<Layout> {
        let field = |property: &Property| {
            let kind = if property.length.is_none() { Some(property.kind) } else { None };
            (property.name.clone(), kind)
        };
        Layout::find(&self.properties.iter().map(field).collect::<Vec<_>>())
    }
}

/// What follows the header, as far as it is not read yet.
struct Body<'a> {
    path: &'a Path,
    words: Words<'a>,
    bytes: &'a [u8],
    format: Format,
}

impl Body<'_> {
    /// Hands on each row of an element; lists come as zero.
    fn walk(
        &mut self,
        element: &Element,
        mut take: impl FnMut(&[f64]),
        row: &mut Vec<f64>,
    ) -> Result<(), CloudError> {
        if element.properties.is_empty() {
            return Ok(()); // Rows of nothing take no bytes, however many there are.
        }
        for held in 0..element.count {
            row.clear();
            for property in &element.properties {
                let value = match property.length {
                    None => self.number(property)?,
                    Some(kind) => self.skip_list(property, kind)?,
                };
                row.push(value.ok_or_else(|| CloudError::Truncated {
                    path: self.path.to_owned(),
                    held,
                    promised: element.count,
                    unit: format!("rows of the element `{}`", element.name),
                })?);
            }
            take(row);
        }
        Ok(())
    }

    /// The next number, or `None` at the end.
    fn number(&mut self, property: &Property) -> Result<Option<f64>, CloudError> {
        match self.format {
            Format::Text => self.words.number(self.path, &property.name),
            Format::Binary { big_endian } => Ok(self.binary(property.kind, big_endian)),
        }
    }

    fn binary(&mut self, kind: Number, big_endian: bool) -> Option<f64> {
        let (raw, rest) = self.bytes.split_at_checked(kind.bytes())?;
        self.bytes = rest;
        Some(number(kind, big_endian, raw))
    }

    /// Steps over a list; `None` if the body ends first.
    fn skip_list(&mut self, list: &Property, kind: Number) -> Result<Option<f64>, CloudError> {
        let length = match self.format {
            Format::Text => self.words.number(self.path, &list.name)?,
            Format::Binary { big_endian } => self.binary(kind, big_endian),
        };
        let Some(length) = length else { return Ok(None) };
        if length < 0.0 || length.fract() != 0.0 {
            return Err(CloudError::Value {
                path: self.path.to_owned(),
                place: format!("the length of a list `{}`", list.name),
                found: length.to_string(),
                wanted: "a whole number from 0 on",
            });
        }
        let length = length as u64;
        if self.format == Format::Text {
            for _ in 0..length {
                if self.words.next().is_none() {
                    return Ok(None);
                }
            }
            return Ok(Some(0.0));
        }
        let size = length.saturating_mul(list.kind.bytes() as u64);
        let rest = usize::try_from(size).ok().and_then(|size| self.bytes.get(size..));
        Ok(rest.map(|rest| {
            self.bytes = rest;
            0.0
        }))
    }
}
