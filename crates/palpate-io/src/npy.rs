//! The `.npy` format: one array of numbers with a short header of text.
//!
//! Arrays are read row by row in blocks of bounded size, so that a log of any length streams. The
//! size in the header is checked against the length of the file before memory is allocated. Rows of
//! an array in Fortran order (`np.save` writes a transposed array so) are gathered column by
//! column.
//!
//! Supported are versions 1 to 3 of the format, floats of 4 and 8 bytes and integers of 1 to 8, in
//! either byte order. Objects, records, text and complex numbers are refused. The `npyz` crate
//! reads more types, but needs a parser generator and a C compiler, and cannot read Fortran order
//! by rows.

use std::io::{self, Read, Seek, SeekFrom, Write};

use serde::Deserialize;
use serde_json::Value;

/// First six bytes of every npy file.
const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest header that is accepted, bytes. numpy's own reader accepts 10,000 bytes.
const MAX_HEADER_BYTES: usize = 65_536;
/// Bytes read at a time.
const BLOCK_BYTES: u64 = 1 << 18;

/// What can be wrong with an npy file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum NpyError {
    /// The file begins with something else.
    #[error("is not an npy file: it begins with {found}; write it with numpy.save")]
    NotNpy { found: String },
    /// A version other than 1 to 3.
    #[error("is npy version {major}; wanted version 1, 2 or 3")]
    Version { major: u8 },
    /// The header's text does not parse.
    #[error("has a header that cannot be read: {reason}")]
    Header { reason: String },
    /// A type of numbers that is not supported.
    #[error("holds `{descr}`, which is {what}; save it with array.astype('float64')")]
    Dtype { descr: String, what: &'static str },
    /// A shape whose size no file could hold.
    #[error("claims the shape {shape:?}, more than any file could hold")]
    TooLarge { shape: Vec<u64> },
    /// Fewer bytes than the header says.
    #[error(
        "is truncated: it holds {held} of the {promised} {unit} its header promises; copy it again"
    )]
    Truncated { held: u64, promised: u64, unit: &'static str },
    /// The operating system reported an error.
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
}

/// Type of a number and its size in bytes: 4 or 8 for a float, 1, 2, 4 or 8 for an integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Number {
    Float(usize),
    Signed(usize),
    Unsigned(usize),
}

/// The header of an npy file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Header {
    pub(crate) number: Number,
    pub(crate) big_endian: bool,
    pub(crate) fortran_order: bool,
    pub(crate) shape: Vec<u64>,
}

/// The Python dictionary in a header.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Dictionary {
    descr: Value,
    fortran_order: bool,
    shape: Vec<u64>,
}

impl Number {
    /// The type for a letter (`f`, `i` or `u`) and a number of bytes.
    pub(crate) fn of(letter: &str, bytes: &str) -> Option<Self> {
        let size = bytes.parse().ok()?;
        match (letter, bytes) {
            ("f", "4" | "8") => Some(Self::Float(size)),
            ("i", "1" | "2" | "4" | "8") => Some(Self::Signed(size)),
            ("u", "1" | "2" | "4" | "8") => Some(Self::Unsigned(size)),
            _ => None,
        }
    }

    /// Size of one number, bytes.
    pub(crate) fn bytes(self) -> usize {
        match self {
            Self::Float(bytes) | Self::Signed(bytes) | Self::Unsigned(bytes) => bytes,
        }
    }

    /// The number in the first bytes of `raw`, little-endian, rounded to `f64` if necessary; the
    /// remaining bytes must be zero.
    #[allow(clippy::cast_precision_loss)] // integers beyond 2^53 are no joint angles
    pub(crate) fn to_f64(self, raw: [u8; 8]) -> f64 {
        match self {
            Self::Float(4) => f64::from(f32::from_bits(u64::from_le_bytes(raw) as u32)),
            Self::Float(_) => f64::from_le_bytes(raw),
            Self::Signed(bytes) => signed(raw, bytes) as f64,
            Self::Unsigned(_) => u64::from_le_bytes(raw) as f64,
        }
    }

    /// The type that `descr` (numpy's `dtype.str`) names, and whether it is big-endian.
    fn parse(descr: &str) -> Result<(Self, bool), NpyError> {
        let refuse = |what| Err(NpyError::Dtype { descr: descr.to_owned(), what });
        let (order, kind) = match descr.as_bytes() {
            [order @ (b'<' | b'>' | b'|' | b'='), ..] => (*order, &descr[1..]),
            _ => (b'=', descr),
        };
        let number = kind.split_at_checked(1).and_then(|(letter, bytes)| Self::of(letter, bytes));
        let number = match (number, kind) {
            (Some(number), _) => number,
            (None, "b1") => Self::Unsigned(1),
            _ if kind.starts_with('O') => return refuse("Python objects that only pickle reads"),
            _ if kind.starts_with('c') => return refuse("complex numbers"),
            _ if kind.starts_with(['U', 'S']) => return refuse("text"),
            _ => return refuse("neither a plain float nor an integer"),
        };
        Ok((number, order == b'>'))
    }
}

impl Header {
    /// Reads magic bytes, version and header; leaves `input` at the first number.
    pub(crate) fn read(input: &mut impl Read) -> Result<Self, NpyError> {
        let mut start = Vec::new();
        input.by_ref().take(8).read_to_end(&mut start)?;
        let [magic @ .., major, _minor] = start.as_slice() else { return Err(not_npy(&start)) };
        if magic != MAGIC {
            return Err(not_npy(&start));
        }
        let bytes = match major {
            1 => 2,
            2 | 3 => 4,
            &major => return Err(NpyError::Version { major }),
        };
        let mut length = [0; 4];
        read_whole(input, &mut length[..bytes])?;
        let length = u32::from_le_bytes(length) as usize;
        if length > MAX_HEADER_BYTES {
            return Err(header(format!("it claims to be {length} bytes long")));
        }
        let mut text = vec![0; length];
        read_whole(input, &mut text)?;
        let text = String::from_utf8(text).map_err(|_| header("it is not text"))?;
        Self::parse(&text)
    }

    /// Parses `{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }`, keys in any order.
    fn parse(text: &str) -> Result<Self, NpyError> {
        // A Python dictionary is YAML except for the brackets of a tuple. Python 2 wrote `400L`.
        let yaml = text.replace('(', "[").replace(')', "]").replace("L,", ",").replace("L]", "]");
        let Dictionary { descr, fortran_order, shape } =
            serde_saphyr::from_str(&yaml).map_err(|error| {
                header(error.to_string().lines().next().unwrap_or("it is not a dictionary"))
            })?;
        let Value::String(descr) = descr else {
            let (descr, what) = ("structured dtype".to_owned(), "an array of records");
            return Err(NpyError::Dtype { descr, what });
        };
        let (number, big_endian) = Number::parse(&descr)?;
        Ok(Self { number, big_endian, fortran_order, shape })
    }

    /// Size of all numbers, bytes.
    pub(crate) fn data_bytes(&self) -> Result<u64, NpyError> {
        self.product(self.number.bytes() as u64, &self.shape)
    }

    fn product(&self, size: u64, sides: &[u64]) -> Result<u64, NpyError> {
        let mut sides = sides.iter();
        let product = sides.try_fold(size, |product, &side| product.checked_mul(side));
        product.ok_or_else(|| self.too_large())
    }

    /// Error for a shape that does not fit into memory.
    pub(crate) fn too_large(&self) -> NpyError {
        NpyError::TooLarge { shape: self.shape.clone() }
    }

    /// The numbers in `raw`, whose length is a multiple of [`Number::bytes`].
    pub(crate) fn decode<'a>(&self, raw: &'a [u8]) -> impl Iterator<Item = f64> + use<'a> {
        let number = self.number;
        self.words(raw).map(move |word| number.to_f64(word))
    }

    /// The numbers in `raw` as little-endian bytes, padded with zeros to 8 bytes.
    pub(crate) fn words<'a>(&self, raw: &'a [u8]) -> impl Iterator<Item = [u8; 8]> + use<'a> {
        let big_endian = self.big_endian;
        raw.chunks_exact(self.number.bytes()).map(move |chunk| word(chunk, big_endian))
    }
}

/// The bytes of one number as little-endian, padded with zeros to 8 bytes.
pub(crate) fn word(bytes: &[u8], big_endian: bool) -> [u8; 8] {
    let mut word = [0; 8];
    word[..bytes.len()].copy_from_slice(bytes);
    if big_endian {
        word[..bytes.len()].reverse();
    }
    word
}

/// The signed integer in the first `bytes` bytes of a word, little-endian.
pub(crate) fn signed(word: [u8; 8], bytes: usize) -> i64 {
    let unused = 64 - 8 * bytes;
    i64::from_le_bytes(word) << unused >> unused
}

/// Writes the header of an array in C order, little-endian; `descr` is numpy's `dtype.str`.
///
/// As numpy does, it leaves space for any number of rows, so that the header can be overwritten
/// when the number of rows is known.
pub(crate) fn write_header(out: &mut impl Write, descr: &str, shape: &[usize]) -> io::Result<()> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sides}), }}");
    let digits = |number: usize| number.to_string().len();
    let room = shape.first().map_or(0, |&rows| digits(usize::MAX) - digits(rows));
    let unpadded = MAGIC.len() + 4 + text.len() + room + 1;
    text.push_str(&" ".repeat(unpadded.next_multiple_of(64) - unpadded + room));
    text.push('\n');
    let length = u16::try_from(text.len()).map_err(|_| io::Error::other("too many dimensions"))?;
    out.write_all(MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(text.as_bytes())
}

/// Rows of a T x n array, read in blocks.
///
/// The whole length is checked when opening: a truncated file never yields a row.
#[derive(Debug)]
pub(crate) struct Rows<R> {
    input: R,
    header: Header,
    data_start: u64,
    /// Number of rows; a one-dimensional array has one number per row.
    pub(crate) rows: u64,
    /// Numbers per row.
    pub(crate) columns: usize,
    /// Number of rows returned so far.
    pub(crate) read: u64,
    block: Vec<f64>,
    block_start: u64,
}

impl<R: Read + Seek> Rows<R> {
    /// Reads the header and checks the length of the input against it.
    pub(crate) fn open(mut input: R) -> Result<Self, NpyError> {
        let header = Header::read(&mut input)?;
        let promised = header.data_bytes()?;
        let columns = header.product(1, &header.shape[header.shape.len().min(1)..])?;
        let data_start = input.stream_position()?;
        let held = input.seek(SeekFrom::End(0))?.saturating_sub(data_start);
        // Rows without columns are ignored, whatever their number in the header.
        let rows = if columns == 0 { 0 } else { header.shape.first().copied().unwrap_or(1) };
        let size = header.number.bytes() as u64;
        if held < promised {
            let in_rows = !header.fortran_order && columns > 0;
            let (step, unit) = if in_rows { (columns * size, "rows") } else { (size, "numbers") };
            let (held, promised) = (held / step, promised / step);
            return Err(NpyError::Truncated { held, promised, unit });
        }
        let columns = usize::try_from(columns).map_err(|_| header.too_large())?;
        let block = Vec::new();
        Ok(Self { input, header, data_start, rows, columns, read: 0, block, block_start: 0 })
    }

    /// Shape of the array as in the header.
    pub(crate) fn shape(&self) -> &[u64] {
        &self.header.shape
    }

    /// Whether the file holds floats, not integers.
    pub(crate) fn is_float(&self) -> bool {
        matches!(self.header.number, Number::Float(_))
    }

    /// The next row, or `None` after the last.
    pub(crate) fn next_row(&mut self) -> Option<Result<&[f64], NpyError>> {
        if self.read >= self.rows {
            return None;
        }
        let held = (self.block.len() / self.columns.max(1)) as u64;
        if self.read >= self.block_start + held
            && let Err(error) = self.read_block()
        {
            self.read = self.rows; // After a failed read, no more rows are returned.
            return Some(Err(error));
        }
        let offset = (self.read - self.block_start) as usize * self.columns;
        self.read += 1;
        Some(Ok(&self.block[offset..offset + self.columns]))
    }

    /// All numbers of the remaining rows.
    pub(crate) fn all(mut self) -> Result<Vec<f64>, NpyError> {
        let mut numbers = Vec::new();
        while let Some(row) = self.next_row() {
            numbers.extend_from_slice(row?);
        }
        Ok(numbers)
    }

    /// Reads the block that begins at the next row.
    fn read_block(&mut self) -> Result<(), NpyError> {
        let size = self.header.number.bytes() as u64;
        let columns = self.columns as u64;
        let room = (BLOCK_BYTES / (columns * size).max(1)).max(1);
        let n_rows = room.min(self.rows - self.read);
        self.block_start = self.read;
        self.block.clear();
        if !self.header.fortran_order {
            let raw = self.read_at(self.read * columns, n_rows * columns)?;
            self.block.extend(self.header.decode(&raw));
            return Ok(());
        }
        self.block.resize((n_rows * columns) as usize, 0.0);
        for column in 0..columns {
            let raw = self.read_at(column * self.rows + self.read, n_rows)?;
            let places = self.block.iter_mut().skip(column as usize).step_by(self.columns);
            places.zip(self.header.decode(&raw)).for_each(|(place, value)| *place = value);
        }
        Ok(())
    }

    /// The bytes of `count` numbers, starting with number `first`.
    fn read_at(&mut self, first: u64, count: u64) -> Result<Vec<u8>, NpyError> {
        let size = self.header.number.bytes() as u64;
        self.input.seek(SeekFrom::Start(self.data_start + first * size))?;
        let mut raw = vec![0; (count * size) as usize];
        self.input.read_exact(&mut raw)?;
        Ok(raw)
    }
}

fn header(reason: impl Into<String>) -> NpyError {
    NpyError::Header { reason: reason.into() }
}

fn not_npy(start: &[u8]) -> NpyError {
    let found = match start {
        [] => "nothing, it is empty".to_owned(),
        [b'P', b'K', ..] => "a zip archive (an npz?)".to_owned(),
        _ => format!("{:?}", String::from_utf8_lossy(start)),
    };
    NpyError::NotNpy { found }
}

/// Fills `raw`, or returns an error if the file ends within the header.
fn read_whole(input: &mut impl Read, raw: &mut [u8]) -> Result<(), NpyError> {
    input.read_exact(raw).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => header("the file ends within the header"),
        _ => NpyError::Io(error),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::Cursor;

    /// An npy file with a given header text.
    fn file(major: u8, header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([major, 0]);
        match major {
            1 => bytes.extend((header.len() as u16).to_le_bytes()),
            _ => bytes.extend((header.len() as u32).to_le_bytes()),
        }
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn rows_of(bytes: Vec<u8>) -> Result<Vec<Vec<f64>>, NpyError> {
        let mut rows = Rows::open(Cursor::new(bytes))?;
        let mut all = Vec::new();
        while let Some(row) = rows.next_row() {
            all.push(row?.to_vec());
        }
        Ok(all)
    }

    #[test]
    fn every_version_byte_order_and_memory_order_gives_the_same_rows() {
        let wanted = vec![vec![1.0, 2.0, 3.0], vec![4.0, 5.0, 6.0]];
        let c: Vec<u8> = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0].map(f64::to_le_bytes).concat();
        let f: Vec<u8> = [1.0f32, 4.0, 2.0, 5.0, 3.0, 6.0].map(f32::to_be_bytes).concat();
        let i: Vec<u8> = [1i16, 2, 3, 4, 5, 6].map(i16::to_le_bytes).concat();
        let plain = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }\n";
        for major in 1..=3 {
            assert_eq!(rows_of(file(major, plain, &c)).unwrap(), wanted);
        }
        let turned = "{'shape': (2L, 3L), 'fortran_order': True, 'descr': '>f4'}";
        assert_eq!(rows_of(file(1, turned, &f)).unwrap(), wanted);
        let whole = r#"{"descr": "<i2", "fortran_order": False, "shape": (2,3)}"#;
        assert_eq!(rows_of(file(1, whole, &i)).unwrap(), wanted);
    }

    #[test]
    fn rows_are_the_same_across_block_borders() {
        let (rows, columns) = (20_011, 7); // more than one block in either order
        let value = |row: usize, column: usize| (row * columns + column) as f64;
        let c: Vec<u8> = (0..rows * columns)
            .flat_map(|i| value(i / columns, i % columns).to_le_bytes())
            .collect();
        let f: Vec<u8> =
            (0..rows * columns).flat_map(|i| value(i % rows, i / rows).to_le_bytes()).collect();
        for (order, data) in [("False", c), ("True", f)] {
            let text =
                format!("{{'descr': '<f8', 'fortran_order': {order}, 'shape': ({rows}, 7)}}");
            let read = rows_of(file(1, &text, &data)).unwrap();
            assert_eq!(read.len(), rows);
            for (row, numbers) in read.iter().enumerate() {
                assert!(numbers.iter().enumerate().all(|(column, &x)| x == value(row, column)));
            }
        }
    }

    #[test]
    fn a_truncated_file_says_how_many_rows_it_holds() {
        let text = "{'descr': '<f8', 'fortran_order': False, 'shape': (400, 7), }";
        let error = rows_of(file(1, text, &[0; 100 * 56 + 9])).unwrap_err();
        assert!(error.to_string().contains("100 of the 400 rows"), "{error}");
    }

    #[test]
    fn an_absurd_shape_or_header_is_refused_without_being_allocated() {
        let huge = "{'descr': '<f8', 'fortran_order': False, 'shape': (4294967295, 4294967295)}";
        assert!(matches!(rows_of(file(1, huge, &[])), Err(NpyError::TooLarge { .. })));
        let long = "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 7)}";
        assert!(matches!(rows_of(file(1, long, &[])), Err(NpyError::Truncated { .. })));
        let wide = "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 99999999999)}";
        assert!(rows_of(file(1, wide, &[])).unwrap().is_empty());
        let mut header = file(2, "", &[]);
        header[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(rows_of(header).unwrap_err().to_string().contains("4294967295 bytes long"));
    }

    #[test]
    fn objects_records_and_text_are_refused_by_name() {
        for (descr, word) in [("'|O'", "pickle"), ("[('a', '<f8')]", "records"), ("'<U3'", "text")]
        {
            let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (1,)}}");
            let error = rows_of(file(1, &text, &[0; 64])).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        assert!(rows_of(b"1,2,3\n".to_vec()).unwrap_err().to_string().contains("1,2,3"));
    }

    #[test]
    fn a_written_header_reads_back() {
        for shape in [&[][..], &[5], &[400, 7], &[2, 3, 4]] {
            let mut bytes = Vec::new();
            write_header(&mut bytes, "<u4", shape).unwrap();
            assert_eq!(bytes.len() % 64, 0, "numpy aligns the data");
            let header = Header::read(&mut bytes.as_slice()).unwrap();
            assert_eq!(header.number, Number::Unsigned(4));
            assert!(header.shape.iter().map(|&side| side as usize).eq(shape.iter().copied()));
        }
    }

    proptest! {
        #[test]
        fn no_header_text_makes_the_reader_panic(
            text in r"\{?('(descr|shape|fortran_order)': ?('[<>|]?[fiuOc]?[0-9]*'|True|False|\([0-9, ]*\)),? ?){0,5}\}?",
            data in prop::collection::vec(any::<u8>(), 0..200),
        ) {
            let _ = rows_of(file(1, &text, &data));
        }
    }
}
