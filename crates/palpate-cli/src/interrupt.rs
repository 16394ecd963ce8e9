//! Ctrl-C: the first one stops the command at the next sample; another one, at least a second later, ends it at once.

use std::io::Write;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Time of the first Ctrl-C.
static PRESSED: OnceLock<Instant> = OnceLock::new();

/// Signals within this time after the first count as one with it: `ros2 launch` repeats a signal that the terminal or
/// `systemd` has sent to all processes.
const TOGETHER: Duration = Duration::from_secs(1);

/// Installs the handler of Ctrl-C. Without it, Ctrl-C ends the process at once.
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
    // It fails only if a handler is installed already, which then serves as well.
    let _ = ctrlc::set_handler(pressed);
}

/// Whether a later signal is a new one, not a repetition of the first.
fn is_another(first: Instant, again: Instant) -> bool {
    again.duration_since(first) >= TOGETHER
}

/// Whether Ctrl-C was pressed, so that the command must stop.
pub(crate) fn pressed() -> bool {
    PRESSED.get().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_signal_counts_once_and_a_later_one_is_new() {
        let first = Instant::now();
        assert!(!is_another(first, first + TOGETHER / 10));
        assert!(is_another(first, first + TOGETHER));
    }
}
