//! Who asked for work: hears of it, and may stop it.

/// The command's terminal, or a program.
pub trait Progress: Sync {
    /// Receives a message that is no result: what was decided for the user, or is being done.
    fn note(&self, text: &str);

    /// Receives a warning: something looks wrong, though it does not stop the work.
    fn warn(&self, text: &str) {
        self.note(text);
    }

    /// Work of so many steps begins, if they are known: of `things`, such as frames.
    fn begin(&self, steps: Option<u64>, things: &'static str, doing: &str) -> Box<dyn Bar>;

    /// Whether to stop at the next step.
    fn stopped(&self) -> bool;
}

/// How far some work is. It is over when this is dropped.
pub trait Bar: Sync {
    /// A step is done.
    fn step(&self);

    /// What is being worked on.
    fn at(&self, what: &str);
}
