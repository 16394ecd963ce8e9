//! Files that appear whole or not at all.
//!
//! Every writer of palpate goes through [`write()`]: the bytes go to a hidden file in the same
//! folder, reach the disk, and only then take the wanted name. Whatever fails on the way, a full
//! disk or a crash, the file that stood there before stands there still. What an error or a panic
//! leaves is removed; a killed process leaves at most a file that ends in `.partial`, which the next
//! one that writes to that name removes.
//!
//! A hidden file is locked as long as somebody writes to it, so that one without a lock is nobody's.

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
    /// What was to be written fits no such file.
    #[error("`{path}` cannot be written: {source}")]
    Content { path: PathBuf, source: io::Error },
    /// Somebody else holds it.
    #[error(
        "`{path}` is being written by another palpate; end that one first, or choose another name"
    )]
    Held { path: PathBuf },
    /// The system refused; nothing was left behind.
    #[error("`{path}` cannot be written: {source}; {remedy}")]
    Io { path: PathBuf, remedy: &'static str, source: io::Error },
}

/// Writes a file through `fill`, whole or not at all.
///
/// A symbolic link is followed: the file it points to is replaced, not the link.
///
/// # Errors
///
/// [`WriteError`]; the place is then as it was before.
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

/// Whether [`write()`] could begin: call it before hours of work, not after.
///
/// # Errors
///
/// As [`write()`], as far as can be known without writing.
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
        // As any new file, not private as temporary ones are: the user's umask decides.
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

/// How the names of hidden files end.
const SUFFIX: &str = ".partial";
/// And that of the one that holds a file.
const HELD: &str = "held";

/// How the names of those of a file begin.
fn prefix(name: &OsStr) -> OsString {
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    prefix
}

/// Locks a hidden file that was just made; whether it is still there, and not taken for one that a
/// killed process has left.
fn is_ours(file: &File, path: &Path) -> bool {
    // Some file systems have no locks; there, nothing is removed either.
    file.lock().is_err() || path.exists()
}

/// Removes what killed processes have left.
fn clear(folder: &Path, prefix: &OsStr) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.filter_map(Result::ok) {
        let name = entry.file_name();
        let name = name.as_encoded_bytes();
        let Some(rest) = name.strip_prefix(prefix.as_encoded_bytes()) else { continue };
        let hidden = rest == HELD.as_bytes() || rest.ends_with(SUFFIX.as_bytes());
        let Some(kind) = entry.file_type().ok().filter(|_| hidden) else { continue };
        if !kind.is_file() && !kind.is_dir() {
            continue; // a pipe, say, which would not open
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

/// A hidden folder beside `target`, which is removed unless it is kept, and its lock.
///
/// # Errors
///
/// If none can be made there.
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

/// Keeps others who ask for it from writing to a file, until it is dropped or the process ends.
#[derive(Debug)]
pub struct Hold {
    hidden: PathBuf,
    _lock: File,
}

impl Hold {
    /// Holds a file, which need not be there yet.
    ///
    /// # Errors
    ///
    /// If somebody else holds it, or nothing can be written beside it.
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

impl Drop for Hold {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.hidden);
    }
}

/// Makes the rename last through a power cut, where the system can.
fn sync_folder(target: &Path) {
    #[cfg(unix)]
    if let Some(folder) = target.parent().and_then(|folder| File::open(folder).ok()) {
        let _ = folder.sync_all(); // Some file systems cannot; the file itself is whole already.
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
    fn what_a_killed_process_left_is_removed_and_what_another_writes_is_not() {
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
    fn a_file_is_held_by_one_until_it_lets_go() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        let hold = Hold::on(&path).unwrap();
        let error = Hold::on(&path).unwrap_err().to_string();
        assert!(error.contains("being written by another palpate"), "{error}");
        write(&path, |out| out.write_all(b"mine")).unwrap();
        assert!(Hold::on(&path).is_err(), "writing to it does not let go");
        drop(hold);
        drop(Hold::on(&path).unwrap());
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
    fn a_place_that_is_no_place_is_named() {
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
