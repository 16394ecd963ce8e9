//! `palpate forget`: removes touches from a field, as if they had never been learnt.

use std::path::PathBuf;
use std::time::Instant;

use palpate_io::field::{self, SavedField};
use palpate_work::forget::{TouchSelection, forget, listed};
use palpate_work::held_joints::of_field;
use palpate_work::robot;
use serde_json::json;

use crate::args::{corners, number_in};
use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::interrupt;
use crate::output::{Output, seconds};
use crate::settings::{RobotOnlySettings, Settings};

const NOTES: &str = "Examples:
  palpate forget field.npz -o field.npz --touch seq_003
  palpate forget field.npz -o newer.npz --older-than 20
  palpate forget field.npz -o rest.npz --box 0.3 -0.1 0.4 0.5 0.1 0.6

The result is, bit for bit, the field that `palpate map` learns from the other touches with the \
same settings: they are learned again from the samples in the field's memory (with `ekf` and \
drift, steps without contact do not count). Bands and chosen settings stay as they are. `palpate \
inspect FIELD.npz` lists the touches.

--json prints {\"forgotten\": [names], \"touches\": left, \"cells_touched\", \"seconds\"}.";

/// Flags of `palpate forget`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES, group = clap::ArgGroup::new("which").required(true).multiple(true))]
pub(crate) struct Args {
    /// The field
    #[arg(value_name = "FIELD.npz")]
    field: PathBuf,
    /// Output file of the field without these touches; may be the same file
    #[arg(long, short, value_name = "FIELD.npz")]
    output: PathBuf,
    /// Forget the touches with this name, or the touch with this number, such as `#3`; may be given
    /// several times
    #[arg(long, value_name = "NAME", group = "which")]
    touch: Vec<String>,
    /// Forget all touches but the last N
    #[arg(long, value_name = "N", group = "which")]
    older_than: Option<usize>,
    /// Forget the touches in which the arm went through a point of this box: two corners, m
    #[arg(
        long = "box", num_args = 6, group = "which",
        value_names = ["X", "Y", "Z", "X", "Y", "Z"],
        value_parser = number_in(f64::MIN..=f64::MAX, "a finite coordinate, m")
    )]
    touched_box: Option<Vec<f64>>,
    /// Print what was forgotten as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotOnlySettings,
}

impl Args {
    fn which(&self) -> TouchSelection {
        let corners = self.touched_box.as_deref().map(corners);
        TouchSelection {
            names: self.touch.clone(),
            older_than: self.older_than,
            touched_box_m: corners,
        }
    }
}

/// Forgets touches of a field.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings: Settings = args.settings.load()?;
    let mut places = FilePaths::read(&args.settings, &settings, &[]);
    places.output("the field (--output)", Some(&args.output))?;
    interrupt::listen();
    let _hold = file_paths::hold_field(&args.output)?;
    let started = Instant::now();
    let name = args.field.display().to_string();
    let saved = field::load(&args.field).map_err(CliError::file)?;
    let arm = robot::load(&settings.robot, output)?;
    let arm = of_field(arm, saved.snapshot.as_ref(), output);
    let (mapper, forgotten) = forget(&arm, (&saved, &name), &args.which(), output)?;
    let without = SavedField::of_mapper(&mapper);
    file_paths::save(&args.output, &without)?;
    let touches = without.snapshot.as_ref().map_or(0, |own| own.sample_log.len());
    let cells = without.field.touched_rows().count();
    let elapsed = started.elapsed();
    if args.json {
        return output.json(&json!({
            "forgotten": forgotten,
            "touches": touches,
            "cells_touched": cells,
            "seconds": elapsed.as_secs_f64(),
        }));
    }
    output.result(&format!(
        "`{}` holds {touches} touches and {cells} touched cells; forgotten, in {}: {}.\n",
        args.output.display(),
        seconds(elapsed),
        listed(&forgotten)
    ))
}
