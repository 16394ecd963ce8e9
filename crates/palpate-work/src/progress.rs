//! Messages and progress for the caller, who may also stop the work.

/// Receiver of messages and progress: the terminal of the command, or a program.
pub trait Progress: Sync {
    /// Receives a message that is not a result: what was decided for the user, or is being done.
    fn note(&self, text: &str);

    /// Receives a warning: something looks wrong, though it does not stop the work.
    fn warn(&self, text: &str) {
        self.note(text);
    }

    /// Begins work of `steps` steps, `None` if unknown. Steps are counted in `things`, such as
    /// frames; `doing` names the work.
    fn begin(&self, steps: Option<u64>, things: &'static str, doing: &str) -> Box<dyn Bar>;

    /// Whether to stop at the next step.
    fn stopped(&self) -> bool;
}

/// Progress of one piece of work, which ends when the bar is dropped.
pub trait Bar: Sync {
    /// Counts one finished step.
    fn step(&self);

    /// Shows what is being worked on, such as the name of a touch.
    fn at(&self, what: &str);
}
