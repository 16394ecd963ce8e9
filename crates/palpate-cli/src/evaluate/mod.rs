//! `palpate evaluate`: the paper's experiment (Sec. III-A) on any touches.
//!
//! [`run`] is the command; [`kept`] stores finished pieces, so that an interrupted evaluation can
//! continue; [`summary`] is what it prints.

mod kept;
mod summary;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use askama::Template;
use palpate::{Arm, Field, MapperConfig};
use palpate_io::cloud::Cloud;
use palpate_io::log::is_simulated;
use palpate_learn::method::Method;
use palpate_work::csv;
use palpate_work::elastic::replace_elastic_by_map;
use palpate_work::evaluate::{
    Evaluated, EvaluationJob, configs, folds, make_unique, method_of, methods_to_compare,
    touch_samples,
};
use palpate_work::tune::{Tune, given};

use crate::error::CliError;
use crate::file_paths::Folder;
use crate::object_args::ObjectArgs;
use crate::output::Output;
use crate::report::{Page, Report, Scene, errors_csv};
use crate::settings::{AllSettings, Settings};
use crate::{file_paths, interrupt, logs, picture};

use kept::Kept;
pub(crate) use summary::EvaluationSummary;

const NOTES: &str = "Examples:
  palpate evaluate recordings/
  palpate evaluate plant_a/ --truth --methods map,knn,zero -o plant_a_evaluation
  palpate evaluate monday/ tuesday/ --robot panda.urdf --gravity removed --folds 5
  palpate evaluate recordings/ --test push_7,push_8
  palpate evaluate plant_a/ --cloud plant_a/object.ply

Every touch is predicted by methods that have learnt from other touches only: \
leave-one-touch-out, or --folds groups of touches, or the touches named by --test from all \
others. The methods are

  map      the exact maximum a posteriori      mlp  network, two layers of 128, Adam
  ekf      the paper's filter                  gp   Gaussian process, RBF kernel
  uniform  one stiffness for all points        knn  50 nearest neighbours, RBF weights
  zero     no torque at all
  elastic  with --cloud: an elastic body made from the cloud, and map for the rest of the torque

Of these, mlp, gp and knn use joint angles only, and choose their hyperparameters on their \
training touches. All methods learn the same external torques: gravity and tare are subtracted.

Errors are those of the paper's Table I for each touch, then mean and standard deviation over \
touches. A touch that never reaches 1 N·m has no relative error, and is named.

The folder of results gets report.html, which opens in a browser without a network, errors.csv, a \
picture for papers, and evaluation.json with every predicted torque. After Ctrl-C, the same \
command continues from the finished parts.

[estimator] in the settings applies to the estimator that it names (map by default); the other \
one keeps its default settings.

--json prints {\"methods\": [{\"name\", avg_error, max_error, avg_relative, max_relative, each \
{\"mean\", \"std\"}}], \"touches\": [...]}, N·m.";

/// Notes which methods this program was built without, if all methods were requested.
pub(crate) fn note_methods_not_built(output: &Output) {
    if !Method::Gp.is_built() {
        output.note(&palpate_io::not_built("the baselines mlp and gp"));
    }
}

/// Flags of `palpate evaluate`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs of the touches
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Folder for the report and its figures
    #[arg(long, short, value_name = "DIR", default_value = "palpate-evaluation")]
    output: PathBuf,
    /// Methods to compare, in this order [default: all]
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = method_of)]
    methods: Vec<Method>,
    /// Divide the touches into K groups, each predicted from the others, instead of one group per touch
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..))]
    folds: Option<u32>,
    /// Predict these touches, by name, from all others
    #[arg(long, value_name = "TOUCH", value_delimiter = ',', conflicts_with = "folds")]
    test: Vec<String>,
    /// Score against the true torques in truth/ beside the touches, which simulated logs have, instead of
    /// the measured ones
    #[arg(long)]
    truth: bool,
    /// How settings are chosen in every fold, from its training touches only: `quick`: those of map that are not
    /// given, as in `palpate map`; `thorough` (or no value): those of map and ekf, in many minutes; `off`: none
    /// [default: quick]
    #[arg(
        long, value_name = "HOW", num_args = 0..=1, default_missing_value = "thorough",
        require_equals = true, value_parser = Tune::named
    )]
    tune: Option<Tune>,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    object: ObjectArgs,
    #[command(flatten)]
    settings: AllSettings,
}

/// Evaluates all methods and writes the report.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    let has_body = args.object.is_given();
    replace_elastic_by_map(&mut settings, has_body)?;
    settings.config()?;
    let methods = methods_to_compare(&args.methods, has_body)?;
    if args.methods.is_empty() {
        note_methods_not_built(output);
    } else if has_body && !methods.contains(&Method::Elastic) {
        output.note("--methods leaves out `elastic`, the method that uses --cloud and --body");
    }
    let (bodies, cloud) = args.object.bodies(output)?;
    let folder = Folder::make(&args.output, "report.html")?;
    interrupt::listen();
    let (touches, arm) = logs::open(&args.logs, &mut settings, logs::IfUndecided::Refuse, output)?;
    let estimators = configs(&settings)?;
    let recorded = touches.read_to_learn(&arm, &settings, None, output)?;
    let touches = touch_samples(&recorded, args.truth)?;
    let folds = folds(&touches, args.folds, &args.test)?;
    let work = EvaluationJob {
        arm: &arm,
        recorded: &recorded,
        touches: &touches,
        methods,
        todo: (0..folds.len()).collect(),
        folds,
        estimators,
        tune: args.tune.unwrap_or_default(),
        given: given(&settings),
        truth: args.truth,
        bodies,
        tracked: None,
    };
    let origin = Origin {
        simulated: args.logs.iter().all(|log| is_simulated(log)),
        logs: args.logs.iter().map(|log| log.display().to_string()).collect(),
        settings,
        cloud,
    };
    let (summary, written) = into_folder(&work, &folder.path, &origin, output)?;
    if args.json {
        output.json(&summary.json())?
    } else {
        output.result(&summary.text())?
    }
    written
}

/// Where the touches of an evaluation come from.
pub(crate) struct Origin {
    /// Whether all touches are simulated.
    pub(crate) simulated: bool,
    /// The logs, as the user named them.
    pub(crate) logs: Vec<String>,
    /// The settings as they were given.
    pub(crate) settings: Settings,
    /// The cloud of the object, if there is one.
    pub(crate) cloud: Option<Cloud>,
}

/// Evaluates, and writes the report and its figures into a folder. Returns the summary, and separately
/// whether the report could be written, so that the results of hours of work are printed in any case.
pub(crate) fn into_folder(
    work: &EvaluationJob<'_>,
    folder: &Path,
    origin: &Origin,
    output: &Output,
) -> Result<(EvaluationSummary, Result<(), CliError>), CliError> {
    let kept = Kept::open(folder, work, *output)?;
    let mut evaluated = work.evaluate(&kept, output)?;
    let field = work.field(&mut evaluated, (&kept, output))?;
    let settings_toml = settings_toml(&evaluated, &origin.settings)?;
    let mut summary = EvaluationSummary {
        evaluation: evaluated.evaluation,
        simulated: origin.simulated,
        folds: work.folds.len(),
        folder: Some(folder.to_owned()),
    };
    summary.note_oddities(output);
    let shown = (work.arm, &field);
    let written = write_report(&summary, shown, (origin, &settings_toml), (folder, output));
    match written {
        Ok(()) => kept.remove(),
        Err(_) => summary.folder = None,
    }
    Ok((summary, written))
}

/// Writes the report, and files beside it, into a folder.
fn write_report(
    summary: &EvaluationSummary,
    (arm, field): (&Arc<Arm>, &Field),
    (origin, settings_toml): (&Origin, &str),
    (folder, output): (&Path, &Output),
) -> Result<(), CliError> {
    let evaluation = &summary.evaluation;
    let robot = origin.settings.robot.name().to_owned();
    let page = Page {
        title: &summary.title(),
        simulated: origin.simulated,
        card: vec![("logs", origin.logs.join(", ")), ("robot", robot)],
        settings_toml,
    };
    let scene = Scene::new(arm, field, evaluation)?;
    let cloud = origin.cloud.as_ref();
    let scene = Some(scene.bending((arm, field), evaluation, cloud, output)?);
    let report = Report { page, evaluation, scene };
    let write = |name: &str, text: &str| file_paths::write(&folder.join(name), text);
    let figures = folder.join("figures");
    let what = format!("the folder `{}`", figures.display());
    std::fs::create_dir_all(&figures).map_err(|source| CliError::Write { what, source })?;
    let mut names = vec!["field".to_owned()];
    let mut index = vec![vec!["file".to_owned(), "touch".to_owned()]];
    for touch in evaluation.touches.iter().filter(|touch| !touch.time_s.is_empty()) {
        let mut name = plain(&touch.name);
        make_unique(&mut name, &mut names);
        write(&format!("figures/{name}.svg"), &picture::errors(touch)?)?;
        index.push(vec![format!("{name}.svg"), touch.name.clone()]);
    }
    write("figures/index.csv", &csv::text(index))?;
    write("figures/field.svg", &picture::field(field)?)?;
    write("errors.csv", &errors_csv(evaluation))?;
    write("evaluation.json", &serde_json::to_string(evaluation).map_err(CliError::file)?)?;
    write("report.html", &report.render().map_err(CliError::file)?)
}

/// A touch's name as a file name, or "touch" if it is too long, empty or has characters that are unusual
/// in file names.
fn plain(name: &str) -> String {
    let name = name.replace(['/', '\\'], "_");
    let is_plain = |c: char| c.is_alphanumeric() || " ._-#()+,".contains(c);
    let is_odd = name.len() > 100
        || name.is_empty()
        || name.starts_with([' ', '.', '-'])
        || !name.chars().all(is_plain);
    if is_odd { "touch".to_owned() } else { name }
}

/// The settings as TOML, with the tuned settings of each fold as comments.
fn settings_toml(evaluated: &Evaluated, settings: &Settings) -> Result<String, CliError> {
    let mut text = settings.template()?;
    for (fold, [map, ekf]) in evaluated.tuned.iter().flatten().enumerate() {
        for (name, config) in [("map", map), ("ekf", ekf)] {
            text += &format!("\n# fold {fold}, {name}: {}", tuned_line(config));
        }
    }
    Ok(text)
}

/// The settings that tuning chooses, in one line.
fn tuned_line(config: &MapperConfig) -> String {
    let (contact, estimator) = (&config.contact, &config.estimator);
    let stds: Vec<String> = estimator.torque_std.iter().map(|std| format!("{std:.3}")).collect();
    format!(
        "contact_distance_m = {:.4}, friction = {:.3}, coulomb_friction = {:.3}, prior_mean = {:.4}, prior_std = {:.3}, \
         torque_std = [{}], stiffness_scale = {:.2}, replays = {}",
        contact.contact_distance_m,
        contact.friction,
        contact.coulomb_friction,
        estimator.prior.mean_n_per_m,
        estimator.prior.std_n_per_m,
        stds.join(", "),
        estimator.stiffness_scale,
        estimator.replays
    )
}
