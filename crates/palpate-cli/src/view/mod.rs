//! `palpate view`: the arm, its contacts, the field and the torques in the Rerun viewer.
//!
//! The flags always exist, but the command needs the feature `viewer`: without it, it says how to get
//! it. [`args`] has the flags, [`show`] is the command; [`play`] processes the touches and shows each
//! sample; [`scene`] is the constant part; [`to`] is where the recording goes.

mod args;
#[cfg(feature = "viewer")]
mod play;
#[cfg(feature = "viewer")]
pub(crate) mod scene;
#[cfg(feature = "viewer")]
mod show;
#[cfg(feature = "viewer")]
pub(crate) mod to;

#[cfg(not(feature = "viewer"))]
use crate::{error::CliError, output::Output};

pub(crate) use args::Args;
#[cfg(feature = "viewer")]
pub(crate) use show::run;

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
         with it by `cargo install --locked --path crates/palpate-cli --features full,viewer`. `palpate \
         predict --picture FILE.svg` and `palpate evaluate` draw without it"
            .to_owned(),
    )
}
