//! The same measurement for lattices of other sizes: does a step cost what it touches?
//!
//! *Worlds* have the spacing of the settings and from 50 to 1000 points a side, about the middle of
//! what the configuration of the settings touches. Their first points lie whole spacings apart, so
//! that all worlds have the same rest points wherever they overlap. *Cells* fill the box of the
//! settings at other spacings.
//!
//! Every row is a run of this program in its own process, one after the other, so that memory is
//! its own and nothing shares the machine with it. Rows are held against each other by their time
//! per contact, each as a multiple of the mean of its table. All rows are measured `--rounds`
//! times, and each counts by its middle run ([`super::rounds`]).

use std::process::Command;

use palpate::Lattice;
use serde::Serialize;

use super::figures::Figures;
use super::rounds::{self, Row};
use super::whole::Touched;
use super::{Bench, child};
use crate::error::CliError;
use crate::output::{Output, table};
use crate::settings::sections::LatticeSettings;
use crate::settings::{Settings, SettingsError, corners};

/// Points along each side of the worlds.
const WORLDS: [u32; 5] = [50, 100, 200, 400, 1000];
/// Spacings of the cells, m.
const CELLS_M: [f64; 4] = [0.024, 0.012, 0.008, 0.005];
/// Touches of a row, unless `--touches` says how many.
const TOUCHES: u32 = 3;

/// What is varied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Sweep {
    /// Points a side, at the same spacing
    Worlds,
    /// Spacing, in the same box
    Cells,
}

/// The rows to measure.
pub(super) struct Plan {
    /// Whether worlds are varied; where they lie is known once something was touched.
    worlds: bool,
    /// The lattices of the cells, if they are varied.
    cells: Option<Vec<Lattice>>,
}

/// What was measured.
#[derive(Default, Serialize)]
pub(super) struct Sweeps {
    #[serde(skip_serializing_if = "Option::is_none")]
    worlds: Option<Vec<Row>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cells: Option<Vec<Row>>,
}

impl Plan {
    /// The rows of these sweeps, every lattice that is known by now being tried.
    pub(super) fn new(sweeps: &[Sweep], base: &Lattice) -> Result<Self, CliError> {
        let (low_m, high_m) = corners(base);
        let filling = |&spacing_m: &f64| Lattice::filling(low_m, high_m, spacing_m);
        let cells = sweeps.contains(&Sweep::Cells).then(|| CELLS_M.iter().map(filling).collect());
        let cells = cells.transpose().map_err(SettingsError::Lattice)?;
        Ok(Self { worlds: sweeps.contains(&Sweep::Worlds), cells })
    }

    /// Measures all rows.
    pub(super) fn run(
        &self,
        bench: &Bench<'_>,
        settings: &Settings,
        touched: &Touched,
        output: &Output,
    ) -> Result<Sweeps, CliError> {
        let base = &bench.config.lattice;
        let worlds = self.worlds.then(|| WORLDS.map(|points| world(base, touched, points)));
        let worlds: Option<Vec<Lattice>> =
            worlds.map(|worlds| worlds.into_iter().collect::<Result<_, _>>()).transpose()?;
        if worlds.is_none() && self.cells.is_none() {
            return Ok(Sweeps::default());
        }
        let lattices: Vec<Lattice> = worlds.iter().chain(&self.cells).flatten().cloned().collect();
        let mut runs = measure(bench, settings, &lattices, output)?.into_iter();
        // They come back in the order in which they were put together.
        let mut take =
            |lattices: &Vec<Lattice>| rounds::compare(runs.by_ref().take(lattices.len()).collect());
        let worlds = worlds.as_ref().map(&mut take);
        Ok(Sweeps { worlds, cells: self.cells.as_ref().map(&mut take) })
    }
}

/// A world of some points a side about what was touched, on the rest points of the base.
fn world(base: &Lattice, touched: &Touched, points: u32) -> Result<Lattice, SettingsError> {
    let spacing_m = base.spacing_m();
    let origin_m = std::array::from_fn(|axis| {
        let middle = 0.5 * (f64::from(touched[0][axis]) + f64::from(touched[1][axis]));
        let first = (middle - 0.5 * f64::from(points - 1)).round();
        base.origin_m()[axis] + first * spacing_m
    });
    Ok(Lattice::new(origin_m, spacing_m, [points; 3])?)
}

/// The runs of some lattices, measured in rounds.
fn measure(
    bench: &Bench<'_>,
    settings: &Settings,
    lattices: &[Lattice],
    output: &Output,
) -> Result<Vec<Vec<Figures>>, CliError> {
    let rounds = bench.args.rounds;
    let all = lattices.len() as u64 * u64::from(rounds);
    let bar = output.progress_of(Some(all), "runs", "sweeping");
    let runs = rounds::measure(rounds, lattices, |round, lattice| {
        let name = format!("{}, round {round} of {rounds}", name(lattice));
        if bar.is_hidden() {
            output.note(&format!("measuring {name}"));
        }
        bar.set_message(name.clone());
        let figures = run(bench, settings, lattice, (&name, &|| bar.tick()));
        bar.inc(1);
        figures
    })?;
    bar.finish_and_clear();
    Ok(runs)
}

/// One run of a row, in a process of its own.
fn run(
    bench: &Bench<'_>,
    settings: &Settings,
    lattice: &Lattice,
    (name, waiting): (&str, &dyn Fn()),
) -> Result<Figures, CliError> {
    let unwritten = |source| CliError::Write { what: "the settings of a row".to_owned(), source };
    let file = tempfile::NamedTempFile::new().map_err(unwritten)?;
    let mut settings = settings.clone();
    settings.lattice = LatticeSettings {
        spacing_m: Some(lattice.spacing_m()),
        origin_m: Some(lattice.origin_m().into()),
        shape: Some(lattice.shape()),
        ..LatticeSettings::default()
    };
    std::fs::write(file.path(), settings.template()?).map_err(unwritten)?;

    let args = bench.args;
    let program = std::env::current_exe()
        .map_err(|error| format!("the program cannot find itself to measure a row: {error}"))?;
    let mut command = Command::new(program);
    command.args(["bench", "--json", "--quiet", "--settings"]).arg(file.path());
    command.arg("--touches").arg(args.touches.unwrap_or(TOUCHES).to_string());
    command.arg("--passes").arg(args.passes.to_string());
    command.arg("--warm-passes").arg(args.warm_passes.to_string());
    if let Some(rate_hz) = args.pace.rate_hz() {
        command.arg("--rate").arg(rate_hz.to_string());
    }
    // The bundled touches are given as files, so that a row leaves none behind if it is ended.
    command.arg("--").args(bench.logs.paths());

    let told = child::run(&mut command, name, waiting)?;
    let mut figures: Figures =
        serde_json::from_slice(&told).map_err(|error| format!("{name} cannot be read: {error}"))?;
    figures.simulated = matches!(bench.logs, super::Logs::Bundled(_));
    Ok(figures)
}

/// What a row is called.
fn name(lattice: &Lattice) -> String {
    format!("the row of {} points every {} m", sides(lattice.shape()), lattice.spacing_m())
}

/// Points along the sides: one number if they are alike.
fn sides(shape: [u32; 3]) -> String {
    match shape {
        [nx, ny, nz] if nx == ny && ny == nz => nx.to_string(),
        [nx, ny, nz] => format!("{nx} x {ny} x {nz}"),
    }
}

impl Sweeps {
    /// The figures of the configuration, and the rows beside them.
    pub(super) fn beside<'a>(&'a self, figures: &'a Figures) -> impl Serialize + 'a {
        Beside { figures, sweeps: self }
    }

    /// The tables; empty if nothing was swept.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        for (rows, what) in [
            (&self.worlds, "Worlds of the same cells about what is touched"),
            (&self.cells, "Cells in the same box"),
        ] {
            let Some([first, ..]) = rows.as_deref() else { continue };
            let touches = match first.figures.touches {
                1 => "1 touch".to_owned(),
                n => format!("{n} touches"),
            };
            let rounds = match first.rounds.len() {
                1 => "Every row was measured once.".to_owned(),
                n => format!(
                    "Every row was measured {n} times, in\n\
                     rounds over all rows; told is the round whose step has the middle median."
                ),
            };
            text += &format!(
                "\n{what}, {touches}. The ratio is that of a row's\n\
                 time per contact to the mean of all rows. {rounds}\n\n"
            );
            text += &table_of(rows.as_deref().unwrap_or_default());
        }
        text
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Beside<'a> {
    #[serde(flatten)]
    figures: &'a Figures,
    #[serde(flatten)]
    sweeps: &'a Sweeps,
}

const HEADS: [&str; 12] = [
    "points a side",
    "cells cm",
    "contacts",
    "step ms",
    "p99 ms",
    "µs/contact",
    "simulator ms",
    "update ms",
    "ns/visit",
    "peak MiB",
    "cells touched",
    "ratio",
];

/// A table of rows.
fn table_of(rows: &[Row]) -> String {
    let line = |row: &Row| {
        let figures = &row.figures;
        vec![
            sides(figures.shape),
            format!("{:.2}", 1e2 * figures.spacing_m),
            format!("{:.0}", figures.contacts),
            format!("{:.3}", figures.step_ms.median),
            format!("{:.3}", figures.step_ms.p99),
            format!("{:.3}", figures.us_per_contact()),
            format!("{:.3}", figures.simulator_ms),
            format!("{:.3}", figures.update_ms),
            format!("{:.2}", figures.ns_per_visit),
            figures.peak(),
            figures.cells_touched.to_string(),
            format!("{:.2}", row.ratio),
        ]
    };
    let mut lines = vec![HEADS.map(str::to_owned).to_vec()];
    lines.extend(rows.iter().map(line));
    table(&lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_share_their_points_and_lie_about_what_is_touched() {
        let base = Lattice::default();
        let touched = [[90, 20, 101], [120, 41, 110]];
        for points in WORLDS {
            let world = world(&base, &touched, points).unwrap();
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
        let base = Lattice::default();
        let plan = Plan::new(&[Sweep::Cells], &base).unwrap();
        let shapes: Vec<u32> = plan.cells.unwrap().iter().map(|cells| cells.shape()[0]).collect();
        assert_eq!(shapes, [100, 200, 300, 480]);
        assert!(!plan.worlds);
    }

    #[test]
    fn a_box_too_large_for_the_smallest_cells_is_refused_before_the_work() {
        let large = Lattice::new([0.0; 3], 0.1, [100; 3]).unwrap();
        assert!(Plan::new(&[Sweep::Cells], &large).is_err());
        assert!(Plan::new(&[Sweep::Worlds], &large).is_ok());
    }
}
