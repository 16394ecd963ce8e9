//! Atomic writing: a file appears whole or not at all.
//!
//! Every writer of palpate uses [`write()`]: it writes a hidden file in the same folder, flushes it
//! to the disk, and then renames it to the wanted name. If anything fails before, such as a full
//! disk or a crash, the previous file remains. After an error or a panic, the hidden file is
//! removed; a killed process leaves at most a file that ends in `.partial`, which the next process
//! that writes to the same name removes.
//!
//! A hidden file is locked while a process writes to it, so an unlocked one is a leftover.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use tempfile::{Builder, NamedTempFile, TempDir};

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum WriteError {
    /// The folder is missing.
    #[error("`{path}` cannot be written: there is no folder `{folder}`; make it first")]
    NoFolder { path: PathBuf, folder: PathBuf },
    /// A folder has the wanted name, or a device: as root, a rename would replace `/dev/null`.
    #[error("`{path}` cannot be written: it is a folder or a device; add a file name")]
    NotAFile { path: PathBuf },
    /// The content cannot be represented in this format.
    #[error("`{path}` cannot be written: {source}")]
    Content { path: PathBuf, source: io::Error },
    /// Another process holds the file.
    #[error(
        "`{path}` is being written by another palpate; end that one first, or choose another name"
    )]
    Held { path: PathBuf },
    /// The operating system reported an error; the hidden file was removed.
    #[error("`{path}` cannot be written: {source}; {remedy}")]
    Io { path: PathBuf, remedy: &'static str, source: io::Error },
}

/// Writes a file atomically; `fill` writes its content.
///
/// A symbolic link is followed: the file it points to is replaced, not the link.
///
/// # Errors
///
/// [`WriteError`]; the path is then unchanged.
///
/// # Example
///
/// ```
/// use palpate_io::atomic::write;
/// use std::io::Write;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("note.txt");
/// write(&path, |out| out.write_all(b"soft here"))?;
/// assert_eq!(std::fs::read(&path)?, b"soft here");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<(), WriteError> {
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let failed = |source| failure(path, source);
    let mut partial = start(path, &target)?;

    let mut out = BufWriter::new(partial.as_file_mut());
    fill(&mut out).and_then(|()| out.flush()).map_err(failed)?;
    drop(out);
    partial.as_file().sync_all().map_err(failed)?;

    partial.persist(&target).map_err(|error| failed(error.error))?;
    sync_folder(&target);
    Ok(())
}

/// Checks that [`write()`] could begin; call it before a long computation.
///
/// # Errors
///
/// As [`write()`], as far as known before the content is written.
pub fn check(path: &Path) -> Result<(), WriteError> {
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    start(path, &target).map(drop)
}

/// Opens the hidden file beside `target`.
fn start(path: &Path, target: &Path) -> Result<NamedTempFile, WriteError> {
    let path_owned = || path.to_owned();
    let is_other = target.exists() && !target.is_file();
    let Some(name) = target.file_name().filter(|_| !is_other) else {
        return Err(WriteError::NotAFile { path: path_owned() });
    };
    let folder = match target.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(WriteError::NoFolder { path: path_owned(), folder: folder.to_owned() });
    }
    let prefix = prefix(name);
    clear(folder, &prefix);
    let mut builder = Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX);
    #[cfg(unix)]
    {
        // Permissions follow the umask, as of any new file; those of temporary files are private.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    loop {
        let partial = builder.tempfile_in(folder).map_err(|source| failure(path, source))?;
        if is_ours(partial.as_file(), partial.path()) {
            return Ok(partial);
        }
    }
}

/// Suffix of hidden files that are being written.
const SUFFIX: &str = ".partial";
/// Suffix of the lock file of [`FileLock`].
const HELD: &str = "held";

/// Prefix of the hidden files that belong to the file `name`.
fn prefix(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    prefix
}

/// Locks a hidden file that was just created. False if another process took it for a leftover and
/// removed it before the lock.
fn is_ours(file: &File, path: &Path) -> bool {
    // Some file systems have no locks; `clear` removes nothing there.
    file.lock().is_err() || path.exists()
}

/// Removes the unlocked hidden files with this prefix, which killed processes have left.
fn clear(folder: &Path, prefix: &OsStr) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.filter_map(Result::ok) {
        let name = entry.file_name();
        let name = name.as_encoded_bytes();
        let Some(rest) = name.strip_prefix(prefix.as_encoded_bytes()) else { continue };
        let hidden = rest == HELD.as_bytes() || rest.ends_with(SUFFIX.as_bytes());
        let Some(kind) = entry.file_type().ok().filter(|_| hidden) else { continue };
        if !kind.is_file() && !kind.is_dir() {
            continue; // a pipe, for example, would block when opened
        }
        let Ok(file) = File::open(entry.path()) else { continue };
        if file.try_lock().is_ok() {
            let _ = match kind.is_dir() {
                true => fs::remove_dir_all(entry.path()),
                false => fs::remove_file(entry.path()),
            };
        }
    }
}

/// Creates a hidden folder beside `target`, removed when dropped, and returns it with its lock.
///
/// # Errors
///
/// If the folder cannot be created.
pub(crate) fn hidden_folder(target: &Path) -> io::Result<(TempDir, File)> {
    let parent = target.parent().filter(|parent| !parent.as_os_str().is_empty());
    let parent = parent.unwrap_or(Path::new("."));
    let prefix = prefix(target.file_name().unwrap_or_default());
    clear(parent, &prefix);
    loop {
        let folder = Builder::new().prefix(&prefix).suffix(SUFFIX).tempdir_in(parent)?;
        let lock = File::open(folder.path())?;
        if is_ours(&lock, folder.path()) {
            return Ok((folder, lock));
        }
    }
}

/// Advisory lock on a file, against other processes that use [`FileLock`]. It ends when dropped or with
/// the process.
#[derive(Debug)]
pub struct FileLock {
    hidden: PathBuf,
    _lock: File,
}

impl FileLock {
    /// Locks `path`; the file need not exist yet.
    ///
    /// # Errors
    ///
    /// If it is already held, or the lock file cannot be created beside it.
    pub fn on(path: &Path) -> Result<Self, WriteError> {
        let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let mut name = prefix(target.file_name().unwrap_or_default());
        name.push(HELD);
        let hidden = target.with_file_name(name);
        loop {
            let opened = OpenOptions::new().write(true).create(true).truncate(false).open(&hidden);
            let lock = opened.map_err(|source| failure(path, source))?;
            match lock.try_lock() {
                Err(TryLockError::WouldBlock) => {
                    return Err(WriteError::Held { path: path.to_owned() });
                }
                // Some file systems have no locks.
                _ if hidden.exists() => return Ok(Self { hidden, _lock: lock }),
                _ => {}
            }
        }
    }
}

impl Drop for FileLock {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.hidden);
    }
}

/// Flushes the folder, so that the rename survives a power failure, where the system supports it.
fn sync_folder(target: &Path) {
    #[cfg(unix)]
    if let Some(folder) = target.parent().and_then(|folder| File::open(folder).ok()) {
        let _ = folder.sync_all(); // Some file systems cannot; the file itself is already complete.
    }
}

fn failure(path: &Path, source: io::Error) -> WriteError {
    let path = path.to_owned();
    let remedy = match source.kind() {
        ErrorKind::InvalidData => return WriteError::Content { path, source },
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space or write elsewhere",
        ErrorKind::ReadOnlyFilesystem | ErrorKind::PermissionDenied => {
            "write to a folder that you may change"
        }
        _ => "try another place",
    };
    WriteError::Io { path, remedy, source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_full_disk_leaves_what_was_there_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        fs::write(&path, "old").unwrap();
        let error = write(&path, |out| {
            out.write_all(b"half of the new")?;
            Err(ErrorKind::StorageFull.into())
        });
        assert!(error.unwrap_err().to_string().contains("free some space"));
        assert_eq!(names(folder.path()), ["field.npz"]);
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[test]
    fn files_of_killed_processes_are_removed_and_those_being_written_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        fs::write(folder.path().join(".field.npz.x1.partial"), "left").unwrap();
        fs::create_dir(folder.path().join(".field.npz.x2.partial")).unwrap();
        fs::write(folder.path().join(".field.npz.held"), "left").unwrap();
        fs::write(folder.path().join(".other.npz.x3.partial"), "another's").unwrap();
        let others = start(&path, &path).unwrap();
        write(&path, |out| out.write_all(b"new")).unwrap();
        let mut found = names(folder.path());
        found.sort();
        let others = others.path().file_name().unwrap().to_str().unwrap().to_owned();
        assert_eq!(found, [others.as_str(), ".other.npz.x3.partial", "field.npz"]);
    }

    #[test]
    fn a_file_has_one_lock_until_it_is_released() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        let hold = FileLock::on(&path).unwrap();
        let error = FileLock::on(&path).unwrap_err().to_string();
        assert!(error.contains("being written by another palpate"), "{error}");
        write(&path, |out| out.write_all(b"mine")).unwrap();
        assert!(FileLock::on(&path).is_err(), "writing to it does not let go");
        drop(hold);
        drop(FileLock::on(&path).unwrap());
        assert_eq!(names(folder.path()), ["field.npz"]);
    }

    #[test]
    fn a_panic_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        let panicked = std::panic::catch_unwind(|| write(&path, |_| panic!("in the middle")));
        assert!(panicked.is_err() && names(folder.path()).is_empty());
    }

    #[test]
    fn a_path_that_cannot_be_written_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("nowhere/field.npz");
        assert!(matches!(check(&missing), Err(WriteError::NoFolder { .. })));
        assert!(matches!(check(folder.path()), Err(WriteError::NotAFile { .. })));
        assert!(names(folder.path()).is_empty());
        #[cfg(unix)]
        assert!(matches!(check(Path::new("/dev/null")), Err(WriteError::NotAFile { .. })));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_followed_and_others_may_read_the_file() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        write(&link, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(link.is_symlink());
        assert_ne!(file.metadata().unwrap().permissions().mode() & 0o060, 0);
    }
}
