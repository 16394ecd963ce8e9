//! Chooses settings beside the mapper, which goes on meanwhile: contact model, prior and stiffness scale, by
//! cross-validation on the touches so far ([`palpate_learn::choose`]).
//!
//! A second mapper then learns the touches again with the chosen settings. Once it has caught up with the first one to
//! within a few samples, it takes its place ([`Session::go_on_with`](crate::session::Session::go_on_with)). All of this
//! runs on threads of low priority.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use crossbeam_channel::{RecvTimeoutError, Sender, bounded};
use palpate::unstable::TouchLog;
use palpate::{Arm, Mapper, MapperConfig, MapperError, ReplayPolicy};
use palpate_learn::LearnError;
use palpate_learn::choose::{Chosen, MIN_TUNING_TOUCHES, choose_for_log, refusal};
use palpate_learn::tune::FixedSettings;

use crate::background::{Share, nice_pool, on};
use crate::query_server::Request;
use crate::session::Succession;
use crate::threads::Shared;

/// Interval between checks whether a touch or the session has ended.
const LOOK: Duration = Duration::from_millis(200);

/// Chooses settings beside the mapper.
pub(crate) struct Chooser<'a> {
    arm: Arc<Arm>,
    /// The settings with which the session began; a candidate themselves.
    initial: MapperConfig,
    /// Which of them the user has given: they are not changed.
    given: FixedSettings,
    to_mapper: Sender<Request>,
    shared: &'a Shared,
}

/// Why nothing is chosen.
enum Failure {
    /// The session has ended.
    Ended,
    /// The touches cannot be predicted or learnt again.
    Touches(String),
    /// Touches are no longer in memory.
    Forgotten(MapperError),
}

impl<'a> Chooser<'a> {
    /// A chooser beside this mapper.
    pub(crate) fn new(
        mapper: &Mapper,
        given: FixedSettings,
        to_mapper: Sender<Request>,
        shared: &'a Shared,
    ) -> Self {
        let (arm, initial) = (Arc::clone(mapper.arm()), mapper.config().clone());
        Self { arm, initial, given, to_mapper, shared }
    }

    /// Chooses when there are three touches in contact, and again whenever there are a quarter more.
    pub(crate) fn run(&self) {
        let pool = nice_pool("choose", Share::Half);
        if let Err(Failure::Forgotten(error)) = on(pool.as_ref(), || self.follow()) {
            self.shared.note(format!("settings are no longer chosen: {error}"));
        }
        while self.shared.is_running() {
            thread::sleep(LOOK); // if the thread returned, the session would end
        }
    }

    fn follow(&self) -> Result<(), Failure> {
        let (mut log, mut due) = (TouchLog::default(), MIN_TUNING_TOUCHES);
        loop {
            thread::sleep(LOOK);
            if self.ask(Request::Position)?.completed() == log.end().completed() {
                continue;
            }
            let later = self.ask(|to_me| Request::Log(log.end(), to_me))?;
            log.extend(later.map_err(Failure::Forgotten)?);
            let touches = log.touches.len();
            if touches < due {
                continue;
            }
            due = touches + (touches / 4).max(1);
            match self.choose(&log) {
                Ok(note) => self.shared.note(note),
                Err(Failure::Touches(why)) => {
                    self.shared.note(format!("the settings stay as they are: {why}"));
                }
                Err(end) => return Err(end),
            }
        }
    }

    /// Chooses settings for these touches and lets a mapper that has learnt with them take the place of the present
    /// one; says what was chosen.
    fn choose(&self, log: &TouchLog) -> Result<String, Failure> {
        let (stop, setup) = (|| !self.shared.is_running(), (&self.arm, &self.initial));
        let found = choose_for_log(setup, log, self.given, &stop)?;
        let Some((Chosen { tuned, calibration }, summary)) = found else {
            let why = format!("fewer than {MIN_TUNING_TOUCHES} touches meet something");
            return Err(Failure::Touches(why));
        };
        if let Some(why) = refusal(&tuned) {
            return Err(Failure::Touches(why));
        }
        let mapper =
            Mapper::new(Arc::clone(&self.arm), tuned.config)?.with_calibration(calibration);
        self.learn_again(mapper, log)?;
        Ok(format!("{summary}; the field was learned again with these settings"))
    }

    /// Lets a new mapper learn the touches of `log` and all that came later, until it takes the place of the present one.
    fn learn_again(&self, mut mapper: Mapper, log: &TouchLog) -> Result<(), Failure> {
        let mut is_complete = mapper.catch_up(log, || self.shared.is_running())?;
        while is_complete {
            mapper = mapper.with_replays(ReplayPolicy::SpareTime); // its due replays are made
            let successor = Box::new(mapper);
            let answer = self.ask(|to_me| Request::GoOnWith(successor, to_me))?;
            match answer.map_err(|(error, _)| error)? {
                Succession::Done(before) => {
                    drop(before); // here, as a refused successor, because it takes time
                    return Ok(());
                }
                Succession::Behind(behind, log) => {
                    mapper = behind.with_replays(ReplayPolicy::Background);
                    is_complete = mapper.catch_up(&log, || self.shared.is_running())?;
                }
            }
        }
        Err(Failure::Ended)
    }

    /// The answer of the mapper's thread to a request.
    fn ask<T>(&self, request: impl FnOnce(Sender<T>) -> Request) -> Result<T, Failure> {
        let (to_me, answer) = bounded(1);
        self.to_mapper.send(request(to_me)).map_err(|_| Failure::Ended)?;
        while self.shared.is_running() {
            match answer.recv_timeout(LOOK) {
                Ok(answer) => return Ok(answer),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Err(Failure::Ended)
    }
}

impl From<LearnError> for Failure {
    fn from(error: LearnError) -> Self {
        match error {
            LearnError::Stopped => Self::Ended,
            error => Self::Touches(error.to_string()),
        }
    }
}

impl From<MapperError> for Failure {
    fn from(error: MapperError) -> Self {
        match error {
            MapperError::NotLogged { .. } => Self::Forgotten(error),
            error => Self::Touches(error.to_string()),
        }
    }
}
