//! The facts of a field, as text.

use palpate_work::contact_counts::point;
use palpate_work::forget::listed;
use palpate_work::inspect::field::{FieldFacts, LatticeFacts, OwnFacts};
use palpate_work::inspect::{counted, number, word};
use serde::Serialize;
use serde_json::Value;

use super::page::fact;

/// The facts of a field.
pub(super) fn text(field: &FieldFacts) -> String {
    let mut text = field.own.as_ref().map_or(String::new(), own);
    text += &fact("file", &format!("{:.1} kB", field.file_bytes as f64 / 1e3));
    text += &fact("cells", &format!("{} touched", field.cells));
    if field.expected_cells > 0 {
        let only = counted(field.expected_cells, "cell");
        text += &fact("", &format!("{only} more without a learnt frame"));
    }
    if let Some(counts) = field.frames_per_cell {
        let counts = quantiles(counts, |frames| format!("{frames:.0}"));
        text += &fact("frames", &format!("per cell: {counts}"));
    }
    let zero = format!("{:.1} % of the cells at zero", 100.0 * field.zero_share);
    text += &fact("stiffness", &format!("{} N/m in all; {zero}", number(field.total_n_per_m)));
    if let Some(stiffness) = field.stiffness_n_per_m {
        text += &fact("", &format!("of the other cells, N/m: {}", quantiles(stiffness, number)));
    }
    if let Some(std) = field.std_n_per_m {
        let memory = field.own.as_ref().and_then(|own| own.memory.as_ref());
        let prior = memory.map_or(String::new(), |memory| {
            format!(" (untouched: {})", number(memory.prior_std_n_per_m))
        });
        text += &fact("std", &format!("N/m: {}{prior}", quantiles(std, number)));
    }
    if let Some([low, high]) = field.stiff_box_m {
        let stiff = format!(
            "{} of at least a tenth of the largest stiffness lie within {} .. {} m",
            counted(field.stiff_cells, "cell"),
            point(low),
            point(high)
        );
        text += &fact("stiff", &stiff);
    }
    text
}

/// Quantiles with their names.
fn quantiles(quantiles: [f64; 5], number: fn(f64) -> String) -> String {
    let names = ["10 %", "median", "90 %", "99 %", "largest"];
    let parts = names.iter().zip(quantiles);
    let parts = parts.map(|(name, value)| format!("{name} {}", number(value)));
    parts.collect::<Vec<_>>().join(", ")
}

/// How the field was learnt.
fn own(own: &OwnFacts) -> String {
    let mut text = fact("robot", &own.robot);
    text += &fact("lattice", &lattice(&own.lattice));
    text += &fact("contact", &settings(&own.contact));
    text += &fact("torques", &settings(&own.touch));
    let Some(memory) = &own.memory else {
        return text + &fact("memory", "none: mapping cannot go on from this file");
    };
    let estimator = format!("{}, {}", word(memory.method), settings(&memory.estimator));
    text += &fact("estimator", &estimator);
    let frames = format!(
        "{} remembered of {}; `palpate map --from` can go on from it",
        counted(memory.frames, "frame"),
        counted(memory.touches as usize, "touch")
    );
    text += &fact("memory", &frames);
    text + &fact("", &format!("touches: {}", listed(&memory.remembered)))
}

/// The points of a lattice, and its box.
pub(super) fn lattice(lattice: &LatticeFacts) -> String {
    let [nx, ny, nz] = lattice.shape;
    format!(
        "{nx} x {ny} x {nz} points every {} m from {} m; box {} .. {} m",
        number(lattice.spacing_m),
        point(lattice.origin_m),
        point(lattice.box_m[0]),
        point(lattice.box_m[1])
    )
}

/// The value of a setting.
fn setting(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Number(own) => match own.as_f64() {
            Some(value) if own.is_f64() => number(value),
            _ => own.to_string(),
        },
        Value::Array(all) => all.iter().map(setting).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

/// Settings as `key value, …`; nested ones as `key.key`.
fn settings(settings: &impl Serialize) -> String {
    fn walk(prefix: &str, value: &Value) -> Vec<String> {
        match value {
            Value::Object(map) => {
                let dot = if prefix.is_empty() { "" } else { "." };
                let entries = map.iter();
                entries
                    .flat_map(|(key, value)| walk(&format!("{prefix}{dot}{key}"), value))
                    .collect()
            }
            value => vec![format!("{prefix} {}", setting(value))],
        }
    }
    walk("", &serde_json::to_value(settings).unwrap_or_default()).join(", ")
}
