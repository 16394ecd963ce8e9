//! Rows of named numbers after a header of text: the common part of PLY and PCD.
//!
//! Rows are text or binary. A list in a row may have any length, so rows have no fixed size and are
//! read number by number.

use std::path::Path;

use super::error::CloudError;
use crate::npy::{Number, word};

/// Largest length of a header, bytes; a longer one is refused.
const MAX_HEADER_BYTES: usize = 1 << 20;

/// Reads a header line by line and passes the words of each line to `take`, which returns true for
/// the last line. Returns the bytes after the header and its number of lines.
pub(super) fn header<'a>(
    bytes: &'a [u8],
    last_line: &str,
    path: &Path,
    mut take: impl FnMut(&[&str]) -> Result<bool, String>,
) -> Result<(&'a [u8], usize), CloudError> {
    let (mut rest, mut line) = (bytes, 1);
    loop {
        let wrong = |reason: String| CloudError::Header { path: path.to_owned(), line, reason };
        let window = &rest[..rest.len().min(MAX_HEADER_BYTES)];
        let end = window.iter().position(|&byte| byte == b'\n');
        let end = end.ok_or_else(|| wrong(format!("there is no {last_line}")))?;
        let text = std::str::from_utf8(&rest[..end]).map_err(|_| wrong("it is not text".into()))?;
        rest = &rest[end + 1..];
        if bytes.len() - rest.len() > MAX_HEADER_BYTES {
            return Err(wrong("the header is longer than 1 MiB".to_owned()));
        }
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        if take(&words).map_err(wrong)? {
            return Ok((rest, line));
        }
        line += 1;
    }
}

/// Encoding of the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Text,
    Binary { big_endian: bool },
}

/// A named number or list in a row.
#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Number,
    pub(super) holds: Content,
}

/// Content of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Content {
    One,
    /// One number, whose bits are a colour.
    Packed,
    /// One of several numbers with the same name, which are skipped.
    Part,
    /// A list, which is skipped; its length is written before it, as a number of this type.
    List(Number),
}

/// Rows that all have the same properties.
#[derive(Debug)]
pub(super) struct Rows {
    /// Name of the rows, for error messages.
    pub(super) unit: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

/// The part of a file after the header that is not read yet.
pub(super) struct Body<'a> {
    path: &'a Path,
    format: Format,
    rest: &'a [u8],
    /// Number of the current line, for text.
    line: usize,
}

impl<'a> Body<'a> {
    /// The bytes after a header of `header_lines` lines.
    pub(super) fn new(path: &'a Path, format: Format, rest: &'a [u8], header_lines: usize) -> Self {
        Self { path, format, rest, line: header_lines + 1 }
    }

    /// Passes the numbers of each row to `take`; a skipped list counts as one zero.
    pub(super) fn walk(
        &mut self,
        rows: &Rows,
        mut take: impl FnMut(&[f64]),
    ) -> Result<(), CloudError> {
        if rows.properties.is_empty() {
            return Ok(()); // Rows without properties take no bytes, whatever their number.
        }
        let mut row = Vec::new();
        for held in 0..rows.count {
            row.clear();
            for property in &rows.properties {
                let value = match property.holds {
                    Content::List(length) => self.skip_list(property, length)?,
                    _ => self.number(property, property.kind)?,
                };
                row.push(value.ok_or_else(|| CloudError::Truncated {
                    path: self.path.to_owned(),
                    held,
                    promised: rows.count,
                    unit: rows.unit.clone(),
                })?);
            }
            take(&row);
        }
        Ok(())
    }

    /// The next number, or `None` at the end.
    fn number(&mut self, property: &Property, kind: Number) -> Result<Option<f64>, CloudError> {
        let Format::Binary { big_endian } = self.format else {
            let Some(word) = self.word() else { return Ok(None) };
            let number = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
            let number = number.ok_or_else(|| CloudError::Value {
                path: self.path.to_owned(),
                place: format!("`{}` in line {}", property.name, self.line),
                found: format!("`{}`", word[..word.len().min(24)].escape_ascii()),
                wanted: "a number",
            })?;
            return Ok(Some(if property.holds == Content::Packed { bits(number) } else { number }));
        };
        let Some((bytes, rest)) = self.rest.split_at_checked(kind.bytes()) else {
            return Ok(None);
        };
        self.rest = rest;
        Ok(Some(kind.to_f64(word(bytes, big_endian))))
    }

    /// Skips a list; `None` if the body ends before the list.
    fn skip_list(&mut self, list: &Property, kind: Number) -> Result<Option<f64>, CloudError> {
        let Some(length) = self.number(list, kind)? else { return Ok(None) };
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
            let all_there = (0..length).all(|_| self.word().is_some());
            return Ok(all_there.then_some(0.0));
        }
        let size = length.saturating_mul(list.kind.bytes() as u64);
        let rest = usize::try_from(size).ok().and_then(|size| self.rest.get(size..));
        self.rest = rest.unwrap_or_default();
        Ok(rest.map(|_| 0.0))
    }

    /// The next word, for text.
    fn word(&mut self) -> Option<&'a [u8]> {
        let start = self.rest.iter().position(|byte| !byte.is_ascii_whitespace())?;
        self.line += self.rest[..start].iter().filter(|&&byte| byte == b'\n').count();
        let rest = &self.rest[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.rest = &rest[end..];
        Some(&rest[..end])
    }
}

/// Decodes a packed colour in text: written either as the integer of its bits, or as the float with
/// these bits. Such floats are tiny, negative or not finite, so the two cases cannot be confused.
fn bits(value: f64) -> f64 {
    if value.fract() == 0.0 && value.abs() <= f64::from(u32::MAX) {
        return f64::from(value as i64 as u32);
    }
    f64::from((value as f32).to_bits())
}
