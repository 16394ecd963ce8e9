//! The flags of `palpate view`.

use std::path::PathBuf;

use crate::settings::AllSettings;

/// Address of a viewer on this machine, the default of `--connect`.
const HERE: &str = "rerun+http://127.0.0.1:9876/proxy";

const NOTES: &str = "Examples:
  palpate view field.npz
  palpate view field.npz recordings/seq_010
  palpate view recordings/ --save touches.rrd
  palpate view recordings/ --connect=rerun+http://192.168.0.7:9876/proxy

With a field and logs, the field predicts the logs' torques. With logs alone, a field is learnt \
from them while they are played, and the torque of each sample is predicted before the sample is \
learnt. A field alone is shown with the arm where its last touch ended, if the field has its \
memory.

Without --save and --connect, a Rerun viewer is started: the command `rerun`, of version 0.36, \
which comes with `pip install 'rerun-sdk==0.36.*'` or `cargo install --locked rerun-cli@0.36.0`. \
Its usage statistics are switched off first. An .rrd file can be opened by anyone who has that \
viewer: `rerun FILE.rrd`, or `rerun --web-viewer FILE.rrd` in a browser.

Of a field, the stiffest touched cells are drawn, those of the upper one and a half decades of \
stiffness, at most 10000. Of more than 300 contacts, 300 are drawn, the same ones from sample to \
sample. The numbers beside them count all.";

/// Flags of `palpate view`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
#[cfg_attr(not(feature = "viewer"), allow(dead_code))] // without the viewer, they are only parsed
pub(crate) struct Args {
    /// A field, logs to play, or a field and the logs that it is to predict
    #[arg(required = true, value_name = "FIELD.npz|LOG")]
    pub(super) what: Vec<PathBuf>,
    /// Write a file for the viewer, in place of starting one
    #[arg(long, value_name = "FILE.rrd", conflicts_with = "connect")]
    pub(super) save: Option<PathBuf>,
    /// Show it in a running viewer, on this machine or at URL
    #[arg(
        long,
        value_name = "URL",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = HERE
    )]
    pub(super) connect: Option<String>,
    /// Show every N-th sample; all samples are processed
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) every: u64,
    /// Show a field that is being learnt after every N samples
    #[arg(long, value_name = "N", default_value = "50", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) field_every: u64,
    /// Print the summary as JSON
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) settings: AllSettings,
}
