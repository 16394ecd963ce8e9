//! Checks the sizes that a Parquet file declares before the library uses them.
//!
//! Footer and headers of pages are structs of [Thrift's compact protocol]. The library skips unknown
//! fields without checking that their elements fit into the remaining bytes, and it allocates the
//! size that the header of a page declares.
//!
//! [Thrift's compact protocol]: https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom};

/// Deepest nesting of structs, as in the library.
const DEPTH: u32 = 64;
/// Size of the read buffer for the header of a page, bytes.
const HEADER: usize = 512;

/// Field numbers in the header of a page: uncompressed size and compressed size.
const UNPACKED: usize = 2;
const PACKED: usize = 3;

/// Parses the footer only to check it: every element of a list must take at least one byte.
///
/// # Errors
///
/// If the footer is truncated or inconsistent, or the file cannot be read.
pub(super) fn check_footer(file: &mut File) -> io::Result<()> {
    let end = file.seek(SeekFrom::End(0))?;
    let tail = end.checked_sub(8).ok_or(ErrorKind::UnexpectedEof)?;
    file.seek(SeekFrom::Start(tail))?;
    let mut length = [0; 4];
    file.read_exact(&mut length)?;
    let length = u64::from(u32::from_le_bytes(length));
    file.seek(SeekFrom::Start(tail.checked_sub(length).ok_or(ErrorKind::UnexpectedEof)?))?;
    Walker { bytes: BufReader::new(file), left: length }.structure(DEPTH).map(drop)
}

/// Uncompressed size of the largest page of a column, bytes. The column's pages begin at `start` in
/// the file and have `length` bytes in all.
///
/// # Errors
///
/// If a header is inconsistent, or the file cannot be read.
pub(super) fn largest_page(file: &mut File, start: u64, length: u64) -> io::Result<u64> {
    let end = start
        .checked_add(length)
        .ok_or_else(|| broken("a column ends beyond the largest possible file"))?;
    let (mut at, mut largest) = (start, 0);
    while at < end {
        file.seek(SeekFrom::Start(at))?;
        let bytes = BufReader::with_capacity(HEADER, &mut *file);
        let mut header = Walker { bytes, left: end - at };
        let sizes = header.structure(DEPTH)?;
        let [unpacked, packed] = [UNPACKED, PACKED].map(|field| u64::try_from(sizes[field]));
        let (Ok(unpacked), Ok(packed)) = (unpacked, packed) else {
            return Err(broken("a page has a negative size"));
        };
        largest = largest.max(unpacked);
        at = (end - header.left).saturating_add(packed);
    }
    Ok(largest)
}

fn broken(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what.to_owned())
}

/// Parser that skips over Thrift structs and returns only some of their numbers.
struct Walker<R> {
    bytes: R,
    /// Number of bytes that may still be read.
    left: u64,
}

impl<R: Read> Walker<R> {
    /// Skips a struct; returns its fields 0 to 3 where they are 32-bit integers, else 0.
    fn structure(&mut self, depth: u32) -> io::Result<[i64; 4]> {
        let depth = depth.checked_sub(1).ok_or_else(|| broken("structs are nested too deep"))?;
        let (mut numbers, mut field) = ([0; 4], 0_i64);
        loop {
            let head = self.byte()?;
            let (step, kind) = (head >> 4, head & 0x0f);
            if kind == 0 {
                return Ok(numbers);
            }
            field = match step {
                0 => self.integer()?,
                step => field.saturating_add(step.into()),
            };
            match kind {
                1 | 2 => {} // the kind of a flag is its value
                5 => {
                    let number = self.integer()?;
                    let place = usize::try_from(field).ok();
                    if let Some(kept) = place.and_then(|place| numbers.get_mut(place)) {
                        *kept = number;
                    }
                }
                kind => self.value(kind, depth)?,
            }
        }
    }

    /// Skips a value that is not a flag.
    fn value(&mut self, kind: u8, depth: u32) -> io::Result<()> {
        match kind {
            3 => self.skip(1),
            4..=6 => self.varint().map(drop),
            7 => self.skip(8),
            8 => {
                let length = self.varint()?;
                self.skip(length)
            }
            9 | 10 => {
                let head = self.byte()?;
                let count = match head >> 4 {
                    15 => self.varint()?,
                    count => count.into(),
                };
                self.values(count, head & 0x0f, depth)
            }
            11 => match self.varint()? {
                0 => Ok(()),
                count => {
                    let kinds = self.byte()?;
                    (0..count).try_for_each(|_| {
                        self.values(1, kinds >> 4, depth)?;
                        self.values(1, kinds & 0x0f, depth)
                    })
                }
            },
            12 => self.structure(depth).map(drop),
            13 => self.skip(16),
            kind => Err(broken(&format!("a value of the unknown kind {kind}"))),
        }
    }

    /// Skips the elements of a collection. Flags are refused: Parquet has no lists of them, and the
    /// library reads no byte for a flag.
    fn values(&mut self, count: u64, kind: u8, depth: u32) -> io::Result<()> {
        let depth = depth.checked_sub(1).ok_or_else(|| broken("lists are nested too deep"))?;
        if count > 0 && kind <= 2 {
            return Err(broken("a list of flags, which Parquet does not have"));
        }
        (0..count).try_for_each(|_| self.value(kind, depth))
    }

    fn byte(&mut self) -> io::Result<u8> {
        let mut byte = [0];
        self.left = self.left.checked_sub(1).ok_or(ErrorKind::UnexpectedEof)?;
        self.bytes.read_exact(&mut byte)?;
        Ok(byte[0])
    }

    fn varint(&mut self) -> io::Result<u64> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(broken("a number of more than 64 bits"))
    }

    /// A zigzag-encoded integer: its sign is the lowest bit.
    fn integer(&mut self) -> io::Result<i64> {
        let number = self.varint()?;
        Ok((number >> 1) as i64 ^ -((number & 1) as i64))
    }

    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        self.left = self.left.checked_sub(bytes).ok_or(ErrorKind::UnexpectedEof)?;
        let skipped = io::copy(&mut (&mut self.bytes).take(bytes), &mut io::sink())?;
        if skipped < bytes {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::parquet::data_type::DoubleType;
    use ::parquet::file::properties::WriterProperties;
    use ::parquet::file::reader::{FileReader, SerializedFileReader};
    use ::parquet::file::writer::SerializedFileWriter;
    use ::parquet::schema::parser::parse_message_type;
    use std::sync::Arc;

    #[test]
    fn the_largest_page_of_a_column_is_found_among_all() {
        let schema = parse_message_type("message schema { required double x; }").unwrap();
        let properties = WriterProperties::builder()
            .set_dictionary_enabled(false)
            .set_write_batch_size(1)
            .set_data_page_row_count_limit(700)
            .build();
        let mut file = tempfile::tempfile().unwrap();
        let copy = file.try_clone().unwrap();
        let mut writer =
            SerializedFileWriter::new(copy, Arc::new(schema), Arc::new(properties)).unwrap();
        let mut rows = writer.next_row_group().unwrap();
        let mut column = rows.next_column().unwrap().unwrap();
        column.typed::<DoubleType>().write_batch(&[1.5; 1000], None, None).unwrap();
        column.close().unwrap();
        rows.close().unwrap();
        writer.close().unwrap();

        check_footer(&mut file).unwrap();
        let reader = SerializedFileReader::new(file.try_clone().unwrap()).unwrap();
        let (start, length) = reader.metadata().row_group(0).column(0).byte_range();
        assert_eq!(largest_page(&mut file, start, length).unwrap(), 8 * 700);
        largest_page(&mut file, start + 1, length - 1).unwrap_err();
    }

    fn walk(bytes: &[u8]) -> Result<[i64; 4], String> {
        let mut walker = Walker { bytes, left: bytes.len() as u64 };
        walker.structure(DEPTH).map_err(|error| error.to_string())
    }

    #[test]
    fn numbers_are_returned_and_all_else_is_skipped() {
        // 1: 5, 2: 300, 3: -2, a flag, a text, a list of two structs, a map, a double.
        let mut bytes =
            vec![0x15, 10, 0x15, 0xD8, 4, 0x15, 3, 0x11, 0x18, 2, b'h', b'i', 0x19, 0x2C];
        bytes.extend([0x15, 2, 0, 0, 0x1B, 1, 0x85, 0, 7, 0x17]);
        bytes.extend([0; 8]);
        bytes.push(0);
        assert_eq!(walk(&bytes), Ok([0, 5, 300, -2]));
        for cut in 0..bytes.len() {
            walk(&bytes[..cut]).unwrap_err();
        }
    }

    #[test]
    fn a_list_that_claims_more_than_its_bytes_is_refused() {
        let claims = [0xFF, 0xFF, 0xFF, 0xFF, 0x0F];
        for kind in [0xF1, 0xF5, 0xFC, 0xF9] {
            let bytes = [&[0x19, kind][..], &claims, &[0; 20]].concat();
            walk(&bytes).unwrap_err();
        }
        assert!(walk(&[0x19, 0x11, 1, 0]).unwrap_err().contains("list of flags"));
        assert!(walk(&[0x1C; 100]).unwrap_err().contains("too deep"));
        assert!(walk(&[0x19; 200]).unwrap_err().contains("too deep"));
        assert!(walk(&[0x1E, 0]).unwrap_err().contains("kind 14"));
    }
}
