//! What a field holds: cells, stiffness, how sure it is of it, and whether it can be continued.

use std::path::Path;

use palpate::Snapshot;
use palpate_io::field::npz::{NpzError, read_npz};
use palpate_io::field::{self, FieldFile, Saved, SavedError};
use serde::Serialize;
use serde_json::Value;

use super::finding::Finding;
use super::page::{counted, fact, number};
use crate::quantile::{extremes, quantile};

/// Cells below this part of the stiffest one count as zero.
const ZERO: f64 = 1e-6;
/// Cells above this part of the stiffest one count as stiff.
const STIFF: f64 = 0.1;
/// A standard deviation above this part of the prior's has learnt nothing.
const UNCHANGED: f64 = 0.999;
/// The shares of which quantiles are told.
const SHARES: [f64; 5] = [0.1, 0.5, 0.9, 0.99, 1.0];

/// What a field holds.
#[derive(Debug, Serialize)]
pub(super) struct FieldFacts {
    file_bytes: u64,
    /// Those that were touched, which all figures are of.
    cells: usize,
    /// Those of which something is expected and nothing was ever felt.
    expected_cells: usize,
    /// Quantiles 10, 50, 90, 99 and 100 % of the cells above zero, N/m.
    stiffness_n_per_m: Option<[f64; 5]>,
    /// Sum over the touched cells, N/m.
    total_n_per_m: f64,
    /// Share of the cells at zero.
    zero_share: f64,
    /// The same quantiles of the standard deviations, N/m.
    std_n_per_m: Option<[f64; 5]>,
    /// The same quantiles of the frames that touched a cell.
    frames_per_cell: Option<[f64; 5]>,
    /// Lowest and highest point of the cells of at least a tenth of the largest stiffness, m.
    stiff_box_m: Option<[[f64; 3]; 2]>,
    stiff_cells: usize,
    /// What only palpate's own files say.
    own: Option<OwnFacts>,
}

#[derive(Debug, Serialize)]
struct OwnFacts {
    robot: String,
    lattice: LatticeFacts,
    contact: Value,
    touch: Value,
    memory: Option<MemoryFacts>,
}

#[derive(Debug, Serialize)]
struct LatticeFacts {
    origin_m: [f64; 3],
    spacing_m: f64,
    shape: [u32; 3],
    box_m: [[f64; 3]; 2],
    cells_declared: u64,
}

/// What mapping would go on from.
#[derive(Debug, Serialize)]
struct MemoryFacts {
    method: palpate::EstimatorKind,
    estimator: Value,
    /// Standard deviation of an untouched cell, N/m.
    prior_std_n_per_m: f64,
    touches: u32,
    frames: usize,
    logged_samples: usize,
}

/// Looks at a field.
pub(super) fn inspect(path: &Path) -> (Option<FieldFacts>, Vec<Finding>) {
    match field::load(path) {
        Ok(saved) => {
            let facts = FieldFacts::of_saved(path, &saved);
            let findings = facts.findings();
            (Some(facts), findings)
        }
        Err(SavedError::Foreign { missing, .. }) => foreign(path, missing),
        Err(error) => (None, vec![refused(error.to_string())]),
    }
}

fn refused(what: String) -> Finding {
    let remedy = "a field is an .npz with `points` and `K`, as `palpate map` writes it; map again, \
                  or copy the file again if it was whole";
    Finding::error("field", what, remedy)
}

/// A field of another program: what there is of it.
fn foreign(path: &Path, missing: &str) -> (Option<FieldFacts>, Vec<Finding>) {
    let read = || -> Result<FieldFile, NpzError> { FieldFile::from_arrays(&read_npz(path)?) };
    let file = match read() {
        Ok(file) => file,
        Err(error) => return (None, vec![refused(error.to_string())]),
    };
    let facts = FieldFacts::new(path, &file);
    let what = format!(
        "the field was written by another program, such as OpenVSF: it lacks `{missing}`, which \
         says how its points were touched"
    );
    let remedy = "`palpate predict` cannot use it; map the logs with `palpate map`. Points, K and \
                  K_std can be compared all the same";
    let mut findings = vec![Finding::warning("foreign_field", what, remedy)];
    findings.extend(facts.findings());
    (Some(facts), findings)
}

/// The touched points of a field: all of them, if it does not say.
fn touched(file: &FieldFile) -> FieldFile {
    let is_touched = |row: &usize| file.counts.as_ref().is_none_or(|counts| counts[*row] > 0);
    let rows: Vec<usize> = (0..file.points.len()).filter(is_touched).collect();
    let of = |numbers: &Vec<f64>| rows.iter().map(|&row| numbers[row]).collect();
    FieldFile {
        points: rows.iter().map(|&row| file.points[row]).collect(),
        stiffness: of(&file.stiffness),
        std: file.std.as_ref().map(of),
        counts: file.counts.as_ref().map(|counts| rows.iter().map(|&row| counts[row]).collect()),
        prior: file.prior.as_ref().map(of),
        lattice: file.lattice,
        cells: file.cells.as_ref().map(|cells| rows.iter().map(|&row| cells[row]).collect()),
    }
}

/// The shares of interest of some numbers.
fn quantiles(numbers: &[f64]) -> Option<[f64; 5]> {
    let all: Option<Vec<f64>> = SHARES.iter().map(|&share| quantile(numbers, share)).collect();
    all.and_then(|all| all.try_into().ok())
}

impl FieldFacts {
    fn new(path: &Path, file: &FieldFile) -> Self {
        let all = file.points.len();
        let file = &touched(file);
        let largest = file.stiffness.iter().copied().fold(0.0, f64::max);
        let above =
            |part: f64| move |stiffness: &&f64| **stiffness > 0.0 && **stiffness >= part * largest;
        let positive: Vec<f64> = file.stiffness.iter().filter(above(ZERO)).copied().collect();
        let stiff = file.points.iter().zip(&file.stiffness);
        let stiff: Vec<&[f64; 3]> = stiff
            .filter(|(_, stiffness)| above(STIFF)(stiffness))
            .map(|(point, _)| point)
            .collect();
        let sides: Option<Vec<[f64; 2]>> =
            (0..3).map(|axis| extremes(stiff.iter().map(|point| point[axis]))).collect();
        let counts = file
            .counts
            .as_ref()
            .map(|counts| counts.iter().map(|&count| f64::from(count)).collect::<Vec<_>>());
        let cells = file.points.len();
        Self {
            file_bytes: path.metadata().map_or(0, |metadata| metadata.len()),
            cells,
            expected_cells: all - cells,
            stiffness_n_per_m: quantiles(&positive),
            total_n_per_m: file.stiffness.iter().sum(),
            zero_share: 1.0 - positive.len() as f64 / cells.max(1) as f64,
            std_n_per_m: file.std.as_deref().and_then(quantiles),
            frames_per_cell: counts.as_deref().and_then(quantiles),
            stiff_box_m: sides
                .map(|sides| [0, 1].map(|end| std::array::from_fn(|axis| sides[axis][end]))),
            stiff_cells: stiff.len(),
            own: None,
        }
    }

    fn of_saved(path: &Path, saved: &Saved) -> Self {
        let held = &saved.field;
        let (lattice, json) = (&held.lattice, |value: Result<Value, _>| value.unwrap_or_default());
        let file = FieldFile {
            points: held.cells.iter().map(|&cell| lattice.point(cell).into()).collect(),
            stiffness: held.stiffness_n_per_m.clone(),
            std: Some(held.std_n_per_m.clone()),
            counts: Some(held.counts.clone()),
            prior: None,
            lattice: None,
            cells: None,
        };
        let (spacing_m, shape) = (lattice.spacing_m(), lattice.shape());
        let low_m: [f64; 3] = lattice.origin_m().coords.map(|x| x - 0.5 * spacing_m).into();
        let high_m = std::array::from_fn(|axis| low_m[axis] + f64::from(shape[axis]) * spacing_m);
        let lattice = LatticeFacts {
            origin_m: lattice.origin_m().into(),
            spacing_m,
            shape,
            box_m: [low_m, high_m],
            cells_declared: lattice.n_cells(),
        };
        let own = OwnFacts {
            robot: saved.robot.clone(),
            lattice,
            contact: json(serde_json::to_value(&held.contact)),
            touch: json(serde_json::to_value(&held.touch)),
            memory: saved.snapshot.as_ref().map(MemoryFacts::new),
        };
        Self { own: Some(own), ..Self::new(path, &file) }
    }

    fn findings(&self) -> Vec<Finding> {
        [self.all_zero(), self.never_reduced()].into_iter().flatten().collect()
    }

    fn all_zero(&self) -> Option<Finding> {
        let remedy = "inspect the logs: torque sign and gravity first, then whether the arm \
                      touches the object inside the lattice's box";
        if self.cells == 0 {
            return Some(Finding::warning("empty_field", "no cell was ever touched", remedy));
        }
        (self.zero_share >= 1.0).then(|| {
            let what = format!("the stiffness of all {} is zero", counted(self.cells, "cell"));
            Finding::warning("all_zero", what, remedy)
        })
    }

    /// With the prior unknown, standard deviations that are all the same tell as much.
    fn never_reduced(&self) -> Option<Finding> {
        let [least, _, _, _, largest] = self.std_n_per_m?;
        let memory = self.own.as_ref().and_then(|own| own.memory.as_ref());
        let prior = memory.map_or(largest, |memory| memory.prior_std_n_per_m);
        (least >= UNCHANGED * prior && self.cells > 1).then(|| {
            let what = format!(
                "the standard deviation of every cell is still {} N/m, as before learning",
                number(least)
            );
            let remedy = "nothing was learnt from these touches: look whether frames are left \
                          after the tare (`palpate inspect LOG`), and at --torque-std";
            Finding::warning("std_never_reduced", what, remedy)
        })
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let mut text = self.own.as_ref().map_or(String::new(), OwnFacts::text);
        text += &fact("file", &format!("{:.1} kB", self.file_bytes as f64 / 1e3));
        text += &fact("cells", &format!("{} touched", self.cells));
        if self.expected_cells > 0 {
            let only = counted(self.expected_cells, "cell");
            text += &fact("", &format!("{only} more, expected by a prior and never touched"));
        }
        let shown_as = |quantiles: [f64; 5], number: fn(f64) -> String| {
            let names = ["10 %", "median", "90 %", "99 %", "largest"];
            let parts = names.iter().zip(quantiles);
            let parts = parts.map(|(name, value)| format!("{name} {}", number(value)));
            parts.collect::<Vec<_>>().join(", ")
        };
        let shown = |quantiles| shown_as(quantiles, number);
        if let Some(counts) = self.frames_per_cell {
            text += &fact(
                "frames",
                &format!("a cell: {}", shown_as(counts, |frames| format!("{frames:.0}"))),
            );
        }
        let zero = format!("{:.1} % of the cells at zero", 100.0 * self.zero_share);
        text += &fact("stiffness", &format!("{} N/m in all; {zero}", number(self.total_n_per_m)));
        if let Some(stiffness) = self.stiffness_n_per_m {
            text += &fact("", &format!("of the others, N/m: {}", shown(stiffness)));
        }
        if let Some(std) = self.std_n_per_m {
            text += &fact("std", &format!("N/m: {}{}", shown(std), self.prior()));
        }
        if let Some([low, high]) = self.stiff_box_m {
            let stiff = format!(
                "{} of at least a tenth of the largest stiffness lie within {} .. {} m",
                counted(self.stiff_cells, "cell"),
                place(&low),
                place(&high)
            );
            text += &fact("stiff", &stiff);
        }
        text
    }

    fn prior(&self) -> String {
        let memory = self.own.as_ref().and_then(|own| own.memory.as_ref());
        memory.map_or(String::new(), |memory| {
            format!(" (untouched: {})", number(memory.prior_std_n_per_m))
        })
    }
}

fn place(point: &[f64; 3]) -> String {
    let [x, y, z] = point;
    format!("({x:.3}, {y:.3}, {z:.3})")
}

impl MemoryFacts {
    fn new(snapshot: &Snapshot) -> Self {
        let config = &snapshot.config;
        let spacing_m = config.lattice.spacing_m();
        let samples = |touch: &palpate::unstable::LoggedTouch| {
            touch.q.len().checked_div(snapshot.n_joints).unwrap_or(0)
        };
        Self {
            method: config.method,
            estimator: serde_json::to_value(&config.estimator).unwrap_or_default(),
            prior_std_n_per_m: config.estimator.prior.at_spacing(spacing_m).1,
            touches: snapshot.touches,
            frames: snapshot.state.remembered.len(),
            logged_samples: snapshot.sample_log.iter().map(samples).sum(),
        }
    }
}

impl OwnFacts {
    fn text(&self) -> String {
        let lattice = &self.lattice;
        let [nx, ny, nz] = lattice.shape;
        let mut text = fact("robot", &self.robot);
        let spaced = format!(
            "{nx} x {ny} x {nz} points every {} m from {} m; box {} .. {} m",
            number(lattice.spacing_m),
            place(&lattice.origin_m),
            place(&lattice.box_m[0]),
            place(&lattice.box_m[1])
        );
        text += &fact("lattice", &spaced);
        text += &fact("contact", &settings(&self.contact));
        text += &fact("torques", &settings(&self.touch));
        match &self.memory {
            Some(memory) => {
                let name = serde_json::to_value(memory.method).unwrap_or_default();
                let name = name.as_str().unwrap_or_default();
                let set = format!("{name}, {}", settings(&memory.estimator));
                text += &fact("estimator", &set);
                let frames = format!(
                    "{} remembered of {}; `palpate map --from` can go on from it",
                    counted(memory.frames, "frame"),
                    counted(memory.touches as usize, "touch")
                );
                text += &fact("memory", &frames);
            }
            None => text += &fact("memory", "none: mapping cannot go on from this file"),
        }
        text
    }
}

/// Settings as `key value, …`; nested ones as `key.key`.
fn settings(value: &Value) -> String {
    fn walk(prefix: &str, value: &Value, into: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                for (key, value) in map {
                    let dot = if prefix.is_empty() { "" } else { "." };
                    walk(&format!("{prefix}{dot}{key}"), value, into);
                }
            }
            Value::String(word) => into.push(format!("{prefix} {word}")),
            other => into.push(format!("{prefix} {other}")),
        }
    }
    let mut parts = Vec::new();
    walk("", value, &mut parts);
    parts.join(", ")
}
