//! The command `palpate bench`, run in a process of its own.

use std::error::Error;
use std::path::PathBuf;
use std::process;

use palpate::Lattice;
use palpate_work::settings::Settings;
use palpate_work::settings::sections::LatticeSettings;
use serde::Deserialize;
use serde_json::Value;

use crate::Args;

/// The command, with the arguments that all its runs share.
pub(crate) struct Command {
    palpate: PathBuf,
    logs: Vec<PathBuf>,
    settings: Settings,
    passes: [u32; 2],
    rate_hz: Option<f64>,
}

/// The results of one run.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct Measured {
    pub(crate) touches: usize,
    pub(crate) spacing_m: f64,
    pub(crate) shape: [u32; 3],
    pub(crate) contacts: f64,
    pub(crate) step_ms: Spread,
    pub(crate) simulator_ms: f64,
    pub(crate) update_ms: f64,
    pub(crate) ns_per_visit: f64,
    pub(crate) update_ns_per_visit: f64,
    pub(crate) peak_memory_mib: Option<f64>,
    pub(crate) cells_touched: usize,
    /// First and last touched cell along x, y and z.
    pub(crate) cells_touched_box: [[u32; 3]; 2],
    /// The whole output of the command.
    #[serde(skip)]
    pub(crate) json: Value,
}

#[derive(Debug, Clone, Copy, Deserialize)]
pub(crate) struct Spread {
    pub(crate) median: f64,
    pub(crate) p99: f64,
}

impl Command {
    pub(crate) fn new(args: &Args, settings: Settings) -> Result<Self, Box<dyn Error>> {
        let beside = || {
            let name = format!("palpate{}", std::env::consts::EXE_SUFFIX);
            Ok::<_, std::io::Error>(std::env::current_exe()?.with_file_name(name))
        };
        let palpate = args.palpate.clone().map_or_else(beside, Ok)?;
        if !palpate.is_file() {
            let palpate = palpate.display();
            return Err(format!(
                "`{palpate}` is not there: build the command first, with `cargo build --release`, \
                 or say where it is with --palpate"
            )
            .into());
        }
        let (logs, rate_hz) = (args.logs.clone(), args.rate);
        Ok(Self { palpate, logs, settings, passes: [args.warm_passes, args.passes], rate_hz })
    }

    /// Measures the first touches of the log, or all, in a lattice.
    pub(crate) fn measure(
        &self,
        lattice: &Lattice,
        touches: Option<u32>,
    ) -> Result<Measured, Box<dyn Error>> {
        let lattice = LatticeSettings {
            spacing_m: Some(lattice.spacing_m()),
            origin_m: Some(lattice.origin_m().into()),
            shape: Some(lattice.shape()),
            ..LatticeSettings::default()
        };
        let settings = Settings { lattice, ..self.settings.clone() };
        let file = tempfile::NamedTempFile::new()?;
        std::fs::write(file.path(), toml::to_string(&settings)?)?;

        let mut command = process::Command::new(&self.palpate);
        command.args(["bench", "--json", "--quiet", "--settings"]).arg(file.path());
        let [warm_passes, passes] = self.passes.map(|passes| passes.to_string());
        command.args(["--warm-passes", &warm_passes, "--passes", &passes]);
        if let Some(touches) = touches {
            command.args(["--touches", &touches.to_string()]);
        }
        if let Some(rate_hz) = self.rate_hz {
            command.args(["--rate", &rate_hz.to_string()]);
        }
        let output = command.arg("--").args(&self.logs).output()?;
        if !output.status.success() {
            let error = String::from_utf8_lossy(&output.stderr);
            let error = error.trim().trim_start_matches("error: ");
            return Err(format!("palpate bench, {}: {error}", output.status).into());
        }
        let json: Value = serde_json::from_slice(&output.stdout)?;
        Ok(Measured { json: json.clone(), ..Measured::deserialize(json)? })
    }
}

impl Measured {
    /// Median time of a step, divided by its median number of contacts, µs.
    pub(crate) fn us_per_contact(&self) -> f64 {
        1e3 * self.step_ms.median / self.contacts
    }
}
