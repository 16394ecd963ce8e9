//! Lists the files of a folder in natural order (`seq_2` before `seq_10`), and recognises types of
//! files.

use std::cmp::Ordering;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::input;

/// The direct entries of a folder that are not hidden, in natural order.
pub(super) fn listed(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = folder.read_dir()?.map(|entry| Ok(entry?.path()));
    let mut paths = entries.collect::<io::Result<Vec<PathBuf>>>()?;
    let is_hidden = |path: &PathBuf| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
    };
    paths.retain(|path| !is_hidden(path));
    paths.sort_by(|a, b| compare(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(paths)
}

/// Whether a path is a file with one of these extensions, in lower or upper case.
pub(super) fn is_file_with(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| endings.contains(&ending.as_str())) && path.is_file()
}

/// The first bytes of a file, enough to recognise its format.
pub(super) fn beginning(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    input::open(path)?.take(16).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The Parquet files of a folder, or of its folder `data` if there is one, and of the folders one
/// level below.
pub(super) fn parquet_in(path: &Path) -> Vec<PathBuf> {
    let data = path.join("data");
    let listed = |folder: &Path| listed(folder).unwrap_or_default();
    let entries = listed(if data.is_dir() { &data } else { path });
    let below = |entry: PathBuf| if entry.is_dir() { listed(&entry) } else { vec![entry] };
    let is_called_so = |file: &PathBuf| is_file_with(file, &["parquet"]);
    entries.into_iter().flat_map(below).filter(is_called_so).collect()
}

/// Whether a file has the extension or the magic bytes of Parquet.
pub(super) fn is_parquet(path: &Path) -> bool {
    is_file_with(path, &["parquet"])
        || beginning(path).is_ok_and(|bytes| bytes.starts_with(b"PAR1"))
}

/// Natural order: compares digits by the value of their number, everything else by character; if
/// equal, by spelling.
pub(super) fn compare(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a, b);
    loop {
        let (digits_left, digits_right) = (digits(left), digits(right));
        if !digits_left.is_empty() && !digits_right.is_empty() {
            let (x, y) =
                (digits_left.trim_start_matches('0'), digits_right.trim_start_matches('0'));
            match x.len().cmp(&y.len()).then_with(|| x.cmp(y)) {
                Ordering::Equal => {}
                unequal => return unequal,
            }
            left = &left[digits_left.len()..];
            right = &right[digits_right.len()..];
            continue;
        }
        let (mut rest_left, mut rest_right) = (left.chars(), right.chars());
        match (rest_left.next(), rest_right.next()) {
            (Some(x), Some(y)) if x == y => {
                (left, right) = (rest_left.as_str(), rest_right.as_str())
            }
            (None, None) => return a.cmp(b),
            (x, y) => return x.cmp(&y),
        }
    }
}

/// The digits that `text` begins with.
fn digits(text: &str) -> &str {
    &text[..text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn two_comes_before_ten() {
        let mut names =
            vec!["seq_10", "seq_2", "seq_010", "seq_1", "b", "seq_2b", "a10x3", "a9x20"];
        names.sort_by(|a, b| compare(a, b));
        assert_eq!(names, ["a9x20", "a10x3", "b", "seq_1", "seq_2", "seq_2b", "seq_010", "seq_10"]);
    }

    proptest! {
        #[test]
        fn the_order_is_total(a in "[a0-3é]{0,6}", b in "[a0-3é]{0,6}", c in "[a0-3é]{0,6}") {
            prop_assert_eq!(compare(&a, &b), compare(&b, &a).reverse());
            prop_assert_eq!(compare(&a, &b) == Ordering::Equal, a == b);
            if compare(&a, &b).is_le() && compare(&b, &c).is_le() {
                prop_assert!(compare(&a, &c).is_le());
            }
        }
    }
}
