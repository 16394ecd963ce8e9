//! LZF, in which PCD packs its bytes: runs copied from the input, or from what was written before.
//!
//! A control byte below 32 is followed by that many bytes and one more, to be copied. Above, its
//! upper three bits are a length less two (seven: one more byte is added), its lower five with the
//! next byte how far back the copy begins, less one; a copy may run into what it writes.

/// Unpacks `packed` into exactly `size` bytes; an error is half a sentence.
///
/// At least 1 byte in 88 of what comes out must have come in, so that no false `size` is allocated.
pub(super) fn unpack(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    // The densest code: three bytes that stand for 7 + 255 + 2 bytes.
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
            let start = start.ok_or("its compressed bytes refer to before their beginning")?;
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
        // "a", then 1 + 2 bytes from one back: a copy that runs into itself.
        assert_eq!(unpack(&[0, b'a', 1 << 5, 0], 4).unwrap(), b"aaaa");
        assert_eq!(unpack(&[0, b'a', 7 << 5, 3, 0], 13).unwrap(), b"aaaaaaaaaaaaa");
    }

    #[test]
    fn what_does_not_add_up_is_refused() {
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
