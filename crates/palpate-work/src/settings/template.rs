//! `palpate settings`: the effective settings as a commented TOML file.

use palpate::unstable::PauseConfig;
use palpate::{EstimatorKind, Lattice, Tare};

use super::error::SettingsError;
use super::file::sections;
use super::lattice::corners;
use super::sections::{Section, Settings};
use super::values::{OrAuto, TareFrames};
use crate::tune::CHOSEN;

impl Settings {
    /// The same settings with every default filled in.
    pub fn effective(&self) -> Result<Self, SettingsError> {
        let config = self.config()?;
        let mut all = self.clone();
        all.robot.robot = Some(self.robot.name().to_owned());
        all.log.take(&self.log.options());
        all.log.angle_unit.get_or_insert(OrAuto::AUTO);
        all.log.time_unit.get_or_insert(OrAuto::AUTO);
        all.log.split_idle.get_or_insert_default();
        all.log.strict.get_or_insert_default();
        all.log.idle_s.get_or_insert(PauseConfig::default().idle_s);

        all.touch.take(&config.touch);
        all.touch.torque_sign.get_or_insert(OrAuto::AUTO);
        all.touch.gravity.get_or_insert(OrAuto::AUTO);
        all.touch.no_tare = Some(config.touch.tare == Tare::None);
        all.touch.tare_frames = match config.touch.tare {
            Tare::Auto => Some(TareFrames::Auto),
            Tare::Frames(frames) => Some(TareFrames::First(frames)),
            Tare::None => None,
        };

        let lattice = &config.lattice;
        all.lattice.spacing_m = Some(lattice.spacing_m());
        if all.lattice.by_shape() {
            all.lattice.origin_m = Some(lattice.origin_m().into());
            all.lattice.shape = Some(lattice.shape());
        } else {
            // A box that is not a multiple of the spacing is larger than its lattice: only the given box leads to the
            // same points again.
            let (low_m, high_m) = corners(&Lattice::default());
            all.lattice.box_low_m.get_or_insert(low_m.map(rounded));
            all.lattice.box_high_m.get_or_insert(high_m.map(rounded));
        }

        all.contact.take(&config.contact);
        all.estimator.take(&config.estimator);
        all.estimator.estimator = Some(config.method);
        all.estimator.memory_mib = Some(config.estimator.memory.bytes >> 20);
        Ok(all)
    }

    /// The effective settings as TOML, each key under its help. Keys without a value are commented out, and so are
    /// those for which `map` chooses a value: it would not if the file had one.
    pub fn template(&self) -> Result<String, SettingsError> {
        let broken = |error: toml::ser::Error| {
            SettingsError::Together(format!("the settings cannot be written as TOML: {error}"))
        };
        let given = toml::Table::try_from(self).map_err(broken)?;
        let values = toml::Table::try_from(self.effective()?).map_err(broken)?;
        let is_map = self.config()?.method == EstimatorKind::Map;
        let is_chosen = |section, key: &str| {
            let given = given.get(section).is_some_and(|table| table.get(key).is_some());
            is_map && !given && CHOSEN.contains(&key)
        };
        let mut text = String::from(
            "# Settings of palpate: every key is also a flag, which wins over this file.\n\
             # Use with --settings FILE.toml; what is left out keeps its default. `map` and `evaluate` choose\n\
             # values for the keys that say so, if neither this file nor a flag gives one.\n",
        );
        for (section, args) in sections() {
            text += &format!("\n[{section}]\n");
            for arg in args {
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                text += &format!("# {}\n", help.replace('\n', "\n# "));
                let key = arg.get_id().as_str();
                text += &match values.get(section).and_then(|table| table.get(key)) {
                    Some(value) if is_chosen(section, key) => {
                        format!(
                            "# `map` and `evaluate` choose a value, if none is given.\n# {key} = {value}\n"
                        )
                    }
                    Some(value) => format!("{key} = {value}\n"),
                    None => format!("# {key} =\n"),
                };
            }
        }
        Ok(text)
    }
}

/// A length, m, without rounding errors.
fn rounded(length_m: f64) -> f64 {
    (length_m * 1e9).round() / 1e9
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::resolve::first_difference;
    use super::super::sections::EstimatorSettings;
    use super::*;

    #[test]
    fn the_template_read_back_means_the_same() {
        let text = Settings::default().template().unwrap();
        let read: Settings = toml::from_str(&text).unwrap();
        assert_eq!(read.template().unwrap(), text);
        let (shipped, read) = (Settings::default().config().unwrap(), read.config().unwrap());
        assert_eq!(first_difference(&shipped, &read), None);
    }

    proptest! {
        #[test]
        fn a_template_of_any_settings_reads_back_as_itself(
            spacing_m in 0.002..1.0f64,
            [friction, mean] in prop::array::uniform2(1e-4..1.0f64),
            torque_std in prop::collection::vec(1e-6..1e3f64, 1..8),
            [robot, topic, link] in prop::array::uniform3("\\PC{1,12}|.{1,12}"),
            [strict, no_cache] in any::<[bool; 2]>(),
            seed in any::<u32>(),
        ) {
            let mut settings = Settings::default();
            (settings.robot.robot, settings.robot.payload_link) = (Some(robot), Some(link));
            (settings.robot.no_cache, settings.log.strict) = (Some(no_cache), Some(strict));
            settings.log.topic = Some(topic);
            settings.lattice.spacing_m = Some(spacing_m);
            settings.contact.friction = Some(friction);
            settings.estimator.prior_mean = Some(mean);
            settings.estimator.torque_std = Some(torque_std);
            settings.estimator.seed = Some(seed.into());
            let text = settings.template().unwrap();
            let read: Settings = toml::from_str(&text).unwrap();
            prop_assert_eq!(read.template().unwrap(), text);
            prop_assert_eq!(read.robot.robot, settings.robot.robot);
            prop_assert_eq!(read.robot.payload_link, settings.robot.payload_link);
            prop_assert_eq!(read.log.topic, settings.log.topic);
            prop_assert_eq!(read.estimator.torque_std, settings.estimator.torque_std);
        }
    }

    #[test]
    fn the_help_gives_the_defaults_of_the_core() {
        let of = |method| {
            let estimator = EstimatorSettings { estimator: Some(method), ..Default::default() };
            let settings = Settings { estimator, ..Settings::default() };
            toml::Table::try_from(settings.effective().unwrap()).unwrap()
        };
        let (map, ekf) = (of(EstimatorKind::Map), of(EstimatorKind::Ekf));
        for (section, args) in sections() {
            for arg in args.iter().filter(|arg| arg.get_id() != "estimator") {
                let default = |table: &toml::Table| {
                    let value = table[section].get(arg.get_id().as_str())?.to_string();
                    Some(value.replace(['[', ']', ' ', '"'], "")).filter(|value| value != "false")
                };
                let (Some(map), Some(ekf)) = (default(&map), default(&ekf)) else { continue };
                let expected =
                    if map == ekf { map } else { format!("{map} for map, {ekf} for ekf") };
                let help = arg.get_help().unwrap().to_string();
                assert!(help.ends_with(&format!("[default: {expected}]")), "{expected}: {help}");
            }
        }
    }
}
