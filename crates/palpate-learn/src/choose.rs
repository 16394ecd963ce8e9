//! Settings of `map` chosen for the touches at hand ([`Search::quick`]): from which touches, with which bands, and a
//! summary of the choice.

use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::{Downsampling, TouchLog, Tracker};
use palpate::{Arm, Calibration, EstimatorKind, MapperConfig, Sample, SettingError, Tare};
use rayon::prelude::*;

use crate::calibrate::{calibrate, learn_springs};
use crate::error::{LearnError, Stop};
use crate::torque_errors::RELATIVE_FROM_N_M;
use crate::tracked::{TouchSamples, TrackedTouches, largest_torques};
use crate::tune::{FixedSettings, Search, Tuned, Tuner};

/// Fewest touches from which settings can be chosen.
pub const MIN_TUNING_TOUCHES: usize = 3;
/// Most touches from which settings are chosen, and most samples of them after [`Downsampling`].
const QUICK_TOUCHES: usize = 16;
const QUICK_LEARNT: usize = 20_000;
/// Most touches whose contacts are simulated to pick those touches.
const MAX_SIMULATED: usize = 24;

/// Chosen settings, and bands around predictions under them if there were enough touches.
#[derive(Debug, Clone)]
pub struct Chosen {
    /// The choice, with the scores of all candidates.
    pub tuned: Tuned,
    /// The bands.
    pub calibration: Option<Calibration>,
}

/// Indices of the touches from which settings are chosen, in their order: those with the largest torques. Touches
/// without contact are left out, and weak ones too, if there are enough others. Also whether all others are chosen
/// from, so that none was left out because of their number of samples.
///
/// # Errors
///
/// Names the first touch and sample that cannot be used.
pub fn pick(
    (arm, config): (&Arc<Arm>, &MapperConfig),
    touches: &[&[Sample]],
    stop: Stop<'_>,
) -> Result<(Vec<usize>, bool), LearnError> {
    let torques = largest_torques(arm, config, &candidates((arm, config), touches)?, stop)?;
    let learnt = |samples: &&[Sample]| {
        let mut downsampling = Downsampling::default();
        samples.iter().filter(|sample| downsampling.takes(sample)).count()
    };
    let learnt: Vec<usize> = touches.iter().map(learnt).collect();
    let strongest = strongest_first(&torques);
    let (mut kept, mut all) = (Vec::new(), 0);
    for &place in &strongest {
        if kept.len() < QUICK_TOUCHES && all + learnt[place] <= QUICK_LEARNT {
            kept.push(place);
            all += learnt[place];
        }
    }
    kept.sort_unstable();
    let are_all = kept.len() == strongest.len().min(QUICK_TOUCHES);
    Ok((kept, are_all))
}

/// The touches; if there are more than [`MAX_SIMULATED`], only those with the largest change of torque keep their samples,
/// and the others are empty.
fn candidates<'a>(
    (arm, config): (&Arc<Arm>, &MapperConfig),
    touches: &[&'a [Sample]],
) -> Result<Vec<&'a [Sample]>, LearnError> {
    if touches.len() <= MAX_SIMULATED {
        return Ok(touches.to_vec());
    }
    let changes = largest_changes(arm, config, touches)?;
    let mut places: Vec<usize> = (0..touches.len()).collect();
    places.sort_by(|a, b| changes[*b].total_cmp(&changes[*a]));
    let mut candidates = vec![&[][..]; touches.len()];
    for &place in places.iter().take(MAX_SIMULATED) {
        candidates[place] = touches[place];
    }
    Ok(candidates)
}

/// For each touch, given by its samples, the largest change of the torque since its first sample, or without a tare the
/// largest torque, as the norm over the joints, N·m. Contacts are not simulated, so this takes little time.
///
/// # Errors
///
/// If a setting is out of its range.
pub fn largest_changes(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[&[Sample]],
) -> Result<Vec<f64>, SettingError> {
    let (contact, touch) = (&config.contact, config.touch.clone());
    let tracker = Tracker::new(Arc::clone(arm), config.lattice.clone(), contact, touch)?;
    let largest = |samples: &&[Sample]| {
        // Samples that cannot be used are refused where they are simulated.
        let mut torques = samples.iter().filter_map(|sample| Some(tracker.check(sample).ok()?.1));
        let first = torques.next().filter(|_| config.touch.tare != Tare::None);
        let change = |torque: DVector<f64>| match &first {
            Some(first) => (torque - first).norm(),
            None => torque.norm(),
        };
        torques.map(change).fold(0.0, f64::max)
    };
    Ok(touches.par_iter().map(largest).collect())
}

/// Chooses the settings that are not `given`, by cross-validation on all of these touches, and calibrates bands. No
/// inertia is computed: the times of logged samples are not those of the arm
/// ([`palpate::unstable::LoggedTouch::samples`]).
///
/// # Errors
///
/// If the settings are not of `map`, a sample cannot be used, or on being stopped.
pub fn choose(
    (arm, config): (&Arc<Arm>, &MapperConfig),
    touches: &[TouchSamples],
    given: FixedSettings,
    stop: Stop<'_>,
) -> Result<Chosen, LearnError> {
    if config.method != EstimatorKind::Map {
        return Err(LearnError::NotMap(config.method.name()));
    }
    let tracked = TrackedTouches::sparse(arm, config, touches, stop)?.without_times();
    let search = Search::quick(config, given);
    let tuner = Tuner::new((arm, touches, &tracked), config, search, stop, &|| ())?;
    let everything: Vec<usize> = (0..touches.len()).collect();
    let tuned = tuner.tune(&everything, stop)?;
    let calibration = bands((arm, touches, &tracked), (config, &tuned.config), stop)?;
    Ok(Chosen { tuned, calibration })
}

/// Chooses the settings that are not `given` for the completed touches of a log ([`pick`], [`choose`]), and says in one
/// line what was chosen, and whether the torques follow the arm's own motion all the same. `None` if the arm touches
/// something in fewer than [`MIN_TUNING_TOUCHES`] of them.
///
/// # Errors
///
/// As [`choose`].
pub fn choose_for_log(
    (arm, config): (&Arc<Arm>, &MapperConfig),
    log: &TouchLog,
    given: FixedSettings,
    stop: Stop<'_>,
) -> Result<Option<(Chosen, String)>, LearnError> {
    let n_joints = arm.robot.n_joints();
    let completed = log.touches.iter().filter(|touch| !touch.open);
    let mut touches: Vec<TouchSamples> = completed
        .map(|touch| TouchSamples {
            name: format!("#{} {}", touch.touch, touch.name).trim_end().to_owned(),
            samples: touch.samples(n_joints).collect(),
            truth: None,
        })
        .collect();
    let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
    let (kept, _) = pick((arm, config), &samples, stop).map_err(|error| named(error, &touches))?;
    let (found, mut place) = (touches.len(), 0..);
    touches.retain(|_| place.next().is_some_and(|place| kept.contains(&place)));
    if touches.len() < MIN_TUNING_TOUCHES {
        return Ok(None);
    }
    let chosen = choose((arm, config), &touches, given, stop);
    let chosen = chosen.map_err(|error| named(error, &touches))?;
    let mut summary = summary(&chosen.tuned, (touches.len(), found));
    if let Some((finding, remedy)) = doubt(&chosen.tuned).filter(|_| !chosen.tuned.is_all_noise) {
        summary += &format!("; {finding}; it is learned as stiffness all the same; {remedy}");
    }
    Ok(Some((chosen, summary)))
}

/// An error with the name of the touch in place of its index.
fn named(error: LearnError, touches: &[TouchSamples]) -> LearnError {
    match error {
        LearnError::Sample { touch, sample, source } => {
            LearnError::Logged { touch: touches[touch].name.clone(), sample, source }
        }
        error => error,
    }
}

/// Bands around predictions under the `chosen` settings, calibrated on all touches; `tracked` are these under the
/// `initial` settings.
///
/// # Errors
///
/// If a sample cannot be used, or on being stopped.
pub fn bands(
    (arm, touches, tracked): (&Arc<Arm>, &[TouchSamples], &TrackedTouches),
    (initial, chosen): (&MapperConfig, &MapperConfig),
    stop: Stop<'_>,
) -> Result<Option<Calibration>, LearnError> {
    let other;
    let tracked = if chosen.contact == initial.contact {
        tracked
    } else {
        // Tracked anew: the tare depends on the contact model.
        other = tracked.again(arm, chosen, touches, stop)?;
        &other
    };
    let everything: Vec<usize> = (0..touches.len()).collect();
    calibrate(learn_springs, tracked, &everything, chosen, (stop, &|| ()))
}

/// The chosen settings and their score, in one line; they were chosen on `touches` of the touches that were `found`.
pub fn summary(tuned: &Tuned, (touches, found): (usize, usize)) -> String {
    let (contact, estimator) = (&tuned.config.contact, &tuned.config.estimator);
    let score = tuned.trials[0].scores.last().copied().filter(|score| score.is_finite());
    let score = score.map_or(String::new(), |score| format!(" (score {score:.2})"));
    let of = if touches < found { format!(" of {found}") } else { String::new() };
    format!(
        "chosen by cross-validation on {touches}{of} touches{score}: contact distance {:.0} mm, \
         friction {:.2}, Coulomb friction {:.2}, prior {:.3} ± {:.3} N/m, torque noise {}, stiffness scale {:.2}",
        1e3 * contact.contact_distance_m,
        contact.friction,
        contact.coulomb_friction,
        estimator.prior.mean_n_per_m,
        estimator.prior.std_n_per_m,
        noise(&estimator.torque_std),
        estimator.stiffness_scale,
    )
}

/// What shows that the torques are not those of contacts, and what to do about it.
pub fn doubt(tuned: &Tuned) -> Option<(String, &'static str)> {
    let identified = tuned.config.touch.identified;
    if let Some(share) = tuned.own_motion {
        let percent = 100.0 * share;
        let finding = format!(
            "the external torque follows the arm's own motion rather than contacts: while the arm moves, its friction \
             and inertia explain {percent:.0} % of the torque (mean square)"
        );
        let remedy = if identified {
            "`palpate identify` on new free motion finds the present friction"
        } else {
            "`palpate identify` finds friction and inertia from free motion, and --arm subtracts them"
        };
        return Some((finding, remedy));
    }
    let remedy = if identified {
        "Perhaps nothing was touched"
    } else {
        "The torques of the arm's own motion may be the reason: `palpate identify` finds friction and inertia from free \
         motion, and --arm subtracts them"
    };
    let finding = "these touches hardly predict each other's torques".to_owned();
    tuned.is_all_noise.then_some((finding, remedy))
}

/// Why the settings should stay as they are: with the chosen ones, all torque would count as noise.
pub fn refusal(tuned: &Tuned) -> Option<String> {
    let doubt = doubt(tuned).filter(|_| tuned.is_all_noise);
    doubt.map(|(finding, remedy)| format!("{finding}. {remedy}"))
}

/// Indices of touches, given the largest torque of each, N·m, in descending order: those above [`RELATIVE_FROM_N_M`],
/// or above 0 if these are fewer than [`MIN_TUNING_TOUCHES`].
fn strongest_first(torques: &[f64]) -> Vec<usize> {
    let above = |least: f64| (0..torques.len()).filter(move |place| torques[*place] > least);
    let least =
        if above(RELATIVE_FROM_N_M).count() < MIN_TUNING_TOUCHES { 0.0 } else { RELATIVE_FROM_N_M };
    let mut places: Vec<usize> = above(least).collect();
    places.sort_by(|a, b| torques[*b].total_cmp(&torques[*a]));
    places
}

/// The torque noise, N·m, or its range over the joints.
fn noise(torque_std: &[f64]) -> String {
    let least = torque_std.iter().copied().fold(f64::INFINITY, f64::min);
    let most = torque_std.iter().copied().fold(0.0, f64::max);
    let [least, most] = [least, most].map(|std| format!("{std:.2}"));
    if least == most { format!("{least} N·m") } else { format!("{least} to {most} N·m") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_torque_noise_is_one_number_or_a_range_over_the_joints() {
        assert_eq!(noise(&[0.2]), "0.20 N·m");
        assert_eq!(noise(&[0.301, 0.2, 0.204]), "0.20 to 0.30 N·m");
        assert_eq!(noise(&[0.201, 0.2, 0.204]), "0.20 N·m");
    }

    #[test]
    fn strong_touches_come_first_and_weak_ones_only_where_there_are_no_others() {
        assert_eq!(strongest_first(&[0.3, 5.0, 0.0, 2.0, 9.0]), [4, 1, 3]);
        assert_eq!(strongest_first(&[0.3, 5.0, 0.0, 2.0]), [1, 3, 0]);
    }
}
