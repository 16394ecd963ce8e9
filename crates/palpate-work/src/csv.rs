//! Tables as CSV, whose names cannot do harm.

use std::borrow::Cow;

/// Rows as CSV, the head first; names may contain commas, quotes and line breaks. A name that a
/// spreadsheet would read as a formula gets an apostrophe, which makes it a text there; control
/// characters are escaped as in JSON.
pub fn text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let quoted = |cell: &String| {
        let is_formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r']);
        let is_number = cell.parse::<f64>().is_ok();
        let cell = visible(cell);
        let cell = if is_formula && !is_number { format!("'{cell}") } else { cell.into_owned() };
        match cell.contains([',', '"', '\n']) {
            true => format!("\"{}\"", cell.replace('"', "\"\"")),
            false => cell,
        }
    };
    let line = |row: Vec<String>| row.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n";
    rows.into_iter().map(line).collect()
}

/// A text with its control characters escaped: names in files must not control the terminal.
/// They are escaped as in JSON strings, so that JSON keeps its meaning.
pub fn visible(text: &str) -> Cow<'_, str> {
    // Control characters, and those that change the direction of writing.
    let obeyed = |c: char| {
        c.is_control() && c != '\n' && c != '\t'
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    if !text.contains(obeyed) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| {
        if obeyed(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() }
    };
    Cow::Owned(text.chars().map(shown).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_names_read_back_but_for_controls_and_the_apostrophe_of_formulas(
            rows in prop::collection::vec(prop::array::uniform2(".{0,8}|[-=+@,\"\n\r\t\u{0}\u{1b}1e]{1,6}"), 1..6),
        ) {
            let head = ["name", "other"].map(str::to_owned);
            let written = text([&head].into_iter().chain(&rows).map(|row| row.to_vec()));
            let mut reader = csv::Reader::from_reader(written.as_bytes());
            let read: Vec<_> = reader.records().map(Result::unwrap).collect();
            prop_assert_eq!(read.len(), rows.len());
            for (read, row) in read.iter().zip(&rows) {
                prop_assert_eq!(read.len(), row.len());
                for (read, cell) in read.iter().zip(row) {
                    let cell = visible(cell);
                    prop_assert!(read == cell || read.strip_prefix('\'') == Some(&*cell));
                }
            }
        }
    }

    #[test]
    fn no_name_is_a_formula_and_numbers_stay() {
        let cells = ["=1+1", "@SUM(1)", "+A", "-1.5", "1e3", "-"].map(str::to_owned);
        assert_eq!(text([cells.to_vec()]), "'=1+1,'@SUM(1),'+A,-1.5,1e3,'-\n");
    }

    #[test]
    fn no_name_breaks_its_row() {
        let names = ["a,b", "say \"x\"", "one\ntwo", "one\r\u{1b}two"].map(str::to_owned);
        let wanted = "\"a,b\",\"say \"\"x\"\"\",\"one\ntwo\",one\\u000d\\u001btwo\n";
        assert_eq!(text([names.to_vec()]), wanted);
    }

    #[test]
    fn control_characters_are_escaped_and_json_keeps_its_meaning() {
        let name = "a\u{1b}[31m\u{9b}2J\r\u{202e}gnp.exe";
        assert_eq!(visible(name), "a\\u001b[31m\\u009b2J\\u000d\\u202egnp.exe");
        let json = serde_json::to_string(name).unwrap();
        assert_eq!(serde_json::from_str::<String>(&visible(&json)).unwrap(), name);
        assert!(matches!(visible("µ, λ\tand\n"), Cow::Borrowed(_)));
    }
}
