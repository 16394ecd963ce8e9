//! PCD 0.7: points of the Point Cloud Library, one a row, in text, bytes or compressed bytes.
//!
//! A field may count several numbers (a histogram): they are stepped over. `rgb` and `rgba` hold
//! a colour as the bits of one number, whatever type the header gives it. Compressed files hold
//! field after field instead of point after point. `VIEWPOINT` is not applied, as PCL does not.

use super::rows::{Collector, Layout, Words, number};
use super::{CloudError, Reading, lzf};
use crate::npy::Number;
use std::path::Path;

/// Longest header believed.
const MAX_HEADER_BYTES: usize = 1 << 16;

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
    /// Numbers of this field in a row.
    count: usize,
}

#[derive(Debug)]
struct Header {
    fields: Vec<Field>,
    points: u64,
    data: Data,
    /// Lines, the last being `DATA`.
    lines: usize,
}

/// Reads the points.
pub(super) fn decode(bytes: &[u8], path: &Path) -> Result<Reading, CloudError> {
    let (header, body) = Header::read(bytes).map_err(|(line, reason)| CloudError::Header {
        path: path.to_owned(),
        line,
        reason,
    })?;
    let layout = header.layout().ok_or_else(|| header.no_positions(path))?;
    let mut collector = Collector::new(layout);
    match header.data {
        Data::Text => header.walk_text(body, path, &mut collector)?,
        Data::Binary => header.walk(body, path, &mut collector)?,
        Data::Compressed => header.walk(&unpacked(body, path)?, path, &mut collector)?,
    }
    collector.finish(path)
}

/// The bytes behind the two sizes that a compressed body begins with.
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

impl Header {
    /// Reads up to the line `DATA`; what comes after it is the body. An error is a line and a
    /// reason.
    fn read(bytes: &[u8]) -> Result<(Self, &[u8]), (usize, String)> {
        let (mut rest, mut lines) = (bytes, 0);
        let mut entries = Entries::default();
        loop {
            let window = &rest[..rest.len().min(MAX_HEADER_BYTES)];
            let end = window.iter().position(|&byte| byte == b'\n');
            let wrong = |reason: &str| (lines + 1, reason.to_owned());
            let end = end.ok_or_else(|| wrong("there is no line `DATA`"))?;
            let text = std::str::from_utf8(&rest[..end]).map_err(|_| wrong("it is not text"))?;
            rest = &rest[end + 1..];
            if bytes.len() - rest.len() > MAX_HEADER_BYTES {
                return Err(wrong("the header is longer than 64 KiB"));
            }
            lines += 1;
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            if let Some(data) = entries.take(&words).map_err(|reason| (lines, reason))? {
                let (fields, points) = entries.close().map_err(|reason| (lines, reason))?;
                return Ok((Self { fields, points, data, lines }, rest));
            }
        }
    }

    /// One name for each number of a row; none for those of which a field has several.
    fn layout(&self) -> Option<Layout> {
        let names = self.fields.iter().flat_map(|field| {
            let kind = (field.count == 1).then_some(field.kind);
            std::iter::repeat_n((field.name.clone(), kind), field.count)
        });
        Layout::find(&names.collect::<Vec<_>>())
    }

    /// Where each number of a row begins, and how far it is to that of the next row.
    fn slots(&self, row_bytes: usize, points: usize) -> Vec<(Number, usize, usize)> {
        let (mut slots, mut offset) = (Vec::new(), 0);
        for field in &self.fields {
            let size = field.kind.bytes();
            for place in 0..field.count {
                slots.push(match self.data {
                    Data::Compressed => {
                        (field.kind, offset * points + place * size, size * field.count)
                    }
                    _ => (field.kind, offset + place * size, row_bytes),
                });
            }
            offset += size * field.count;
        }
        slots
    }

    /// Hands on the rows of a binary body.
    fn walk(&self, body: &[u8], path: &Path, to: &mut Collector) -> Result<(), CloudError> {
        let row_bytes: usize = self.fields.iter().map(|f| f.kind.bytes() * f.count).sum();
        let held = (body.len() / row_bytes) as u64;
        if held < self.points {
            return Err(self.truncated(path, held));
        }
        let points = self.points as usize; // no more than the body has rows
        let slots = self.slots(row_bytes, points);
        let mut row = vec![0.0; slots.len()];
        for point in 0..points {
            for (value, &(kind, start, stride)) in row.iter_mut().zip(&slots) {
                *value = number(kind, false, &body[start + point * stride..]);
            }
            to.push(&row);
        }
        Ok(())
    }

    /// Hands on the rows of a text.
    fn walk_text(&self, body: &[u8], path: &Path, to: &mut Collector) -> Result<(), CloudError> {
        let mut words = Words::new(body, self.lines + 1);
        let mut row = Vec::new();
        for held in 0..self.points {
            row.clear();
            for field in &self.fields {
                for _ in 0..field.count {
                    let value = words.number(path, &field.name)?;
                    let value = value.ok_or_else(|| self.truncated(path, held))?;
                    row.push(if field.is_packed() { bits(value) } else { value });
                }
            }
            to.push(&row);
        }
        Ok(())
    }

    fn truncated(&self, path: &Path, held: u64) -> CloudError {
        let (path, promised) = (path.to_owned(), self.points);
        CloudError::Truncated { path, held, promised, unit: "points".to_owned() }
    }

    fn no_positions(&self, path: &Path) -> CloudError {
        let names = self.fields.iter().take(40).map(|field| format!("`{}`", field.name));
        let found = names.collect::<Vec<_>>().join(", ");
        CloudError::NoPositions { path: path.to_owned(), of: "each point", found }
    }
}

/// A packed colour that was written as text: its bits as a whole number, or the number that these
/// bits are as a float. Such floats are tiny, negative or not finite, so that neither is mistaken.
fn bits(value: f64) -> f64 {
    if value.fract() == 0.0 && value.abs() <= f64::from(u32::MAX) {
        return f64::from(value as i64 as u32);
    }
    f64::from((value as f32).to_bits())
}

impl Field {
    fn is_packed(&self) -> bool {
        matches!(self.name.as_str(), "rgb" | "rgba")
    }
}

/// Lines of a header, as far as they came.
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
    /// Takes a line; that of `DATA` ends the header.
    fn take(&mut self, words: &[&str]) -> Result<Option<Data>, String> {
        fn numbers<T: std::str::FromStr>(words: &[&str]) -> Result<Vec<T>, String> {
            let number = |word: &&str| word.parse().map_err(|_| format!("`{word}` is no count"));
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
            [word, ..] => return Err(format!("`{word}` is no word of PCD's")),
        }
        Ok(None)
    }

    /// The fields and the number of points, once they fit together.
    fn close(self) -> Result<(Vec<Field>, u64), String> {
        let n = self.names.len();
        let counts = self.counts.unwrap_or_else(|| vec![1; n]);
        if self.sizes.len() != n || self.types.len() != n || counts.len() != n {
            return Err(format!("there are {n} FIELDS, but not as many of SIZE, TYPE and COUNT"));
        }
        // A row is bounded, so that its header can be spread out number by number.
        if counts.iter().fold(0, |sum: usize, &count| sum.saturating_add(count)) > 65_536 {
            return Err("a row of so many numbers is not read".to_owned());
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
            let kind = kind(letter, size)?;
            let mut field = Field { name, kind, count };
            if field.is_packed() && size == 4 {
                field.kind = Number::U32;
            }
            Ok(field)
        });
        Ok((fields.collect::<Result<_, String>>()?, points))
    }
}

fn kind(letter: &str, size: usize) -> Result<Number, String> {
    Ok(match (letter, size) {
        ("F", 4) => Number::F32,
        ("F", 8) => Number::F64,
        ("I", 1) => Number::I8,
        ("I", 2) => Number::I16,
        ("I", 4) => Number::I32,
        ("I", 8) => Number::I64,
        ("U", 1) => Number::U8,
        ("U", 2) => Number::U16,
        ("U", 4) => Number::U32,
        ("U", 8) => Number::U64,
        _ => return Err(format!("TYPE {letter} of SIZE {size} is unknown")),
    })
}
