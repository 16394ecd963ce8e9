//! Decompresses LZF, the compression of PCD: runs are copied from the input or from earlier output.
//!
//! A control byte `c` below 32 is followed by `c + 1` bytes to copy. Otherwise, its upper three
//! bits are the length minus 2 (if they are 7, the next byte is added), and its lower five bits
//! with the next byte are the distance back to the start of the copy, minus 1. A copy may overlap
//! its own output.

/// Unpacks `packed` into exactly `size` bytes; the error is the end of a message.
///
/// A `size` above 88 times the length of `packed` is impossible and refused before allocation.
pub(super) fn unpack(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    // The densest code: three bytes give 7 + 255 + 2 bytes.
    if size > packed.len().saturating_mul(88) {
        return Err(format!("{} bytes cannot unpack to the promised {size}", packed.len()));
    }
    let cut = || "its compressed bytes end too early".to_owned();
    let mut out: Vec<u8> = Vec::with_capacity(size);
    let mut rest = packed;
    while let [control, tail @ ..] = rest {
        if *control < 32 {
            let (run, tail) = tail.split_at_checked(usize::from(*control) + 1).ok_or_else(cut)?;
            out.extend_from_slice(run);
            rest = tail;
        } else {
            let (length, tail) = match (control >> 5, tail) {
                (7, [more, tail @ ..]) => (9 + usize::from(*more), tail),
                (short, tail) => (2 + usize::from(short), tail),
            };
            let [low, tail @ ..] = tail else { return Err(cut()) };
            let back = (usize::from(control & 31) << 8) + usize::from(*low) + 1;
            let start = out.len().checked_sub(back);
            let start =
                start.ok_or("its compressed bytes refer to a place before their beginning")?;
            for place in start..start + length {
                out.push(out[place]);
            }
            rest = tail;
        }
        if out.len() > size {
            return Err(format!("it unpacks to more than the promised {size} bytes"));
        }
    }
    if out.len() < size {
        return Err(format!("it unpacks to {} of the promised {size} bytes", out.len()));
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn runs_and_copies_unpack() {
        assert_eq!(unpack(&[2, b'a', b'b', b'c'], 3).unwrap(), b"abc");
        // "a", then a copy of 1 + 2 bytes at distance 1, which overlaps its own output.
        assert_eq!(unpack(&[0, b'a', 1 << 5, 0], 4).unwrap(), b"aaaa");
        assert_eq!(unpack(&[0, b'a', 7 << 5, 3, 0], 13).unwrap(), b"aaaaaaaaaaaaa");
    }

    #[test]
    fn inconsistent_bytes_are_refused() {
        assert!(unpack(&[2, b'a'], 3).unwrap_err().contains("end too early"));
        assert!(unpack(&[1 << 5, 0], 3).unwrap_err().contains("before their beginning"));
        assert!(unpack(&[0, b'a'], 2).unwrap_err().contains("1 of the promised 2"));
        assert!(unpack(&[1, b'a', b'b'], 1).unwrap_err().contains("more than"));
        assert!(unpack(&[0; 4], usize::MAX).unwrap_err().contains("cannot unpack"));
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            size in 0usize..2000,
        ) {
            let _ = unpack(&bytes, size);
        }
    }
}
