//! The bundled touches and the cloud of their object, in the binary, so that `demo` and `bench` run
//! wherever it is installed.
//!
//! They are simulated, and every result of them says so.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::error::CliError;

/// The files of a touch.
struct Bundled {
    name: &'static str,
    angles: &'static [u8],
    torques: &'static [u8],
    times: &'static [u8],
}

macro_rules! bundled {
    ($($name:literal),+) => {
        [$(Bundled {
            name: $name,
            angles: include_bytes!(concat!("../data/plant_a/", $name, "/angles.npy")),
            torques: include_bytes!(concat!("../data/plant_a/", $name, "/torques.npy")),
            times: include_bytes!(concat!("../data/plant_a/", $name, "/time.npy")),
        }),+]
    };
}

/// `data/plant_a`; its README says what made it.
const TOUCHES: [Bundled; 11] = bundled![
    "seq_000", "seq_001", "seq_002", "seq_003", "seq_004", "seq_005", "seq_006", "seq_007",
    "seq_008", "seq_009", "seq_010"
];

/// The cloud of the plant as a camera saw it before the touches, as PLY.
const OBJECT: &[u8] = include_bytes!("../data/plant_a/object.ply");

/// Number of bundled touches.
pub(crate) const COUNT: usize = TOUCHES.len();

/// The touches and the cloud as temporary files, deleted when this is dropped.
pub(crate) struct Unpacked {
    /// Deletes the files when dropped.
    _folder: TempDir,
    /// The folder of each touch.
    pub touches: Vec<PathBuf>,
    /// The coloured cloud of the object that was touched.
    pub object: PathBuf,
}

/// Unpacks the touches into a temporary folder.
pub(crate) fn unpack() -> Result<Unpacked, CliError> {
    let unpacked = |source| CliError::Write { what: "the bundled touches".to_owned(), source };
    let folder = tempfile::tempdir().map_err(unpacked)?;
    let touches = into(folder.path()).map_err(unpacked)?;
    let object = folder.path().join("object.ply");
    fs::write(&object, OBJECT).map_err(unpacked)?;
    Ok(Unpacked { _folder: folder, touches, object })
}

/// Unpacks the touches into a folder and returns the folder of each.
fn into(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let unpack = |touch: &Bundled| {
        let path = folder.join(touch.name);
        fs::create_dir(&path)?;
        fs::write(path.join("angles.npy"), touch.angles)?;
        fs::write(path.join("torques.npy"), touch.torques)?;
        fs::write(path.join("time.npy"), touch.times)?;
        Ok(path)
    };
    TOUCHES.iter().map(unpack).collect()
}
