//! Identified values with standard deviations, in common units, and notes for the user.

use nalgebra::{DMatrix, Isometry3, Matrix3, Point3, Vector3};
use palpate::unstable::N_INERTIAL_PARAMETERS;
use palpate::{JointFriction, JointModel, Robot, TorqueModel, TorqueNoise};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde::Serialize;

use super::held_out::{Found, HeldOutResiduals};
use super::notes::{misfit, notes};
use super::posterior::Posterior;
use super::prior::NEVER_NEGATIVE;
use super::rows::{FRICTION, RegressionSettings};
use super::search::Fit;
use super::{Checked, IdentifyConfig, ReadTimes, contact_samples};

/// A value with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The most probable value.
    pub value: f64,
    /// Standard deviation.
    pub std: f64,
}

/// Result of the identification of an arm.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct IdentifiedArm {
    /// The identified arm, for other commands.
    pub model: TorqueModel,
    /// Mass that the URDF does not contain.
    pub payload: PayloadEstimate,
    /// By joint.
    pub joints: Vec<JointEstimate>,
    /// By body.
    pub bodies: Vec<InertiaEstimate>,
    /// Number of base parameters: combinations of inertial parameters that motion can determine.
    pub base_parameters: usize,
    /// Number of base parameters that these logs determine better than the URDF.
    pub base_parameters_identified: usize,
    /// Delay of the torques after the positions, s.
    pub delay_s: Estimate,
    /// Whether the time stamps of the logs give speeds.
    pub timed: bool,
    /// The fraction of the samples that is left out, since something seems to be touched in them, 0 to 1.
    pub touched: f64,
    /// Correction of time stamps that differ from the times at which the joints were read.
    pub read_times: ReadTimes,
    /// Residuals of held-out motion.
    pub held_out: HeldOutResiduals,
    /// What may be wrong, if the model does not fit held-out motion.
    pub misfit: Option<String>,
    /// What is suspect or cannot be determined, and why.
    pub notes: Vec<String>,
}

/// The payload: mass in addition to that of the URDF.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PayloadEstimate {
    /// The link in whose frame the payload is given.
    pub link: String,
    /// Mass, kg.
    pub mass_kg: Estimate,
    /// Centre of mass, m.
    pub com_m: [Estimate; 3],
    /// Inertia about the centre of mass in the link's axes, kg·m².
    pub inertia_kg_m2: [[f64; 3]; 3],
    /// Whether the mass is more than twice its standard deviation.
    pub is_significant: bool,
}

/// Identified values of a joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointEstimate {
    /// Its name.
    pub name: String,
    /// Largest range of the joint within a touch, rad or m.
    pub moved: f64,
    /// Coulomb friction, mean of both directions, N·m.
    pub coulomb_n_m: Estimate,
    /// Half the difference between the directions, N·m.
    pub asymmetry_n_m: Estimate,
    /// Breakaway: how much larger friction is at the slowest speeds, N·m.
    pub breakaway_n_m: Estimate,
    /// Whether breakaway is distinguished from how friction changes in reversals. It is not if it takes away nearly all
    /// of the Coulomb friction: a joint that slides has friction at the slowest speeds, too.
    pub is_breakaway_separable: bool,
    /// Viscous friction, N·m·s/rad.
    pub viscous_n_m_s: Estimate,
    /// Inertia of the drive, kg·m².
    pub rotor_inertia_kg_m2: Estimate,
    /// Constant part of the bias, N·m.
    pub bias_n_m: Estimate,
    /// Measured over true torque.
    pub gain: Estimate,
    /// Presliding distance: how far the joint moves after a reversal until half of the change of friction is over, rad.
    pub presliding_rad: f64,
    /// Orders of the ripple of its gears, in periods per turn, the strongest first; empty if none is found.
    pub ripple_orders: Vec<f64>,
    /// Standard deviation of the torque that the friction model leaves unexplained during reversals, N·m.
    pub hysteresis_n_m: f64,
    /// Names of those of the values above that would be negative, and are held at zero; their standard deviations say
    /// nothing.
    pub at_zero: Vec<&'static str>,
}

/// Identified values of a body: links that move together.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InertiaEstimate {
    /// The first link of the body.
    pub link: String,
    /// Mass, kg; mass times centre of mass, kg·m; inertia about the origin xx, xy, xz, yy, yz, zz, kg·m². Payload
    /// included.
    pub parameters: [Estimate; N_INERTIAL_PARAMETERS],
    /// Reduction of each parameter's variance, relative to its prior variance: 0 (nothing learned) to 1.
    pub variance_reduction: [f64; N_INERTIAL_PARAMETERS],
}

/// The model with the mean of a posterior; noise, ripple and alarm are not yet set.
pub(super) fn model(
    robot: &Robot,
    settings: &RegressionSettings,
    posterior: &Posterior,
) -> TorqueModel {
    let joints = robot.joint_names().enumerate().map(|(j, name)| {
        let at = posterior.joint(j);
        let (own, gain) = (|k: usize| posterior.mean[at + 1 + k], posterior.gain(j));
        // For values that cannot be negative: a negative estimate is set to zero.
        let positive = |k: usize| (own(k) / gain).max(0.0);
        JointModel {
            name: name.to_owned(),
            gain,
            bias: [
                posterior.mean_bias(j).iter().map(|(k, slope)| slope * posterior.mean[*k]).sum(),
                -own(FRICTION + 1),
                -own(FRICTION + 2),
            ],
            rotor_inertia: positive(4),
            friction: JointFriction {
                coulomb: positive(0),
                asymmetry: own(1) / gain,
                breakaway: own(2) / gain,
                viscous: positive(3),
                presliding: settings.turning[j].presliding,
                stribeck: settings.turning[j].stribeck,
            },
            ripple: Vec::new(),
            noise: TorqueNoise { still: 1.0, turning: 0.0, by_speed: 0.0, by_inertia: 0.0 },
        }
    });
    TorqueModel {
        delay_s: settings.delay_s + posterior.delay().0,
        window_s: settings.window_s,
        joints: joints.collect(),
        inertial: posterior.parameters().as_slice().to_vec(),
        alarm: None,
        causal: None,
    }
}

pub(super) fn of(
    robot: &Robot,
    config: &IdentifyConfig,
    fit: &Fit,
    found: Found,
    (motion, read_times): (&Checked, ReadTimes),
) -> IdentifiedArm {
    let Fit { settings, rows, posterior, .. } = fit;
    let mut model = model(robot, settings, posterior);
    for (joint, noise) in model.joints.iter_mut().zip(&found.noise) {
        joint.noise = *noise;
    }
    for (joint, ripple) in model.joints.iter_mut().zip(&found.ripple) {
        joint.ripple.clone_from(ripple);
    }
    model.alarm = found.alarm;
    model.causal = found.causal;
    let joint = |(j, joint): (usize, &JointModel)| {
        let presliding_rad = settings.turning[j].presliding;
        joint_estimate(posterior, (j, joint), motion.moved[j], presliding_rad)
    };
    let joints = model.joints.iter().enumerate().map(joint).collect();
    let payload = payload(robot, config, posterior);
    let (all, identified) = base_parameters(robot, posterior);
    let (delay, std) = posterior.delay();
    let mut identified = IdentifiedArm {
        bodies: bodies(robot, posterior),
        payload,
        joints,
        base_parameters: all,
        base_parameters_identified: identified,
        delay_s: Estimate {
            value: settings.delay_s + delay,
            std: (INFLATION * std).hypot(BETWEEN_SAMPLES * rows.interval_s()),
        },
        timed: rows.timed,
        touched: contact_samples::part(&settings.touched),
        read_times,
        held_out: found.held_out,
        misfit: None,
        notes: Vec::new(),
        model,
    };
    identified.misfit = misfit(&identified, motion);
    identified.notes = notes(&identified, (motion, fit), robot);
    identified
}

/// The estimates of joint `j`.
fn joint_estimate(
    posterior: &Posterior,
    (j, joint): (usize, &JointModel),
    moved: f64,
    presliding_rad: f64,
) -> JointEstimate {
    let at = posterior.joint(j);
    let gain = posterior.gain(j);
    let by_gain = |k: usize| {
        let value = posterior.mean[at + 1 + k] / gain;
        // Set to zero as in the model.
        let value = if NEVER_NEGATIVE.contains(&k) { value.max(0.0) } else { value };
        value_of(posterior, &[(at + 1 + k, 1.0 / gain), (at, -value / gain)], value)
    };
    // The mean over the touches: the constant plus their offsets.
    let bias = posterior.mean_bias(j);
    JointEstimate {
        name: joint.name.clone(),
        moved,
        coulomb_n_m: by_gain(0),
        asymmetry_n_m: by_gain(1),
        breakaway_n_m: by_gain(2),
        is_breakaway_separable: is_separable(&joint.friction),
        viscous_n_m_s: by_gain(3),
        rotor_inertia_kg_m2: by_gain(4),
        bias_n_m: value_of(posterior, &bias, joint.bias[0]),
        gain: value_of(posterior, &[(at, 1.0)], gain),
        presliding_rad,
        ripple_orders: joint.ripple.iter().map(|own| own.order).collect(),
        hysteresis_n_m: joint.noise.turning,
        at_zero: at_zero(posterior, j),
    }
}

/// Least friction at the slowest speeds, relative to Coulomb friction. If less is left, the joint hardly moved at these
/// speeds but in reversals, and breakaway describes what the presliding distance does not.
const LEAST_SLOW: f64 = 0.2;

/// Whether breakaway is distinguished from friction in reversals ([`LEAST_SLOW`]).
fn is_separable(friction: &JointFriction) -> bool {
    friction.coulomb + friction.breakaway > LEAST_SLOW * friction.coulomb
}

/// Names of the values of a joint that are held at zero, since they would be negative.
fn at_zero(posterior: &Posterior, j: usize) -> Vec<&'static str> {
    let is_held = |k: usize| {
        let at = posterior.joint(j) + 1 + k;
        posterior.is_zero[at] || posterior.mean[at] * posterior.gain(j) < 0.0
    };
    let names = ["coulomb_n_m", "viscous_n_m_s", "rotor_inertia_kg_m2"];
    let held = NEVER_NEGATIVE.into_iter().zip(names).filter(|(k, _)| is_held(*k));
    held.map(|(_, name)| name).collect()
}

/// A value with the standard deviation of a linear combination of the unknowns: (index, factor).
fn value_of(posterior: &Posterior, slopes: &[(usize, f64)], value: f64) -> Estimate {
    let variance: f64 = (slopes.iter())
        .flat_map(|a| slopes.iter().map(move |b| (a, b)))
        .map(|((a, by_a), (b, by_b))| by_a * by_b * posterior.covariance[(*a, *b)])
        .sum();
    Estimate { value, std: INFLATION * variance.max(0.0).sqrt() }
}

/// Factor from standard deviations of the posterior to reported ones. The posterior takes widths, noise and
/// correlations as known: its 95 % intervals contained only 76 to 93 % of the true values of 200 simulated arms.
const INFLATION: f64 = 1.25;
/// Standard deviation of the delay from interpolation between samples, as a fraction of the sampling interval.
const BETWEEN_SAMPLES: f64 = 0.03;

fn payload(robot: &Robot, config: &IdentifyConfig, posterior: &Posterior) -> PayloadEstimate {
    let link = config.payload_link;
    let pose = robot.body_from_link(link).unwrap_or_else(Isometry3::identity).inverse();
    let at = posterior.shared() - 1 - N_INERTIAL_PARAMETERS;
    let own: Vec<f64> = (0..N_INERTIAL_PARAMETERS).map(|k| posterior.mean[at + k]).collect();
    let mass = own[0];
    let mass_kg = value_of(posterior, &[(at, 1.0)], mass);
    let com = Vector3::new(own[1], own[2], own[3]) / mass;
    let rotation = pose.rotation.to_rotation_matrix();
    let com_link = pose * Point3::from(com);
    let com_m = [0, 1, 2].map(|axis| {
        let row = rotation.matrix().row(axis);
        let mut slopes: Vec<(usize, f64)> = (0..3).map(|k| (at + 1 + k, row[k] / mass)).collect();
        slopes.push((at, -(0..3).map(|k| row[k] * com[k]).sum::<f64>() / mass));
        value_of(posterior, &slopes, com_link[axis])
    });
    let origin =
        Matrix3::new(own[4], own[5], own[6], own[5], own[7], own[8], own[6], own[8], own[9]);
    let about_com =
        origin - mass * (Matrix3::identity() * com.norm_squared() - com * com.transpose());
    let turned = rotation * about_com * rotation.transpose();
    PayloadEstimate {
        link: robot.links()[link.index()].name.clone(),
        is_significant: mass > 2.0 * mass_kg.std,
        mass_kg,
        com_m,
        inertia_kg_m2: [0, 1, 2].map(|row| [0, 1, 2].map(|column| turned[(row, column)])),
    }
}

fn bodies(robot: &Robot, posterior: &Posterior) -> Vec<InertiaEstimate> {
    let parameters = posterior.parameters();
    let payload = posterior.shared() - 1 - N_INERTIAL_PARAMETERS;
    (robot.bodies().enumerate())
        .map(|(body, link)| {
            let value = |k: usize| {
                let at = N_INERTIAL_PARAMETERS * body + k;
                let mut slopes = vec![(at, 1.0)];
                if body == posterior.payload_body() {
                    slopes.push((payload + k, 1.0));
                }
                value_of(posterior, &slopes, parameters[at])
            };
            let variance_reduction = |k: usize| {
                let at = N_INERTIAL_PARAMETERS * body + k;
                1.0 - (posterior.covariance[(at, at)] / posterior.prior_variance[at]).min(1.0)
            };
            InertiaEstimate {
                link: robot.links()[link.index()].name.clone(),
                parameters: std::array::from_fn(value),
                variance_reduction: std::array::from_fn(variance_reduction),
            }
        })
        .collect()
}

/// The number of base parameters, and the number of them that these logs determine better than the URDF.
fn base_parameters(robot: &Robot, posterior: &Posterior) -> (usize, usize) {
    let size = posterior.prior_variance.len().min(N_INERTIAL_PARAMETERS * robot.bodies().len());
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut uniform = |half: f64| -> Vec<f64> {
        let one = |_| (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half;
        (0..robot.n_joints()).map(one).collect()
    };
    let scales = posterior.prior_variance.rows(0, size).map(f64::sqrt);
    let mut gram = DMatrix::zeros(size, size);
    for _ in 0..2 * size {
        let (q, speed, acceleration) = (uniform(2.5), uniform(1.0), uniform(3.0));
        let Ok(poses) = robot.forward(&q) else { continue };
        let regressor =
            robot.regressor(&poses, &speed, &acceleration) * DMatrix::from_diagonal(&scales);
        gram += regressor.transpose() * regressor;
    }
    let eigenvalues = gram.symmetric_eigenvalues();
    let largest = eigenvalues.max();
    let all = eigenvalues.iter().filter(|value| **value > 1e-9 * largest).count();

    let covariance = posterior.covariance.view((0, 0), (size, size));
    let relative = DMatrix::from_fn(size, size, |a, b| covariance[(a, b)] / scales[a] / scales[b]);
    // Determined: less than half of the prior variance remains.
    let identified = relative.symmetric_eigenvalues().iter().filter(|left| **left < 0.5).count();
    (all, identified.min(all))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn breakaway_that_takes_away_all_friction_is_not_separable() {
        let friction = |coulomb: f64, breakaway: f64| {
            is_separable(&JointFriction { coulomb, breakaway, ..JointFriction::default() })
        };
        assert!(friction(0.5, 0.2) && friction(0.5, -0.3));
        assert!(!friction(0.8, -0.83) && !friction(18.1, -19.4) && !friction(0.0, -0.1));
    }
}
