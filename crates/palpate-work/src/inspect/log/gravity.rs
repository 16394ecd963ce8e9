//! Findings from gravity: convention of the torques, order of joints, payload.

use palpate::{ExternalTorqueConfig, Gravity, Payload, Robot, Sample};
use palpate_io::log::AngleUnit;

use super::super::finding::Finding;
use super::super::words::{listed, number, word};
use super::joints::Matching;
use super::payload;
use super::reading::{self, ConventionFit, ConventionFits, LogInterpretation};
use crate::conventions::{ConventionEvidence, KnownConvention, TorqueConvention, Undecided};
use crate::touches::RecordedTouch;

/// Finds from gravity how the log is to be read, and puts the joints of the touches into the order
/// that fits.
pub(super) fn judge(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    (set, given): (&ExternalTorqueConfig, KnownConvention),
    (angle_unit, matching): (AngleUnit, Matching),
) -> (LogInterpretation, Vec<Finding>) {
    let mut rests = reading::rests(touches, set.still_rad);
    let straight: Vec<usize> = (0..robot.n_joints()).collect();
    let mut fits = reading::fits(robot, &rests, &straight, set);
    let (mut order, mut findings) = (None, Vec::new());
    if let Some((other, better)) = reading::other_order(robot, &rests, set, &fits) {
        findings.push(wrong_order(robot, &other, matching, (&fits, &better)));
        touches.iter_mut().for_each(|touch| touch.permute(&other));
        rests = reading::rests(touches, set.still_rad);
        (fits, order) = (better, Some(other));
    }
    let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
    let evidence = ConventionEvidence::of(robot, &samples, set.still_rad);
    let decided = evidence.map(|evidence| evidence.decide(given));
    if let Some(Ok(found)) = decided {
        let mut set = set.clone();
        (set.torque_sign, set.gravity) = (found.torque_sign, found.gravity);
        fits = reading::fits(robot, &rests, &straight, &set);
    }
    fits = fits.with_sign_by_work(evidence.and_then(|evidence| evidence.sign_by_work()));
    let mut payload = None;
    let by_sign = reading::by_sign(robot, &rests, set, &fits)
        .or_else(|| evidence.and_then(|evidence| evidence.negated_joints()));
    if let Some(by_sign) = &by_sign {
        findings.push(opposite_signs(robot, by_sign));
    } else if let Some((what, remedy)) = currents(decided) {
        findings.push(Finding::warning("currents", what, remedy));
    } else if fits.contradict() {
        findings.push(wrong_convention(&fits));
    } else if fits.misfit() {
        let heavier = payload_of(robot, &rests.all, &fits);
        findings.push(misfit(&fits, heavier.as_ref()));
        payload = heavier.map(|(_, payload)| payload);
    } else if let Some(Err(undecided)) = decided {
        let remedy =
            "give the flags that this message names; the figures of this report are without them";
        findings.push(Finding::warning("undecided", undecided.to_string(), remedy));
    }
    let ConventionFit { torque_sign, gravity, residual, .. } = fits.accepted();
    let unexplained_share = fits.has_enough_gravity().then(|| residual / fits.gravity_torque);
    let reading = LogInterpretation {
        angle_unit,
        order,
        torque_sign,
        gravity,
        unexplained_share,
        payload,
        fits,
    };
    (reading, findings)
}

/// What to say if the torques follow gravity as motor currents do, and the remedy.
fn currents(
    decided: Option<Result<TorqueConvention, Undecided>>,
) -> Option<(String, &'static str)> {
    let Some(Err(Undecided::NoFit(of))) = decided else { return None };
    let remedy = "find the gains of the motors with `palpate identify`, and give the file that it writes with --arm; if \
                  they are torques, give both --torque-sign and --gravity; the figures of this report take them for \
                  torques";
    let what =
        "the torques follow those of gravity, but are much smaller: they seem to be motor currents";
    of.is_like_currents().then(|| (what.to_owned(), remedy))
}

/// A payload that explains the torques, and the convention under which it does.
fn payload_of(
    robot: &Robot,
    rests: &[Sample],
    fits: &ConventionFits,
) -> Option<(ConventionFit, Payload)> {
    [&fits.set, &fits.best].into_iter().find_map(|fit| {
        let included = ConventionFit { gravity: Gravity::Included, ..*fit };
        Some((included, payload::explain(robot, rests, &included)?))
    })
}

/// Flags that change the convention `set` into `right`.
fn flags(set: &ConventionFit, right: &ConventionFit) -> Vec<String> {
    let mut flags = Vec::new();
    if set.torque_sign != right.torque_sign {
        flags.extend(["--torque-sign".to_owned(), word(right.torque_sign)]);
    }
    if set.gravity != right.gravity {
        flags.extend(["--gravity".to_owned(), word(right.gravity)]);
    }
    flags
}

fn wrong_convention(fits: &ConventionFits) -> Finding {
    let (set, best) = (&fits.set, &fits.best);
    let when = if fits.at_rest { "at rest" } else { "on average" };
    let [residual, residual_as_set, gravity_torque] =
        [best.residual, set.residual, fits.gravity_torque].map(number);
    if fits.by_work {
        let what = "the torques have the opposite sign: with the given one they do more work on the arm than they take \
                    from it, which only motors do, or a person who leads the arm";
        let flags = flags(set, best);
        let remedy = format!("use {}; the figures of this report do", flags.join(" "));
        return Finding::warning("torque_sign", what.to_owned(), remedy).try_flags(&flags);
    }
    let (code, seen) = match best.gravity {
        Gravity::Removed => {
            ("gravity", format!("the torques contain no gravity: they are {residual} N·m"))
        }
        Gravity::Included if set.gravity == Gravity::Removed => {
            ("gravity", format!("the torques contain gravity: without it they are {residual} N·m"))
        }
        Gravity::Included => (
            "torque_sign",
            format!(
                "the torques have the opposite sign: with the other one they are {:.2} times those \
                 of gravity, and {residual} N·m remain unexplained",
                best.slope
            ),
        ),
    };
    let slope = match fits.at_rest {
        true => String::new(),
        false => format!(
            " (no touch begins at rest, but the slope of the torques on gravity is {:.2})",
            best.slope
        ),
    };
    let what = format!(
        "{seen}, where gravity {when} is {gravity_torque} N·m{slope}; with the settings \
         as given, {residual_as_set} N·m remain unexplained"
    );
    let flags = flags(set, best);
    let remedy = format!("use {}; the figures of this report do", flags.join(" "));
    Finding::warning(code, what, remedy).try_flags(&flags)
}

fn wrong_order(
    robot: &Robot,
    order: &[usize],
    matching: Matching,
    (straight, better): (&ConventionFits, &ConventionFits),
) -> Finding {
    let n = order.len();
    let names: Vec<&str> = robot.joint_names().collect();
    // Column `order[j]` of the log is joint j of the robot.
    let mut columns = vec![""; n];
    order.iter().zip(&names).for_each(|(&place, name)| columns[place] = name);
    let wrong: Vec<&str> = (0..n).filter(|&j| order[j] != j).map(|j| names[j]).collect();
    let how = match wrong.len() {
        2 => format!("with `{}` and `{}` swapped", wrong[0], wrong[1]),
        _ if (0..n).all(|j| order[j] == n - 1 - j) => "in reverse".to_owned(),
        _ => "in another order".to_owned(),
    };
    let what = format!(
        "the log seems to hold the joints {how}: then {} N·m remain unexplained by gravity, in the \
         robot's order {} N·m",
        number(better.best.residual),
        number(straight.best.residual)
    );
    let source = match matching {
        Matching::Unnamed => "save the columns",
        _ => "the log's joint names look wrong; name the columns",
    };
    let remedy = format!(
        "its columns seem to be {}; {source} in the robot's order, {} (CSV: --columns); \
         the figures of this report are for the order that it seems to have",
        listed(&columns),
        listed(&names)
    );
    Finding::warning("joint_order", what, remedy).at(&wrong)
}

/// The finding that some joints have the opposite sign of the others.
fn opposite_signs(robot: &Robot, by_sign: &[Vec<usize>; 2]) -> Finding {
    let names: Vec<&str> = robot.joint_names().collect();
    let [plus, minus] = by_sign
        .each_ref()
        .map(|joints| joints.iter().map(|&joint| names[joint]).collect::<Vec<_>>());
    let what = format!(
        "gravity shows the sign plus for {}, and minus for {}: some columns are negated",
        listed(&plus),
        listed(&minus)
    );
    let remedy = "all joints must have the same sign: negate the columns with the wrong sign in the log (there is no \
                  flag for it)";
    let odd = if plus.len() < minus.len() { &plus } else { &minus };
    Finding::warning("joint_sign", what, remedy).at(odd)
}

/// The finding that no convention explains the torques.
fn misfit(fits: &ConventionFits, heavier: Option<&(ConventionFit, Payload)>) -> Finding {
    let what = format!(
        "gravity does not explain the torques at rest, in either sign: {} N·m remain unexplained, where \
         gravity is {} N·m",
        number(fits.best.residual),
        number(fits.gravity_torque)
    );
    let Some((fit, payload)) = heavier else {
        let remedy = "look for a wrong robot (--robot), a payload that is not in its URDF \
                      (--payload-link, --payload-mass-kg), another order of the joints, a torque that was not recorded, or \
                      another unit (--angle-unit deg)";
        return Finding::warning("gravity_misfit", what, remedy);
    };
    let [x, y, z] = payload.com_link_m;
    let mut flags = flags(&fits.set, fit);
    flags.extend(["--payload-link".to_owned(), payload.link.clone()]);
    flags.extend(["--payload-mass-kg".to_owned(), format!("{:.2}", payload.mass_kg)]);
    flags.push(format!("--payload-com-m={x:.3},{y:.3},{z:.3}"));
    let remedy = format!(
        "a payload of {:.2} kg at the last link would explain it: weigh the tool and give it, such \
         as {}",
        payload.mass_kg,
        flags.join(" ")
    );
    Finding::warning("payload", what, remedy).try_flags(&flags)
}
