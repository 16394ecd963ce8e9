//! Tables for programs.

/// Rows as CSV, the head first; names may hold commas, quotes and line breaks.
pub(crate) fn text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let quoted = |cell: &String| match cell.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.clone(),
    };
    let line = |row: Vec<String>| row.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n";
    rows.into_iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_breaks_its_row() {
        let names = ["a,b", "say \"x\"", "one\ntwo", "one\rtwo"].map(str::to_owned);
        assert_eq!(text([names.to_vec()]), "\"a,b\",\"say \"\"x\"\"\",\"one\ntwo\",\"one\rtwo\"\n");
    }
}
