//! Temporary files for parsers that read files, in memory (`/dev/shm`) where available.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

thread_local! {
    static FOLDER: TempDir = folder();
}

fn folder() -> TempDir {
    let in_memory = Path::new("/dev/shm");
    let made = match in_memory.is_dir() {
        true => tempfile::tempdir_in(in_memory),
        false => tempfile::tempdir(),
    };
    made.expect("a folder for files")
}

/// Writes a file into the folder of this thread.
pub(crate) fn file(name: &str, bytes: &[u8]) -> PathBuf {
    FOLDER.with(|folder| {
        let path = folder.path().join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).expect("a folder for a file");
        }
        fs::write(&path, bytes).expect("room for a file");
        path
    })
}

/// The bytes that `write` writes to a file in this thread's folder.
pub(crate) fn written(name: &str, write: impl FnOnce(&Path)) -> Vec<u8> {
    let path = file(name, &[]);
    fs::remove_file(&path).expect("it was just written");
    write(&path);
    fs::read(&path).expect("it was just written")
}
