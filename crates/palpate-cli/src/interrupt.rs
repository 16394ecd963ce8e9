//! Ctrl-C: the first asks the loop to stop at the next sample; another, a second later or more, kills.

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
            if PRESSED.get().is_some_and(|first| is_another(*first, again)) {
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

/// Whether a later signal is a new one, not the first one passed on.
fn is_another(first: Instant, again: Instant) -> bool {
    again.duration_since(first) >= TOGETHER
}

/// Whether to stop.
pub(crate) fn pressed() -> bool {
    PRESSED.get().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_that_comes_twice_is_one_and_a_later_one_another() {
        let first = Instant::now();
        assert!(!is_another(first, first + TOGETHER / 10));
        assert!(is_another(first, first + TOGETHER));
    }
}
