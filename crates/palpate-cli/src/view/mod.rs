//! `palpate view`: the arm, its contacts, the field and the torques in the Rerun viewer.
//!
//! The flags are always there, and what they do needs the feature `viewer`: without it, the command
//! says how to get it. [`show`] is the command; [`play`] follows the touches and says each sample;
//! [`scene`] is what stays as it is; [`to`] is where the recording goes.

#[cfg(feature = "viewer")]
mod play;
#[cfg(feature = "viewer")]
pub(crate) mod scene;
#[cfg(feature = "viewer")]
mod show;
#[cfg(feature = "viewer")]
pub(crate) mod to;

use std::path::PathBuf;

use crate::settings::AllSettings;
#[cfg(not(feature = "viewer"))]
use crate::{error::CliError, output::Output};

/// Where `--viewer` and `--connect` look for a viewer that runs on this machine.
const HERE: &str = "rerun+http://127.0.0.1:9876/proxy";

#[cfg(feature = "viewer")]
pub(crate) use show::run;

const NOTES: &str = "Examples:
  palpate view field.npz
  palpate view field.npz recordings/seq_010
  palpate view recordings/ --save touches.rrd
  palpate view recordings/ --connect=rerun+http://192.168.0.7:9876/proxy

With a field and logs, the field predicts the logs' torques; with logs alone, a field is learnt from
them as they are played, and each sample's torque is what was expected before the sample was learnt
from. A field alone is shown with the arm as it was last seen, if the field has its memory.

Without --save and --connect, a Rerun viewer is started: the command `rerun`, of version 0.36, which
comes with `pip install 'rerun-sdk==0.36.*'` or `cargo install --locked rerun-cli@0.36.0`. Its usage
statistics are switched off first. An .rrd file can be opened by anyone who has that viewer: `rerun
FILE.rrd`, or `rerun --web-viewer FILE.rrd` in a browser.

Of a field, the touched cells of the uppermost one and a half powers of ten are drawn, at most
10000; of more than 300 contacts, 300 are, the same ones from sample to sample. The numbers beside
them count all.";

/// Flags of `palpate view`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
#[cfg_attr(not(feature = "viewer"), allow(dead_code))] // they are there to be told of
pub(crate) struct Args {
    /// A field, logs to play, or a field and the logs that it is to predict
    #[arg(required = true, value_name = "FIELD.npz|LOG")]
    what: Vec<PathBuf>,
    /// Write a file for the viewer, in place of starting one
    #[arg(long, value_name = "FILE.rrd", conflicts_with = "connect")]
    save: Option<PathBuf>,
    /// Show it in a viewer that runs already, here or elsewhere
    #[arg(
        long,
        value_name = "URL",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = HERE
    )]
    connect: Option<String>,
    /// Show every so-manieth sample; all of them are followed
    #[arg(long, value_name = "N", default_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Show a field that grows after so many more samples
    #[arg(long, value_name = "N", default_value = "50", value_parser = clap::value_parser!(u32).range(1..))]
    field_every: u32,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: AllSettings,
}

/// Says how to get the viewer, which this command was built without.
#[cfg(not(feature = "viewer"))]
pub(crate) fn run(_: &Args, _: &Output) -> Result<(), CliError> {
    Err(without_viewer())
}

/// How to get the viewer, which this command was built without.
#[cfg(not(feature = "viewer"))]
pub(crate) fn without_viewer() -> CliError {
    CliError::Usage(
        "this `palpate` was built without the viewer, which takes some 360 more crates; get one \
         with it by `cargo install --locked --path crates/palpate-cli --features viewer`. `palpate \
         predict --picture FILE.svg` and `palpate evaluate` draw without it"
            .to_owned(),
    )
}
