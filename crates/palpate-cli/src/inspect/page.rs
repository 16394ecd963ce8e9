//! Facts and tables as wrapped text.

/// Width at which text is wrapped, in characters; tables may be wider.
const WIDTH: usize = 100;

/// Width of the names of facts, in characters.
const NAMES: usize = 10;

/// A named fact, wrapped.
pub(super) fn fact(name: &str, text: &str) -> String {
    let name = format!("  {name:<NAMES$}");
    wrapped(text, &name, &" ".repeat(NAMES + 2))
}

/// A table under a heading, indented: the names of its columns, then its rows.
pub(super) fn table(
    heading: &str,
    columns: &[&str],
    rows: impl Iterator<Item = Vec<String>>,
) -> String {
    let table = crate::output::table(columns, rows);
    let lines = table.lines().map(|line| format!("  {line}\n"));
    format!("\n  {heading}\n{}", lines.collect::<String>())
}

/// Wraps a text between words; `first` precedes the first line, `others` each further one.
pub(super) fn wrapped(text: &str, first: &str, others: &str) -> String {
    let (mut lines, mut line, mut empty) = (String::new(), first.to_owned(), true);
    for word in text.split(' ') {
        if !empty && line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines += line.trim_end();
            lines.push('\n');
            (line, empty) = (others.to_owned(), true);
        }
        if !empty {
            line.push(' ');
        }
        line += word;
        empty = false;
    }
    lines + line.trim_end() + "\n"
}
