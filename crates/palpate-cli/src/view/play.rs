//! Plays touches sample by sample: each sample is predicted by a field, or learnt, and shown.

use std::collections::VecDeque;
use std::fmt::Write;
use std::path::PathBuf;

use nalgebra::DVector;
use palpate::{Arm, Contacts, Mapper, MapperError, Predictor, Sample};
use palpate_learn::torque_errors::{ErrorSum, TorqueErrors};
use palpate_view::{DrawnSample, Recording, SampleTorque};
use palpate_work::Progress;
use palpate_work::touches::{TouchEvent, Touches};
use serde::Serialize;

use crate::error::CliError;
use crate::hull::Hulls;
use crate::output::Output;

use super::args::Args;
use super::to::failed;

/// Time between the end of a touch and the start of the next in a recording, s.
const PAUSE_S: f64 = 1.0;

/// What predicts the torques of a sample.
pub(super) enum Follower {
    /// Predicts each sample, then learns it.
    Mapper(Box<Mapper>),
    /// Predicts each sample with a field.
    Predictor(Box<Predictor>),
}

/// Measured and predicted torque, n_joints, N·m; `None` while the tare is being taken.
type Torques = Option<(DVector<f64>, DVector<f64>)>;

impl Follower {
    fn begin_touch(&mut self) {
        match self {
            Self::Mapper(mapper) => mapper.begin_touch(),
            Self::Predictor(predictor) => predictor.begin_touch(),
        }
    }

    fn step(&mut self, sample: &Sample) -> Result<Torques, MapperError> {
        Ok(match self {
            Self::Mapper(mapper) => {
                let report = mapper.step(sample)?;
                report.external.zip(report.predicted)
            }
            Self::Predictor(predictor) => {
                predictor.step(sample)?.map(|step| (step.external, step.predicted))
            }
        })
    }

    fn end_touch(&mut self) -> Result<(), MapperError> {
        match self {
            Self::Mapper(mapper) => mapper.end_touch(),
            Self::Predictor(predictor) => Ok(predictor.end_touch()?),
        }
    }

    fn contacts(&self) -> Contacts {
        match self {
            Self::Mapper(mapper) => mapper.contacts(),
            Self::Predictor(predictor) => predictor.contacts(),
        }
    }
}

/// Summary of what was played.
#[derive(Debug, Default, Serialize)]
pub(super) struct Played {
    touches: u64,
    samples: u64,
    samples_shown: u64,
    contacts_largest: usize,
    /// Errors of the predicted torques against the measured ones.
    errors: Option<TorqueErrors>,
    /// Errors of predicting zero.
    zero: Option<TorqueErrors>,
}

impl Played {
    /// The summary as a few lines of text.
    pub(super) fn text(&self) -> String {
        let Self { touches, samples, samples_shown, contacts_largest, .. } = self;
        let mut text = format!(
            "  touches {touches}, samples {samples}, of them shown {samples_shown}; at most \
             {contacts_largest} points touched\n"
        );
        if let (Some(errors), Some(zero)) = (&self.errors, &self.zero) {
            let _ = writeln!(
                text,
                "  error of the predicted torque {:.3} N·m on average (predicting zero: {:.3} N·m)",
                errors.avg_error, zero.avg_error
            );
        }
        text
    }
}

/// The time of a recording, in which touches follow each other whatever the times in their logs.
#[derive(Debug, Default)]
struct Clock {
    /// Logged time of the first sample of the current touch, s.
    first_s: Option<f64>,
    /// Time of that sample in the recording, s.
    began_s: f64,
    /// The latest time in the recording so far, s.
    now_s: f64,
}

impl Clock {
    fn begin_touch(&mut self) {
        if self.first_s.take().is_some() {
            self.began_s = self.now_s + PAUSE_S;
        }
        self.now_s = self.began_s;
    }

    fn at(&mut self, time_s: f64) -> f64 {
        let first_s = *self.first_s.get_or_insert(time_s);
        let at_s = self.began_s + (time_s - first_s);
        self.now_s = self.now_s.max(at_s);
        at_s
    }
}

/// Plays logs.
pub(super) struct Player {
    follower: Follower,
    pub(super) touches: Touches,
    /// Events that were read before playing began.
    ahead: VecDeque<TouchEvent>,
    /// Whether the samples have times.
    pub(super) timed: bool,
    /// Log and name of the current touch.
    under_way: Option<(PathBuf, String)>,
    clock: Clock,
    played: Played,
    errors: ErrorSum,
}

impl Player {
    /// Reads up to the first sample.
    pub(super) fn new(follower: Follower, mut touches: Touches) -> Result<Self, CliError> {
        let mut ahead = VecDeque::new();
        while !matches!(ahead.back(), Some(TouchEvent::Sample(_))) {
            let Some(moment) = touches.advance()? else { break };
            ahead.push_back(moment);
        }
        let timed =
            matches!(ahead.back(), Some(TouchEvent::Sample(first)) if first.time_s.is_some());
        let (clock, played) = (Clock::default(), Played::default());
        let errors = ErrorSum::default();
        let under_way = None;
        Ok(Self { follower, touches, ahead, timed, under_way, clock, played, errors })
    }

    /// Joint positions of the first sample, if nothing was played yet.
    pub(super) fn first_q(&self) -> Option<&[f64]> {
        match self.ahead.back() {
            Some(TouchEvent::Sample(sample)) => Some(&sample.q),
            _ => None,
        }
    }

    fn advance(&mut self) -> Result<Option<TouchEvent>, CliError> {
        match self.ahead.pop_front() {
            Some(moment) => Ok(Some(moment)),
            None => self.touches.advance(),
        }
    }

    /// Plays all touches; Ctrl-C is an error.
    pub(super) fn play(
        &mut self,
        recording: &mut Recording<'_>,
        arm: (&Arm, &Hulls),
        args: &Args,
        output: &Output,
    ) -> Result<Played, CliError> {
        let bar = output.begin(self.touches.samples(), "frames", "playing");
        while let Some(moment) = self.advance()? {
            if output.stopped() {
                let kept = format!(" at {}; no file was written", self.touches.place());
                return Err(CliError::Interrupted { kept });
            }
            match moment {
                TouchEvent::Touch(name) => {
                    self.end_touch(recording)?;
                    self.follower.begin_touch();
                    self.clock.begin_touch();
                    self.played.touches += 1;
                    bar.at(&name);
                    let at_s = self.timed.then_some(self.clock.now_s);
                    recording.touch(&name, self.played.samples, at_s).map_err(failed)?;
                    self.under_way = Some((self.touches.log().to_owned(), name));
                }
                TouchEvent::Sample(sample) => {
                    self.sample(&sample, recording, arm, args)?;
                    bar.step();
                }
            }
        }
        self.end_touch(recording)?;
        let mut played = std::mem::take(&mut self.played);
        (played.errors, played.zero) = (self.errors.errors(), self.errors.zero());
        Ok(played)
    }

    /// Predicts or learns a sample, and shows every `args.every`-th.
    fn sample(
        &mut self,
        sample: &Sample,
        recording: &mut Recording<'_>,
        (arm, hulls): (&Arm, &Hulls),
        args: &Args,
    ) -> Result<(), CliError> {
        let number = self.played.samples;
        let time_s = sample.time_s.map(|time_s| self.clock.at(time_s));
        let torques = self.follower.step(sample).map_err(|error| self.touches.fault(error))?;
        self.played.samples += 1;
        if let Some((measured, predicted)) = &torques {
            self.errors.add(predicted.as_slice(), measured.as_slice());
        }
        let contacts = self.follower.contacts();
        self.played.contacts_largest = self.played.contacts_largest.max(contacts.len());
        if number.is_multiple_of(args.every) {
            let poses = hulls.poses(arm, &sample.q).map_err(CliError::file)?;
            let torque = torques.as_ref();
            let torque = torque.map(|(measured, predicted)| SampleTorque { measured, predicted });
            let frame = DrawnSample {
                sample: number,
                time_s,
                world_from_link: &poses,
                contacts: &contacts,
                torque,
            };
            recording.frame(&frame).map_err(failed)?;
            if let Follower::Predictor(predictor) = &self.follower
                && let Some(body) = predictor.body()
            {
                let bent = (&**body.body(), &body.segments_m()[..]);
                recording.body(bent, number, time_s).map_err(failed)?;
            }
            self.played.samples_shown += 1;
        }
        if self.played.samples.is_multiple_of(args.field_every) {
            self.show_field(recording, number, time_s)?;
        }
        Ok(())
    }

    /// Shows the field so far, if it is being learnt.
    fn show_field(
        &self,
        recording: &mut Recording<'_>,
        sample: u64,
        time_s: Option<f64>,
    ) -> Result<(), CliError> {
        match &self.follower {
            Follower::Mapper(mapper) => {
                recording.field(&mapper.field(), sample, time_s).map_err(failed)
            }
            Follower::Predictor(_) => Ok(()),
        }
    }

    /// Ends the current touch, if there is one, and shows the field learnt so far.
    fn end_touch(&mut self, recording: &mut Recording<'_>) -> Result<(), CliError> {
        let Some((log, name)) = &self.under_way else { return Ok(()) };
        let place = || format!("touch `{name}`");
        self.follower.end_touch().map_err(|error| CliError::touch(log, place(), error))?;
        let last = self.played.samples.saturating_sub(1);
        let time_s = self.clock.first_s.map(|_| self.clock.now_s);
        self.show_field(recording, last, time_s)
    }
}
