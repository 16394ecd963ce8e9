//! The object as an elastic body, beside the mapper: one thread bends it with the arm, another learns it from
//! the touches that are over. Neither holds up the mapper, or each other.
//!
//! A body that has learnt a touch replaces the one before when the next touch begins, when both are at rest.
//! Questions and viewers get the body as the arm bends it. The mapper knows no body: it goes on to learn
//! the whole torque, and predicts the next sample from that.

use std::fmt::{self, Formatter};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use nalgebra::Point3;
use palpate::unstable::{ElasticBody, ElasticModel, ElasticTorque, ElasticVariant};
use palpate::{Arm, MapperConfig, PathPredictor, Sample};
use palpate_io::field::Saved;
use palpate_learn::LearnError;
use palpate_learn::elastic::BodyLearner;
use rayon::ThreadPoolBuilder;

use crate::inbox::Inbox;
use crate::run::Mapped;
use crate::session::State;
use crate::threads::Shared;

/// Samples that may wait for the body to be bent.
const SAMPLES: usize = 4096;
/// Between two samples that the body learns or is bent by, s: a hundred a second, as it was tried with.
const EVERY_S: f64 = 0.009;
/// Samples of a touch that are learnt; what comes after is left out.
const MOST_SAMPLES: usize = 20_000;
/// Touches that are remembered, and learnt from: the newest.
const MOST_TOUCHES: usize = 32;
/// Niceness of the threads that learn.
const NICE: i32 = 10;
/// Between two looks at whether the session goes on.
const LOOK: Duration = Duration::from_millis(50);

/// A body; start and end of each of its segments, m, world frame.
pub type BentBody = (Arc<ElasticBody>, Vec<[Point3<f64>; 2]>);

/// An elastic body beside a running robot.
pub struct LiveBody {
    arm: Arc<Arm>,
    config: MapperConfig,
    mapped: Inbox<Mapped>,
    learnt: Mutex<Learnt>,
    /// As the arm bends it.
    bent: Mutex<Bent>,
    to_learner: Sender<Vec<Sample>>,
    touches: Receiver<Vec<Sample>>,
}

/// What is known of the body.
struct Learnt {
    model: Arc<ElasticModel>,
    /// The newest touches: first those that the model has learnt, then those that wait for it.
    touches: Vec<Vec<Sample>>,
    waiting: usize,
}

#[derive(Clone)]
struct Bent {
    model: Arc<ElasticModel>,
    torque: ElasticTorque,
}

impl Bent {
    fn at_rest(arm: &Arc<Arm>, model: Arc<ElasticModel>) -> Self {
        Self { torque: ElasticTorque::new(arm, &model), model }
    }
}

impl LiveBody {
    /// One of these bodies, the most likely first, which nobody has touched.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    ///
    /// # Panics
    ///
    /// Without a body.
    pub fn new(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        bodies: &[Arc<ElasticBody>],
    ) -> Result<Self, LearnError> {
        let model = BodyLearner::new(arm, config, bodies).learn([], (&|| false, &|| ()))?;
        Ok(Self::resumed(arm, config, Arc::new(model), Vec::new()))
    }

    /// The body of a field, and the touches that it was learnt from.
    pub fn resumed(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        model: Arc<ElasticModel>,
        touches: Vec<Vec<Sample>>,
    ) -> Self {
        let (to_learner, from_body) = bounded(MOST_TOUCHES);
        Self {
            arm: Arc::clone(arm),
            config: config.clone(),
            mapped: Inbox::new(SAMPLES),
            bent: Mutex::new(Bent::at_rest(arm, Arc::clone(&model))),
            learnt: Mutex::new(Learnt { model, touches, waiting: 0 }),
            to_learner,
            touches: from_body,
        }
    }

    /// Gives a field the body as it is known now, and the touches of the session.
    pub fn put_into(&self, saved: &mut Saved) {
        let learnt = lock(&self.learnt);
        saved.field.elastic = Some(Arc::clone(&learnt.model));
        saved.elastic_touches.clone_from(&learnt.touches);
    }

    /// Touches that are over, and that the body has not learnt.
    pub fn waiting(&self) -> usize {
        lock(&self.learnt).waiting
    }

    /// The most likely body as the arm bends it; none if no body has a torque.
    pub(crate) fn bent(&self) -> Option<BentBody> {
        let bent = lock(&self.bent);
        let body = bent.torque.body()?;
        Some((Arc::clone(body.body()), body.segments_m()))
    }

    /// Where samples go once they are mapped.
    pub(crate) fn mapped(&self) -> &Inbox<Mapped> {
        &self.mapped
    }

    /// A path predictor that bends the body as well.
    pub(crate) fn with_body(&self, predictor: PathPredictor) -> PathPredictor {
        let Bent { model, torque } = lock(&self.bent).clone();
        predictor.with_body(&model, torque)
    }

    /// The thread that bends the body, and keeps the samples of touches.
    pub(crate) fn follow(&self, shared: &Shared) {
        let mut now = lock(&self.bent).clone();
        let mut recorder = Recorder::default();
        let mut bent_s: Option<f64> = None;
        loop {
            let Some(mapped) = self.mapped.pop(LOOK) else {
                if shared.goes_on() {
                    continue;
                }
                break;
            };
            if let Some(touch) = recorder.take(&mapped) {
                self.hand_over(touch, shared);
            }
            if mapped.begins {
                now = Bent::at_rest(&self.arm, Arc::clone(&lock(&self.learnt).model));
                bent_s = None;
            }
            let at_s = mapped.sample.time_s;
            let is_due = at_s.zip(bent_s).is_none_or(|(now, last)| now - last >= EVERY_S);
            let follows = mapped.begins || mapped.state != State::Waiting;
            // At the end nobody asks any more.
            if follows && mapped.is_usable && is_due && shared.goes_on() {
                let Ok(poses) = self.arm.robot.forward(&mapped.sample.q) else { continue };
                bent_s = at_s;
                now.torque.bend(&poses.world_from_link, at_s);
                lock(&self.bent).clone_from(&now);
            }
        }
        if let Some(touch) = recorder.end() {
            self.hand_over(touch, shared);
        }
    }

    fn hand_over(&self, touch: Vec<Sample>, shared: &Shared) {
        if self.to_learner.try_send(touch.clone()).is_err() {
            return shared.note("the elastic body does not keep up: a touch is not learnt by it");
        }
        let mut learnt = lock(&self.learnt);
        learnt.touches.push(touch);
        learnt.waiting += 1;
    }

    /// The thread that learns the body, touch by touch.
    pub(crate) fn learn(&self, shared: &Shared) {
        // Of the thread alone; without the right to do so it learns all the same.
        let nice = |_| {
            let _ = rustix::process::setpriority_process(None, NICE);
        };
        let pool =
            ThreadPoolBuilder::new().thread_name(|n| format!("body-{n}")).start_handler(nice);
        let pool = match pool.build() {
            Ok(pool) => pool,
            Err(error) => return shared.note(format!("the elastic body cannot learn: {error}")),
        };
        let (bodies, mut before) = {
            let learnt = lock(&self.learnt);
            let body = |variant: &ElasticVariant| Arc::new(variant.body.clone());
            let bodies: Vec<Arc<ElasticBody>> = learnt.model.variants.iter().map(body).collect();
            (bodies, learnt.touches.clone())
        };
        let mut learner = BodyLearner::new(&self.arm, &self.config, &bodies);
        while shared.goes_on() {
            let Ok(first) = self.touches.recv_timeout(LOOK) else { continue };
            let more: Vec<Vec<Sample>> =
                [first].into_iter().chain(self.touches.try_iter()).collect();
            let taken = more.len();
            // Those of an earlier session are simulated once there is something to learn.
            before.extend(more);
            let older = before.len().saturating_sub(MOST_TOUCHES);
            before.drain(..older);
            learner.forget_all_but(MOST_TOUCHES - before.len());
            let stop = || !shared.goes_on();
            let found = pool.install(|| learner.learn(before.iter().cloned(), (&stop, &|| ())));
            let mut learnt = lock(&self.learnt);
            let over = learnt.touches.len() - learnt.waiting;
            match found {
                Ok(model) => {
                    let n = learner.n_touches();
                    learnt.model = Arc::new(model);
                    learnt.touches.drain(..(over + taken).saturating_sub(n));
                    before.clear();
                    shared.note(format!("touches that the elastic body has learnt: {n}"));
                }
                Err(LearnError::Stopped) => return,
                Err(error) => {
                    // Nor would they be learnt with the next.
                    learnt.touches.drain(over..over + taken);
                    before.truncate(before.len() - taken);
                    shared.note(format!("the elastic body cannot learn a touch: {error}"));
                }
            }
            learnt.waiting -= taken;
        }
    }
}

impl fmt::Debug for LiveBody {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_struct("LiveBody").field("waiting", &self.waiting()).finish_non_exhaustive()
    }
}

/// No thread panics while it holds one of these; if one did, what it guards would still be whole.
fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps the samples of touches: all of the tare, and then a hundred a second.
#[derive(Default)]
struct Recorder {
    touch: Vec<Sample>,
    touches_anything: bool,
}

impl Recorder {
    /// Takes the next sample; returns the touch that is over with it, if it has touched anything.
    fn take(&mut self, mapped: &Mapped) -> Option<Vec<Sample>> {
        let over = if mapped.begins || mapped.state == State::Waiting { self.end() } else { None };
        if mapped.begins {
            self.touch.clone_from(&mapped.tare);
        }
        let is_new = !mapped.begins || mapped.tare.is_empty();
        if is_new && mapped.state != State::Waiting && mapped.is_usable {
            let last_s = self.touch.last().and_then(|last| last.time_s);
            let passed_s = mapped.sample.time_s.zip(last_s).map(|(now, last)| now - last);
            let is_due = mapped.state == State::Taring || passed_s.is_none_or(|s| s >= EVERY_S);
            if is_due && self.touch.len() < MOST_SAMPLES {
                self.touch.push(mapped.sample.clone());
                self.touches_anything |= mapped.contacts > 0;
            }
        }
        over
    }

    /// The touch so far, if it has touched anything.
    fn end(&mut self) -> Option<Vec<Sample>> {
        let touch = std::mem::take(&mut self.touch);
        std::mem::take(&mut self.touches_anything).then_some(touch)
    }
}
