//! Notes for the user on an identified arm: what is suspect, what cannot be determined, and why.

use palpate::Robot;

use super::outliers::ResidualOutliers;
use super::result::{Estimate, IdentifiedArm, JointEstimate};
use super::search::Fit;
use super::{Checked, MIN_MOTION, ReadTimes};

/// Largest residual, relative to the standard deviation of the torques, before a misfit is reported.
const MAX_RESIDUAL: f64 = 0.3;

/// Torques may come before the positions by this, s, and by this part of the sampling interval, before it is reported.
const EARLY_S: f64 = 0.01;
const EARLY_PART: f64 = 0.5;

/// A note on negative gains.
fn of_gains(identified: &IdentifiedArm) -> Option<String> {
    let is_negative = |joint: &&JointEstimate| joint.gain.value < 0.0;
    let negative: Vec<&str> =
        identified.joints.iter().filter(is_negative).map(|joint| joint.name.as_str()).collect();
    match negative.len() {
        0 => None,
        all if all == identified.joints.len() => Some(
            "all gains are negative: these torques or currents have the opposite sign (--torque-sign)"
                .to_owned(),
        ),
        _ => Some(format!(
            "the gain of {} is negative, and those of other joints are not: does its torque have the opposite \
             sign, is it the torque of another joint, or did the joint hardly move?",
            negative.join(", ")
        )),
    }
}

/// A note on torques that come before the positions.
fn of_delay(delay_s: Estimate, interval_s: f64) -> Option<String> {
    let Estimate { value, std } = delay_s;
    let least_s = (2.0 * std).max(EARLY_S.min(EARLY_PART * interval_s));
    (interval_s > 0.0 && value < -least_s).then(|| {
        format!(
            "the torques come {:.1} ms before the positions, which is impossible: friction near reversals of the \
             motion may not follow the model, which looks like a delay; or the time stamps are those of another clock, \
             or the torques those of other joints",
            -1e3 * value
        )
    })
}

/// A note on friction that would be negative at most joints.
fn of_friction(joints: &[JointEstimate], timed: bool) -> Option<String> {
    let moving = || joints.iter().filter(|joint| joint.moved >= MIN_MOTION);
    let is_none = |joint: &&JointEstimate| {
        let is_zero = |name| joint.at_zero.contains(&name);
        is_zero("coulomb_n_m") && (!timed || is_zero("viscous_n_m_s"))
    };
    let none = moving().filter(is_none).count();
    (2 * none > moving().count()).then(|| {
        format!(
            "Coulomb and viscous friction would be negative at {none} of {} moving joints, and are set to zero: the \
             arm was probably led by hand or touched, or the sign of the torques is wrong (--torque-sign); record \
             motion that only the motors drive",
            moving().count()
        )
    })
}

/// Notes for the user: what is suspect, what cannot be determined, and why.
pub(super) fn notes(
    identified: &IdentifiedArm,
    (motion, fit): (&Checked, &Fit),
    robot: &Robot,
) -> Vec<String> {
    let mut notes = Vec::new();
    if identified.touched > 0.0 {
        notes.push(format!(
            "in {:.1} % of the samples the torques are far from what free motion explains, as when something is \
             touched; these are left out",
            100.0 * identified.touched
        ));
    }
    notes.extend(of_stamps(identified.read_times));
    if !identified.timed {
        notes.push(
            "the log has no clock, or one too slow to determine speeds: viscous friction, inertia and delay are not \
             identified"
                .to_owned(),
        );
    }
    if identified.timed && !fit.has_settled {
        notes.push(
            "delay and presliding distances did not converge: faster reversals, or a higher sampling rate, \
             distinguish them"
                .to_owned(),
        );
    }
    notes.extend(of_joints(&identified.joints, motion));
    notes.extend(of_gains(identified));
    notes.extend(of_delay(identified.delay_s, fit.rows.interval_s()));
    if identified.misfit.is_none() {
        notes.extend(of_friction(&identified.joints, identified.timed));
    }
    let parameters = robot.inertial_parameters();
    if parameters.iter().all(|parameter| *parameter == 0.0) {
        notes.push(
            "the URDF has no masses: all of them are found from the logs, as far as these determine them"
                .to_owned(),
        );
    }
    let payload = &identified.payload;
    if payload.mass_kg.std > 0.5 * payload.mass_kg.value.abs().max(1.0) {
        notes.push(format!(
            "the payload cannot be determined: its mass has a standard deviation of {:.2} kg; the torque of gravity \
             must change at the joints that carry it, but it does not at vertical axes or if all poses are alike",
            payload.mass_kg.std
        ));
    }
    notes.extend(identified.held_out.few.as_ref().map(far_off));
    notes
}

/// Notes on joints that do not move, and on those whose torque is not measured.
fn of_joints(joints: &[JointEstimate], motion: &Checked) -> Vec<String> {
    let mut notes = Vec::new();
    let still: Vec<&str> = (joints.iter())
        .filter(|joint| joint.moved < MIN_MOTION)
        .map(|joint| joint.name.as_str())
        .collect();
    if !still.is_empty() {
        notes.push(format!(
            "{} moved by less than {MIN_MOTION} rad: {} friction cannot be determined, and bias cannot be \
             distinguished from gravity; move every joint in both directions, as `palpate excite` does",
            still.join(", "),
            if still.len() == 1 { "its" } else { "their" }
        ));
    }
    let silent: Vec<&str> = motion.silent.iter().map(|j| joints[*j].name.as_str()).collect();
    if !silent.is_empty() {
        notes.push(format!(
            "the torque of {} never changes: it is not measured, so friction, bias and gain cannot be determined",
            silent.join(", ")
        ));
    }
    notes
}

/// A note on time stamps that were corrected.
fn of_stamps(read_times: ReadTimes) -> Option<String> {
    let ReadTimes { corrected, rms_s } = read_times;
    (corrected > 0).then(|| {
        format!(
            "in {corrected} {}, time stamps differ by {:.1} ms (root mean square) from the times at which the joints \
             were read; a usual reason is a node that publishes joint states again at another rate; speeds are \
             computed with corrected times, which follow from how the joints move together",
            if corrected == 1 { "touch" } else { "touches" },
            1e3 * rms_s
        )
    })
}

/// A note on the outliers that have most of the residual.
fn far_off(few: &ResidualOutliers) -> String {
    let ResidualOutliers {
        samples,
        of,
        share,
        largest,
        touch,
        rows: [from, to],
        without: [gravity, own],
    } = few;
    format!(
        "{samples} of {of} samples have {:.0} % of the squared residual on held-out motion (residuals up to \
         {largest:.1} N·m), most of it in touch {touch}, samples {from} to {to} (from 0): the arm jerks there, or is \
         touched; the residual of the other samples is {own:.2} N·m, and {gravity:.2} N·m with the gravity of \
         the URDF alone",
        100.0 * share
    )
}

/// What may be wrong, if the model does not fit held-out motion; `None` if it fits.
pub(super) fn misfit(identified: &IdentifiedArm, motion: &Checked) -> Option<String> {
    let variation = motion.variation.iter().zip(&identified.joints);
    let variation =
        variation.map(|(logged, joint)| (logged / joint.gain.value).powi(2)).sum::<f64>().sqrt();
    let held_out = &identified.held_out;
    let total = |of: &[f64]| of.iter().map(|own| own * own).sum::<f64>().sqrt();
    let (urdf, own) = (total(&held_out.urdf), total(&held_out.identified));
    if own > MAX_RESIDUAL * variation {
        Some(format!(
            "on held-out motion, {own:.2} N·m remain unexplained, of torques that vary by {variation:.2} N·m: \
             is it another robot, are its joints in another order, the angles in degrees (--angle-unit deg), the \
             torques in another unit, or was something touched?"
        ))
    } else if own > 0.9 * urdf.min(total(&held_out.gravity)) {
        Some(format!(
            "on held-out motion, the identified model leaves {own:.2} N·m unexplained, and the URDF alone \
             {urdf:.2} N·m, so the model is no better; the motion is too short or not varied enough, something was \
             touched, or it is another robot"
        ))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(at_zero: &[&'static str]) -> JointEstimate {
        let none = Estimate { value: 0.0, std: 0.1 };
        JointEstimate {
            name: "a".to_owned(),
            moved: 1.0,
            coulomb_n_m: none,
            asymmetry_n_m: none,
            breakaway_n_m: none,
            is_breakaway_separable: true,
            viscous_n_m_s: none,
            rotor_inertia_kg_m2: none,
            bias_n_m: none,
            gain: none,
            presliding_rad: 1e-3,
            ripple_orders: Vec::new(),
            hysteresis_n_m: 0.0,
            at_zero: at_zero.to_vec(),
        }
    }

    #[test]
    fn a_delay_below_zero_is_reported_if_it_is_clear() {
        let note =
            |value: f64, std: f64, interval_s: f64| of_delay(Estimate { value, std }, interval_s);
        let found = note(-9.2e-3, 0.4e-3, 8e-3).unwrap();
        assert!(found.contains("9.2 ms") && found.contains("near reversals"), "{found}");
        assert!(note(-3.9e-3, 0.4e-3, 8e-3).is_none(), "less than half an interval");
        assert!(note(-9.2e-3, 5e-3, 8e-3).is_none(), "less than two standard deviations");
        assert!(note(-12e-3, 1e-3, 0.04).is_some(), "at a low rate, 10 ms are enough");
        assert!(note(9.2e-3, 0.4e-3, 8e-3).is_none());
        assert!(note(-0.1, 1e-3, 0.0).is_none(), "without a clock");
    }

    #[test]
    fn friction_that_would_be_negative_at_most_joints_is_reported() {
        let none = || joint(&["coulomb_n_m", "viscous_n_m_s"]);
        let found = of_friction(&[none(), none(), joint(&[])], true).unwrap();
        assert!(found.contains("at 2 of 3 moving joints"), "{found}");
        assert!(of_friction(&[none(), joint(&[])], true).is_none());
        // Viscous friction alone is often too small to be found.
        assert!(
            of_friction(&[joint(&["viscous_n_m_s"]), joint(&["viscous_n_m_s"])], true).is_none()
        );
        let still = JointEstimate { moved: 0.0, ..none() };
        assert!(of_friction(&[still, joint(&[])], true).is_none());
        assert!(of_friction(&[joint(&["coulomb_n_m"])], false).is_some(), "without a clock");
    }
}
