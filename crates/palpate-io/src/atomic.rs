//! Files that appear whole or not at all.
//!
//! Every writer of palpate goes through [`write()`]: the bytes go to a hidden file in the same
//! folder, reach the disk, and only then take the wanted name. Whatever fails on the way, a full
//! disk or a crash, the file that stood there before stands there still. What an error or a panic
//! leaves is removed; a killed process leaves at most a file that ends in `.partial`.

use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use tempfile::{Builder, NamedTempFile};

/// What to do about a file that is already there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IfExists {
    /// Leave it and fail.
    Refuse,
    /// Put the new one in its place.
    Replace,
}

/// Why a file could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum WriteError {
    /// A file is there and may not be replaced.
    #[error("`{path}` exists already; choose another name or allow it to be overwritten")]
    Exists { path: PathBuf },
    /// The folder is missing.
    #[error("`{path}` cannot be written: there is no folder `{folder}`; make it first")]
    NoFolder { path: PathBuf, folder: PathBuf },
    /// A folder has the wanted name, or a device: as root, a rename would replace `/dev/null`.
    #[error("`{path}` cannot be written: it is a folder or a device; add a file name")]
    NotAFile { path: PathBuf },
    /// What was to be written fits no such file.
    #[error("`{path}` cannot be written: {source}")]
    Content { path: PathBuf, source: io::Error },
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
/// use palpate_io::atomic::{IfExists, write};
/// use std::io::Write;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("note.txt");
/// write(&path, IfExists::Refuse, |out| out.write_all(b"soft here"))?;
/// assert_eq!(std::fs::read(&path)?, b"soft here");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(
    path: &Path,
    if_exists: IfExists,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<(), WriteError> {
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let failed = |source| failure(path, source);
    let mut partial = start(path, &target, if_exists)?;

    let mut out = BufWriter::new(partial.as_file_mut());
    fill(&mut out).and_then(|()| out.flush()).map_err(failed)?;
    drop(out);
    partial.as_file().sync_all().map_err(failed)?;

    let kept = match if_exists {
        IfExists::Refuse => partial.persist_noclobber(&target),
        IfExists::Replace => partial.persist(&target),
    };
    kept.map_err(|error| failed(error.error))?;
    sync_folder(&target);
    Ok(())
}

/// Whether [`write()`] could begin: call it before hours of work, not after.
///
/// # Errors
///
/// As [`write()`], as far as can be known without writing.
pub fn check(path: &Path, if_exists: IfExists) -> Result<(), WriteError> {
    let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    start(path, &target, if_exists).map(drop)
}

/// Opens the hidden file beside `target`.
fn start(path: &Path, target: &Path, if_exists: IfExists) -> Result<NamedTempFile, WriteError> {
    let path_owned = || path.to_owned();
    let is_other = target.exists() && !target.is_file();
    let Some(name) = target.file_name().filter(|_| !is_other) else {
        return Err(WriteError::NotAFile { path: path_owned() });
    };
    if if_exists == IfExists::Refuse && target.exists() {
        return Err(WriteError::Exists { path: path_owned() });
    }
    let folder = match target.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(WriteError::NoFolder { path: path_owned(), folder: folder.to_owned() });
    }
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    let mut builder = Builder::new();
    builder.prefix(&prefix).suffix(".partial");
    #[cfg(unix)]
    {
        // As any new file, not private as temporary ones are: the user's umask decides.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(|source| failure(path, source))
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
        ErrorKind::AlreadyExists => return WriteError::Exists { path },
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
        let error = write(&path, IfExists::Replace, |out| {
            out.write_all(b"half of the new")?;
            Err(ErrorKind::StorageFull.into())
        });
        assert!(error.unwrap_err().to_string().contains("free some space"));
        assert_eq!(names(folder.path()), ["field.npz"]);
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[test]
    fn a_panic_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        let panicked = std::panic::catch_unwind(|| {
            write(&path, IfExists::Refuse, |_| panic!("in the middle"))
        });
        assert!(panicked.is_err() && names(folder.path()).is_empty());
    }

    #[test]
    fn a_file_is_replaced_only_if_allowed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        let put =
            |text: &'static [u8], if_exists| write(&path, if_exists, |out| out.write_all(text));
        put(b"one", IfExists::Refuse).unwrap();
        assert!(matches!(put(b"two", IfExists::Refuse), Err(WriteError::Exists { .. })));
        assert!(matches!(check(&path, IfExists::Refuse), Err(WriteError::Exists { .. })));
        assert_eq!(fs::read(&path).unwrap(), b"one");
        put(b"two", IfExists::Replace).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
    }

    #[test]
    fn a_place_that_is_no_place_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("nowhere/field.npz");
        assert!(matches!(check(&missing, IfExists::Refuse), Err(WriteError::NoFolder { .. })));
        assert!(matches!(
            check(folder.path(), IfExists::Replace),
            Err(WriteError::NotAFile { .. })
        ));
        assert!(names(folder.path()).is_empty());
        #[cfg(unix)]
        assert!(matches!(
            check(Path::new("/dev/null"), IfExists::Replace),
            Err(WriteError::NotAFile { .. })
        ));
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_followed_and_others_may_read_the_file() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        symlink(&file, &link).unwrap();
        write(&link, IfExists::Replace, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(link.is_symlink());
        assert_ne!(file.metadata().unwrap().permissions().mode() & 0o060, 0);
    }
}
