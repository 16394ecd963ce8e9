//! The settings file: TOML with one table per section, keys named as the flags.
//!
//! Keys are checked before values, so that a misspelt one is met with its line and the nearest
//! name that exists, wherever in the file that lives.

use std::path::Path;

use clap::{Arg, Args, Command};
use serde::Deserialize;
use toml::de::DeTable;

use super::error::SettingsError;
use super::sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, Settings,
    TouchSettings,
};

/// The sections of a settings file and their keys, as the flags declare them.
pub(super) struct Keys {
    /// Section names in the template's order, each with its keys.
    pub(super) sections: Vec<(&'static str, Vec<Arg>)>,
}

impl Keys {
    /// All there are.
    pub(super) fn all() -> Self {
        Self {
            sections: vec![
                ("robot", keys_of::<RobotSettings>()),
                ("log", keys_of::<LogSettings>()),
                ("touch", keys_of::<TouchSettings>()),
                ("lattice", keys_of::<LatticeSettings>()),
                ("contact", keys_of::<ContactSettings>()),
                ("estimator", keys_of::<EstimatorSettings>()),
            ],
        }
    }

    /// What to say to someone who wrote a section that is not known.
    fn section_remedy(&self, wrong: &str) -> String {
        nearest(wrong, self.sections.iter().map(|(name, _)| (*name, format!("[{name}]"))))
    }

    /// What to say to someone who wrote a key that is not known in `section`.
    fn key_remedy(&self, section: Option<&str>, wrong: &str) -> String {
        let all = self.sections.iter().flat_map(|(name, args)| {
            args.iter().map(move |arg| {
                let key = arg.get_id().as_str();
                let here = section == Some(name);
                (key, if here { format!("`{key}`") } else { format!("`{key}` in [{name}]") })
            })
        });
        nearest(wrong, all)
    }
}

/// Suggests the name that is most like the wrong one, if any is.
fn nearest<'a>(wrong: &str, names: impl Iterator<Item = (&'a str, String)>) -> String {
    let plain = wrong.replace('-', "_").to_lowercase();
    let likeness = names.map(|(name, shown)| (strsim::jaro_winkler(&plain, name), shown));
    match likeness.max_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((likeness, shown)) if likeness > 0.8 => format!("; did you mean {shown}?"),
        _ => "; `palpate settings` prints all there are".to_owned(),
    }
}

fn keys_of<T: Args>() -> Vec<Arg> {
    T::augment_args(Command::new("")).get_arguments().cloned().collect()
}

/// Reads a settings file.
///
/// # Errors
///
/// If it cannot be read, is no TOML, or has a key or a value that means nothing.
pub fn read(path: &Path) -> Result<Settings, SettingsError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| SettingsError::Unreadable { path: path.to_owned(), source })?;
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Settings, SettingsError> {
    let broken = |error: toml::de::Error| SettingsError::Toml {
        path: path.to_owned(),
        message: error.to_string().trim_end().to_owned(),
    };
    check_keys(path, text, DeTable::parse(text).map_err(broken)?.get_ref())?;
    let settings: Settings = toml::from_str(text).map_err(broken)?;
    settings.check_tare(&format!("`{}`: ", path.display()))?;
    Ok(settings)
}

/// The settings that a table says, as a program may have made it.
///
/// # Errors
///
/// As [`read`]; values out of their range are found as well.
pub fn of_table(table: &toml::Table) -> Result<Settings, SettingsError> {
    let keys = |value: &toml::Value| {
        value.as_table().map(|table| table.keys().map(|key| (0, key.clone())).collect())
    };
    let sections = table.iter().map(|(name, value)| (0, name.clone(), keys(value)));
    if let Some((_, key, remedy)) = first_unknown(sections) {
        return Err(SettingsError::Together(format!("there is no setting `{key}`{remedy}")));
    }
    let settings = Settings::deserialize(table.clone()).map_err(|error| {
        let message = error.to_string().trim_end().replace('\n', " ");
        SettingsError::Together(format!("bad setting: {message}"))
    })?;
    settings.check_tare("")?;
    settings.check()?;
    Ok(settings)
}

/// Refuses the first key, in the file's order, that is not known.
fn check_keys(path: &Path, text: &str, table: &DeTable<'_>) -> Result<(), SettingsError> {
    let keys = |table: &DeTable<'_>| {
        table.keys().map(|key| (key.span().start, key.get_ref().to_string())).collect()
    };
    let sections = table.iter().map(|(section, value)| {
        let (at, name) = (section.span().start, section.get_ref().to_string());
        (at, name, value.get_ref().as_table().map(keys))
    });
    match first_unknown(sections) {
        Some((at, key, remedy)) => Err(SettingsError::UnknownKey {
            path: path.to_owned(),
            line: 1 + text[..at].matches('\n').count(),
            key,
            remedy,
        }),
        None => Ok(()),
    }
}

/// A name and where it stands.
type Placed = (usize, String);

/// The first name that is not known, with what to say to whoever wrote it.
///
/// Each section comes with its place, its name and, if it is a table, its keys.
fn first_unknown(
    sections: impl Iterator<Item = (usize, String, Option<Vec<Placed>>)>,
) -> Option<(usize, String, String)> {
    let all = Keys::all();
    let mut unknown: Vec<(usize, String, String)> = Vec::new();
    for (at, section, keys) in sections {
        let Some((_, known)) = all.sections.iter().find(|(name, _)| *name == section) else {
            let remedy = match keys {
                Some(_) => all.section_remedy(&section),
                None => all.key_remedy(None, &section),
            };
            unknown.push((at, section, remedy));
            continue;
        };
        for (at, key) in keys.unwrap_or_default() {
            if !known.iter().any(|arg| *arg.get_id() == *key) {
                let remedy = all.key_remedy(Some(&section), &key);
                unknown.push((at, key, remedy));
            }
        }
    }
    unknown.into_iter().min()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse(Path::new("p.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn a_misspelt_key_is_met_with_its_line_and_the_name_that_was_meant() {
        let found = message("[contact]\nfriction = 0.3\n\n[estimator]\npriorstd = 1.0\n");
        assert!(found.contains("line 5") && found.contains("mean `prior_std`?"), "{found}");
        let found = message("[contact]\nspacing_m = 0.01\n");
        assert!(found.contains("did you mean `spacing_m` in [lattice]?"), "{found}");
        let found = message("[estimater]\n");
        assert!(found.contains("did you mean [estimator]?"), "{found}");
        let found = message("friction = 0.3\n");
        assert!(found.contains("line 1") && found.contains("in [contact]?"), "{found}");
    }

    #[test]
    fn a_table_made_by_a_program_is_checked_as_a_file_is() {
        let message = |text: &str| {
            let table: toml::Table = toml::from_str(text).unwrap();
            of_table(&table).unwrap_err().to_string()
        };
        let found = message("[estimator]\npriorstd = 1.0\n");
        assert_eq!(found, "there is no setting `priorstd`; did you mean `prior_std`?");
        let found = message("[contact]\nfriction = \"much\"\n");
        assert!(found.contains("much") && found.contains("contact.friction"), "{found}");
        let found = message("[touch]\nno_tare = true\ntare_frames = 3\n");
        assert!(found.contains("exclude each other"), "{found}");
        assert!(message("[robot]\nbake_spacing_m = 1.0\n").contains("at most"));
    }

    #[test]
    fn a_value_of_the_wrong_kind_is_met_with_its_place() {
        let found = message("[contact]\nfriction = \"much\"\n");
        assert!(found.contains("line 2, column 12"), "{found}");
        let found = message("[touch]\ntare_frames = 0\n");
        assert!(found.contains("line 2") && found.contains("above 0, or auto"), "{found}");
    }

    #[test]
    fn every_key_is_known_to_the_struct_that_reads_the_file() {
        let settings = Settings::effective(&Settings::default()).unwrap();
        let table = toml::Table::try_from(settings).unwrap();
        for (section, args) in Keys::all().sections {
            for key in table[section].as_table().unwrap().keys() {
                assert!(args.iter().any(|arg| arg.get_id() == key), "{section}.{key}");
            }
        }
    }
}
