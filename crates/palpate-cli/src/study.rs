//! `palpate study`: how well settings work on objects that they were not chosen on.

use std::path::PathBuf;

use palpate::{EstimatorKind, MapperConfig};
use palpate_learn::study::{
    NEAR_DEGREES, ObjectScores, StudyPlan, TouchScore, chosen_on_others, mean,
};
use palpate_learn::tune::FixedSettings;
use palpate_work::evaluate::{make_unique, touch_samples};
use palpate_work::study::{StudiedObject, at_least_two};
use palpate_work::tune::{Tune, given};
use serde_json::json;

use crate::args::quick_or_off;
use crate::error::CliError;
use crate::output::{Output, figure, table};
use crate::settings::{AllSettings, Settings};
use crate::{file_paths, interrupt, logs};

const NOTES: &str = "Examples:
  palpate study plant_a/ plant_b/ cushion/ --truth
  palpate study lab/*/ --distances-m 0.024,0.03,0.036 --frictions 0.05,0.1,0.3
  palpate study lab/*/ --prior-stds 1,2,4 --curve --json > study.json

Each OBJECT is a log, or a folder of them, of touches of one object. Each touch is predicted from \
the other touches of its object under the given settings and under every combination of those \
listed. The table has the mean relative error of each object under each of them (predicting zero \
has 1.00), then:

  best of each          the best settings of each object, which are not known beforehand
  chosen on the others  the settings that are best on average over all other objects
  chosen by map         for each touch, the settings that `map` chooses from the others

The difference between `best of each` and `chosen on the others` is what an object loses by settings \
that were chosen on other objects, such as the defaults. The second table divides the frames, under the settings that \
`map` chooses, or else under the given ones.";

/// Flags of `palpate study`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs of touches, one for each object
    #[arg(required = true, value_name = "OBJECT")]
    objects: Vec<PathBuf>,
    /// Contact distances to try, m
    #[arg(long, value_name = "M", value_delimiter = ',')]
    distances_m: Vec<f64>,
    /// Friction coefficients to try
    #[arg(long, value_name = "MU", value_delimiter = ',')]
    frictions: Vec<f64>,
    /// Coefficients of Coulomb friction to try
    #[arg(long, value_name = "MU", value_delimiter = ',')]
    coulomb_frictions: Vec<f64>,
    /// Means of the prior to try, N/m
    #[arg(long, value_name = "MEAN", value_delimiter = ',')]
    prior_means: Vec<f64>,
    /// Standard deviations of the prior to try, N/m
    #[arg(long, value_name = "STD", value_delimiter = ',')]
    prior_stds: Vec<f64>,
    /// Multiples of the torque noise to try
    #[arg(long, value_name = "FACTOR", value_delimiter = ',')]
    torque_noise: Vec<f64>,
    /// Use every N-th frame, with N times the weight
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    every: u32,
    /// Also predict from 1, 2, 4 and more touches, under the given settings
    #[arg(long)]
    curve: bool,
    /// Whether each touch is also predicted under settings that `map` chooses: `quick` or `off` [default: quick; off with
    /// --estimator ekf]
    #[arg(
        long, value_name = "HOW", num_args = 0..=1, default_missing_value = "quick",
        require_equals = true, value_parser = quick_or_off
    )]
    tune: Option<Tune>,
    /// Score against the true torques in truth/ beside the touches, which simulated logs have, instead of the measured
    /// ones
    #[arg(long)]
    truth: bool,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: AllSettings,
}

/// An object with its settings and the scores of its touches.
struct Studied {
    name: String,
    configs: Vec<MapperConfig>,
    scores: ObjectScores,
}

/// Reads all objects, then studies one after the other.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = args.settings.load_without_body()?;
    args.grid(&settings.config()?)?;
    let choose = args.choose(&settings)?;
    let plan = StudyPlan { every: args.every as usize, curve: args.curve, choose };
    args.check_objects()?;
    interrupt::listen();
    let mut names = Vec::new();
    let mut read = Vec::new();
    for object in &args.objects {
        let mut name = file_paths::last_part(object);
        make_unique(&mut name, &mut names);
        let mut settings = settings.clone();
        let (touches, arm) = logs::open(
            std::slice::from_ref(object),
            &mut settings,
            logs::IfUndecided::Refuse,
            output,
        )?;
        let recorded = touches.read_to_learn(&arm, &settings, None, output)?;
        let touches = touch_samples(&recorded, args.truth)?;
        at_least_two(&name, &touches)?;
        read.push((name, arm, recorded, touches, args.grid(&settings.config()?)?));
    }
    let mut studied = Vec::new();
    for (name, arm, recorded, touches, configs) in read {
        let (recorded, touches) = (&recorded[..], &touches[..]);
        let of = StudiedObject { name: &name, arm: &arm, recorded, touches };
        let scores = of.study(&configs, plan, output)?;
        studied.push(Studied { name, configs, scores });
    }
    let relative: Vec<_> = studied.iter().map(|object| object.scores.relative()).collect();
    let chosen = chosen_on_others(&relative);
    if !args.json {
        return output.result(&text(&studied, &relative, &chosen));
    }
    let objects = studied.iter().zip(&relative).zip(&chosen).map(|((object, relative), chosen)| {
        json!({
            "name": object.name,
            "avg_relative": relative,
            "chosen_on_others": chosen,
            "touches": object.scores.settings,
            "chosen_by_map": {
                "avg_relative": mean(&object.scores.chosen, |score| score.relative),
                "touches": object.scores.chosen,
            },
            "by_touches_learnt": object.scores.by_touches_learnt,
        })
    });
    let against = if args.truth { "truth" } else { "measured" };
    output.json(&json!({
        "settings": studied[0].configs,
        "objects": objects.collect::<Vec<_>>(),
        "against": against,
    }))
}

impl Args {
    /// The given settings, then all combinations of those listed.
    fn grid(&self, given: &MapperConfig) -> Result<Vec<MapperConfig>, CliError> {
        let grid = vec![given.clone()];
        let grid = vary(grid, &self.distances_m, |config, m| config.contact.contact_distance_m = m);
        let grid =
            vary(grid, &self.frictions, |config, friction| config.contact.friction = friction);
        let grid = vary(grid, &self.coulomb_frictions, |config, coulomb| {
            config.contact.coulomb_friction = coulomb;
        });
        let grid = vary(grid, &self.prior_means, |config, mean| {
            config.estimator.prior.mean_n_per_m = mean;
        });
        let grid =
            vary(grid, &self.prior_stds, |config, std| config.estimator.prior.std_n_per_m = std);
        let grid = vary(grid, &self.torque_noise, |config, factor| {
            config.estimator.torque_std.iter_mut().for_each(|std| *std *= factor);
        });
        let mut each_once = vec![given.clone()];
        for config in grid {
            config.contact.check().map_err(|error| CliError::Usage(error.to_string()))?;
            let n_joints = config.estimator.torque_std.len(); // of the arm, or one for all
            drop(config.estimator(n_joints).map_err(|error| CliError::Usage(error.to_string()))?);
            if !each_once.contains(&config) {
                each_once.push(config);
            }
        }
        Ok(each_once)
    }

    /// Which settings `map` does not choose; `None` if it chooses none.
    fn choose(&self, settings: &Settings) -> Result<Option<FixedSettings>, CliError> {
        let is_map = settings.config()?.method == EstimatorKind::Map;
        if self.tune == Some(Tune::Quick) && !is_map {
            return Err(CliError::Usage(
                "settings are chosen for the estimator `map`, not for `ekf`; leave out --tune"
                    .to_owned(),
            ));
        }
        let chooses = self.tune.map_or(is_map, |tune| tune == Tune::Quick);
        Ok(chooses.then(|| given(settings)))
    }

    /// Refuses an object that is given twice: it would choose its own settings.
    fn check_objects(&self) -> Result<(), CliError> {
        let mut seen = Vec::new();
        for object in &self.objects {
            let real = object.canonicalize().unwrap_or_else(|_| object.clone());
            if seen.contains(&real) {
                let twice = object.display();
                return Err(CliError::Usage(format!(
                    "`{twice}` is given twice; wanted each object once"
                )));
            }
            seen.push(real);
        }
        Ok(())
    }
}

/// Every setting of the grid with each of the values; the grid itself if there are no values.
fn vary(
    grid: Vec<MapperConfig>,
    values: &[f64],
    set: impl Fn(&mut MapperConfig, f64),
) -> Vec<MapperConfig> {
    if values.is_empty() {
        return grid;
    }
    let with = |config: &MapperConfig, value: f64| {
        let mut config = config.clone();
        set(&mut config, value);
        config
    };
    grid.iter().flat_map(|config| values.iter().map(|&value| with(config, value))).collect()
}

/// The tables of the study as text.
fn text(studied: &[Studied], relative: &[Vec<Option<f64>>], chosen: &[Option<usize>]) -> String {
    let names: Vec<&str> = studied.iter().map(|object| &*object.name).collect();
    let mut head = vec!["settings"];
    head.extend(&names);
    head.push("mean");
    let settings = &studied[0].configs;
    let row = |name: String, figures: Vec<Option<f64>>| {
        let known: Vec<f64> = figures.iter().copied().flatten().collect();
        let mean = (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64);
        let cells = figures.into_iter().chain([mean]).map(|error| figure(error, 3));
        [name].into_iter().chain(cells).collect::<Vec<String>>()
    };
    let of_setting = |number: usize| relative.iter().map(|scores| scores[number]).collect();
    let mut rows: Vec<Vec<String>> = (settings.iter().enumerate())
        .map(|(number, config)| row(label(config), of_setting(number)))
        .collect();
    if settings.len() > 1 && studied.len() > 1 {
        let best =
            |scores: &Vec<Option<f64>>| scores.iter().copied().flatten().min_by(f64::total_cmp);
        rows.push(row("best of each".to_owned(), relative.iter().map(best).collect()));
        let on_others = |(scores, chosen): (&Vec<Option<f64>>, &Option<usize>)| scores[(*chosen)?];
        let on_others = relative.iter().zip(chosen).map(on_others).collect();
        rows.push(row("chosen on the others".to_owned(), on_others));
    }
    let has_chosen = studied.iter().any(|object| !object.scores.chosen.is_empty());
    if has_chosen {
        let of = |object: &Studied| mean(&object.scores.chosen, |score| score.relative);
        rows.push(row("chosen by map".to_owned(), studied.iter().map(of).collect()));
    }
    let mut text =
        "Mean relative error of touches that were not learnt; predicting zero: 1.00\n\n".to_owned();
    text += &table(&head, rows);
    let under = match has_chosen {
        true => "settings that map chooses (with fewer than four touches, the given ones)",
        false => "given settings",
    };
    text += &format!(
        "\nBy frames, under the {under}.\nLoading: the torque grows; met: other touches touched at least half of the \
         points in contact;\nsame way: other touches pushed these points within {NEAR_DEGREES}° of the same direction\n\n"
    );
    text += &parts(studied);
    let longest = studied.iter().map(|object| object.scores.by_touches_learnt.len()).max();
    if longest.is_some_and(|longest| longest > 0) {
        text += "\nBy number of touches learnt, under the given settings\n\n";
        text += &curves(studied);
    }
    text
}

/// The values in which settings of a study differ.
fn label(config: &MapperConfig) -> String {
    let (contact, estimator) = (&config.contact, &config.estimator);
    let stds = &estimator.torque_std;
    format!(
        "{} mm, friction {}, Coulomb {}, prior {} ± {} N/m, noise {:.3} N·m",
        (1e5 * contact.contact_distance_m).round() / 100.0,
        contact.friction,
        contact.coulomb_friction,
        estimator.prior.mean_n_per_m,
        estimator.prior.std_n_per_m,
        stds.iter().sum::<f64>() / stds.len() as f64
    )
}

/// Errors by parts of the frames, and the worst touch.
fn parts(studied: &[Studied]) -> String {
    let head = [
        "object",
        "all",
        "loading",
        "unloading",
        "met",
        "unmet",
        "same way",
        "other way",
        "worst touch",
        "",
    ];
    let rows = studied.iter().map(|object| {
        let ObjectScores { settings, chosen, .. } = &object.scores;
        let touches = if chosen.is_empty() { &settings[0] } else { chosen };
        let of: [fn(&TouchScore) -> Option<f64>; 7] = [
            |s| s.relative,
            |s| s.loading,
            |s| s.unloading,
            |s| s.met,
            |s| s.unmet,
            |s| s.same_direction,
            |s| s.other_direction,
        ];
        let figures = of.map(|of| figure(mean(touches, of), 3));
        let with_error = touches.iter().filter_map(|touch| Some((touch.relative?, touch)));
        let worst = with_error.max_by(|a, b| a.0.total_cmp(&b.0));
        let worst = worst.map_or(["-".to_owned(), String::new()], |(error, touch)| {
            [format!("{error:.3}"), touch.touch.clone()]
        });
        [object.name.clone()].into_iter().chain(figures).chain(worst).collect()
    });
    table(&head, rows)
}

/// A table with a row for each object and a column for each number of touches.
fn curves(studied: &[Studied]) -> String {
    let longest = studied.iter().map(|object| &object.scores.by_touches_learnt);
    let counts: Vec<usize> = longest
        .max_by_key(|curve| curve.len())
        .map_or(Vec::new(), |curve| curve.iter().map(|(count, _)| *count).collect());
    let names: Vec<String> = counts.iter().map(ToString::to_string).collect();
    let head: Vec<&str> = ["object"].into_iter().chain(names.iter().map(|name| &**name)).collect();
    let rows = studied.iter().map(|object| {
        let of = |count: &usize| {
            let curve = &object.scores.by_touches_learnt;
            figure(curve.iter().find(|(of, _)| of == count).map(|(_, error)| *error), 3)
        };
        [object.name.clone()].into_iter().chain(counts.iter().map(of)).collect()
    });
    table(&head, rows)
}
