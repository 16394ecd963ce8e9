//! Places for results, tried before the work starts.

use std::path::{Path, PathBuf};

use clap::Args;
use palpate_io::atomic::{self, Hold};
use palpate_io::field::{self, Saved};
use tempfile::Builder;

use crate::error::CliError;
use crate::settings::{Settings, SettingsArgs};

/// Refuses a place that cannot be written to; an older file there will be replaced.
pub(crate) fn check(path: &Path) -> Result<(), CliError> {
    atomic::check(path).map_err(CliError::file)
}

/// Everything that a command reads and writes, each in its own place.
///
/// Places are compared with links resolved. What is added last is held against all before it.
#[derive(Debug, Default)]
pub(crate) struct Places {
    /// What each file is to the command, and where it is.
    taken: Vec<(String, PathBuf)>,
}

impl Places {
    /// The files that settings name, and all files of logs.
    pub(crate) fn read<F: Args + Clone + Into<Settings>>(
        args: &SettingsArgs<F>,
        settings: &Settings,
        logs: &[PathBuf],
    ) -> Self {
        let mut places = Self::default();
        places.input("the settings file", args.path());
        places.input("the robot", Some(Path::new(settings.robot.name())));
        places.input("the arm (--arm)", settings.robot.arm.as_deref());
        logs.iter().for_each(|log| places.log(log));
        places
    }

    /// Adds a file that is read, if there is one.
    pub(crate) fn input(&mut self, role: &str, path: Option<&Path>) {
        if let Some(place) = path.and_then(|path| path.canonicalize().ok()) {
            self.taken.push((role.to_owned(), place));
        }
    }

    /// Adds all files of a log.
    pub(crate) fn log(&mut self, log: &Path) {
        let role = format!("a file of the log `{}`", log.display());
        let Ok(log) = log.canonicalize() else { return };
        let within = entries(&log).filter(|entry| entry.is_dir());
        // The truth of a single touch lies beside its folder.
        let beside = log.parent().map(|parent| parent.join("truth"));
        let folders: Vec<PathBuf> =
            std::iter::once(log.clone()).chain(within).chain(beside).collect();
        // An array that is missing counts as well: to write it would make or break a touch.
        let arrays = ["angles.npy", "torques.npy", "time.npy"];
        let named = |folder: &PathBuf| arrays.map(|name| folder.join(name));
        let mut files: Vec<PathBuf> = folders.iter().flat_map(named).collect();
        // Tables beside arrays are not read.
        let touches = files.iter().any(|file| !file.ends_with("time.npy") && file.is_file());
        files.extend(
            folders.iter().flat_map(|folder| entries(folder).filter(|file| ending(file) == "npy")),
        );
        files.extend(
            entries(&log).filter(|file| !touches && ["csv", "tsv"].contains(&&*ending(file))),
        );
        self.taken.extend(files.iter().filter_map(|f| Some((role.clone(), resolved(f)?))));
        self.taken.push((role, log));
    }

    /// Adds a file that is written, if there is one: refuses it if it cannot be, or if it is one
    /// of those added before.
    pub(crate) fn output(&mut self, role: &str, path: Option<&Path>) -> Result<(), CliError> {
        let Some(path) = path else { return Ok(()) };
        check(path)?;
        let Some(place) = resolved(path) else { return Ok(()) };
        if let Some((other, _)) = self.taken.iter().find(|(_, taken)| *taken == place) {
            return Err(CliError::Usage(format!(
                "{role} would go to `{}`, which is {other}; give it a place of its own",
                path.display()
            )));
        }
        self.taken.push((format!("also the place of {role}"), place));
        Ok(())
    }
}

/// The folder of results; made before the work, and removed again if nothing came to lie in it.
pub(crate) struct Folder {
    /// Where it is.
    pub(crate) path: PathBuf,
    /// What was made: the folder, then those that it is in, if they were not there.
    made: Vec<PathBuf>,
}

impl Folder {
    /// Makes the folder, and tries whether a file of this name can be written into it.
    pub(crate) fn make(path: &Path, file: &str) -> Result<Self, CliError> {
        let what = format!("the folder `{}`", path.display());
        let new = path.ancestors().take_while(|folder| !folder.exists());
        let made = new.filter(|folder| *folder != Path::new("")).map(Path::to_owned).collect();
        let folder = Self { path: path.to_owned(), made };
        std::fs::create_dir_all(path).map_err(|source| CliError::Write { what, source })?;
        check(&folder.path.join(file))?;
        Ok(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        for folder in &self.made {
            let _ = std::fs::remove_dir(folder); // Refused unless it is empty, which is the point.
        }
    }
}

/// The ending of a file's name in small letters; empty if it has none.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map_or_else(String::new, |ending| ending.to_string_lossy().to_lowercase())
}

/// The last part of a path: recordings and pages are shared, and folders are nobody's business.
pub(crate) fn last_part(path: &Path) -> String {
    let last = path.file_name().or_else(|| path.components().next_back().map(|c| c.as_os_str()));
    last.unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The format that a file's ending asks for, by the endings that there are.
pub(crate) fn format_of<T: Copy>(
    path: &Path,
    what: &str,
    formats: &[(&str, T)],
) -> Result<T, CliError> {
    let asked = ending(path);
    let format = formats.iter().find_map(|&(ending, format)| (ending == asked).then_some(format));
    format.ok_or_else(|| {
        let endings: Vec<String> = formats.iter().map(|(ending, _)| format!(".{ending}")).collect();
        let mut endings = endings.join(", ");
        if let Some((others, last)) = endings.rsplit_once(", ") {
            endings = format!("{others} or {last}");
        }
        CliError::Usage(format!(
            "`{}` does not say how the {what} is to be written; end its name with {endings}",
            path.display()
        ))
    })
}

/// Where a file is or would be, with links resolved.
fn resolved(path: &Path) -> Option<PathBuf> {
    path.canonicalize().ok().or_else(|| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        Some(folder.unwrap_or(Path::new(".")).canonicalize().ok()?.join(path.file_name()?))
    })
}

/// What lies in a folder; nothing if it is none.
pub(crate) fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    folder.read_dir().into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()))
}

/// Refuses to replace a file that neither ends as such a result does nor `is_one`: a text, say, whose name was given by
/// mistake.
pub(crate) fn check_older(
    path: &Path,
    wanted: &str,
    is_one: impl Fn(&Path) -> bool,
) -> Result<(), CliError> {
    if !path.is_file() || ending(path) == wanted || is_one(path) {
        return Ok(());
    }
    let path = path.display();
    Err(CliError::Usage(format!(
        "`{path}` is there already and does not end with .{wanted}, so it is not replaced; choose another name"
    )))
}

/// Keeps others from writing to the file of a field until it is dropped: `palpate live`, say, would replace it at its end.
pub(crate) fn hold_field(path: &Path) -> Result<Option<Hold>, CliError> {
    check_older(path, "npz", |path| field::load(path).is_ok())?;
    let is_device = path.exists() && !path.is_file();
    (!is_device).then(|| Hold::on(path).map_err(CliError::file)).transpose()
}

/// Saves a field that took long to learn; where its folder is gone, say, or full, elsewhere.
pub(crate) fn save(path: &Path, saved: &Saved) -> Result<(), CliError> {
    let Err(error) = field::save(path, saved) else { return Ok(()) };
    let kept = Builder::new().prefix("palpate_").suffix(".npz").tempfile().ok().and_then(|file| {
        field::save(file.path(), saved).ok()?;
        file.into_temp_path().keep().ok()
    });
    Err(match kept {
        Some(kept) => {
            CliError::from(format!("{error}; the field is in `{}` instead", kept.display()))
        }
        None => CliError::file(error),
    })
}

/// Writes a text or bytes, whole or not at all.
pub(crate) fn write<T: AsRef<[u8]> + ?Sized>(path: &Path, content: &T) -> Result<(), CliError> {
    use std::io::Write;
    let content = content.as_ref();
    atomic::write(path, |out| out.write_all(content)).map_err(CliError::file)
}
