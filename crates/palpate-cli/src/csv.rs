//! Tables for programs.

/// Rows as CSV, the head first; names may hold commas, quotes and line breaks.
pub(crate) fn text(rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let quoted = |cell: &String| match cell.contains([',', '"', '\n']) {
        true => format!("\"{}\"", cell.replace('"', "\"\"")),
        false => cell.clone(),
    };
    let line = |row: Vec<String>| row.iter().map(quoted).collect::<Vec<_>>().join(",") + "\n";
    rows.into_iter().map(line).collect()
}
