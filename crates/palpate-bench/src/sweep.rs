//! Lattices of other sizes: does the time of a step depend only on its number of contacts?
//!
//! *Worlds* have the spacing of the settings and from 50 to 1000 points per side, around the middle
//! of the cells touched in the lattice of the settings. Their first points are whole spacings
//! apart, so that all worlds have the same rest points where they overlap. *Cells* fill the box of
//! the settings at other spacings.
//!
//! Rows are compared by their time per contact, each as a multiple of the mean of its table. All
//! rows are measured `--rounds` times, and the run with the middle median counts.

use std::error::Error;

use palpate::{Lattice, LatticeError};
use palpate_work::settings::corners;
use serde_json::{Value, json};

use crate::Args;
use crate::command::{Command, Measured};
use crate::rounds::{self, middle, ratios_to_mean};

/// Points along each side of the worlds.
const WORLDS: [u32; 5] = [50, 100, 200, 400, 1000];
/// Spacings of the cells, m.
const CELLS_M: [f64; 4] = [0.024, 0.012, 0.008, 0.005];
/// Number of touches for each row, without `--touches`.
const TOUCHES: u32 = 3;

/// What is varied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Sweep {
    /// Number of points per side, at the same spacing
    Worlds,
    /// Spacing, in the same box
    Cells,
}

/// The measured tables; `None` for a table that was not requested.
pub(crate) struct Sweeps {
    worlds: Option<Vec<Row>>,
    cells: Option<Vec<Row>>,
}

/// The results for one lattice.
struct Row {
    /// The run whose step median is the middle one.
    run: Measured,
    /// Median time of a step in each run, in the order of the rounds, ms.
    rounds: Vec<f64>,
    /// Time of a step per contact, as a multiple of the mean of all rows.
    ratio: f64,
}

/// Lattices of other spacings in the same box.
pub(crate) fn cells(base: &Lattice) -> Result<Vec<Lattice>, LatticeError> {
    let (low_m, high_m) = corners(base);
    CELLS_M.iter().map(|&spacing_m| Lattice::filling(low_m, high_m, spacing_m)).collect()
}

/// Lattices with the spacing of `base`, around the box of the touched cells, with the same rest
/// points.
pub(crate) fn worlds(
    base: &Lattice,
    touched: &[[u32; 3]; 2],
) -> Result<Vec<Lattice>, LatticeError> {
    let world = |points: u32| {
        let origin_m = std::array::from_fn(|axis| {
            let middle = 0.5 * (f64::from(touched[0][axis]) + f64::from(touched[1][axis]));
            let first = (middle - 0.5 * f64::from(points - 1)).round();
            base.origin_m()[axis] + first * base.spacing_m()
        });
        Lattice::new(origin_m, base.spacing_m(), [points; 3])
    };
    WORLDS.into_iter().map(world).collect()
}

impl Sweeps {
    /// Measures all lattices of both tables in the same rounds.
    pub(crate) fn measure(
        command: &Command,
        worlds: Option<Vec<Lattice>>,
        cells: Option<Vec<Lattice>>,
        args: &Args,
    ) -> Result<Self, Box<dyn Error>> {
        let lattices: Vec<Lattice> = worlds.iter().chain(&cells).flatten().cloned().collect();
        let mut runs = rounds::measure(args.rounds, &lattices, |round, lattice| {
            let (sides, spacing_m) = (sides(lattice.shape()), lattice.spacing_m());
            let name = format!("{sides} points every {spacing_m} m, round {round}");
            eprintln!("measuring {name} of {}", args.rounds);
            let run = command.measure(lattice, args.touches.or(Some(TOUCHES)));
            run.map_err(|error| format!("{name}: {error}"))
        })?
        .into_iter();
        // The runs come in the order of the lattices.
        let mut rows =
            |lattices: Vec<Lattice>| Row::compare(runs.by_ref().take(lattices.len()).collect());
        let worlds = worlds.map(&mut rows);
        Ok(Self { worlds, cells: cells.map(rows) })
    }

    /// Adds the rows to the figures of `--json`.
    pub(crate) fn add_to(&self, figures: &mut Value) {
        for (name, rows) in [("worlds", &self.worlds), ("cells", &self.cells)] {
            if let Some(rows) = rows {
                figures[name] = rows.iter().map(Row::json).collect();
            }
        }
    }

    /// The tables, in Markdown; empty if nothing was swept.
    pub(crate) fn text(&self) -> String {
        let mut text = String::new();
        for (rows, what) in [
            (&self.worlds, "Larger lattices of the same cells"),
            (&self.cells, "Smaller cells in the same box"),
        ] {
            let Some([first, ..]) = rows.as_deref() else { continue };
            let (touches, rounds) = (first.run.touches, first.rounds.len());
            text += &format!("\n{what}; touches: {touches}, rounds: {rounds}\n\n{HEAD}");
            text.extend(rows.iter().flatten().map(Row::line));
        }
        text
    }
}

const HEAD: &str = "\
| points | cells, cm | contacts | step, ms | p99, ms | µs per contact | ratio | simulator, ms \
| update, ms | ns per visit | peak memory, MiB | cells touched |
|---|---|---|---|---|---|---|---|---|---|---|---|
";

impl Row {
    /// The rows of a table from their runs; all rows have the same number of runs, at least one.
    fn compare(rows: Vec<Vec<Measured>>) -> Vec<Self> {
        let per_contact = rows.iter().map(|runs| runs.iter().map(Measured::us_per_contact));
        let ratios = ratios_to_mean(&per_contact.map(Iterator::collect).collect::<Vec<_>>());
        let row = |(mut runs, ratio): (Vec<Measured>, f64)| {
            let rounds: Vec<f64> = runs.iter().map(|run| run.step_ms.median).collect();
            Self { run: runs.swap_remove(middle(&rounds)), rounds, ratio }
        };
        rows.into_iter().zip(ratios).map(row).collect()
    }

    fn json(&self) -> Value {
        let mut json = self.run.json.clone();
        json["rounds"] = json!(self.rounds);
        json["ratio"] = json!(self.ratio);
        json
    }

    fn line(&self) -> String {
        let run = &self.run;
        let peak = run.peak_memory_mib.map_or("unknown".to_owned(), |mib| format!("{mib:.1}"));
        format!(
            "| {} | {:.2} | {:.0} | {:.3} | {:.3} | {:.3} | {:.2} | {:.3} | {:.3} | {:.2} | {peak} \
             | {} |\n",
            sides(run.shape),
            1e2 * run.spacing_m,
            run.contacts,
            run.step_ms.median,
            run.step_ms.p99,
            run.us_per_contact(),
            self.ratio,
            run.simulator_ms,
            run.update_ms,
            run.ns_per_visit,
            run.cells_touched
        )
    }
}

/// Points along the sides: one number if all sides are equal.
fn sides(shape: [u32; 3]) -> String {
    match shape {
        [nx, ny, nz] if nx == ny && ny == nz => format!("{nx}³"),
        [nx, ny, nz] => format!("{nx} x {ny} x {nz}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_share_their_points_and_lie_about_what_is_touched() {
        let base = Lattice::default();
        let touched = [[90, 20, 101], [120, 41, 110]];
        for (points, world) in WORLDS.into_iter().zip(worlds(&base, &touched).unwrap()) {
            assert_eq!(world.shape(), [points; 3]);
            let apart = (world.origin_m() - base.origin_m()) / base.spacing_m();
            let middle = apart.add_scalar(0.5 * f64::from(points - 1));
            for axis in 0..3 {
                assert!((apart[axis] - apart[axis].round()).abs() < 1e-9, "{points}: {apart}");
                let wanted = 0.5 * f64::from(touched[0][axis] + touched[1][axis]);
                assert!((middle[axis] - wanted).abs() <= 0.5 + 1e-9, "{points}: {middle}");
            }
        }
    }

    #[test]
    fn cells_of_every_size_fill_the_same_box() {
        let shapes = cells(&Lattice::default()).unwrap();
        let shapes: Vec<u32> = shapes.iter().map(|cells| cells.shape()[0]).collect();
        assert_eq!(shapes, [100, 200, 300, 480]);
    }

    #[test]
    fn a_box_too_large_for_the_smallest_cells_is_refused() {
        assert!(cells(&Lattice::new([0.0; 3], 0.1, [100; 3]).unwrap()).is_err());
    }
}
