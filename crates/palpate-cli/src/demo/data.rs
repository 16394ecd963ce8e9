//! The bundled touches, carried in the binary so that the demo runs wherever it is installed.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

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
        angles: include_bytes!("../../../../data/plant_a/seq_000/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_000/torques.npy"),
    },
    Bundled {
        name: "seq_001",
        angles: include_bytes!("../../../../data/plant_a/seq_001/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_001/torques.npy"),
    },
    Bundled {
        name: "seq_002",
        angles: include_bytes!("../../../../data/plant_a/seq_002/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_002/torques.npy"),
    },
    Bundled {
        name: "seq_003",
        angles: include_bytes!("../../../../data/plant_a/seq_003/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_003/torques.npy"),
    },
    Bundled {
        name: "seq_004",
        angles: include_bytes!("../../../../data/plant_a/seq_004/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_004/torques.npy"),
    },
    Bundled {
        name: "seq_005",
        angles: include_bytes!("../../../../data/plant_a/seq_005/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_005/torques.npy"),
    },
    Bundled {
        name: "seq_006",
        angles: include_bytes!("../../../../data/plant_a/seq_006/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_006/torques.npy"),
    },
    Bundled {
        name: "seq_007",
        angles: include_bytes!("../../../../data/plant_a/seq_007/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_007/torques.npy"),
    },
    Bundled {
        name: "seq_008",
        angles: include_bytes!("../../../../data/plant_a/seq_008/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_008/torques.npy"),
    },
    Bundled {
        name: "seq_009",
        angles: include_bytes!("../../../../data/plant_a/seq_009/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_009/torques.npy"),
    },
    Bundled {
        name: "seq_010",
        angles: include_bytes!("../../../../data/plant_a/seq_010/angles.npy"),
        torques: include_bytes!("../../../../data/plant_a/seq_010/torques.npy"),
    },
];

/// How many touches there are.
pub(super) const COUNT: usize = TOUCHES.len();

/// Unpacks the touches into a folder and returns the folder of each.
pub(super) fn unpack(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let unpack = |touch: &Bundled| {
        let path = folder.join(touch.name);
        fs::create_dir(&path)?;
        fs::write(path.join("angles.npy"), touch.angles)?;
        fs::write(path.join("torques.npy"), touch.torques)?;
        Ok(path)
    };
    TOUCHES.iter().map(unpack).collect()
}
