//! From what was given to what holds: given values laid over a base configuration.
//!
//! The base is the shipped one of the chosen estimator, or that of a saved field.

use palpate::unstable::{JointKind, PauseConfig};
use palpate::{
    ContactConfig, EstimatorConfig, ExternalTorqueConfig, Lattice, LatticeError, MapperConfig,
    Payload, Robot, Tare,
};
use palpate_io::log::{AngleUnit, LogOptions};
use serde::Serialize;

use super::parse::TareFrames;
use super::sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};
use super::{Settings, SettingsError};

/// Baked coarser than this, m, a link loses its shape.
const BAKE_SPACING_LIMIT_M: f64 = 0.05;
/// More replays than this after each frame take hours for a touch.
const REPLAYS_LIMIT: u32 = 100_000;

impl Settings {
    /// Refuses values that the core takes but nobody can mean.
    pub fn check(&self) -> Result<(), SettingsError> {
        let too_large = |key, found, limit, reason| {
            if found > limit {
                Err(SettingsError::TooLarge { key, found, limit, reason })
            } else {
                Ok(())
            }
        };
        let spacing_m = self.robot.bake_spacing_m.unwrap_or(0.0);
        let reason = "a coarser link loses its shape";
        too_large("bake_spacing_m", spacing_m, BAKE_SPACING_LIMIT_M, reason)?;
        let replays = f64::from(self.estimator.replays.unwrap_or(0));
        let reason = "more would take hours for a touch";
        too_large("replays", replays, f64::from(REPLAYS_LIMIT), reason)?;
        self.log.check()
    }

    /// Refuses frames of a tare that is not taken.
    pub(super) fn check_tare(&self, place: &str) -> Result<(), SettingsError> {
        if self.touch.no_tare == Some(true) && self.touch.tare_frames.is_some() {
            return Err(SettingsError::Together(format!(
                "{place}no_tare = true and tare_frames exclude each other; leave one of them out"
            )));
        }
        Ok(())
    }

    /// The configuration of a new field.
    pub fn config(&self) -> Result<MapperConfig, SettingsError> {
        let base = MapperConfig::of(self.estimator.estimator.unwrap_or_default());
        let lattice = self.lattice.over_lattice(&base.lattice)?;
        Ok(self.with_lattice(lattice, &base))
    }

    /// The configuration with everything that was not given taken from that of a saved field.
    ///
    /// Settings that the field's lattice may have come from give that very lattice: a box that is
    /// no multiple of the spacing is larger than what fills it, and cannot be told from it.
    pub fn config_over_saved(&self, saved: &MapperConfig) -> Result<MapperConfig, SettingsError> {
        let lattice = if self.lattice.may_give(&saved.lattice) {
            saved.lattice.clone()
        } else {
            self.lattice.over_lattice(&saved.lattice)?
        };
        Ok(self.with_lattice(lattice, saved))
    }

    fn with_lattice(&self, lattice: Lattice, base: &MapperConfig) -> MapperConfig {
        let method = self.estimator.estimator.unwrap_or(base.method);
        let shipped = EstimatorConfig::of(method);
        let estimator = if method == base.method { &base.estimator } else { &shipped };
        let mut config = MapperConfig::of(method);
        config.lattice = lattice;
        config.contact = self.contact.over_config(&base.contact);
        config.touch = self.touch.over_config(&base.touch);
        config.estimator = self.estimator.over_config(estimator);
        config
    }
}

impl RobotSettings {
    /// The robot's name or path.
    pub fn name(&self) -> &str {
        self.robot.as_deref().unwrap_or("kinova_gen3")
    }

    /// What the robot carries.
    pub fn payload(&self) -> Result<Option<Payload>, SettingsError> {
        let com_link_m = self.payload_com_m.unwrap_or_default();
        match (&self.payload_link, self.payload_mass_kg) {
            (Some(link), Some(mass_kg)) => Ok(Some(Payload::new(link, mass_kg, com_link_m))),
            (None, None) if self.payload_com_m.is_none() => Ok(None),
            _ => Err(SettingsError::Together(
                "a payload needs both payload_link (--payload-link) and payload_mass_kg \
                 (--payload-mass-kg)"
                    .to_owned(),
            )),
        }
    }
}

impl LogSettings {
    /// How to open logs.
    pub fn options(&self) -> LogOptions {
        LogOptions {
            columns: self.columns.clone(),
            angle_unit: self.angle_unit.unwrap_or_default(),
            topic: self.topic.clone(),
            touch_topic: self.touch_topic.clone(),
            joints: self.joints.clone(),
            split_gap_s: self.split_gap_s,
            until_break: self.until_break.unwrap_or_default(),
        }
    }

    /// Refuses gaps and pauses that are none.
    fn check(&self) -> Result<(), SettingsError> {
        if let Some(gap_s) = self.split_gap_s.filter(|gap_s| !(*gap_s > 0.0 && gap_s.is_finite())) {
            return Err(SettingsError::Together(format!(
                "bad setting: split_gap_s is {gap_s}; it must be above 0 s, and finite"
            )));
        }
        let pauses = self.pauses().map_or(Ok(()), |config| config.check());
        pauses.map_err(|error| SettingsError::Together(format!("bad setting: {error}")))
    }

    /// What counts as a pause, if logs are to be parted at pauses.
    pub fn pauses(&self) -> Option<PauseConfig> {
        let mut config = PauseConfig::default();
        config.idle_s = self.idle_s.unwrap_or(config.idle_s);
        config.renew_s = config.renew_s.max(config.idle_s);
        self.split_idle.unwrap_or_default().then_some(config)
    }

    /// Refuses degrees for a robot of which some positions are no angles.
    pub fn check_for(&self, robot: &Robot) -> Result<(), SettingsError> {
        let mut joints = robot.joints().iter();
        let slides = joints.find(|joint| joint.kind == JointKind::Prismatic);
        match slides {
            Some(joint) if self.options().angle_unit == AngleUnit::Deg => {
                Err(SettingsError::Together(format!(
                    "angle_unit is deg, but joint `{}` of the robot `{}` is prismatic: its metres \
                     would be turned into radians; convert the angles of the log to radians, and \
                     leave angle_unit (--angle-unit) out",
                    joint.name,
                    robot.name()
                )))
            }
            _ => Ok(()),
        }
    }
}

impl TouchSettings {
    /// These over another configuration.
    pub fn over_config(&self, base: &ExternalTorqueConfig) -> ExternalTorqueConfig {
        let tare = match (self.no_tare, self.tare_frames) {
            (Some(true), _) => Tare::None,
            (_, Some(TareFrames::First(frames))) => Tare::Frames(frames),
            (_, Some(TareFrames::Auto)) => Tare::Auto,
            (Some(false), None) if base.tare == Tare::None => Tare::Auto,
            _ => base.tare,
        };
        let mut config = base.clone();
        config.torque_sign = self.torque_sign.unwrap_or(base.torque_sign);
        config.gravity = self.gravity.unwrap_or(base.gravity);
        config.tare = tare;
        config.still_rad = self.still_rad.unwrap_or(base.still_rad);
        config
    }
}

impl LatticeSettings {
    /// Whether some box with the one corner that was given is filled by this lattice.
    ///
    /// A lattice stands in the middle of its box, so the other corner is the mirror image.
    fn may_give(&self, saved: &Lattice) -> bool {
        let (low_m, high_m) = corners(saved);
        let mirrored = |corner_m: [f64; 3]| {
            std::array::from_fn(|axis| low_m[axis] + high_m[axis] - corner_m[axis])
        };
        let (low_m, high_m) = match (self.box_low_m, self.box_high_m) {
            (Some(low_m), None) => (low_m, mirrored(low_m)),
            (None, Some(high_m)) => (mirrored(high_m), high_m),
            _ => return false, // There is nothing to guess.
        };
        let spacing_m = self.spacing_m.unwrap_or(saved.spacing_m());
        self.origin_m.is_none()
            && self.shape.is_none()
            && Lattice::filling(low_m, high_m, spacing_m)
                .is_ok_and(|lattice| same_lattice(&lattice, saved))
    }

    fn over_lattice(&self, base: &Lattice) -> Result<Lattice, SettingsError> {
        let by_box = self.box_low_m.is_some() || self.box_high_m.is_some();
        let by_shape = self.origin_m.is_some() || self.shape.is_some();
        let spacing_m = self.spacing_m.unwrap_or(base.spacing_m());
        if by_box && by_shape {
            return Err(SettingsError::Together(
                "the lattice is given twice; give either box_low_m and box_high_m, or origin_m \
                 and shape"
                    .to_owned(),
            ));
        }
        if by_shape {
            let origin_m = self.origin_m.unwrap_or(base.origin_m().into());
            return Ok(Lattice::new(origin_m, spacing_m, self.shape.unwrap_or(base.shape()))?);
        }
        if !by_box && spacing_m == base.spacing_m() {
            return Ok(base.clone());
        }
        let (low_m, high_m) = corners(base);
        let (low_m, high_m) = (self.box_low_m.unwrap_or(low_m), self.box_high_m.unwrap_or(high_m));
        if (0..3).any(|axis| high_m[axis] <= low_m[axis]) {
            return Err(SettingsError::Together(format!(
                "the workspace box is turned inside out: box_high_m is {high_m:?}, which must be \
                 above box_low_m, {low_m:?}, on every axis"
            )));
        }
        let lattice = Lattice::filling(low_m, high_m, spacing_m).map_err(|error| match error {
            LatticeError::EmptyAxis { .. } => SettingsError::Together(format!(
                "a spacing of {spacing_m} m leaves no point in the box from {low_m:?} to \
                 {high_m:?} m; make the spacing smaller or the box larger"
            )),
            other => SettingsError::Lattice(other),
        })?;
        Ok(lattice)
    }
}

/// The corners of the box that a lattice fills, m.
pub fn corners(lattice: &Lattice) -> ([f64; 3], [f64; 3]) {
    let (spacing_m, shape) = (lattice.spacing_m(), lattice.shape());
    let low_m: [f64; 3] = lattice.origin_m().coords.map(|x| x - 0.5 * spacing_m).into();
    let high_m =
        std::array::from_fn(|axis| low_m[axis] + f64::from(shape[axis]) * lattice.spacing_m());
    (low_m, high_m)
}

impl ContactSettings {
    fn over_config(&self, base: &ContactConfig) -> ContactConfig {
        let mut config = base.clone();
        config.contact_distance_m = self.contact_distance_m.unwrap_or(base.contact_distance_m);
        config.friction = self.friction.unwrap_or(base.friction);
        config.slip_step_m = self.slip_step_m.unwrap_or(base.slip_step_m);
        config.slip_iterations = self.slip_iterations.unwrap_or(base.slip_iterations);
        config.substep_cells = self.substep_cells.unwrap_or(base.substep_cells);
        config.known_empty = self.known_empty.unwrap_or(base.known_empty);
        config
    }
}

impl EstimatorSettings {
    fn over_config(&self, base: &EstimatorConfig) -> EstimatorConfig {
        let mut config = base.clone();
        config.prior.mean_n_per_m = self.prior_mean.unwrap_or(base.prior.mean_n_per_m);
        config.prior.std_n_per_m = self.prior_std.unwrap_or(base.prior.std_n_per_m);
        config.torque_std = self.torque_std.clone().unwrap_or(config.torque_std);
        config.drift_std_n_per_m = self.drift_std.unwrap_or(base.drift_std_n_per_m);
        config.replays = self.replays.unwrap_or(base.replays);
        config.memory.frames = self.memory_frames.unwrap_or(base.memory.frames);
        let bytes = self.memory_mib.map(|mib| mib.saturating_mul(1 << 20));
        config.memory.bytes = bytes.unwrap_or(base.memory.bytes);
        config.seed = self.seed.unwrap_or(base.seed);
        config
    }
}

/// Whether two lattices differ by no more than the dust of arithmetic.
pub fn same_lattice(a: &Lattice, b: &Lattice) -> bool {
    (a.spacing_m() - b.spacing_m()).abs() < 1e-9
        && (a.origin_m() - b.origin_m()).amax() < 1e-9
        && a.shape() == b.shape()
}

/// The first setting in which a configuration departs from that of a saved field.
pub fn first_difference(saved: &MapperConfig, given: &MapperConfig) -> Option<String> {
    let (a, b) = (&saved.lattice, &given.lattice);
    if !same_lattice(a, b) {
        let [a, b] = [a, b].map(lattice_in_words);
        return Some(format!("the lattice is {a}, not {b}"));
    }
    if saved.method != given.method {
        let [saved, given] = [saved, given].map(|config| config.method.name());
        return Some(format!("estimator is {saved}, not {given}"));
    }
    let mut differences = departures(&saved.contact, &given.contact);
    differences.extend(departures(&saved.touch, &given.touch));
    differences.extend(departures(&saved.estimator, &given.estimator));
    differences.into_iter().next()
}

/// The settings of a section in which it departs from a saved one.
pub fn departures<T: Serialize>(saved: &T, given: &T) -> Vec<String> {
    let json = |section| serde_json::to_value(section).expect("settings are plain data");
    let (saved, given) = (json(saved), json(given));
    let differs = |(key, value): (&String, &serde_json::Value)| {
        (given.get(key) != Some(value))
            .then(|| format!("{key} is {value}, not {}", given.get(key).unwrap_or_default()))
    };
    saved.as_object().into_iter().flatten().filter_map(differs).collect()
}

/// Shape, spacing and origin.
pub fn lattice_in_words(lattice: &Lattice) -> String {
    let origin_m: [f64; 3] = lattice.origin_m().into();
    format!("{:?} points every {} m from {origin_m:?} m", lattice.shape(), lattice.spacing_m())
}
