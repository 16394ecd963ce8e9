//! Turns settings into configurations: given values are laid over a base configuration.
//!
//! The base is the default of the chosen estimator, or the configuration of a saved field.

use palpate::unstable::{JointKind, PauseConfig};
use palpate::{
    EstimatorConfig, ExternalTorqueConfig, Gravity, Lattice, MapperConfig, Payload, Robot, Tare,
    TorqueSign,
};
use palpate_io::log::{AngleUnit, LogOptions};
use serde::Serialize;

use super::error::SettingsError;
use super::lattice::{lattice_in_words, same_lattice};
use super::sections::{LogSettings, RobotSettings, Section, Settings, TouchSettings};
use super::values::{OrAuto, TareFrames};

/// Largest spacing of baked distances, m; with a larger one, a link loses its shape.
const BAKE_SPACING_LIMIT_M: f64 = 0.05;
/// Most replays after each frame; more would take hours for a touch.
const REPLAYS_LIMIT: f64 = 100_000.0;

impl Settings {
    /// Refuses values that are out of range, whatever the robot and the log are, and values that the core accepts but
    /// that cannot be intended.
    pub fn check(&self) -> Result<(), SettingsError> {
        let spacing_m = self.robot.bake_spacing_m.unwrap_or(0.0);
        let replays = f64::from(self.estimator.replays.unwrap_or(0));
        for (key, found, limit, reason) in [
            ("bake_spacing_m", spacing_m, BAKE_SPACING_LIMIT_M, "a coarser link loses its shape"),
            ("replays", replays, REPLAYS_LIMIT, "more would take hours for a touch"),
        ] {
            if found > limit {
                return Err(SettingsError::TooLarge { key, found, limit, reason });
            }
        }
        let base = MapperConfig::of(self.estimator.estimator.unwrap_or_default());
        let config = self.with_lattice(base.lattice.clone(), &base);
        config.contact.check().map_err(SettingsError::value)?;
        config.touch.check().map_err(SettingsError::value)?;
        config.estimator.check().map_err(SettingsError::value)?;
        self.log.check()
    }

    /// Refuses `tare_frames` together with `no_tare = true`.
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

    /// The configuration of these settings; values that are not given are those of a saved field.
    ///
    /// Settings from which the field's lattice may have been made give exactly that lattice: a box that is not a
    /// multiple of the spacing is larger than the lattice in it, and the saved field contains only the lattice.
    pub(crate) fn config_over_saved(
        &self,
        saved: &MapperConfig,
    ) -> Result<MapperConfig, SettingsError> {
        let lattice = if self.lattice.may_give(&saved.lattice) {
            saved.lattice.clone()
        } else {
            self.lattice.over_lattice(&saved.lattice)?
        };
        Ok(self.with_lattice(lattice, saved))
    }

    /// Convention of the torques that the mapper gets: the settings over a base. With an identified arm, these are
    /// external torques already.
    fn external_torque(&self, base: &ExternalTorqueConfig) -> ExternalTorqueConfig {
        let is_identified = self.robot.arm.is_some();
        let mut config = self.touch.over_config(base);
        if is_identified {
            (config.torque_sign, config.gravity) = (TorqueSign::Plus, Gravity::Removed);
        }
        config.identified = is_identified;
        config
    }

    /// Torque convention of logs that are compared with a field.
    ///
    /// # Errors
    ///
    /// If the convention is unknown: the field was learnt with an identified arm, the logs are read without one, and
    /// sign or gravity is not given.
    pub fn torque_convention_for_field(
        &self,
        field: &ExternalTorqueConfig,
    ) -> Result<ExternalTorqueConfig, SettingsError> {
        let says_all =
            self.touch.torque_sign_given().is_some() && self.touch.gravity_given().is_some();
        if field.identified && self.robot.arm.is_none() && !says_all {
            return Err(SettingsError::Together(
                "the field was learnt with an identified arm, so it does not contain sign and gravity of the torques \
                 in these logs; give that arm (--arm), or both --torque-sign and --gravity"
                    .to_owned(),
            ));
        }
        Ok(self.external_torque(field))
    }

    /// Convention of the measured torques of a running robot.
    ///
    /// # Errors
    ///
    /// If sign or gravity is not given, since they cannot be found sample by sample.
    pub fn torque_convention_for_robot(&self) -> Result<ExternalTorqueConfig, SettingsError> {
        if self.touch.torque_sign_given().is_none() || self.touch.gravity_given().is_none() {
            return Err(SettingsError::Together(
                "give torque_sign (--torque-sign) and gravity (--gravity), or --arm with a file of `palpate identify` \
                 that contains them; while the robot runs, they cannot be found from the data"
                    .to_owned(),
            ));
        }
        Ok(self.touch.over_config(&ExternalTorqueConfig::default()))
    }

    fn with_lattice(&self, lattice: Lattice, base: &MapperConfig) -> MapperConfig {
        let mut config = base.clone();
        config.lattice = lattice;
        if let Some(method) = self.estimator.estimator.filter(|method| *method != base.method) {
            (config.method, config.estimator) = (method, EstimatorConfig::of(method));
        }
        self.contact.set(&mut config.contact);
        config.touch = self.external_torque(&base.touch);
        self.estimator.set(&mut config.estimator);
        if let Some(mib) = self.estimator.memory_mib {
            config.estimator.memory.bytes = mib.saturating_mul(1 << 20);
        }
        config
    }
}

impl RobotSettings {
    /// The robot's name or path.
    pub fn name(&self) -> &str {
        self.robot.as_deref().unwrap_or("kinova_gen3")
    }

    /// The payload, if one is given.
    pub(crate) fn payload(&self) -> Result<Option<Payload>, SettingsError> {
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
        let angle_unit = self.angle_unit_given();
        let time_unit = self.time_unit.and_then(OrAuto::given);
        let mut options = LogOptions { angle_unit, time_unit, ..LogOptions::default() };
        self.set(&mut options);
        options
    }

    /// The given unit of the angles; `None` if it is to be found.
    pub fn angle_unit_given(&self) -> Option<AngleUnit> {
        self.angle_unit.and_then(OrAuto::given)
    }

    /// Refuses gaps and pauses that are out of range.
    fn check(&self) -> Result<(), SettingsError> {
        if let Some(gap_s) = self.split_gap_s.filter(|gap_s| !(*gap_s > 0.0 && gap_s.is_finite())) {
            return Err(SettingsError::Together(format!(
                "bad setting: split_gap_s is {gap_s}; it must be above 0 s, and finite"
            )));
        }
        self.pause().check().map_err(SettingsError::value)
    }

    /// What counts as a pause, if logs are to be split at pauses.
    pub fn pauses(&self) -> Option<PauseConfig> {
        self.split_idle.unwrap_or_default().then(|| self.pause())
    }

    /// What counts as a pause.
    fn pause(&self) -> PauseConfig {
        let mut config = PauseConfig::default();
        config.idle_s = self.idle_s.unwrap_or(config.idle_s);
        config.renew_s = config.renew_s.max(config.idle_s);
        config
    }

    /// Refuses degrees for a robot with a prismatic joint.
    pub(crate) fn check_for(&self, robot: &Robot) -> Result<(), SettingsError> {
        let mut joints = robot.joints().iter();
        let slides = joints.find(|joint| joint.kind == JointKind::Prismatic);
        match slides {
            Some(joint) if self.angle_unit_given() == Some(AngleUnit::Deg) => {
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
    /// The given sign of the torques; `None` if it is to be found.
    pub fn torque_sign_given(&self) -> Option<TorqueSign> {
        self.torque_sign.and_then(OrAuto::given)
    }

    /// Whether the torques contain gravity, as given; `None` if it is to be found.
    pub fn gravity_given(&self) -> Option<Gravity> {
        self.gravity.and_then(OrAuto::given)
    }

    /// The given number of frames at the start of each touch that give the tare; 0 if it is not given.
    pub fn first_frames(&self) -> usize {
        match self.tare_frames {
            Some(TareFrames::First(frames)) => frames as usize,
            _ => 0,
        }
    }

    /// Another configuration with the given values.
    pub fn over_config(&self, base: &ExternalTorqueConfig) -> ExternalTorqueConfig {
        let mut config = base.clone();
        self.set(&mut config);
        config.torque_sign = self.torque_sign_given().unwrap_or(base.torque_sign);
        config.gravity = self.gravity_given().unwrap_or(base.gravity);
        config.tare = match (self.no_tare, self.tare_frames) {
            (Some(true), _) => Tare::None,
            (_, Some(TareFrames::First(frames))) => Tare::Frames(frames),
            (_, Some(TareFrames::Auto)) => Tare::Auto,
            (Some(false), None) if base.tare == Tare::None => Tare::Auto,
            _ => base.tare,
        };
        config
    }
}

/// The first setting in which a configuration differs from that of a saved field, in words.
pub(crate) fn first_difference(saved: &MapperConfig, given: &MapperConfig) -> Option<String> {
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

/// The settings in which a section differs from a saved one, in words.
pub(crate) fn departures<T: Serialize>(saved: &T, given: &T) -> Vec<String> {
    let json = |section| serde_json::to_value(section).expect("settings are plain data");
    let (saved, given) = (json(saved), json(given));
    let differs = |(key, value): (&String, &serde_json::Value)| {
        (given.get(key) != Some(value))
            .then(|| format!("{key} is {value}, not {}", given.get(key).unwrap_or_default()))
    };
    saved.as_object().into_iter().flatten().filter_map(differs).collect()
}
