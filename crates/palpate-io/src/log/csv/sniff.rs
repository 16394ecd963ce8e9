//! Detects the delimiter, the comment character and the header of a table from its first lines.

use std::io::{self, BufRead};

/// Largest length of a line, bytes; a file with a longer one is refused.
pub(super) const MAX_LINE_BYTES: u64 = 1 << 20;

/// Delimiter, comment character and header of a table.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Dialect {
    pub(super) delimiter: u8,
    /// First character of comment lines.
    pub(super) comment: u8,
    /// The header, if it is in a comment, as written by `numpy.savetxt`, `rostopic echo -p` and KUKA's recorder.
    pub(super) commented_header: Option<String>,
}

/// Reads up to the first line that is not a comment. The inner error is the end of a message to the user.
pub(super) fn sniff(mut input: impl BufRead) -> io::Result<Result<Dialect, &'static str>> {
    let mut comment: Option<(u8, String)> = None;
    loop {
        let mut line = Vec::new();
        let read = io::Read::take(&mut input, MAX_LINE_BYTES).read_until(b'\n', &mut line)?;
        if line.starts_with(b"\xff\xfe") || line.starts_with(b"\xfe\xff") {
            return Ok(Err("is UTF-16; save it as UTF-8"));
        }
        if read == 0 {
            return Ok(Err("holds no header"));
        }
        if line.contains(&0) || read as u64 == MAX_LINE_BYTES {
            return Ok(Err("is not a text table"));
        }
        let text = String::from_utf8_lossy(&line);
        let text = text.trim_start_matches('\u{feff}').trim();
        if let Some(rest) = text.strip_prefix(['#', '%']) {
            comment = Some((text.as_bytes()[0], rest.trim().to_owned()));
        } else if !text.is_empty() {
            let delimiter = delimiter(text);
            let mark = comment.as_ref().map_or(b'#', |(mark, _)| *mark);
            let is_header = |(mark, comment): &(u8, String)| {
                (*mark == b'%' || is_numeric(text, delimiter))
                    && count(comment, delimiter) == count(text, delimiter)
            };
            let commented_header = comment.filter(is_header).map(|(_, header)| header);
            return Ok(Ok(Dialect { delimiter, comment: mark, commented_header }));
        }
    }
}

/// The most frequent of comma, semicolon and tab in a line; without any of them a blank, as written by Universal
/// Robots' RTDE and `numpy.savetxt`; without a blank a comma.
fn delimiter(line: &str) -> u8 {
    let mut best = b',';
    for candidate in [b';', b'\t'] {
        if count(line, candidate) > count(line, best) {
            best = candidate;
        }
    }
    if count(line, best) == 0 && count(line, b' ') > 0 { b' ' } else { best }
}

/// Number of delimiters outside quotes; several blanks in a row count as one.
fn count(line: &str, delimiter: u8) -> usize {
    let (mut quoted, mut last) = (false, 0);
    let bare = line.bytes().filter(|&byte| {
        quoted ^= byte == b'"';
        let is_first = byte != b' ' || last != b' ';
        last = byte;
        byte == delimiter && !quoted && is_first
    });
    bare.count()
}

fn is_numeric(line: &str, delimiter: u8) -> bool {
    let cells = line.split(char::from(delimiter)).map(str::trim);
    cells
        .filter(|cell| delimiter != b' ' || !cell.is_empty())
        .all(|cell| cell.parse::<f64>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_delimiter_is_found_outside_quotes_and_after_comments() {
        for (text, delimiter) in [
            ("t,q1,tau1\n", b','),
            ("# made; by; us; all\n\nt;q1;tau1\n", b';'),
            ("\u{feff}t\tq1\ttau1\r\n", b'\t'),
            ("\"a;b;c;d\",q1,tau1", b','),
            ("t q1 tau1", b' '),
            ("# by savetxt\nt\tjoint 1", b'\t'),
            ("alone", b','),
        ] {
            let dialect = sniff(text.as_bytes()).unwrap().unwrap();
            let wanted = Dialect { delimiter, comment: b'#', commented_header: None };
            assert_eq!(dialect, wanted, "{text:?}");
        }
    }

    #[test]
    fn a_header_in_a_comment_is_taken_if_numbers_follow() {
        let dialect = sniff(&b"# run 3\n# q1,tau1\n1.0,2.0\n"[..]).unwrap().unwrap();
        assert_eq!(dialect.commented_header.as_deref(), Some("q1,tau1"));
        let dialect = sniff(&b"# q1 tau1\n1.0 2.0\n"[..]).unwrap().unwrap();
        assert_eq!(dialect.commented_header.as_deref(), Some("q1 tau1"));
        for text in ["%time,q1,name\n1,2,three\n", "%  time   q1  name\n 1.0  2.0    three\n"] {
            let dialect = sniff(text.as_bytes()).unwrap().unwrap();
            assert_eq!(dialect.comment, b'%', "{text:?}");
            assert!(dialect.commented_header.unwrap().starts_with("time"), "{text:?}");
        }
        let dialect = sniff(&b"% of today\nq1,tau1\n1,2\n"[..]).unwrap().unwrap();
        assert_eq!(dialect.commented_header, None);
    }

    #[test]
    fn a_file_that_is_not_a_table_is_refused() {
        for bytes in [&b""[..], b"# only\n", b"\xff\xfet\0", b"\x93NUMPY\0", &[b'a'; 1 << 20]] {
            assert!(sniff(bytes).unwrap().is_err());
        }
    }
}
