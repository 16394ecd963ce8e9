//! Named arrays of an npz file, and checks of their types, shapes and numbers.

use super::error::NpzError;
use crate::npy::{Header, Number, signed};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

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

/// Numbers with their shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    pub(super) shape: Vec<usize>,
    pub(super) data: Data,
}

/// Named arrays in the order of the file.
#[derive(Debug, Clone, Default)]
pub struct Arrays {
    pub(super) path: PathBuf,
    entries: Vec<(String, Array)>,
    pub(super) skipped: Vec<(String, String)>,
}

impl Data {
    /// numpy's `dtype.str`, and the number of elements.
    fn kind_and_len(&self) -> (&'static str, usize) {
        match self {
            Self::F64(numbers) => ("<f8", numbers.len()),
            Self::F32(numbers) => ("<f4", numbers.len()),
            Self::I64(numbers) => ("<i8", numbers.len()),
            Self::U64(numbers) => ("<u8", numbers.len()),
            Self::U32(numbers) => ("<u4", numbers.len()),
            Self::U8(numbers) => ("|u1", numbers.len()),
        }
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.kind_and_len().1
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// numpy's `dtype.str`.
    pub(super) fn descr(&self) -> &'static str {
        self.kind_and_len().0
    }

    /// Writes the numbers as little-endian bytes.
    pub(super) fn write(&self, out: &mut impl Write) -> io::Result<()> {
        match self {
            Self::F64(numbers) => write_blocks(out, numbers, f64::to_le_bytes),
            Self::F32(numbers) => write_blocks(out, numbers, f32::to_le_bytes),
            Self::I64(numbers) => write_blocks(out, numbers, i64::to_le_bytes),
            Self::U64(numbers) => write_blocks(out, numbers, u64::to_le_bytes),
            Self::U32(numbers) => write_blocks(out, numbers, u32::to_le_bytes),
            Self::U8(numbers) => out.write_all(numbers),
        }
    }

    /// Decodes `raw` by the header; signed integers become 64-bit, unsigned ones of 16 bits become 32-bit.
    pub(super) fn decode(header: &Header, raw: &[u8]) -> Self {
        let words = header.words(raw).map(u64::from_le_bytes);
        match header.number {
            Number::Float(4) => Self::F32(words.map(|word| f32::from_bits(word as u32)).collect()),
            Number::Float(_) => Self::F64(words.map(f64::from_bits).collect()),
            Number::Signed(bytes) => {
                Self::I64(header.words(raw).map(|word| signed(word, bytes)).collect())
            }
            Number::Unsigned(8) => Self::U64(words.collect()),
            Number::Unsigned(1) => Self::U8(raw.to_vec()),
            Number::Unsigned(_) => Self::U32(words.map(|word| word as u32).collect()),
        }
    }
}

/// Writes numbers block by block.
fn write_blocks<T: Copy, const BYTES: usize>(
    out: &mut impl Write,
    numbers: &[T],
    bytes: fn(T) -> [u8; BYTES],
) -> io::Result<()> {
    numbers.chunks(4096).try_for_each(|block| {
        let block: Vec<u8> = block.iter().copied().flat_map(bytes).collect();
        out.write_all(&block)
    })
}

impl Array {
    /// An array from its shape and its numbers in C order.
    ///
    /// # Panics
    ///
    /// If the product of the shape is not the number of elements.
    #[must_use]
    pub fn new(shape: Vec<usize>, data: Data) -> Self {
        assert_eq!(
            shape.iter().product::<usize>(),
            data.len(),
            "the shape must match the number of elements"
        );
        Self { shape, data }
    }

    /// A one-dimensional array.
    #[must_use]
    pub fn flat(data: Data) -> Self {
        Self { shape: vec![data.len()], data }
    }

    /// Text as an array of its UTF-8 bytes, since numpy reads objects only through pickle.
    #[must_use]
    pub fn text(text: &str) -> Self {
        Self::flat(Data::U8(text.as_bytes().to_vec()))
    }

    /// The shape.
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
        format!("{} of shape {:?}", &self.data.descr()[1..], self.shape)
    }

    /// Whether the shape is the wanted one, in which `None` is any length.
    fn fits(&self, wanted: &[Option<usize>]) -> bool {
        self.shape.len() == wanted.len()
            && self.shape.iter().zip(wanted).all(|(&side, want)| want.is_none_or(|w| w == side))
    }
}

impl Arrays {
    /// An empty collection.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an array, or replaces the array with the same name.
    pub fn insert(&mut self, name: impl Into<String>, array: Array) {
        let name = name.into();
        match self.entries.iter_mut().find(|(held, _)| *held == name) {
            Some((_, held)) => *held = array,
            None => self.entries.push((name, array)),
        }
    }

    /// The array with this name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Array> {
        self.entries.iter().find(|(held, _)| held == name).map(|(_, array)| array)
    }

    /// Names and arrays in the order of the file.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Array)> {
        self.entries.iter().map(|(name, array)| (name.as_str(), array))
    }

    /// Names of the members that are not arrays of numbers, with the reason.
    #[must_use]
    pub fn skipped(&self) -> &[(String, String)] {
        &self.skipped
    }

    /// The file that was read; empty for arrays created in memory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The array with this name, or an error that lists the existing arrays.
    ///
    /// # Errors
    ///
    /// [`NpzError::NoArray`].
    pub fn require(&self, name: &str) -> Result<&Array, NpzError> {
        self.get(name).ok_or_else(|| {
            let held = match self.skipped.iter().find(|(skipped, _)| skipped == name) {
                Some((_, reason)) => format!("the member of that name {reason}"),
                None if self.entries.is_empty() => "it holds no array at all".to_owned(),
                None => {
                    let names: Vec<&str> = self.iter().map(|(name, _)| name).collect();
                    format!("it holds {}", names.join(", "))
                }
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
            Data::F64(numbers) if array.fits(shape) => numbers.clone(),
            Data::F32(numbers) if array.fits(shape) => {
                numbers.iter().copied().map(f64::from).collect()
            }
            _ => return Err(self.misfit(name, array, "floats", shape)),
        };
        self.check(name, &floats, "finite numbers", |number| number.is_finite())?;
        Ok(floats)
    }

    /// Non-negative integers of a wanted shape (`None`: any length), of any width.
    ///
    /// # Errors
    ///
    /// If the array is missing, of floats, of another shape, or holds a negative number.
    pub fn counts(&self, name: &str, shape: &[Option<usize>]) -> Result<Vec<u64>, NpzError> {
        let array = self.require(name)?;
        if !array.fits(shape) {
            return Err(self.misfit(name, array, "integers", shape));
        }
        let negative =
            |place: usize, found: i64| self.refused(name, place, found as f64, "numbers from 0 on");
        match &array.data {
            Data::U64(numbers) => Ok(numbers.clone()),
            Data::U32(numbers) => Ok(numbers.iter().copied().map(u64::from).collect()),
            Data::U8(numbers) => Ok(numbers.iter().copied().map(u64::from).collect()),
            Data::I64(numbers) => (numbers.iter().enumerate())
                .map(|(place, &number)| u64::try_from(number).map_err(|_| negative(place, number)))
                .collect(),
            _ => Err(self.misfit(name, array, "integers", shape)),
        }
    }

    /// As [`Self::counts`], for numbers that fit in 32 bits.
    pub(in crate::field) fn small_counts(
        &self,
        name: &str,
        shape: &[Option<usize>],
    ) -> Result<Vec<u32>, NpzError> {
        let wanted = "numbers below 4,294,967,296";
        let small = |(place, number): (usize, u64)| {
            u32::try_from(number).map_err(|_| self.refused(name, place, number as f64, wanted))
        };
        self.counts(name, shape)?.into_iter().enumerate().map(small).collect()
    }

    /// Text that [`Array::text`] stored.
    ///
    /// # Errors
    ///
    /// If the array is missing or is not a text.
    pub fn text(&self, name: &str) -> Result<String, NpzError> {
        let array = self.require(name)?;
        let text = match &array.data {
            Data::U8(bytes) => String::from_utf8(bytes.clone()).ok(),
            _ => None,
        };
        text.ok_or_else(|| self.misfit(name, array, "the bytes of a text", &[None]))
    }

    /// Returns an error for the first number for which `is_good` is false.
    pub(in crate::field) fn check(
        &self,
        name: &str,
        numbers: &[f64],
        wanted: &'static str,
        is_good: impl Fn(f64) -> bool,
    ) -> Result<(), NpzError> {
        match numbers.iter().position(|&number| !is_good(number)) {
            Some(place) => Err(self.refused(name, place, numbers[place], wanted)),
            None => Ok(()),
        }
    }

    /// The error for an invalid number (`found`) at the index `place` of an array.
    pub(in crate::field) fn refused(
        &self,
        name: &str,
        place: usize,
        found: f64,
        wanted: &'static str,
    ) -> NpzError {
        let columns = self.get(name).map_or(1, |array| array.shape.iter().skip(1).product());
        let row = place / columns.max(1);
        NpzError::Value { path: self.path.clone(), name: name.to_owned(), row, found, wanted }
    }

    fn misfit(&self, name: &str, array: &Array, what: &str, shape: &[Option<usize>]) -> NpzError {
        let sides: Vec<String> = (shape.iter())
            .map(|side| side.map_or_else(|| "N".to_owned(), |side| side.to_string()))
            .collect();
        let wanted = format!("{what} of shape [{}]", sides.join(", "));
        let (path, name) = (self.path.clone(), name.to_owned());
        NpzError::Array { path, name, found: array.describe(), wanted }
    }
}
