//! The `.npz` format: a zip archive of npy files, as named arrays.
//!
//! `numpy.load` reads the written files without pickle. When reading, memory is allocated for the
//! bytes that are unpacked, never for the size in a header, and all arrays together may take at
//! most [`input::largest`]. Checksums are verified.
//!
//! Members that are not plain arrays of numbers, such as the pickled dictionaries of OpenVSF, are
//! skipped; [`Arrays::skipped`] lists them.

mod arrays;
mod error;

use crate::atomic;
use crate::input;
use crate::npy::{Header, NpyError, write_header};
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::Path;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

use error::MAX_MEMBERS;

pub use arrays::{Array, Arrays, Data};
pub use error::NpzError;

/// Reads all arrays of an npz file.
///
/// # Errors
///
/// If the file is missing, broken or truncated, or its content exceeds [`input::largest`].
pub fn read_npz(path: &Path) -> Result<Arrays, NpzError> {
    let file =
        input::open(path).map_err(|source| NpzError::Io { path: path.to_owned(), source })?;
    read(BufReader::new(file), path)
}

/// Reads all arrays of an archive; `path` is for error messages.
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
        return Err(NpzError::TooMany { path: path.to_owned(), found: archive.len() });
    }
    let mut arrays = Arrays::new();
    path.clone_into(&mut arrays.path);
    let mut room = input::largest();
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(broken)?;
        let file_name = member.name().map_err(broken)?.into_owned();
        let Some(name) = file_name.strip_suffix(".npy") else {
            arrays.skipped.push((file_name, "is not an npy file".to_owned()));
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

/// Reads one array to the end of its member, where the checksum is verified, and subtracts its size
/// from `room`. `None` if it would take more than `room` bytes.
fn read_member(member: &mut impl Read, room: &mut u64) -> Result<Option<Array>, NpyError> {
    let header = Header::read(member)?;
    let promised = header.data_bytes()?;
    let Some(left) = room.checked_sub(promised) else { return Ok(None) };
    *room = left;

    let mut raw = Vec::new(); // grows with the bytes that are read, not by the size in the header
    member.by_ref().take(promised).read_to_end(&mut raw)?;
    if (raw.len() as u64) < promised {
        let bytes = header.number.bytes() as u64;
        let (held, promised) = (raw.len() as u64 / bytes, promised / bytes);
        return Err(NpyError::Truncated { held, promised, unit: "numbers" });
    }
    if member.read(&mut [0])? != 0 {
        let reason = "more numbers follow than its shape has".to_owned();
        return Err(NpyError::Header { reason });
    }
    let sides: Result<Vec<usize>, _> = header.shape.iter().map(|&s| usize::try_from(s)).collect();
    let shape = sides.map_err(|_| header.too_large())?;
    if header.fortran_order {
        raw = c_order(&raw, &shape, header.number.bytes());
    }
    Ok(Some(Array { shape, data: Data::decode(&header, &raw) }))
}

/// Reorders numbers from Fortran order to C order.
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

/// Writes arrays as a compressed npz file, atomically. Equal arrays give equal bytes.
///
/// # Errors
///
/// [`NpzError::Write`]; no partial file is left.
pub fn write_npz(path: &Path, arrays: &Arrays) -> Result<(), NpzError> {
    // Packed in memory first: on a full disk, the library would hide the kind of the error and
    // print to stderr that it could not finish.
    let bytes = npz_bytes(arrays);
    Ok(atomic::write(path, |out| out.write_all(&bytes))?)
}

/// The bytes that [`write_npz`] writes.
pub fn npz_bytes(arrays: &Arrays) -> Vec<u8> {
    let mut bytes = Vec::new();
    pack(&mut bytes, arrays).expect("writing to memory cannot fail");
    bytes
}

/// Reads the arrays of an npz file that is in memory.
///
/// # Errors
///
/// As [`read_npz`]; messages use `name` as the path.
pub fn read_npz_bytes(bytes: &[u8], name: &str) -> Result<Arrays, NpzError> {
    read(io::Cursor::new(bytes), Path::new(name))
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
