//! `palpate-bench`: how the time of a step depends on the lattice, and how far it is from the lower
//! bound of the machine.
//!
//! A tool for developers, which makes the tables of BENCHMARKS.md. Every measurement is a separate
//! process of the command `palpate bench --json` ([`command`]), one after the other, so that its peak
//! memory includes nothing else. [`lower_bound`] measures the machine, [`sweep`] defines the lattices
//! to measure, [`rounds`] repeats the measurements.

mod command;
mod lower_bound;
mod rounds;
mod sweep;

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use palpate_work::settings::{self, Settings};
use serde_json::json;

use command::{Command, Measured};
use lower_bound::LowerBound;
use sweep::{Sweep, Sweeps};

/// Measures `palpate bench` for lattices of several sizes, and compares it with the lower bounds set by
/// memory and arithmetic of this machine.
#[derive(Debug, Parser)]
#[command(name = "palpate-bench", max_term_width = 100)]
struct Args {
    /// Logs to learn from; without any, the bundled touches, which are simulated
    #[arg(value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Also measure other lattices: `worlds` of 50 to 1000 points per side around the touched cells, or
    /// `cells` of 2.4 to 0.5 cm in the same box
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    sweep: Vec<Sweep>,
    /// Number of measurements of every row of a sweep; the one with the middle median counts
    #[arg(long, value_name = "N", default_value_t = 3, requires = "sweep",
          value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,
    /// Only the first N touches of the log [default: all; 3 in sweeps]
    #[arg(long, value_name = "N")]
    touches: Option<u32>,
    /// Passes through the log before the clock starts
    #[arg(long, value_name = "N", default_value_t = 1)]
    warm_passes: u32,
    /// Passes through the log with the clock running
    #[arg(long, value_name = "N", default_value_t = 1)]
    passes: u32,
    /// Rate of the steps, Hz
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// The command to measure [default: `palpate` beside this program]
    #[arg(long, value_name = "FILE")]
    palpate: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    /// TOML file with settings; flags win over it
    #[arg(long = "settings", value_name = "FILE.toml")]
    settings_file: Option<PathBuf>,
    #[command(flatten)]
    flags: Settings,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<(), Box<dyn Error>> {
    let settings = match &args.settings_file {
        Some(path) => args.flags.clone().over(settings::read(path)?),
        None => args.flags.clone(),
    };
    let base = settings.config()?.lattice;
    let cells = args.sweep.contains(&Sweep::Cells).then(|| sweep::cells(&base)).transpose()?;
    let command = Command::new(args, settings)?;

    eprintln!("measuring the lattice of the settings");
    let figures = command.measure(&base, args.touches)?;
    let bound = LowerBound::measure();
    let worlds = args.sweep.contains(&Sweep::Worlds);
    let worlds = worlds.then(|| sweep::worlds(&base, &figures.cells_touched_box)).transpose()?;
    let sweeps = Sweeps::measure(&command, worlds, cells, args)?;

    let ratio = figures.update_ns_per_visit / bound.ns_per_visit;
    if args.json {
        let mut all = figures.json.clone();
        all["lower_bound"] = json!(bound);
        all["lower_bound_ratio"] = json!(ratio);
        sweeps.add_to(&mut all);
        println!("{all:#}");
    } else {
        println!("{}", text(&figures, &bound, ratio) + &sweeps.text());
    }
    Ok(())
}

/// The times for the lattice of the settings, with the lower bound, as text.
fn text(figures: &Measured, bound: &LowerBound, ratio: f64) -> String {
    format!(
        "step, median                      {:.3} ms for {:.0} contacts\n\
         a visit of one contact            {:.2} ns\n\
         the update by contact visited     {:.2} ns\n{}\
         times what memory allows          {ratio:.2}\n",
        figures.step_ms.median,
        figures.contacts,
        figures.ns_per_visit,
        figures.update_ns_per_visit,
        bound.text()
    )
}
