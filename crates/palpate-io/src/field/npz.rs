//! The `.npz` format: a zip archive of npy files, as named arrays.
//!
//! What is written here `numpy.load` reads without pickle. What is read here is distrusted: an
//! array is as large as the bytes that come out of the archive, never as large as a header claims,
//! and all arrays together stay under [`MAX_BYTES`]. Checksums are verified to the last byte.
//!
//! Members that are no plain array of numbers, such as the pickled dictionaries that OpenVSF adds,
//! are passed over and asked for in vain: see [`Arrays::skipped`].

use crate::atomic::{self, IfExists, WriteError};
use crate::npy::{Header, NpyError, Number, write_header};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::{Path, PathBuf};
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Most bytes that the arrays of one file may take once unpacked.
pub const MAX_BYTES: u64 = 4 << 30;
/// Most members that one archive may have.
const MAX_MEMBERS: usize = 1024;

/// What can be wrong with an npz file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum NpzError {
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// Not a zip archive, or a broken one.
    #[error("`{path}` is not an npz file, or is truncated: {reason}")]
    NotNpz { path: PathBuf, reason: String },
    /// A member that is broken.
    #[error("`{path}`: the array `{name}` {source}")]
    Member { path: PathBuf, name: String, source: NpyError },
    /// More than believed.
    #[error("`{path}` unpacks to more than {MAX_BYTES} bytes or {MAX_MEMBERS} arrays")]
    TooLarge { path: PathBuf },
    /// An array that is asked for is not there.
    #[error("`{path}` holds no array `{name}`: {held}")]
    NoArray { path: PathBuf, name: String, held: String },
    /// An array of another shape or kind than wanted.
    #[error("`{path}`: the array `{name}` is {found}; wanted {wanted}")]
    Array { path: PathBuf, name: String, found: String, wanted: String },
    /// A number that makes no sense.
    #[error("`{path}`: the array `{name}` holds {found} in row {row} (from 0); wanted {wanted}")]
    Value { path: PathBuf, name: String, row: usize, found: f64, wanted: &'static str },
    /// It could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// The numbers of an array in C order.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs)] // the variants are their types
pub enum Data {
    F64(Vec<f64>),
    F32(Vec<f32>),
    I64(Vec<i64>),
    U64(Vec<u64>),
    U32(Vec<u32>),
    U8(Vec<u8>),
}

/// Numbers and the sides of the box they fill.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    shape: Vec<usize>,
    data: Data,
}

/// Named arrays in the order of the file.
#[derive(Debug, Clone, Default)]
pub struct Arrays {
    path: PathBuf,
    entries: Vec<(String, Array)>,
    skipped: Vec<(String, String)>,
}

impl Data {
    /// How many numbers there are.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::F64(numbers) => numbers.len(),
            Self::F32(numbers) => numbers.len(),
            Self::I64(numbers) => numbers.len(),
            Self::U64(numbers) => numbers.len(),
            Self::U32(numbers) => numbers.len(),
            Self::U8(numbers) => numbers.len(),
        }
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// numpy's `dtype.str`.
    fn descr(&self) -> &'static str {
        match self {
            Self::F64(_) => "<f8",
            Self::F32(_) => "<f4",
            Self::I64(_) => "<i8",
            Self::U64(_) => "<u8",
            Self::U32(_) => "<u4",
            Self::U8(_) => "|u1",
        }
    }

    fn write(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::F64(numbers) => put(out, numbers, f64::to_le_bytes),
            Self::F32(numbers) => put(out, numbers, f32::to_le_bytes),
            Self::I64(numbers) => put(out, numbers, i64::to_le_bytes),
            Self::U64(numbers) => put(out, numbers, u64::to_le_bytes),
            Self::U32(numbers) => put(out, numbers, u32::to_le_bytes),
            Self::U8(numbers) => out.write_all(numbers),
        }
    }

    /// The numbers in `raw`, in its own order; narrow integers are widened.
    fn decode(raw: Vec<u8>, number: Number, big_endian: bool) -> Self {
        let raw = if big_endian { swapped(raw, number.bytes()) } else { raw };
        match number {
            Number::F64 => Self::F64(get(&raw, f64::from_le_bytes)),
            Number::F32 => Self::F32(get(&raw, f32::from_le_bytes)),
            Number::I64 => Self::I64(get(&raw, i64::from_le_bytes)),
            Number::I32 => Self::I64(get(&raw, |bytes| i32::from_le_bytes(bytes).into())),
            Number::I16 => Self::I64(get(&raw, |bytes| i16::from_le_bytes(bytes).into())),
            Number::I8 => Self::I64(get(&raw, |bytes| i8::from_le_bytes(bytes).into())),
            Number::U64 => Self::U64(get(&raw, u64::from_le_bytes)),
            Number::U32 => Self::U32(get(&raw, u32::from_le_bytes)),
            Number::U16 => Self::U32(get(&raw, |bytes| u16::from_le_bytes(bytes).into())),
            Number::U8 => Self::U8(raw),
        }
    }
}

/// Writes numbers by way of a small buffer.
fn put<T: Copy, const N: usize>(
    out: &mut impl Write,
    numbers: &[T],
    to_bytes: fn(T) -> [u8; N],
) -> io::Result<()> {
    let mut block = Vec::with_capacity(4096 * N);
    for chunk in numbers.chunks(4096) {
        block.clear();
        chunk.iter().for_each(|&number| block.extend(to_bytes(number)));
        out.write_all(&block)?;
    }
    Ok(())
}

fn get<T, const N: usize>(raw: &[u8], from_bytes: fn([u8; N]) -> T) -> Vec<T> {
    raw.as_chunks::<N>().0.iter().map(|&bytes| from_bytes(bytes)).collect()
}

fn swapped(mut raw: Vec<u8>, bytes: usize) -> Vec<u8> {
    raw.chunks_exact_mut(bytes).for_each(<[u8]>::reverse);
    raw
}

/// Moves numbers from Fortran order to C order.
fn c_order(raw: &[u8], shape: &[usize], bytes: usize) -> Vec<u8> {
    let mut moved = Vec::with_capacity(raw.len());
    for c_place in 0..raw.len() / bytes {
        let (mut rest, mut fortran_place) = (c_place, 0);
        let mut stride = raw.len() / bytes;
        for &side in shape.iter().rev() {
            stride /= side;
            fortran_place += rest % side * stride;
            rest /= side;
        }
        moved.extend(&raw[fortran_place * bytes..(fortran_place + 1) * bytes]);
    }
    moved
}

impl Array {
    /// Numbers in C order and the sides of the box they fill.
    ///
    /// # Panics
    ///
    /// If the sides do not multiply to the number of numbers.
    #[must_use]
    pub fn new(shape: Vec<usize>, data: Data) -> Self {
        assert_eq!(shape.iter().product::<usize>(), data.len(), "the shape must fit the numbers");
        Self { shape, data }
    }

    /// Numbers in a row.
    #[must_use]
    pub fn flat(data: Data) -> Self {
        Self { shape: vec![data.len()], data }
    }

    /// Text as its UTF-8 bytes, since numpy reads objects only through pickle.
    #[must_use]
    pub fn text(text: &str) -> Self {
        Self::flat(Data::U8(text.as_bytes().to_vec()))
    }

    /// The sides.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The numbers in C order.
    #[must_use]
    pub fn data(&self) -> &Data {
        &self.data
    }

    fn describe(&self) -> String {
        format!("{} of {:?}", &self.data.descr()[1..], self.shape)
    }

    /// Whether the sides are those wanted, `None` standing for any.
    fn fits(&self, wanted: &[Option<usize>]) -> bool {
        self.shape.len() == wanted.len()
            && self.shape.iter().zip(wanted).all(|(&side, want)| want.is_none_or(|w| w == side))
    }
}

impl Arrays {
    /// No arrays.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an array, or puts it in the place of the one of that name.
    pub fn insert(&mut self, name: impl Into<String>, array: Array) {
        let name = name.into();
        match self.entries.iter_mut().find(|(held, _)| *held == name) {
            Some((_, held)) => *held = array,
            None => self.entries.push((name, array)),
        }
    }

    /// The array of that name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Array> {
        self.entries.iter().find(|(held, _)| held == name).map(|(_, array)| array)
    }

    /// Names and arrays in the order of the file.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Array)> {
        self.entries.iter().map(|(name, array)| (name.as_str(), array))
    }

    /// Members of the file that are no arrays of numbers, and why.
    #[must_use]
    pub fn skipped(&self) -> &[(String, String)] {
        &self.skipped
    }

    /// The file they came from; empty for arrays made in memory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The array of that name, or an error that says what there is instead.
    ///
    /// # Errors
    ///
    /// [`NpzError::NoArray`].
    pub fn require(&self, name: &str) -> Result<&Array, NpzError> {
        self.get(name).ok_or_else(|| {
            let held = match self.skipped.iter().find(|(skipped, _)| skipped == name) {
                Some((_, reason)) => format!("the member of that name {reason}"),
                None => format!("it holds {}", self.names()),
            };
            NpzError::NoArray { path: self.path.clone(), name: name.to_owned(), held }
        })
    }

    /// Finite floats of a wanted shape (`None`: any length), as `f64`.
    ///
    /// # Errors
    ///
    /// If the array is missing, of integers, of another shape, or holds a number that is not finite.
    pub fn floats(&self, name: &str, shape: &[Option<usize>]) -> Result<Vec<f64>, NpzError> {
        let array = self.require(name)?;
        let floats = match &array.data {
            Data::F64(numbers) => numbers.clone(),
            Data::F32(numbers) => numbers.iter().copied().map(f64::from).collect(),
            _ => return Err(self.misfit(name, array, "floats", shape)),
        };
        if !array.fits(shape) {
            return Err(self.misfit(name, array, "floats", shape));
        }
        self.check(name, &floats, "finite numbers", |number| number.is_finite())?;
        Ok(floats)
    }

    /// Non-negative integers of a wanted shape (`None`: any length), whatever their width.
    ///
    /// # Errors
    ///
    /// If the array is missing, of floats, of another shape, or holds a negative number.
    pub fn counts(&self, name: &str, shape: &[Option<usize>]) -> Result<Vec<u64>, NpzError> {
        let array = self.require(name)?;
        if !array.fits(shape) {
            return Err(self.misfit(name, array, "integers", shape));
        }
        let negative = |row: usize, found: i64| {
            let wanted = "numbers from 0 on";
            let (path, name) = (self.path.clone(), name.to_owned());
            NpzError::Value { path, name, row, found: found as f64, wanted }
        };
        match &array.data {
            Data::U64(numbers) => Ok(numbers.clone()),
            Data::U32(numbers) => Ok(numbers.iter().copied().map(u64::from).collect()),
            Data::U8(numbers) => Ok(numbers.iter().copied().map(u64::from).collect()),
            Data::I64(numbers) => (numbers.iter().enumerate())
                .map(|(row, &number)| u64::try_from(number).map_err(|_| negative(row, number)))
                .collect(),
            _ => Err(self.misfit(name, array, "integers", shape)),
        }
    }

    /// Text that [`Array::text`] stored.
    ///
    /// # Errors
    ///
    /// If the array is missing or is no text.
    pub fn text(&self, name: &str) -> Result<String, NpzError> {
        let array = self.require(name)?;
        let text = match &array.data {
            Data::U8(bytes) => String::from_utf8(bytes.clone()).ok(),
            _ => None,
        };
        text.ok_or_else(|| self.misfit(name, array, "the bytes of a text", &[None]))
    }

    /// An error unless all numbers are as wanted.
    pub(super) fn check(
        &self,
        name: &str,
        numbers: &[f64],
        wanted: &'static str,
        is_good: impl Fn(f64) -> bool,
    ) -> Result<(), NpzError> {
        let Some(place) = numbers.iter().position(|&number| !is_good(number)) else {
            return Ok(());
        };
        let columns = self.get(name).map_or(1, |array| array.shape.iter().skip(1).product());
        let (path, name) = (self.path.clone(), name.to_owned());
        let row = place / columns.max(1);
        Err(NpzError::Value { path, name, row, found: numbers[place], wanted })
    }

    fn misfit(&self, name: &str, array: &Array, what: &str, shape: &[Option<usize>]) -> NpzError {
        let sides: Vec<String> = (shape.iter())
            .map(|side| side.map_or_else(|| "N".to_owned(), |side| side.to_string()))
            .collect();
        let wanted = format!("{what} of [{}]", sides.join(", "));
        let (path, name) = (self.path.clone(), name.to_owned());
        NpzError::Array { path, name, found: array.describe(), wanted }
    }

    fn names(&self) -> String {
        if self.entries.is_empty() {
            return "no array at all".to_owned();
        }
        let names: Vec<&str> = self.entries.iter().map(|(name, _)| name.as_str()).collect();
        names.join(", ")
    }
}

/// Reads all arrays of an npz file.
///
/// # Errors
///
/// If the file is missing, broken, truncated or unpacks to more than [`MAX_BYTES`].
pub fn read_npz(path: &Path) -> Result<Arrays, NpzError> {
    let file = File::open(path).map_err(|source| NpzError::Io { path: path.to_owned(), source })?;
    read(BufReader::new(file), path)
}

/// Reads all arrays of an archive; `path` is for the errors.
fn read(input: impl Read + Seek, path: &Path) -> Result<Arrays, NpzError> {
    let broken = |error: ZipError| match error {
        ZipError::Io(source) if source.kind() == io::ErrorKind::IsADirectory => {
            NpzError::Io { path: path.to_owned(), source }
        }
        error => NpzError::NotNpz { path: path.to_owned(), reason: error.to_string() },
    };
    let too_large = || NpzError::TooLarge { path: path.to_owned() };
    let mut archive = ZipArchive::new(input).map_err(broken)?;
    if archive.len() > MAX_MEMBERS {
        return Err(too_large());
    }
    let mut arrays = Arrays { path: path.to_owned(), ..Arrays::default() };
    let mut room = MAX_BYTES;
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(broken)?;
        let file_name = member.name().map_err(broken)?.into_owned();
        let Some(name) = file_name.strip_suffix(".npy") else {
            arrays.skipped.push((file_name, "is no npy file".to_owned()));
            continue;
        };
        match read_member(&mut member, &mut room) {
            Ok(Some(array)) => arrays.insert(name, array),
            Ok(None) => return Err(too_large()),
            Err(error @ NpyError::Dtype { .. }) => {
                arrays.skipped.push((name.to_owned(), error.to_string()));
            }
            Err(source) => {
                let name = name.to_owned();
                return Err(NpzError::Member { path: path.to_owned(), name, source });
            }
        }
    }
    Ok(arrays)
}

/// Reads one array to the end of its member, where the checksum is compared. `None` if it would
/// take more than `room` bytes.
fn read_member(member: &mut impl Read, room: &mut u64) -> Result<Option<Array>, NpyError> {
    let header = Header::read(member)?;
    let promised = header.data_bytes()?;
    let Some(left) = room.checked_sub(promised) else { return Ok(None) };
    *room = left;

    let mut raw = Vec::new(); // grows with what comes, not with what is promised
    member.by_ref().take(promised).read_to_end(&mut raw)?;
    if (raw.len() as u64) < promised {
        let bytes = header.number.bytes() as u64;
        let (held, promised) = (raw.len() as u64 / bytes, promised / bytes);
        return Err(NpyError::Truncated { held, promised, unit: "numbers" });
    }
    if member.read(&mut [0])? != 0 {
        let reason = "more numbers follow than its shape tells".to_owned();
        return Err(NpyError::Header { reason });
    }
    let sides: Result<Vec<usize>, _> = header.shape.iter().map(|&s| usize::try_from(s)).collect();
    let shape = sides.map_err(|_| NpyError::TooLarge { shape: header.shape.clone() })?;
    if header.fortran_order {
        raw = c_order(&raw, &shape, header.number.bytes());
    }
    Ok(Some(Array { shape, data: Data::decode(raw, header.number, header.big_endian) }))
}

/// Writes arrays as a compressed npz file, whole or not at all. The same arrays give the same
/// bytes.
///
/// # Errors
///
/// [`NpzError::Write`]; nothing is left behind.
pub fn write_npz(path: &Path, arrays: &Arrays, if_exists: IfExists) -> Result<(), NpzError> {
    atomic::write(path, if_exists, |out| {
        let mut out = FirstError { out, error: None };
        let packed = pack(&mut out, arrays);
        match out.error {
            Some(error) => Err(error),
            None => packed.map_err(io::Error::from),
        }
    })?;
    Ok(())
}

/// Writes the archive.
fn pack(out: impl Write, arrays: &Arrays) -> Result<(), ZipError> {
    let mut zip = ZipWriter::new_stream(out);
    for (name, array) in arrays.iter() {
        let bytes = array.data.len() as u64 * 8;
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .large_file(bytes > u64::from(u32::MAX) / 2);
        zip.start_file(format!("{name}.npy"), options)?;
        write_header(&mut zip, array.data.descr(), &array.shape)?;
        array.data.write(&mut zip)?;
    }
    zip.finish()?;
    Ok(())
}

/// Keeps the first error to itself and swallows what follows.
///
/// [`ZipWriter`] would lose the kind of the error and, when dropped, print to stderr that it could
/// not finish.
struct FirstError<W> {
    out: W,
    error: Option<io::Error>,
}

impl<W: Write> Write for FirstError<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.error.is_none() {
            self.error = self.out.write_all(bytes).err();
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.error.is_none() {
            self.error = self.out.flush().err();
        }
        Ok(())
    }
}
