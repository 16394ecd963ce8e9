//! `palpate demo`: learns bundled touches, predicts the one that was held out, and evaluates; with `--full`, also
//! chooses settings first, evaluates all methods, and extrapolates the field to the points that a camera saw.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::RangedU64ValueParser;
use palpate::unstable::ElasticBody;
use palpate::{Arm, EstimatorKind, Mapper};
use palpate_io::cloud::{self, Cloud};
use palpate_io::field::{self, SavedField};
use palpate_io::log::LogOptions;
use palpate_learn::body::ObjectHints;
use palpate_learn::folds::folds;
use palpate_learn::method::Method;
use palpate_work::elastic::{bodies, learn_body, replace_elastic_by_map};
use palpate_work::evaluate::{EvaluationJob, configs, methods_to_compare, touch_samples};
use palpate_work::extrapolate::{ExtrapolationJob as Extrapolating, ExtrapolationSettings};
use palpate_work::learn::learn;
use palpate_work::predict::{ReferenceTorque, TouchResult, score};
use palpate_work::prediction_report::{PredictionReport, report_oddities};
use palpate_work::robot;
use palpate_work::touches::{RecordedTouch, Touches};
use palpate_work::tune::{Tune, given, quickly_tuned};
use serde::Serialize;

use crate::error::CliError;
use crate::evaluate::{EvaluationSummary, Origin};
use crate::extrapolate::ExtrapolationSummary;
use crate::file_paths::Folder;
use crate::output::Output;
use crate::settings::sections::{EstimatorSettings, RobotSettings};
use crate::settings::{Settings, SettingsError};
use crate::{bundled, evaluate, extrapolate, file_paths, interrupt, picture, predict};

const ORIGIN: &str = "The touches are simulated: a Kinova Gen3 pushes into a potted plant in \
                      MuJoCo, an engine\nthat shares nothing with palpate's contact model. No \
                      real robot took part.\n";

/// Number of random halves of the touches on which the extrapolation is tested.
const HALVES: u32 = 3;

/// Number of groups of touches in the evaluation without `--full`, each predicted from the others.
const GROUPS: usize = 6;
/// Methods of the evaluation without `--full`.
const QUICK: [Method; 4] = [Method::Map, Method::Knn, Method::Uniform, Method::Zero];

/// Flags of `palpate demo`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the field and the pictures
    #[arg(long, short, value_name = "DIR", default_value = "palpate-demo")]
    output: PathBuf,
    /// Number of the bundled touch, from 0 to 10, that is held out and predicted
    #[arg(long, value_name = "N", default_value_t = bundled::COUNT - 1, value_parser = of_bundled())]
    hold_out: usize,
    /// Choose settings, evaluate all methods by leaving out each touch, and extrapolate, in a few minutes
    #[arg(long, conflicts_with = "no_report")]
    full: bool,
    /// Leave out the report: the evaluation on all touches
    #[arg(long)]
    no_report: bool,
    /// Print the errors as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    estimator: EstimatorSettings,
}

/// A parser for the number of a bundled touch.
fn of_bundled() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(..bundled::COUNT as u64)
}

/// Maps all touches but one, predicts that one, and evaluates on all touches.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = Settings { estimator: args.estimator.clone(), ..Settings::default() };
    settings.check()?;
    let mut config = settings.config()?;
    let folder = Folder::make(&args.output, "field.npz")?;
    interrupt::listen();

    let mut files = bundled::unpack()?;
    let open = |paths: &[PathBuf]| Touches::open(paths, &LogOptions::default());
    let recorded = open(&files.touches)?.read(None)?;
    let held_out = files.touches.remove(args.hold_out);

    let picture = Picture::of(&settings, &files.object, output)?;
    let arm = robot::load(&RobotSettings::default(), output)?;
    let mut calibration = None;
    if args.full && config.method == EstimatorKind::Map {
        let chosen = quickly_tuned(open(&files.touches)?, (&arm, &settings, &config), output)?;
        (config, calibration) = (chosen.config, chosen.calibration);
    }
    let mapper = Mapper::new(Arc::clone(&arm), config).map_err(SettingsError::value)?;
    let mut mapper = mapper.with_calibration(calibration);
    let mut samples = Vec::new();
    let record = (!picture.bodies.is_empty()).then_some(&mut samples);
    let tally = learn(&mut mapper, &mut open(&files.touches)?, &mut |_, _, _| (), record, output)?;
    if tally.interrupted.is_some() {
        return Err(CliError::Interrupted { kept: "; nothing was written".to_owned() });
    }
    let saved = learn_body(&mapper, &picture.bodies, samples, output)?;
    let (held_out, touch) = (&mut open(&[held_out])?, saved.field.touch.clone());
    let learnt = (&saved.field, saved.snapshot.as_ref());
    let results = score(&arm, learnt, touch, ReferenceTorque::Measured, (held_out, output))?;
    fill(&folder.path, &saved, &results)?;
    report_oddities(&results, &saved.field, output);
    let report = PredictionReport::new(&results, (&saved.field, ReferenceTorque::Measured));
    if !args.json {
        output.result(&first_errors(&report, tally.touches.len()))?;
    }
    let evaluation = if args.no_report {
        None
    } else {
        Some(args.evaluate(&arm, &recorded, (&folder.path, settings, picture), output)?)
    };
    if args.full {
        extrapolate_all(&arm, &saved, (&files.object, &folder.path), output)?;
    }
    if args.json {
        output.json(&Findings {
            report: &report,
            simulated: true,
            evaluation: evaluation.map(|summary| summary.json()),
            learnt_from: tally.touches.iter().map(|touch| touch.name.as_str()).collect(),
            held_out: results.iter().map(|touch| touch.name.as_str()).collect(),
            folder: &folder.path,
        })
    } else {
        let table = evaluation.map(|summary| summary.text());
        output.result(&args.text(table.as_deref(), &folder.path))
    }
}

/// The bundled cloud and the bodies made from it, for the estimator `elastic`.
#[derive(Default)]
struct Picture {
    bodies: Vec<Arc<ElasticBody>>,
    cloud: Option<Cloud>,
}

impl Picture {
    /// Empty if another estimator is set.
    fn of(settings: &Settings, object: &Path, output: &Output) -> Result<Self, CliError> {
        if settings.estimator.estimator != Some(EstimatorKind::Elastic) {
            return Ok(Self::default());
        }
        let seen = (cloud::read(object).map_err(CliError::file)?.cloud, None);
        let hints = ObjectHints::default();
        let bodies = bodies(std::slice::from_ref(&seen), &hints, "the bundled cloud", output)?;
        Ok(Self { bodies, cloud: Some(seen.0) })
    }
}

/// Extrapolates the field to the bundled cloud; writes Fig. 4 and its page.
fn extrapolate_all(
    arm: &Arc<Arm>,
    saved: &SavedField,
    (object, folder): (&Path, &Path),
    output: &Output,
) -> Result<(), CliError> {
    let cloud = cloud::read(object).map_err(CliError::file)?.cloud;
    let names = [Path::new("field.npz"), Path::new("object.ply")];
    let work = Extrapolating {
        arm,
        saved,
        names,
        cloud: &cloud,
        given: ExtrapolationSettings::default(),
        halves: Some(HALVES),
        drawn: true,
        fills: false,
        kept: "all results are written except the extrapolation to the cloud",
    };
    let found = work.run(output)?;
    let summary = ExtrapolationSummary { work: &work, found: &found, truth: None, simulated: true };
    extrapolate::write(&folder.join("seen.ply"), &cloud, &found.extrapolation)?;
    file_paths::write(&folder.join("fig4.svg"), &summary.picture(None)?)?;
    file_paths::write(&folder.join("seen.html"), &summary.page()?)
}

/// What `--json` prints: the keys of `palpate predict`, and where they come from.
#[derive(Serialize)]
struct Findings<'a> {
    #[serde(flatten)]
    report: &'a PredictionReport,
    simulated: bool,
    learnt_from: Vec<&'a str>,
    held_out: Vec<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    evaluation: Option<serde_json::Value>,
    folder: &'a Path,
}

/// The errors on the touch that was held out, as text.
fn first_errors(report: &PredictionReport, learnt_from: usize) -> String {
    let predicted = predict::text(report);
    format!(
        "{ORIGIN}\nLearnt from {learnt_from} touches, then predicted one held out.\n{predicted}"
    )
}

impl Args {
    /// The paper's experiment on all touches; without `--full`, in groups, by a few methods, with the default settings.
    fn evaluate(
        &self,
        arm: &Arc<Arm>,
        recorded: &[RecordedTouch],
        (folder, mut settings, shown): (&Path, Settings, Picture),
        output: &Output,
    ) -> Result<EvaluationSummary, CliError> {
        let Picture { bodies, cloud } = shown;
        replace_elastic_by_map(&mut settings, !bodies.is_empty())?;
        let touches = touch_samples(recorded, false)?;
        let mut methods = QUICK.to_vec();
        if self.full {
            methods.clear();
            evaluate::note_methods_not_built(output);
        }
        if !bodies.is_empty() {
            methods.insert(0, Method::Elastic);
        }
        let folds = folds(touches.len(), if self.full { touches.len() } else { GROUPS });
        let work = EvaluationJob {
            arm,
            recorded,
            touches: &touches,
            methods: methods_to_compare(&methods, !bodies.is_empty())?,
            todo: (0..folds.len()).collect(),
            folds,
            estimators: configs(&settings)?,
            tune: if self.full { Tune::Quick } else { Tune::Off },
            given: given(&settings),
            truth: false,
            bodies,
            tracked: None,
        };
        let logs = vec!["the bundled touches".to_owned()];
        let origin = Origin { simulated: true, logs, settings, cloud };
        let (summary, written) = evaluate::into_folder(&work, folder, &origin, output)?;
        written.map(|()| summary)
    }

    fn text(&self, evaluation: Option<&str>, folder: &Path) -> String {
        let mut text = String::new();
        if let Some(evaluation) = evaluation {
            let _ = write!(text, "\nThe paper's experiment, on all touches.\n{evaluation}");
        }
        let folder = folder.display();
        let page = if evaluation.is_some() {
            "\n  report.html  all of this, as a page for a browser; figures in figures/"
        } else {
            ""
        };
        let seen = if self.full {
            "\n  seen.html    stiffness extrapolated to all points of the plant that a camera saw\n  \
               fig4.svg     the same as a picture, seen.ply as a cloud"
        } else {
            "\n\n`palpate demo --full` chooses the settings by cross-validation, compares all methods, and \
             extrapolates to\nuntouched points, in a few minutes."
        };
        let _ = write!(
            text,
            "\nIn `{folder}`:\n  \
               field.npz    the field: points, stiffness K [N/m] and its uncertainty\n  \
               field.svg    the field from three sides\n  \
               torques.svg  predicted and measured torques of the touch held out{page}{seen}\n\n\
             Next, with a log of your own:\n  \
               palpate inspect LOG --robot ROBOT.urdf       is the log complete and plausible?\n  \
               palpate map LOG -o field.npz --robot ROBOT.urdf\n  \
               palpate predict field.npz OTHER_LOG --robot ROBOT.urdf\n  \
               palpate evaluate LOG --robot ROBOT.urdf      how accurate are the predictions?\n  \
               palpate extrapolate field.npz CLOUD.ply -o seen.ply --robot ROBOT.urdf\n"
        );
        text
    }
}

/// Writes the field and the pictures.
fn fill(folder: &Path, saved: &SavedField, results: &[TouchResult]) -> Result<(), CliError> {
    file_paths::write(
        &folder.join("torques.svg"),
        &picture::torques(results, (&saved.field, ReferenceTorque::Measured))?,
    )?;
    file_paths::write(&folder.join("field.svg"), &picture::field(&saved.field)?)?;
    field::save(&folder.join("field.npz"), saved).map_err(CliError::file)
}
