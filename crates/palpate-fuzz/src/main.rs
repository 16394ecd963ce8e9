//! Program for libFuzzer, which `scripts/fuzz` builds and runs: tests the target that
//! `PALPATE_FUZZ` names.
//!
//! If `PALPATE_FUZZ_SEEDS` names a folder, the seeds of the target are written into it first.
#![no_main]

use std::path::Path;
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use palpate_fuzz::{Target, target, write_seeds};

fn named() -> &'static Target {
    static TARGET: OnceLock<Target> = OnceLock::new();
    TARGET.get_or_init(|| {
        let name = std::env::var("PALPATE_FUZZ").expect("PALPATE_FUZZ names a target");
        target(&name).expect("PALPATE_FUZZ names a target")
    })
}

fn seed() {
    if let Some(folder) = std::env::var_os("PALPATE_FUZZ_SEEDS") {
        write_seeds(named(), Path::new(&folder)).expect("a folder for seeds");
    }
}

fuzz_target!(init: seed(), |bytes: &[u8]| (named().run)(bytes));
