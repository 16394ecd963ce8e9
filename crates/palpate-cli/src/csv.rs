//! Tables for programs.

/// Rows as CSV, the head first; names may hold commas, quotes and line breaks. A name that a
/// spreadsheet would take for a formula gets an apostrophe, which makes it a text there.
pub(crate) fn text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let quoted = |cell: &String| {
        let is_formula = cell.starts_with(['=', '+', '-', '@', '\t', '\r']);
        let is_number = cell.parse::<f64>().is_ok();
        let cell = if is_formula && !is_number { format!("'{cell}") } else { cell.clone() };
        match cell.contains([',', '"', '\n', '\r']) {
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

    #[test]
    fn no_name_is_a_formula_and_numbers_stay() {
        let cells = ["=1+1", "@SUM(1)", "+A", "-1.5", "1e3", "-"].map(str::to_owned);
        assert_eq!(text([cells.to_vec()]), "'=1+1,'@SUM(1),'+A,-1.5,1e3,'-\n");
    }

    #[test]
    fn no_name_breaks_its_row() {
        let names = ["a,b", "say \"x\"", "one\ntwo", "one\rtwo"].map(str::to_owned);
        assert_eq!(text([names.to_vec()]), "\"a,b\",\"say \"\"x\"\"\",\"one\ntwo\",\"one\rtwo\"\n");
    }
}
