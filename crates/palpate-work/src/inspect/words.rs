//! Numbers and names as text, for findings and facts.

use serde::Serialize;

/// The word for a value in settings, JSON and findings.
pub fn word(value: impl Serialize) -> String {
    let word = serde_json::to_value(value).unwrap_or_default();
    word.as_str().unwrap_or_default().to_owned()
}

/// A count with its noun, such as `2 touches`.
pub fn counted(count: usize, thing: &str) -> String {
    let plural = match thing {
        "touch" | "stretch" => "es",
        _ => "s",
    };
    format!("{count} {thing}{}", if count == 1 { "" } else { plural })
}

/// `once`, `2 times` and so on.
pub(super) fn times(count: usize) -> String {
    if count == 1 { "once".to_owned() } else { format!("{count} times") }
}

/// Names with commas between them; of many only the first, since `--json` has all of them.
pub(super) fn listed<T: AsRef<str>>(names: &[T]) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    match names.len().saturating_sub(SHOWN) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// A quantity, such as a length or torque, rounded to about three significant digits.
pub fn number(value: f64) -> String {
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
