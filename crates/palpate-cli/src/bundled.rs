//! The bundled touches and the cloud of what they touch, carried in the binary so that what needs no log runs wherever it is
//! installed.
//!
//! They are simulated, and whoever shows results of them says so.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::error::CliError;

/// A touch in files.
struct Bundled {
    name: &'static str,
    angles: &'static [u8],
    torques: &'static [u8],
}

/// `data/plant_a`; its README says what made it.
const TOUCHES: [Bundled; 11] = [
    Bundled {
        name: "seq_000",
        angles: include_bytes!("../data/plant_a/seq_000/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_000/torques.npy"),
    },
    Bundled {
        name: "seq_001",
        angles: include_bytes!("../data/plant_a/seq_001/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_001/torques.npy"),
    },
    Bundled {
        name: "seq_002",
        angles: include_bytes!("../data/plant_a/seq_002/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_002/torques.npy"),
    },
    Bundled {
        name: "seq_003",
        angles: include_bytes!("../data/plant_a/seq_003/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_003/torques.npy"),
    },
    Bundled {
        name: "seq_004",
        angles: include_bytes!("../data/plant_a/seq_004/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_004/torques.npy"),
    },
    Bundled {
        name: "seq_005",
        angles: include_bytes!("../data/plant_a/seq_005/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_005/torques.npy"),
    },
    Bundled {
        name: "seq_006",
        angles: include_bytes!("../data/plant_a/seq_006/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_006/torques.npy"),
    },
    Bundled {
        name: "seq_007",
        angles: include_bytes!("../data/plant_a/seq_007/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_007/torques.npy"),
    },
    Bundled {
        name: "seq_008",
        angles: include_bytes!("../data/plant_a/seq_008/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_008/torques.npy"),
    },
    Bundled {
        name: "seq_009",
        angles: include_bytes!("../data/plant_a/seq_009/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_009/torques.npy"),
    },
    Bundled {
        name: "seq_010",
        angles: include_bytes!("../data/plant_a/seq_010/angles.npy"),
        torques: include_bytes!("../data/plant_a/seq_010/torques.npy"),
    },
];

/// What a camera saw of the plant before the touches, as PLY.
const OBJECT: &[u8] = include_bytes!("../data/plant_a/object.ply");

/// How many touches there are.
pub(crate) const COUNT: usize = TOUCHES.len();

/// The touches as files, which are gone when this is.
pub(crate) struct Unpacked {
    /// Holds the files.
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
        Ok(path)
    };
    TOUCHES.iter().map(unpack).collect()
}
