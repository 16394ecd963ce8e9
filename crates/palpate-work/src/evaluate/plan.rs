//! What is to be evaluated: methods, settings, touches and folds.

use std::sync::Arc;

use palpate::{Arm, EstimatorKind, MapperConfig};
use palpate_learn::folds::{self, Fold};
use palpate_learn::method::Method;
use palpate_learn::tracked::TouchSamples;

use crate::error::WorkError;
use crate::inspect::counted;
use crate::predict;
use crate::progress::Progress;
use crate::settings::sections::EstimatorSettings;
use crate::settings::{Settings, SettingsError};
use crate::touches::{RecordedTouch, Touches};

/// The method with this name.
///
/// # Errors
///
/// If there is no such method (the message lists all), or if it is not built.
pub fn method_of(name: &str) -> Result<Method, String> {
    let of = |method: &&Method| method.name() == name;
    let method = Method::ALL.iter().find(of).copied().ok_or_else(|| {
        let names: Vec<&str> = Method::ALL.iter().map(|method| method.name()).collect();
        format!("wanted one of {}", names.join(", "))
    })?;
    if method.is_built() {
        Ok(method)
    } else {
        Err(palpate_io::not_built("networks and Gaussian processes"))
    }
}

/// The given methods without repetition; if none is given, all that are built, without [`Method::Elastic`] if there is
/// no body.
///
/// # Errors
///
/// If `elastic` is given and there is no body.
pub fn methods_to_compare(given: &[Method], has_body: bool) -> Result<Vec<Method>, WorkError> {
    if given.contains(&Method::Elastic) && !has_body {
        return Err(WorkError::Usage(
            "the method `elastic` needs a coloured cloud, or a picture with depth, of the object: give it \
             as well (`--cloud object.ply` of `palpate evaluate`)"
                .to_owned(),
        ));
    }
    let mut methods: Vec<Method> = Vec::new();
    let all: &[Method] = if given.is_empty() { &Method::ALL } else { given };
    for method in all.iter().filter(|method| method.is_built()) {
        if !methods.contains(method) && (has_body || *method != Method::Elastic) {
            methods.push(*method);
        }
    }
    Ok(methods)
}

/// Folds of the touches: those named in `test` are predicted from all others, or else each of `groups` groups from the
/// others, or else each touch from all others.
///
/// # Errors
///
/// If there are too few touches for the folds, `groups` is below 2, or no touch has a given name.
pub fn folds(
    touches: &[TouchSamples],
    groups: Option<u32>,
    test: &[String],
) -> Result<Vec<Fold>, WorkError> {
    let n = touches.len();
    if n < 2 {
        return Err(WorkError::from(format!(
            "the log holds {}; an evaluation needs at least two, one to learn from and one to \
             predict; `palpate inspect` says what a log holds",
            counted(n, "touch")
        )));
    }
    if !test.is_empty() {
        return Ok(vec![testing(touches, test)?]);
    }
    match groups {
        Some(k) if k as usize > n => Err(WorkError::Usage(format!(
            "--folds is {k}, but there are only {n} touches; {n} is leave-one-touch-out"
        ))),
        Some(k) if k < 2 => Err(WorkError::Usage(format!(
            "--folds is {k}; wanted at least 2; without --folds, there is one fold for each touch"
        ))),
        Some(k) => Ok(folds::folds(n, k as usize)),
        None => Ok(folds::folds(n, n)),
    }
}

/// Numbers of the folds in share `number` of `shares`: those with remainder `number` when divided by `shares`.
///
/// # Errors
///
/// If `number` is not below `shares`.
pub fn share(folds: usize, (number, shares): (usize, usize)) -> Result<Vec<usize>, WorkError> {
    if number >= shares {
        return Err(WorkError::Usage(format!(
            "there is no share {number}; wanted a share from 0 to {}, since there are {shares}",
            shares.saturating_sub(1)
        )));
    }
    Ok((number..folds).step_by(shares).collect())
}

/// The fold that predicts the named touches from all others.
fn testing(touches: &[TouchSamples], test: &[String]) -> Result<Fold, WorkError> {
    let place = |name: &String| {
        touches.iter().position(|touch| touch.name == *name).ok_or_else(|| {
            let names: Vec<&str> = touches.iter().map(|touch| &*touch.name).collect();
            let names = names.join(", ");
            WorkError::Usage(format!(
                "--test names touch `{name}`, which is not in the logs; their touches are {names}"
            ))
        })
    };
    let mut test = test.iter().map(place).collect::<Result<Vec<usize>, _>>()?;
    test.sort_unstable();
    test.dedup();
    let fold = Fold::testing(test, touches.len());
    if fold.train.is_empty() {
        let all = "--test names every touch, so that none is left to learn from".to_owned();
        return Err(WorkError::Usage(all));
    }
    Ok(fold)
}

/// The configurations of `map` and `ekf`.
pub fn configs(settings: &Settings) -> Result<[MapperConfig; 2], SettingsError> {
    let named = settings.estimator.estimator.unwrap_or_default();
    let of = |method: EstimatorKind| {
        let estimator = if method == named {
            settings.estimator.clone()
        } else {
            EstimatorSettings { estimator: Some(method), ..EstimatorSettings::default() }
        };
        Settings { estimator, ..settings.clone() }.config()
    };
    Ok([of(EstimatorKind::Map)?, of(EstimatorKind::Ekf)?])
}

/// Reads all touches of logs; returns them as recorded and as they are evaluated.
///
/// # Errors
///
/// If a log is broken or does not fit the arm, or the truth is asked for and missing.
pub fn read(
    touches: Touches,
    (arm, settings): (&Arc<Arm>, &Settings),
    truth: bool,
    progress: &dyn Progress,
) -> Result<(Vec<RecordedTouch>, Vec<TouchSamples>), WorkError> {
    settings.log.check_for(&arm.robot)?;
    let recorded = touches.read_to_learn(arm, settings, None, progress)?;
    let touches = touch_samples(&recorded, truth)?;
    Ok((recorded, touches))
}

/// The touches as they are evaluated, with unique names.
pub fn touch_samples(
    recorded: &[RecordedTouch],
    truth: bool,
) -> Result<Vec<TouchSamples>, WorkError> {
    let mut names = Vec::new();
    let touch = |one: &RecordedTouch| {
        let ambiguous = recorded.iter().filter(|other| other.name == one.name).count() > 1;
        let log = one.log.file_name().map(|name| name.to_string_lossy().into_owned());
        let mut name = match log {
            Some(log) if ambiguous => format!("{log}/{}", one.name),
            _ => one.name.clone(),
        };
        make_unique(&mut name, &mut names);
        let truth = truth.then(|| predict::truth(&one.log, &one.name)).transpose()?;
        Ok(TouchSamples { name, samples: one.samples.clone(), truth })
    };
    recorded.iter().map(touch).collect()
}

/// Makes a name unique among `taken` by appending a number, and adds it to them.
pub fn make_unique(name: &mut String, taken: &mut Vec<String>) {
    let plain = name.clone();
    let mut times = 1;
    while taken.contains(name) {
        times += 1;
        *name = format!("{plain}#{times}");
    }
    taken.push(name.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_repeat_or_look_like_a_repeat_all_differ() {
        let mut taken = Vec::new();
        for name in ["a", "a#2", "a", "b", "a"] {
            make_unique(&mut name.to_owned(), &mut taken);
        }
        assert_eq!(taken, ["a", "a#2", "a#3", "b", "a#4"]);
    }
}
