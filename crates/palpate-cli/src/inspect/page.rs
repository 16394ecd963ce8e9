//! Facts, tables and findings as text for people.

use super::finding::{Finding, Level};
use super::{Holds, Inspection};

/// Columns that text is wrapped at; tables may be wider, since nothing of them is cut off.
const WIDTH: usize = 100;

/// Columns for the names of facts.
const NAMES: usize = 10;

/// Everything about one path.
pub(super) fn of(inspection: &Inspection) -> String {
    let mut text = format!("{} `{}`\n", inspection.kind.word(), inspection.path.display());
    text += &match &inspection.holds {
        Some(Holds::Log(facts)) => facts.text(),
        Some(Holds::Robot(facts)) => facts.text(),
        Some(Holds::Field(facts)) => facts.text(),
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
    let mark = match finding.level {
        Level::Warning => "WARNING",
        Level::Error => "ERROR",
    };
    let text = wrapped(&format!("{mark}  {}", finding.what), "  ", "    ");
    text + &wrapped(&finding.remedy, "    -> ", "       ")
}

/// A named fact, wrapped.
pub(super) fn fact(name: &str, text: &str) -> String {
    let name = format!("  {name:<NAMES$}");
    wrapped(text, &name, &" ".repeat(NAMES + 2))
}

/// A table under a heading, indented.
pub(super) fn table(heading: &str, rows: &[Vec<String>]) -> String {
    let table = crate::output::table(rows);
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

/// A number of things.
pub(super) fn counted(count: usize, thing: &str) -> String {
    let plural = match thing {
        "touch" => "es",
        _ => "s",
    };
    format!("{count} {thing}{}", if count == 1 { "" } else { plural })
}

/// Names in a row; of many only the first, since `--json` has them all.
pub(super) fn listed<T: AsRef<str>>(names: &[T]) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    match names.len().saturating_sub(SHOWN) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// A length, torque or the like with as many digits as tell something.
pub(super) fn number(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if size == 0.0 => "0".to_owned(),
        _ if !(0.001..1e5).contains(&size) => format!("{value:.2e}"),
        _ if size < 0.1 => format!("{value:.4}"),
        _ if size < 10.0 => format!("{value:.3}"),
        _ if size < 1000.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}
