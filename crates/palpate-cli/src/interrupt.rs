//! Ctrl-C: the first asks the loop to stop at the next sample, the second kills.

use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};

static PRESSED: AtomicBool = AtomicBool::new(false);

/// Begins to listen. Without this, Ctrl-C ends the process at once, as it does everywhere.
pub(crate) fn listen() {
    let pressed = || {
        if PRESSED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        let mut stderr = std::io::stderr();
        let _ =
            writeln!(stderr, "\nstopping at the next sample; press Ctrl-C again to stop at once");
    };
    // It fails only if someone listens already, who then serves as well.
    let _ = ctrlc::set_handler(pressed);
}

/// Whether to stop.
pub(crate) fn pressed() -> bool {
    PRESSED.load(Ordering::SeqCst)
}
