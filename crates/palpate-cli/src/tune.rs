//! `palpate tune`: settings for one's own robot and object, chosen on one's own touches.

use std::fmt::Write;
use std::path::PathBuf;

use palpate::MapperConfig;
use palpate_learn::tune::Tuned;
use palpate_work::evaluate::touch_samples;
use palpate_work::tune::{Tuning, given, trials, tuned_settings};
use serde_json::json;

use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::output::{Output, figure, table};
use crate::settings::{AllSettings, Settings};
use crate::{file_paths, interrupt, logs};

const NOTES: &str = "Examples:
  palpate tune recordings/ -o tuned.toml
  palpate tune recordings/ --estimator ekf --candidates 40 -o tuned_ekf.toml
  palpate map recordings/ --settings tuned.toml -o field.npz

Contact distance, friction, Coulomb friction, prior, torque noise, replays and stiffness scale are chosen by \
cross-validation: touches are predicted from other touches under candidate settings around the \
given ones, and successive halving keeps the better third of them, then the best. Only measured \
torques are used, never truth/.

To know how well tuned settings predict touches that they were not chosen on, use `palpate \
evaluate --tune=thorough`, which chooses them anew in every fold.";

/// Flags of `palpate tune`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs of the touches
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Output file of the settings, with the errors of all candidates as comments
    #[arg(long, short, value_name = "FILE.toml")]
    output: PathBuf,
    /// Number of candidate settings, including the given ones [default: 24, 12 for ekf]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1000))]
    candidates: Option<u32>,
    /// Choose only settings that are not given, among few candidates, in seconds, as `palpate map` does
    #[arg(long, conflicts_with = "candidates")]
    quick: bool,
    /// Print the errors of all candidates as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: AllSettings,
}

/// Chooses settings and writes them.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load_without_body()?;
    settings.config()?;
    let mut places = FilePaths::read(&args.settings, &settings, &args.logs);
    places.output("the settings (--output)", Some(&args.output))?;
    interrupt::listen();
    let (touches, arm) = logs::open(&args.logs, &mut settings, logs::IfUndecided::Refuse, output)?;
    let config = settings.config()?;
    let recorded = touches.read_to_learn(&arm, &settings, None, output)?;
    let touches = touch_samples(&recorded, false)?;
    let tuned = Tuning { arm: &arm, recorded: &recorded, touches: &touches, config: &config };
    let tuned = if args.quick {
        tuned.quick(given(&settings), output)?
    } else {
        tuned.thorough(args.candidates, output)?
    };

    file_paths::write(&args.output, &toml(&tuned, &settings)?)?;
    if args.json {
        output.json(&json!({ "output": args.output, "trials": trials(&tuned) }))
    } else {
        let next = args.output.display();
        output.result(&format!(
            "{}\nThe settings are in `{next}`.\nNext: palpate map LOG --settings {next}\n",
            evidence(&tuned, &config)
        ))
    }
}

/// The settings as a file that `--settings` reads, with the table of candidates as comments on top.
fn toml(tuned: &Tuned, given: &Settings) -> Result<String, CliError> {
    let settings = tuned_settings(tuned, given);
    let mut text = String::new();
    for line in evidence(tuned, &given.config()?).lines() {
        let _ = writeln!(text, "{}", format!("# {line}").trim_end());
    }
    Ok(format!("{text}\n{}", settings.template()?))
}

/// A table with a row for each candidate: its settings, and its error in each round.
fn evidence(tuned: &Tuned, given: &MapperConfig) -> String {
    let text = "Chosen by cross-validation: mean relative error on measured torques of held-out \
                touches, on thinned frames.\nRound 1 has few folds, round 2 more, round 3 is \
                leave-one-touch-out.\n\n"
        .to_owned();
    let settings = [
        "distance m",
        "friction",
        "Coulomb",
        "prior mean",
        "prior std",
        "torque std",
        "replays",
        "scale",
    ];
    let head = [&settings[..], &["round 1", "round 2", "round 3", ""]].concat();
    let rows = tuned.trials.iter().map(|trial| {
        let (contact, estimator) = (&trial.config.contact, &trial.config.estimator);
        let stds = &estimator.torque_std;
        let std = stds.iter().sum::<f64>() / stds.len() as f64;
        let mut row = vec![
            format!("{:.4}", contact.contact_distance_m),
            format!("{:.2}", contact.friction),
            format!("{:.2}", contact.coulomb_friction),
            format!("{:.4}", estimator.prior.mean_n_per_m),
            format!("{:.2}", estimator.prior.std_n_per_m),
            format!("{std:.3}"),
            estimator.replays.to_string(),
            format!("{:.2}", estimator.stiffness_scale),
        ];
        row.extend((0..3).map(|round| figure(trial.scores.get(round).copied(), 4)));
        let mut as_given = trial.config.clone();
        as_given.estimator.stiffness_scale = given.estimator.stiffness_scale;
        row.push(if as_given == *given { "given" } else { "" }.to_owned());
        row
    });
    text + &table(&head, rows)
}
