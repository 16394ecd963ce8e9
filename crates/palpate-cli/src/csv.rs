//! Tables as CSV.

use crate::output::visible;

/// Rows as CSV, the head first; names may contain commas, quotes and line breaks. A name that a
/// spreadsheet would read as a formula gets an apostrophe, which makes it a text there; control
/// characters are escaped as in JSON.
pub(crate) fn text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
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
}
