//! Ctrl-C: the first asks the loop to stop at the next sample, the second kills.

use std::io::Write;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// When it was first pressed.
static PRESSED: OnceLock<Instant> = OnceLock::new();

/// Signals that come together count as one: `ros2 launch` passes on what the terminal or `systemd` has sent to all.
const TOGETHER: Duration = Duration::from_secs(1);

/// Begins to listen. Without this, Ctrl-C ends the process at once, as it does everywhere.
pub(crate) fn listen() {
    let pressed = || {
        if let Err(again) = PRESSED.set(Instant::now()) {
            let first = PRESSED.get().copied().unwrap_or(again);
            if again.duration_since(first) >= TOGETHER {
                std::process::exit(130);
            }
            return;
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
    PRESSED.get().is_some()
}
