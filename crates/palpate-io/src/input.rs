//! Opening and reading of input files: only regular files, and with a limit on memory.
//!
//! Opening a pipe can block forever, and a device may never end. So the type of every file that a
//! user or another file names is checked before the file is opened.

use std::fs::{File, FileType};
use std::io::{self, ErrorKind, Read};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Default memory limit for one file, bytes.
const USUAL: u64 = 1 << 30;
/// Memory limit for one file, bytes; 0 until it is first read or set.
static LARGEST: AtomicU64 = AtomicU64::new(0);
/// Environment variable with the memory limit, GiB.
const VARIABLE: &str = "PALPATE_FILE_MEMORY";

/// Memory that the content of one file may take at once, bytes: 1 GiB, unless `PALPATE_FILE_MEMORY`
/// in the environment (GiB) or [`set_largest`] sets another limit. Files that are read piece by
/// piece, such as bags, may be of any size.
pub fn largest() -> u64 {
    if LARGEST.load(Ordering::Relaxed) == 0 {
        let named = std::env::var(VARIABLE).ok().and_then(|gib| gib.parse::<f64>().ok());
        set_largest(named.filter(|gib| *gib > 0.0).map_or(USUAL, |gib| (gib * GIB) as u64));
    }
    LARGEST.load(Ordering::Relaxed)
}

const GIB: f64 = (1_u64 << 30) as f64;

/// Sets [`largest`] for the whole process.
pub fn set_largest(bytes: u64) {
    LARGEST.store(bytes.max(1), Ordering::Relaxed);
}

/// The end of the error message about a file that exceeds [`largest`]: half a sentence.
pub fn too_large() -> String {
    let gib = (1e3 * largest() as f64 / GIB).round() / 1e3;
    format!(
        "more than {gib} GiB of memory; if that is intended, allow more with --file-memory GIB \
         ({VARIABLE} in the environment)"
    )
}

/// Opens a file.
///
/// # Errors
///
/// If the path is a folder, a pipe, a socket or a device, or as [`File::open`].
pub fn open(path: &Path) -> io::Result<File> {
    let metadata = path.metadata().map_err(|error| match error.kind() {
        ErrorKind::NotFound => io::Error::new(
            error.kind(),
            "there is no such file; check the spelling and the current folder",
        ),
        _ => error,
    })?;
    match kind(metadata.file_type()) {
        Some(kind) => {
            Err(io::Error::new(ErrorKind::InvalidInput, format!("it is {kind}, not a file")))
        }
        None => File::open(path),
    }
}

/// Name of the file type, or `None` for a regular file.
fn kind(file_type: FileType) -> Option<&'static str> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if file_type.is_fifo() {
            return Some("a pipe");
        } else if file_type.is_socket() {
            return Some("a socket");
        } else if file_type.is_block_device() || file_type.is_char_device() {
            return Some("a device");
        }
    }
    match (file_type.is_dir(), file_type.is_file()) {
        (true, _) => Some("a folder"),
        (false, true) => None,
        (false, false) => Some("of an unknown type"),
    }
}

/// Whether only the current user can change a file or folder: it belongs to the user, and neither
/// group nor others may write to it. On systems other than Unix, whether it exists.
pub(crate) fn is_private_to_user(path: &Path) -> io::Result<bool> {
    let found = path.metadata()?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        Ok(found.uid() == rustix::process::geteuid().as_raw() && found.mode() & 0o022 == 0)
    }
    #[cfg(not(unix))]
    {
        Ok(found.is_dir() || found.is_file())
    }
}

/// Reads a whole file of at most `largest` bytes, and at most [`largest()`] bytes.
///
/// # Errors
///
/// As [`open`], or if the file is larger.
pub fn read(path: &Path, largest: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let bound = largest.min(self::largest());
    let too_large = || {
        let what = match largest <= bound {
            true => format!("it has more than {largest} bytes, which is too large for such a file"),
            false => format!("it needs {}", too_large()),
        };
        io::Error::new(ErrorKind::FileTooLarge, what)
    };
    let largest = bound;
    let length = file.metadata()?.len();
    if length > largest {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(largest + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > largest { Err(too_large()) } else { Ok(bytes) }
}

/// Reads a text file of at most `largest` bytes.
///
/// # Errors
///
/// As [`read`], or if the text is not UTF-8.
pub fn read_text(path: &Path, largest: u64) -> io::Result<String> {
    String::from_utf8(read(path, largest)?)
        .map_err(|error| io::Error::new(ErrorKind::InvalidData, error.utf8_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_bound() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "grün").unwrap();
        assert_eq!(read(&path, 5).unwrap(), "grün".as_bytes());
        assert_eq!(read_text(&path, 5).unwrap(), "grün");
        assert_eq!(read(&path, 4).unwrap_err().kind(), ErrorKind::FileTooLarge);
        std::fs::write(&path, [0xff]).unwrap();
        assert_eq!(read_text(&path, 5).unwrap_err().kind(), ErrorKind::InvalidData);
    }

    #[cfg(unix)]
    #[test]
    fn pipes_devices_sockets_and_folders_are_not_opened() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for (path, words) in [
            (pipe.as_path(), "it is a pipe"),
            (&link, "it is a device"),
            (&socket, "it is a socket"),
            (folder.path(), "it is a folder"),
        ] {
            let error = open(path).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        assert_eq!(open(&folder.path().join("none")).unwrap_err().kind(), ErrorKind::NotFound);
    }
}
