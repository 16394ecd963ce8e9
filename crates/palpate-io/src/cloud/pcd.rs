//! Reads PCD 0.7 of the Point Cloud Library (PCL): one point per row, as text, binary or
//! compressed.
//!
//! Fields with several numbers (a histogram) are skipped. `rgb` and `rgba` hold a colour as the
//! bits of one number, whatever type the header gives. Compressed files are stored field by field
//! instead of point by point. `VIEWPOINT` is not applied, as in PCL.

use std::path::Path;

use super::error::CloudError;
use super::lzf;
use super::points::CloudFile;
use super::rows::{Collector, Layout};
use super::table::{Body, Content, Format, Property, Rows, header};
use crate::npy::Number;

/// Encoding of the points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Data {
    Text,
    Binary,
    Compressed,
}

#[derive(Debug)]
struct Field {
    name: String,
    kind: Number,
    /// How many numbers this field has in a row.
    count: usize,
}

/// Reads the points.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<CloudFile, CloudError> {
    let (mut entries, mut read) = (Entries::default(), None);
    let (body, lines) = header(bytes, "line `DATA`", path, |words| {
        if let Some(data) = entries.take(words)? {
            read = Some((std::mem::take(&mut entries).close()?, data));
        }
        Ok(read.is_some())
    })?;
    let ((fields, count), data) = read.expect("the header ends with the line `DATA`");
    let properties = fields.iter().flat_map(properties).collect();
    let rows = Rows { unit: "points".to_owned(), count, properties };
    let Some(layout) = Layout::find(&rows.properties) else {
        let names = fields.iter().take(40).map(|field| format!("`{}`", field.name));
        let found = names.collect::<Vec<_>>().join(", ");
        return Err(CloudError::NoPositions { path: path.to_owned(), of: "each point", found });
    };
    let unpacked = match data {
        Data::Compressed => by_rows(&unpacked(body, path)?, &fields, count),
        Data::Text | Data::Binary => Vec::new(),
    };
    let (format, body) = match data {
        Data::Text => (Format::Text, body),
        Data::Binary => (Format::Binary { big_endian: false }, body),
        Data::Compressed => (Format::Binary { big_endian: false }, unpacked.as_slice()),
    };
    let mut collector = Collector::new(layout);
    Body::new(path, format, body, lines).walk(&rows, |row| collector.push(row))?;
    collector.finish(path)
}

/// A property for each number of a field.
fn properties(field: &Field) -> impl Iterator<Item = Property> + use<'_> {
    let holds = match field.count {
        1 if field.is_packed() => Content::Packed,
        1 => Content::One,
        _ => Content::Part,
    };
    (0..field.count).map(move |_| Property { name: field.name.clone(), kind: field.kind, holds })
}

/// Decompresses a body, which begins with its compressed and its uncompressed size.
fn unpacked(body: &[u8], path: &Path) -> Result<Vec<u8>, CloudError> {
    let size = |at: usize| {
        let raw = body.get(at..).and_then(|rest| rest.first_chunk::<4>())?;
        usize::try_from(u32::from_le_bytes(*raw)).ok()
    };
    let truncated = |held: usize, promised: usize| CloudError::Truncated {
        path: path.to_owned(),
        held: held as u64,
        promised: promised as u64,
        unit: "compressed bytes".to_owned(),
    };
    let Some((packed, unpacked)) = size(0).zip(size(4)) else {
        return Err(truncated(body.len(), 8));
    };
    let held = &body[8..];
    let packed = held.get(..packed).ok_or_else(|| truncated(held.len(), packed))?;
    lzf::unpack(packed, unpacked)
        .map_err(|reason| CloudError::Damaged { path: path.to_owned(), reason })
}

/// Reorders bytes that are stored field by field to rows, one per point. If there are fewer points
/// than the header says, returns zeros for as many points as there are.
fn by_rows(columns: &[u8], fields: &[Field], points: u64) -> Vec<u8> {
    let sizes = || fields.iter().map(|field| field.kind.bytes() * field.count);
    let row_bytes: usize = sizes().sum();
    let held = columns.len() / row_bytes.max(1);
    // The start of a field depends on the number of points. If there are too few, the number of
    // rows returned here leads to the error when the rows are read.
    let Some(points) = usize::try_from(points).ok().filter(|&points| points <= held) else {
        return vec![0; held * row_bytes];
    };
    let (mut rows, mut offset) = (vec![0; points * row_bytes], 0);
    for size in sizes().filter(|&size| size > 0) {
        let column = columns[offset * points..].chunks_exact(size);
        for (row, value) in rows.chunks_exact_mut(row_bytes).zip(column) {
            row[offset..offset + size].copy_from_slice(value);
        }
        offset += size;
    }
    rows
}

impl Field {
    fn is_packed(&self) -> bool {
        matches!(self.name.as_str(), "rgb" | "rgba")
    }
}

/// The lines of a header read so far.
#[derive(Debug, Default)]
struct Entries {
    names: Vec<String>,
    sizes: Vec<usize>,
    types: Vec<String>,
    counts: Option<Vec<usize>>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
}

impl Entries {
    /// Parses a line; the line `DATA` ends the header.
    fn take(&mut self, words: &[&str]) -> Result<Option<Data>, String> {
        fn numbers<T: std::str::FromStr>(words: &[&str]) -> Result<Vec<T>, String> {
            let number = |word: &&str| {
                word.parse().map_err(|_| format!("`{word}` is not a whole number from 0 on"))
            };
            words.iter().map(number).collect()
        }
        fn one(words: &[&str]) -> Result<Option<u64>, String> {
            match numbers(words)?[..] {
                [number] => Ok(Some(number)),
                _ => Err("wanted one number".to_owned()),
            }
        }
        let owned = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect();
        match words {
            [] => {}
            [first, ..] if first.starts_with('#') => {}
            ["VERSION" | "VIEWPOINT", ..] => {}
            ["FIELDS" | "COLUMNS", names @ ..] => self.names = owned(names),
            ["SIZE", sizes @ ..] => self.sizes = numbers(sizes)?,
            ["TYPE", types @ ..] => self.types = owned(types),
            ["COUNT", counts @ ..] => self.counts = Some(numbers(counts)?),
            ["WIDTH", width @ ..] => self.width = one(width)?,
            ["HEIGHT", height @ ..] => self.height = one(height)?,
            ["POINTS", points @ ..] => self.points = one(points)?,
            ["DATA", "ascii"] => return Ok(Some(Data::Text)),
            ["DATA", "binary"] => return Ok(Some(Data::Binary)),
            ["DATA", "binary_compressed"] => return Ok(Some(Data::Compressed)),
            ["DATA", ..] => return Err("wanted ascii, binary or binary_compressed".to_owned()),
            [word, ..] => return Err(format!("`{word}` is not a keyword of PCD")),
        }
        Ok(None)
    }

    /// The fields and the number of points; an error if the lines do not agree.
    fn close(self) -> Result<(Vec<Field>, u64), String> {
        let n = self.names.len();
        let counts = self.counts.unwrap_or_else(|| vec![1; n]);
        if self.sizes.len() != n || self.types.len() != n || counts.len() != n {
            return Err(format!(
                "there are {n} FIELDS; wanted {n} values each of SIZE, TYPE and COUNT"
            ));
        }
        // The size of a row is limited, since each number becomes a `Property`.
        if counts.iter().fold(0, |sum: usize, &count| sum.saturating_add(count)) > 65_536 {
            return Err("a row has too many numbers; wanted at most 65536".to_owned());
        }
        let product = self.width.zip(self.height).and_then(|(w, h)| w.checked_mul(h));
        let points = match (self.points, product) {
            (Some(points), Some(product)) if points != product => {
                return Err(format!("POINTS is {points}, but WIDTH times HEIGHT is {product}"));
            }
            (Some(points), _) | (None, Some(points)) => points,
            (None, None) => return Err("neither POINTS nor WIDTH and HEIGHT are given".to_owned()),
        };
        let kinds = self.types.iter().zip(&self.sizes);
        let fields = self.names.into_iter().zip(kinds).zip(counts);
        let fields = fields.map(|((name, (letter, &size)), count)| {
            let number = Number::of(&letter.to_ascii_lowercase(), &size.to_string());
            let kind = number.ok_or_else(|| format!("TYPE {letter} of SIZE {size} is unknown"))?;
            let mut field = Field { name, kind, count };
            if field.is_packed() && size == 4 {
                field.kind = Number::Unsigned(4);
            }
            Ok(field)
        });
        Ok((fields.collect::<Result<_, String>>()?, points))
    }
}
