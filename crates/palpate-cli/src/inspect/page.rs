//! Facts, tables and findings as text for people.

use palpate_work::inspect::{Finding, Holds, Inspection, word};

use super::{field, log, robot};

/// Columns that text is wrapped at; tables may be wider, since nothing of them is cut off.
const WIDTH: usize = 100;

/// Columns for the names of facts.
const NAMES: usize = 10;

/// Everything about one path.
pub(super) fn of(inspection: &Inspection) -> String {
    let mut text = format!("{} `{}`\n", word(inspection.kind), inspection.path.display());
    text += &match &inspection.holds {
        Some(Holds::Log(facts)) => log::text(facts),
        Some(Holds::Robot(facts)) => robot::text(facts),
        Some(Holds::Field(facts)) => field::text(facts),
        None => String::new(),
    };
    text.push('\n');
    for finding in &inspection.findings {
        text += &told(finding);
    }
    let clean = inspection.findings.is_empty();
    text + if clean { "  Nothing looks wrong.\n" } else { "" }
}

/// A finding, its remedy under it.
fn told(finding: &Finding) -> String {
    let mark = word(finding.level).to_uppercase();
    let text = wrapped(&format!("{mark}  {}", finding.what), "  ", "    ");
    text + &wrapped(&finding.remedy, "    -> ", "       ")
}

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
    let columns = columns.iter().map(ToString::to_string).collect();
    let table = crate::output::table(&std::iter::once(columns).chain(rows).collect::<Vec<_>>());
    let lines = table.lines().map(|line| format!("  {line}\n"));
    format!("\n  {heading}\n{}", lines.collect::<String>())
}

/// Breaks a text between words.
fn wrapped(text: &str, first: &str, others: &str) -> String {
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
