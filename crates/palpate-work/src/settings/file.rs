//! The settings file: TOML with one table per section and keys named like the flags.
//!
//! Keys are checked before values, so that the error for a misspelt key gives its line and the most
//! similar key of all sections.

use std::path::Path;

use clap::{Arg, Args, Command};
use palpate_io::input;
use serde::Deserialize;
use toml::de::DeTable;

use super::error::SettingsError;
use super::sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, Settings,
    TouchSettings,
};

/// Name of a section, and its keys as clap arguments.
pub(super) type Keys = (&'static str, Vec<Arg>);

/// All sections, in the template's order.
pub(super) fn sections() -> [Keys; 6] {
    [
        ("robot", keys_of::<RobotSettings>()),
        ("log", keys_of::<LogSettings>()),
        ("touch", keys_of::<TouchSettings>()),
        ("lattice", keys_of::<LatticeSettings>()),
        ("contact", keys_of::<ContactSettings>()),
        ("estimator", keys_of::<EstimatorSettings>()),
    ]
}

/// Advice about a key that does not exist in `section`, or at the top level.
fn key_remedy(all: &[Keys], section: Option<&str>, wrong: &str) -> String {
    let keys = all.iter().flat_map(|(name, args)| {
        args.iter().map(move |arg| {
            let key = arg.get_id().as_str();
            let here = section == Some(name);
            (key, if here { format!("`{key}`") } else { format!("`{key}` in [{name}]") })
        })
    });
    nearest(wrong, keys)
}

/// Suggests the name that is most similar to the wrong one, if one is similar enough.
fn nearest<'a>(wrong: &str, names: impl Iterator<Item = (&'a str, String)>) -> String {
    let plain = wrong.replace('-', "_").to_lowercase();
    let likeness = names.map(|(name, shown)| (strsim::jaro_winkler(&plain, name), shown));
    match likeness.max_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((likeness, shown)) if likeness > 0.8 => format!("; did you mean {shown}?"),
        _ => "; `palpate settings` prints all settings".to_owned(),
    }
}

fn keys_of<T: Args>() -> Vec<Arg> {
    T::augment_args(Command::new("")).get_arguments().cloned().collect()
}

/// Largest size of a settings file, bytes.
const LARGEST: u64 = 1 << 20;

/// Reads a settings file.
///
/// # Errors
///
/// If it cannot be read, is not TOML, or has an unknown key or an invalid value.
pub fn read(path: &Path) -> Result<Settings, SettingsError> {
    let text = input::read_text(path, LARGEST)
        .map_err(|source| SettingsError::Unreadable { path: path.to_owned(), source })?;
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Settings, SettingsError> {
    let broken = |error: toml::de::Error| SettingsError::Toml {
        path: path.to_owned(),
        message: error.to_string().trim_end().to_owned(),
    };
    if let Some(Unknown { at, key, remedy }) = first_unknown(text).map_err(broken)? {
        let line = 1 + text[..at].matches('\n').count();
        return Err(SettingsError::UnknownKey { path: path.to_owned(), line, key, remedy });
    }
    let settings: Settings = toml::from_str(text).map_err(broken)?;
    settings.check_tare(&format!("`{}`: ", path.display()))?;
    Ok(settings)
}

/// The settings in a table that a program has made.
///
/// # Errors
///
/// As [`read`]; also if a value is out of its range.
pub fn of_table(table: &toml::Table) -> Result<Settings, SettingsError> {
    let bad = |error: toml::de::Error| {
        let message = error.to_string().trim_end().replace('\n', " ");
        SettingsError::Together(format!("bad setting: {message}"))
    };
    if let Some(Unknown { key, remedy, .. }) = first_unknown(&table.to_string()).map_err(bad)? {
        return Err(SettingsError::Together(format!("there is no setting `{key}`{remedy}")));
    }
    let settings = Settings::deserialize(table.clone()).map_err(bad)?;
    settings.check_tare("")?;
    settings.check()?;
    Ok(settings)
}

/// An unknown key or section.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Unknown {
    /// Its byte offset in the text.
    at: usize,
    key: String,
    /// Advice at the end of the error message.
    remedy: String,
}

/// The first unknown key or section of a file.
fn first_unknown(text: &str) -> Result<Option<Unknown>, toml::de::Error> {
    let all = sections();
    let mut unknown = Vec::new();
    for (section, value) in DeTable::parse(text)?.get_ref().iter() {
        let (at, name, keys) =
            (section.span().start, section.get_ref(), value.get_ref().as_table());
        if let Some((_, known)) = all.iter().find(|(known, _)| **known == **name) {
            for key in keys.into_iter().flat_map(|keys| keys.keys()) {
                let (at, key) = (key.span().start, key.get_ref().to_string());
                if !known.iter().any(|arg| *arg.get_id() == *key) {
                    unknown.push(Unknown { at, remedy: key_remedy(&all, Some(name), &key), key });
                }
            }
        } else {
            let remedy = match keys {
                Some(_) => {
                    nearest(name, all.iter().map(|(known, _)| (*known, format!("[{known}]"))))
                }
                None => key_remedy(&all, None, name),
            };
            unknown.push(Unknown { at, key: name.to_string(), remedy });
        }
    }
    Ok(unknown.into_iter().min())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse(Path::new("p.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn a_misspelt_key_is_refused_with_its_line_and_the_most_similar_name() {
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
    fn a_value_of_the_wrong_kind_is_refused_with_its_place() {
        let found = message("[contact]\nfriction = \"much\"\n");
        assert!(found.contains("line 2, column 12"), "{found}");
        let found = message("[touch]\ntare_frames = 0\n");
        assert!(found.contains("line 2") && found.contains("above 0, or auto"), "{found}");
    }

    #[test]
    fn every_key_is_known_to_the_struct_that_reads_the_file() {
        let settings = Settings::effective(&Settings::default()).unwrap();
        let table = toml::Table::try_from(settings).unwrap();
        for (section, args) in sections() {
            for key in table[section].as_table().unwrap().keys() {
                assert!(args.iter().any(|arg| arg.get_id() == key), "{section}.{key}");
            }
        }
    }
}
