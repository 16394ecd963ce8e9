//! `palpate evaluate`: the paper's experiment (Sec. III-A) on anyone's touches.
//!
//! [`run`] is the command; [`mod@work`] does what there is to do; [`mod@kept`] keeps what is done,
//! so that an evaluation goes on where it was broken off; [`mod@told`] says what came out.

mod kept;
mod told;
mod work;

use std::path::{Path, PathBuf};

use palpate::estimator::Method;
use palpate::mapper::Config;
use palpate_io::log::{external_truth, is_simulated};
use palpate_learn::contender::Contender;
use palpate_learn::folds::{Fold, folds};
use palpate_learn::tracked::Touch;

use crate::error::CliError;
use crate::output::Output;
use crate::place::Folder;
use crate::report::{Report, Scene, errors_csv};
use crate::settings::sections::EstimatorSettings;
use crate::settings::{AllSettings, Settings, SettingsError};
use crate::touches::{Recorded, Touches};
use crate::{interrupt, picture, place, robot};

pub(crate) use work::{Evaluated, Work, track_fault};

const NOTES: &str = "Examples:
  palpate evaluate recordings/
  palpate evaluate plant_a/ --truth --methods map,knn,zero -o plant_a_evaluation
  palpate evaluate monday/ tuesday/ --robot panda.urdf --gravity removed --folds 5
  palpate evaluate recordings/ --test push_7,push_8

Every touch is predicted by methods that have learnt from other touches alone: leave-one-touch-out,
or --folds groups of touches, or the touches named by --test from all others. The methods are

  map      the exact maximum a posteriori      mlp  network, two layers of 128, Adam
  ekf      the paper's filter                  gp   Gaussian process, RBF kernel
  uniform  one stiffness for all points        knn  50 nearest neighbours, RBF weights
  zero     no torque at all

of which mlp, gp and knn see joint angles alone, and choose what they have to choose on their
training touches. All of them see the same external torques: gravity and tare taken off.

Errors are those of the paper's Table I for each touch, then mean and standard deviation over
touches. A touch that never reaches 1 N·m has no relative error, and is named.

The folder of results gets report.html, which opens in a browser without a network, errors.csv, a
picture for papers, and evaluation.json with every predicted torque. Ctrl-C keeps what is done; the
same command goes on from there.

[estimator] in the settings is that of the estimator it names (map unless it says ekf); the other
keeps its shipped settings.

--json prints {\"methods\": [{\"name\", avg_error, max_error, avg_relative, max_relative, each
{\"mean\", \"std\"}}], \"touches\": [...]}, N·m.";

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
    /// What to compare, in this order [default: all]
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = contender_of)]
    methods: Vec<Contender>,
    /// Predict the touches in so many groups rather than one by one
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(2..))]
    folds: Option<u32>,
    /// Predict these touches, by name, from all others
    #[arg(long, value_name = "TOUCH", value_delimiter = ',', conflicts_with = "folds")]
    test: Vec<String>,
    /// Score against truth/ beside the touches, which simulated logs have, not against what was
    /// measured
    #[arg(long)]
    truth: bool,
    /// Choose the settings of map and ekf anew in every fold, from its training touches alone
    #[arg(long)]
    tune: bool,
    /// Print the table as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: AllSettings,
}

/// A method by its name.
fn contender_of(name: &str) -> Result<Contender, String> {
    let of = |contender: &&Contender| contender.name() == name;
    Contender::ALL.iter().find(of).copied().ok_or_else(|| {
        let names: Vec<&str> = Contender::ALL.iter().map(|contender| contender.name()).collect();
        format!("there are {}", names.join(", "))
    })
}

/// Evaluates all methods and writes the report.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    settings.config()?;
    let folder = Folder::make(&args.output, "report.html")?;
    interrupt::listen();
    let touches = Touches::open(&args.logs, &settings.log.options())?;
    touches.settle(&mut settings.touch, output)?;
    let estimators = configs(&settings)?;
    let arm = robot::load(&settings.robot, output)?;
    settings.log.check_for(&arm.robot)?;

    let config = settings.config()?;
    let mut touches = touches.for_arm(&arm, &settings.log, (config.lattice, config.contact))?;
    let recorded = touches.read(None)?;
    touches.tell_warnings(output);
    let touches = as_touches(&recorded, args.truth)?;
    let work = Work {
        arm: &arm,
        recorded: &recorded,
        touches: &touches,
        contenders: args.contenders(),
        folds: args.folds(&touches)?,
        estimators,
        tune: args.tune,
        truth: args.truth,
    };
    let origin = Origin {
        simulated: args.logs.iter().all(|log| is_simulated(log)),
        logs: args.logs.iter().map(|log| log.display().to_string()).collect(),
        settings,
    };
    let evaluated = into_folder(&work, &folder.path, &origin, output)?;
    let told = work.told(&evaluated, &folder.path, &origin);
    if args.json { output.json(&told.json()) } else { output.result(&told.text()) }
}

/// Where the touches of an evaluation come from.
pub(crate) struct Origin {
    /// Whether they are simulated.
    pub(crate) simulated: bool,
    /// The logs, as the user calls them.
    pub(crate) logs: Vec<String>,
    /// The settings as they were given.
    pub(crate) settings: Settings,
}

/// Evaluates, and writes the report and its figures into a folder.
pub(crate) fn into_folder(
    work: &Work<'_>,
    folder: &Path,
    origin: &Origin,
    output: &Output,
) -> Result<Evaluated, CliError> {
    let evaluated = work.evaluate(folder, output)?;
    let (evaluation, told) = (&evaluated.evaluation, work.told(&evaluated, folder, origin));
    let robot = origin.settings.robot.name().to_owned();
    let report = Report {
        title: &told.title(),
        evaluation,
        simulated: origin.simulated,
        settings_toml: &evaluated.settings_toml(&origin.settings)?,
        data: &[("logs".to_owned(), origin.logs.join(", ")), ("robot".to_owned(), robot)],
        scene: Some(Scene::new(work.arm, &evaluated.field, evaluation)?),
    };
    let write = |name: &str, text: &str| place::write(&folder.join(name), text);
    let figures = folder.join("figures");
    let what = format!("the folder `{}`", figures.display());
    std::fs::create_dir_all(&figures).map_err(|source| CliError::Write { what, source })?;
    let mut names = vec!["field".to_owned()];
    for touch in evaluation.touches.iter().filter(|touch| !touch.time_s.is_empty()) {
        let mut name = touch.name.replace(['/', '\\'], "_");
        number(&mut name, &mut names);
        write(&format!("figures/{name}.svg"), &picture::errors(touch)?)?;
    }
    write("figures/field.svg", &picture::field(&evaluated.field)?)?;
    write("errors.csv", &errors_csv(evaluation))?;
    write("evaluation.json", &serde_json::to_string(evaluation).map_err(CliError::file)?)?;
    write("report.html", &report.html()?)?;
    told.tell_oddities(output);
    Ok(evaluated)
}

impl Args {
    /// The methods, each once.
    fn contenders(&self) -> Vec<Contender> {
        let mut contenders: Vec<Contender> = Vec::new();
        let all: &[Contender] =
            if self.methods.is_empty() { &Contender::ALL } else { &self.methods };
        for contender in all {
            if !contenders.contains(contender) {
                contenders.push(*contender);
            }
        }
        contenders
    }

    /// Which touches are predicted from which.
    fn folds(&self, touches: &[Touch]) -> Result<Vec<Fold>, CliError> {
        let n = touches.len();
        if n < 2 {
            return Err(CliError::from(format!(
                "the log holds {n} {}; an evaluation needs at least two, one to learn from and one \
                 to predict; `palpate inspect` says what a log holds",
                if n == 1 { "touch" } else { "touches" }
            )));
        }
        if !self.test.is_empty() {
            let place = |name: &String| {
                touches.iter().position(|touch| touch.name == *name).ok_or_else(|| {
                    let names: Vec<&str> = touches.iter().map(|touch| &*touch.name).collect();
                    CliError::Usage(format!(
                        "--test names touch `{name}`, which is none of {}",
                        names.join(", ")
                    ))
                })
            };
            let mut test = self.test.iter().map(place).collect::<Result<Vec<usize>, _>>()?;
            test.sort_unstable();
            test.dedup();
            let fold = Fold::testing(test, n);
            if fold.train.is_empty() {
                let all = "--test names every touch, so that none is left to learn from".to_owned();
                return Err(CliError::Usage(all));
            }
            return Ok(vec![fold]);
        }
        match self.folds {
            Some(k) if k as usize > n => Err(CliError::Usage(format!(
                "--folds is {k}, but there are only {n} touches; {n} is leave-one-touch-out"
            ))),
            Some(k) => Ok(folds(n, k as usize)),
            None => Ok(folds(n, n)),
        }
    }
}

/// The configurations of `map` and `ekf`.
pub(crate) fn configs(settings: &Settings) -> Result<[Config; 2], SettingsError> {
    let named = settings.estimator.estimator.unwrap_or_default();
    let of = |method: Method| {
        let estimator = if method == named {
            settings.estimator.clone()
        } else {
            EstimatorSettings { estimator: Some(method), ..EstimatorSettings::default() }
        };
        Settings { estimator, ..settings.clone() }.config()
    };
    Ok([of(Method::Map)?, of(Method::Ekf)?])
}

/// The touches as they are evaluated, with names that tell them apart.
pub(crate) fn as_touches(recorded: &[Recorded], truth: bool) -> Result<Vec<Touch>, CliError> {
    let mut names = Vec::new();
    let touch = |one: &Recorded| {
        let ambiguous = recorded.iter().filter(|other| other.name == one.name).count() > 1;
        let log = one.log.file_name().map(|name| name.to_string_lossy().into_owned());
        let mut name = match log {
            Some(log) if ambiguous => format!("{log}/{}", one.name),
            _ => one.name.clone(),
        };
        number(&mut name, &mut names);
        let missing = || {
            format!(
                "`{}` holds no truth of touch `{name}`: there is no \
                 truth/{name}_external.npy; leave out --truth to score against what was measured",
                one.log.display(),
                name = one.name,
            )
        };
        let truth =
            truth.then(|| external_truth(&one.log, &one.name)?.ok_or_else(|| missing().into()));
        let truth = truth.transpose().map_err(|error: CliError| error)?;
        Ok(Touch { name, samples: one.samples.clone(), truth })
    };
    recorded.iter().map(touch).collect()
}

/// Makes a name differ from those taken, by a number, and takes it.
fn number(name: &mut String, taken: &mut Vec<String>) {
    let plain = name.clone();
    let mut times = 1;
    while taken.contains(name) {
        times += 1;
        *name = format!("{plain}#{times}");
    }
    taken.push(name.clone());
}
