//! Paths of results, checked before the work starts.

use std::path::{Path, PathBuf};

use clap::Args;
use palpate_io::atomic::{self, FileLock};
use palpate_io::field::{self, SavedField};
use tempfile::Builder;

use crate::error::CliError;
use crate::settings::{Settings, SettingsArgs};

/// Refuses a path that cannot be written; an existing file there will be replaced later.
pub(crate) fn check(path: &Path) -> Result<(), CliError> {
    atomic::check(path).map_err(CliError::file)
}

/// The files that a command reads and writes, to refuse an output that would replace another of them.
///
/// Paths are compared with links resolved. Each output is compared with all files added before it.
#[derive(Debug, Default)]
pub(crate) struct FilePaths {
    /// Role of each file, in words, and its resolved path.
    taken: Vec<(String, PathBuf)>,
}

impl FilePaths {
    /// Starts with the files that the settings name and all files of the logs.
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

    /// Adds a file that is read, if it is given and exists.
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
        // The truth of a single touch is beside its folder.
        let beside = log.parent().map(|parent| parent.join("truth"));
        let folders: Vec<PathBuf> =
            std::iter::once(log.clone()).chain(within).chain(beside).collect();
        // Missing arrays are added too: an output of that name would become part of a touch.
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

    /// Adds a file that is written, if it is given; refuses one that cannot be written or was added
    /// before.
    pub(crate) fn output(&mut self, role: &str, path: Option<&Path>) -> Result<(), CliError> {
        let Some(path) = path else { return Ok(()) };
        check(path)?;
        let Some(place) = resolved(path) else { return Ok(()) };
        if let Some((other, _)) = self.taken.iter().find(|(_, taken)| *taken == place) {
            return Err(CliError::Usage(format!(
                "{role} would be written to `{}`, which is {other}; choose another file for it",
                path.display()
            )));
        }
        self.taken.push((format!("also the file of {role}"), place));
        Ok(())
    }
}

/// The folder of results: made before the work, and removed when dropped if it is still empty.
pub(crate) struct Folder {
    /// Path of the folder.
    pub(crate) path: PathBuf,
    /// The folders that were made: this one first, then its parents.
    made: Vec<PathBuf>,
}

impl Folder {
    /// Makes the folder, and checks that a file of this name can be written into it.
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
            let _ = std::fs::remove_dir(folder); // Fails unless the folder is empty, as intended.
        }
    }
}

/// The ending of a file's name in lower case; empty if it has none.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map_or_else(String::new, |ending| ending.to_string_lossy().to_lowercase())
}

/// The last part of a path, for recordings and pages, which are shared and must not show the user's folders.
pub(crate) fn last_part(path: &Path) -> String {
    let last = path.file_name().or_else(|| path.components().next_back().map(|c| c.as_os_str()));
    last.unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// The format that belongs to a file's ending; the error message calls the content `what`.
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
            "the ending of `{}` does not select a format for the {what}; end the name with {endings}",
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

/// The paths in a folder; none if it is not a folder.
pub(crate) fn entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    folder.read_dir().into_iter().flatten().filter_map(|entry| Some(entry.ok()?.path()))
}

/// Refuses to replace an existing file that neither has the ending `wanted` nor is recognised by `is_one`: its name was
/// probably given by mistake.
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

/// Refuses the ending of another format for the file of a field.
pub(crate) fn check_field_ending(path: &Path) -> Result<(), CliError> {
    if ["", "npz"].contains(&&*ending(path)) {
        return Ok(());
    }
    let path = path.display();
    Err(CliError::Usage(format!(
        "`{path}`: a field is saved as .npz; end the name so, and let `palpate convert` turn it into another format"
    )))
}

/// Locks the file of a field until the returned value is dropped, so that no other `palpate` writes it meanwhile;
/// `None` for a device. Refuses the ending of another format.
pub(crate) fn hold_field(path: &Path) -> Result<Option<FileLock>, CliError> {
    check_older(path, "npz", |path| field::load(path).is_ok())?;
    check_field_ending(path)?;
    let is_device = path.exists() && !path.is_file();
    (!is_device).then(|| FileLock::on(path).map_err(CliError::file)).transpose()
}

/// Saves a field; if that fails, for example on a full disk, saves it as a temporary file that the error names.
pub(crate) fn save(path: &Path, saved: &SavedField) -> Result<(), CliError> {
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
