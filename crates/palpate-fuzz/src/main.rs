//! What libFuzzer drives: the target that `PALPATE_FUZZ` names. `scripts/fuzz` builds and runs it.
//!
//! With `PALPATE_FUZZ_SEEDS`, its seeds are written into that folder first.
#![no_main]

use std::path::Path;
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use palpate_fuzz::{Target, target, write_seeds};

fn named() -> &'static Target {
    static TARGET: OnceLock<Target> = OnceLock::new();
    TARGET.get_or_init(|| {
        let name = std::env::var("PALPATE_FUZZ").expect("PALPATE_FUZZ names a target");
        let target = target(&name).expect("PALPATE_FUZZ names a target");
        if let Some(folder) = std::env::var_os("PALPATE_FUZZ_SEEDS") {
            write_seeds(&target, Path::new(&folder)).expect("a folder for seeds");
        }
        target
    })
}

fuzz_target!(|bytes: &[u8]| (named().run)(bytes));
