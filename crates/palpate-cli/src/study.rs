//! `palpate study`: which settings hold for objects that they were not chosen on.

use std::path::PathBuf;

use palpate::MapperConfig;
use palpate_learn::study::{ObjectScores, TouchScore, chosen_on_others, mean};
use palpate_work::evaluate::as_touches;
use palpate_work::study::StudiedObject;
use serde_json::json;

use crate::error::CliError;
use crate::output::{Output, figure, table};
use crate::place::Places;
use crate::settings::AllSettings;
use crate::{interrupt, logs};

const NOTES: &str = "Examples:
  palpate study plant_a/ plant_b/ cushion/ --truth
  palpate study lab/*/ --distances-m 0.024,0.03,0.036 --frictions 0.05,0.1,0.3
  palpate study lab/*/ --prior-stds 1,2,4 --curve --json > study.json

Each OBJECT is a log, or a folder of them, of touches of one object. Each touch is predicted from the other
touches of its object under the given settings and under every combination of those listed. The table has the
mean relative error of each object under each of them (predicting zero has 1.00), then:

  best of each          the best settings of each object, which nobody knows beforehand
  chosen on the others  the settings that are best on average over all other objects

What the second row loses to the first is what settings that are shipped cost an object that they
were not chosen on.";

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
    /// Standard deviations of the prior to try, N/m
    #[arg(long, value_name = "STD", value_delimiter = ',')]
    prior_stds: Vec<f64>,
    /// Multiples of the torque noise to try
    #[arg(long, value_name = "FACTOR", value_delimiter = ',')]
    torque_noise: Vec<f64>,
    /// Use every N-th frame, as worth N of them
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    every: u32,
    /// Also predict from 1, 2, 4 and more touches, under the given settings
    #[arg(long)]
    curve: bool,
    /// Score against truth/ beside the touches, which simulated logs have, not against what was measured
    #[arg(long)]
    truth: bool,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: AllSettings,
}

/// An object with how well its touches were predicted.
struct Studied {
    name: String,
    configs: Vec<MapperConfig>,
    scores: ObjectScores,
}

/// Studies all objects, one after the other.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings = args.settings.load_without_body()?;
    args.grid(&settings.config()?)?;
    drop(Places::read(&args.settings, &settings, &args.objects));
    interrupt::listen();
    let mut studied = Vec::new();
    for object in &args.objects {
        let mut settings = settings.clone();
        let log = std::slice::from_ref(object);
        let (touches, arm) = logs::open(log, &mut settings, output)?;
        let recorded = logs::read(touches, &arm, &settings, None, output)?;
        let touches = as_touches(&recorded, args.truth)?;
        let configs = args.grid(&settings.config()?)?;
        let name = object.file_name().unwrap_or(object.as_os_str()).to_string_lossy().into_owned();
        let (recorded, touches) = (&recorded[..], &touches[..]);
        let of = StudiedObject { name: &name, arm: &arm, recorded, touches };
        let scores = of.study(&configs, (args.every as usize, args.curve), output)?;
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
        let listed = |list: &[f64], given: f64| {
            if list.is_empty() { vec![given] } else { list.to_vec() }
        };
        let (contact, prior) = (&given.contact, &given.estimator.prior);
        let mut grid = vec![given.clone()];
        for &distance_m in &listed(&self.distances_m, contact.contact_distance_m) {
            for &friction in &listed(&self.frictions, contact.friction) {
                for &prior_std in &listed(&self.prior_stds, prior.std_n_per_m) {
                    for &noise in &listed(&self.torque_noise, 1.0) {
                        let mut config = given.clone();
                        config.contact.contact_distance_m = distance_m;
                        config.contact.friction = friction;
                        config.estimator.prior.std_n_per_m = prior_std;
                        config.estimator.torque_std.iter_mut().for_each(|std| *std *= noise);
                        config
                            .contact
                            .check()
                            .map_err(|error| CliError::Usage(error.to_string()))?;
                        drop(
                            config
                                .estimator(1)
                                .map_err(|error| CliError::Usage(error.to_string()))?,
                        );
                        if !grid.contains(&config) {
                            grid.push(config);
                        }
                    }
                }
            }
        }
        Ok(grid)
    }
}

/// The tables.
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
    if settings.len() > 1 {
        let best =
            |scores: &Vec<Option<f64>>| scores.iter().copied().flatten().min_by(f64::total_cmp);
        rows.push(row("best of each".to_owned(), relative.iter().map(best).collect()));
        let on_others = |(scores, chosen): (&Vec<Option<f64>>, &Option<usize>)| scores[(*chosen)?];
        let on_others = relative.iter().zip(chosen).map(on_others).collect();
        rows.push(row("chosen on the others".to_owned(), on_others));
    }
    let mut text =
        "Mean relative error of touches that were not learnt; predicting zero: 1.00\n\n".to_owned();
    text += &table(&head, rows);
    text += "\nUnder the given settings\n\n";
    text += &parts(studied);
    let longest = studied.iter().map(|object| object.scores.by_touches_learnt.len()).max();
    if longest.is_some_and(|longest| longest > 0) {
        text += "\nBy touches learnt, under the given settings\n\n";
        text += &curves(studied);
    }
    text
}

/// What tells settings of a study apart.
fn label(config: &MapperConfig) -> String {
    let (contact, estimator) = (&config.contact, &config.estimator);
    let stds = &estimator.torque_std;
    format!(
        "{:.0} mm, friction {}, prior std {}, noise {:.2}",
        1000.0 * contact.contact_distance_m,
        contact.friction,
        estimator.prior.std_n_per_m,
        stds.iter().sum::<f64>() / stds.len() as f64
    )
}

/// Errors by parts of the frames, and the worst touch.
fn parts(studied: &[Studied]) -> String {
    let head = ["object", "all", "loading", "unloading", "met", "unmet", "worst touch", ""];
    let rows = studied.iter().map(|object| {
        let touches = &object.scores.settings[0];
        let of: [fn(&TouchScore) -> Option<f64>; 5] =
            [|s| s.relative, |s| s.loading, |s| s.unloading, |s| s.met, |s| s.unmet];
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

/// A row an object, a column a number of touches.
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
