//! The mapper's thread: takes samples and requests; produces torques, clouds, figures and checkpoints.
//!
//! Replays fill the time until the next sample; if samples come faster than they can be mapped, no
//! replays are made.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crossbeam_channel::Receiver;
use palpate_io::field::SavedField;

use crate::body::LiveElasticBody;
use crate::checkpoint::Checkpoints;
use crate::cloud;
use crate::diagnostics;
use crate::figures::{SessionCounters, SessionEvent, SessionFigures};
use crate::guard::ALL_ZERO;
use crate::joints::JointReader;
use crate::latest_queue::LatestQueue;
use crate::message::{Header, Stamp};
use crate::query_server::Request;
use crate::ros::{Arrival, TorqueMessage};
use crate::run::{LiveConfig, MappedSample};
use crate::session::{Session, SessionState, StepOutcome};
use crate::threads::{JointMessage, Shared};
use crate::timer::Timer;
use crate::view_feed::ViewFeed;
use crate::wrench::{stamped, with_released, wrenches};

/// Largest wait for a sample; requests are answered in between.
const PAUSE: Duration = Duration::from_millis(2);
/// Interval between two reports of figures.
const FIGURES: Duration = Duration::from_millis(200);
/// Interval between two diagnostic messages.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// Interval between two clouds of contacts.
const CONTACTS: Duration = Duration::from_millis(100);
/// Interval between two clouds of the field.
const FIELD: Duration = Duration::from_secs(1);
/// While more samples than this wait, no clouds are made.
const BACKLOG: usize = 4;

/// The session, and the state of the mapper's thread.
pub(crate) struct Mapping<'a> {
    shared: &'a Shared,
    session: Session,
    reader: JointReader,
    tally: SessionCounters,
    checkpoints: Option<Checkpoints>,
    view: Option<ViewFeed>,
    mapped: Option<Arc<LatestQueue<MappedSample>>>,
    body: Option<Arc<LiveElasticBody>>,
    requests: Receiver<Request>,
    /// Whether it was reported that the messages use other joint names than the URDF.
    noted_names: bool,
    /// Whether it was reported that sign or gravity of the torques seem wrong.
    noted_misread: bool,
    /// Frame and stamp of the last sample.
    header: Header,
    /// Joint positions of the last sample.
    q: Vec<f64>,
    /// Arrival of the last decoded joint state; before the first, the start of the session.
    heard: Instant,
    /// Links in contact when wrenches were last published.
    pressed: Vec<String>,
    figures_due: Timer,
    diagnostics_due: Timer,
    contacts_due: Timer,
    field_due: Timer,
}

impl<'a> Mapping<'a> {
    pub(crate) fn new(
        shared: &'a Shared,
        (session, config): (Session, &LiveConfig),
        checkpoints: Option<Checkpoints>,
        requests: Receiver<Request>,
    ) -> Self {
        let robot = &session.mapper().arm().robot;
        let reader = JointReader::new(robot.joint_names().map(str::to_owned).collect());
        let frame_id = robot.links()[0].name.clone(); // the world of all poses
        Self {
            shared,
            session,
            reader,
            tally: SessionCounters::default(),
            checkpoints,
            view: config.view.clone().map(|to| ViewFeed::new(to, config.body.clone())),
            mapped: config.mapped.clone(),
            body: config.body.clone(),
            requests,
            noted_names: false,
            noted_misread: false,
            header: Header { frame_id, ..Header::default() },
            q: Vec::new(),
            heard: Instant::now(),
            pressed: Vec::new(),
            figures_due: Timer::new(FIGURES),
            diagnostics_due: Timer::new(DIAGNOSTICS),
            contacts_due: Timer::new(CONTACTS),
            field_due: Timer::new(FIELD),
        }
    }

    /// Maps until the session is stopped; ends its touch and returns it.
    pub(crate) fn run(mut self) -> Session {
        while self.shared.is_running() {
            if self.shared.tare.swap(false, Ordering::Relaxed) {
                self.session.wait();
                self.shared
                    .note("a tare at the next pause was requested: the arm must stand still and touch nothing");
            }
            self.answer_requests();
            // Answers to questions are urgent, replays are not.
            let answering = self.shared.answering.load(Ordering::Relaxed) > 0;
            let spare = self.session.has_spare() && !answering;
            let patience = if spare { Duration::ZERO } else { PAUSE };
            match self.shared.samples.pop(patience) {
                Some(message) => {
                    let came = message.at;
                    self.take(message);
                    if let Some(guard) = &self.shared.guard {
                        guard.taken(came, !self.shared.samples.is_empty());
                    }
                }
                None if spare => self.tally.replayed(self.session.spare()),
                None => {}
            }
            self.report();
        }
        self.session.finish();
        self.session
    }

    /// Answers the waiting requests to the mapper.
    fn answer_requests(&mut self) {
        while let Ok(request) = self.requests.try_recv() {
            // Sending fails if the client has disconnected.
            match request {
                Request::Predictor(cluster_weight, to_asker) => {
                    let predictor = self.session.mapper().coarse_path_predictor(cluster_weight);
                    let _ = to_asker.send(predictor);
                }
                Request::Save(to_asker) => {
                    let mapper = self.session.mapper();
                    let checkpoints = self.checkpoints.as_mut();
                    let number =
                        checkpoints.and_then(|them| them.now(|| SavedField::of_mapper(mapper)));
                    let _ = to_asker.send(number);
                }
                Request::Position(to_asker) => {
                    let _ = to_asker.send(self.session.mapper().position());
                }
                Request::Log(from, to_asker) => {
                    let _ = to_asker.send(self.session.mapper().log_from(from));
                }
                Request::GoOnWith(mapper, to_asker) => {
                    let _ = to_asker.send(self.session.go_on_with(mapper));
                }
            }
        }
    }

    /// Maps a joint state, or counts it as refused.
    fn take(&mut self, JointMessage { state, came, at }: JointMessage) {
        let state = match state {
            Ok(state) => state,
            Err(why) => return self.refuse("broken", &format!("it cannot be decoded: {why}")),
        };
        self.heard = at;
        let read = match self.reader.read(&state, came.at_s) {
            Ok(read) => read,
            Err(refusal) => return self.refuse(refusal.name(), &refusal.to_string()),
        };
        if read.set_back {
            self.session.wait();
            self.shared.note("the clock was set back; waiting for the arm to pause");
        }
        self.header.stamp = match state.header.stamp.seconds() {
            Some(_) => state.header.stamp,
            None => Stamp::at(came.at_s),
        };
        if let Some((own, called)) = self.reader.other_name().filter(|_| !self.noted_names) {
            self.noted_names = true;
            let own_and =
                "joints are matched by the parts of their names that differ from joint to joint";
            self.shared.note(format!("{own_and}: `{called}` is `{own}`, and so on"));
        }
        if self.session.is_dead(&read.sample) {
            return self.refuse("no torque", ALL_ZERO);
        }
        let started = Instant::now();
        let sample = match self.session.external(read.sample) {
            Ok(sample) => sample,
            Err(error) => return self.refuse("not followed", &error.to_string()),
        };
        self.q.clone_from(&sample.q);
        let mut outcome = self.session.take(&sample);
        self.tally.step(&outcome, started.elapsed());
        self.shared.wake_for_flag();
        if let Some(view) = &mut self.view {
            let (state, mapper) = (self.session.state(), self.session.mapper());
            view.sample((&sample, at), (&outcome, state, mapper));
        }
        let mapped = MappedSample {
            sample,
            contacts: outcome.contacts,
            state: self.session.state(),
            begins: outcome.begins,
            tare: std::mem::take(&mut outcome.tare),
            is_usable: outcome.fault.is_none(),
        };
        if let Some(body) = &self.body {
            body.mapped().push(mapped.clone());
        }
        if let Some(inbox) = &self.mapped {
            inbox.push(mapped);
        }
        self.publish(outcome, came);
    }

    /// Publishes the outcome of a sample.
    fn publish(&mut self, outcome: StepOutcome, came: Arrival) {
        if let Some((external, predicted)) = outcome.torques {
            self.shared.outbox.torques.push(TorqueMessage {
                header: self.header.clone(),
                came,
                external_n_m: external.data.into(),
                predicted_n_m: predicted.data.into(),
                detection: outcome.detection,
            });
        }
        if let Some((link, wrench)) = outcome.wrench {
            let frame_id = self.session.mapper().arm().robot.links()[link.index()].name.clone();
            let wrench = stamped(&wrench, Header { stamp: self.header.stamp, frame_id });
            self.shared.outbox.wrenches.push(vec![wrench]);
        }
        if let Some(why) =
            outcome.convention_warning.filter(|_| !std::mem::replace(&mut self.noted_misread, true))
        {
            self.shared.note(format!(
                "sign or gravity of the torques seems to be set wrong: {why} (reported once)"
            ));
        }
        if let Some(fault) = outcome.fault
            && self.tally.refuse("not followed")
        {
            self.shared.note(format!("a sample cannot be used: {fault}"));
        }
    }

    /// Counts a message that cannot be used; reports the first one for each reason.
    fn refuse(&mut self, reason: &'static str, why: &str) {
        if self.tally.refuse(reason) {
            self.shared.note(format!("a message cannot be used: {why} (reported once)"));
        }
    }

    /// Produces the clouds, figures, diagnostics and checkpoints that are due.
    fn report(&mut self) {
        let (shared, session, now) = (self.shared, &self.session, Instant::now());
        while let Some(latency) = shared.latencies.pop(Duration::ZERO) {
            self.tally.published(latency);
        }
        if let Some(checkpoints) = &mut self.checkpoints {
            checkpoints.tick(|| SavedField::of_mapper(session.mapper()));
        }
        // With a backlog of samples, clouds would delay them further.
        let is_mapping = session.maps() && session.state() == SessionState::Mapping;
        if shared.samples.len() <= BACKLOG && is_mapping {
            self.publish_clouds(now);
        }
        if self.figures_due.is_due(now) {
            let figures = self.figures();
            if let Some(why) = shared.written.failure() {
                shared.note(format!("the checkpoint could not be written: {why}"));
            }
            if self.diagnostics_due.is_due(now) {
                let robot = self.session.mapper().arm().robot.name();
                let header = Header { stamp: self.header.stamp, ..Header::default() };
                shared.outbox.diagnostics.push(diagnostics::of(&figures, robot, header));
            }
            shared.events.push(SessionEvent::Figures(Box::new(figures)));
        }
    }

    /// Publishes the present contacts, the wrenches, and the field near the contacts, if due.
    fn publish_clouds(&mut self, now: Instant) {
        let (outbox, mapper) = (&self.shared.outbox, self.session.mapper());
        if self.contacts_due.is_due(now) {
            outbox.contacts.push(cloud::contacts(mapper, &self.header));
            if let Ok(poses) = mapper.arm().robot.forward(&self.q) {
                let now = wrenches(mapper, &poses.world_from_link, self.header.stamp);
                let stamp = self.header.stamp;
                outbox.wrenches.push(with_released(now, &mut self.pressed, stamp));
            }
        }
        if self.field_due.is_due(now)
            && let Some(near) = cloud::field_near_contacts(mapper, &self.header)
        {
            outbox.field.push(near);
        }
    }

    fn figures(&mut self) -> SessionFigures {
        let stop = self.shared.cause().map(|cause| cause.to_string());
        let counts = self.shared.counts();
        SessionFigures {
            state: self.session.state(),
            silent_s: self.heard.elapsed().as_secs_f64(),
            dropped: self.shared.samples.dropped(),
            lost: counts.lost,
            cells: self.session.mapper().n_cells(),
            stopped: stop.is_some(),
            stop,
            unsent: counts.unsent + self.shared.outbox.torques.dropped(),
            checkpoint_s: self.shared.written.age_s(),
            ..self.tally.figures(counts.received)
        }
    }
}
