//! What the user of a live session reads: events, and warnings of what looks wrong.

use std::cell::RefCell;
use std::sync::Arc;

use palpate_live::latest_queue::LatestQueue;
use palpate_live::{MappedSample, SessionEvent};

use super::checker::Checker;
use super::status::Shown;

/// Shows events and warnings.
pub(super) struct Reporter {
    shown: RefCell<Shown>,
    checker: Checker,
    strict: bool,
    /// The first warning, if warnings end the session (`--strict`).
    wrong: RefCell<Option<String>>,
}

impl Reporter {
    pub(super) fn new(shown: Shown, checker: Checker, strict: bool) -> Self {
        Self { shown: RefCell::new(shown), checker, strict, wrong: RefCell::default() }
    }

    /// The queue of mapped samples to be checked.
    pub(super) fn inbox(&self) -> Arc<LatestQueue<MappedSample>> {
        self.checker.inbox()
    }

    pub(super) fn show(&self, event: SessionEvent) {
        self.shown.borrow_mut().show(event);
    }

    /// Prints new warnings; returns whether one of them ends the session.
    pub(super) fn looks_wrong(&self) -> bool {
        self.warn(self.checker.warnings());
        self.wrong.borrow().is_some()
    }

    fn warn(&self, warnings: Vec<String>) {
        for warning in warnings {
            self.shown.borrow().warn(&warning);
            if self.strict {
                self.wrong.borrow_mut().get_or_insert(warning);
            }
        }
    }

    /// Prints the last warnings; also returns the warning that ends the session with an error, if
    /// any.
    pub(super) fn end(mut self) -> (Shown, Option<String>) {
        let warnings = self.checker.end();
        self.warn(warnings);
        (self.shown.into_inner(), self.wrong.into_inner())
    }
}
