//! The object as an elastic body, beside the mapper: one thread bends it with the arm, another learns it from
//! the touches that are over. Both have a low priority, and threads of their own.
//!
//! A body that has learnt a touch replaces the one before when the next touch begins, when both are at rest.
//! Questions and viewers get the body as the arm bends it. The mapper knows no body: it goes on to learn
//! the whole torque, and predicts the next sample from that.

use std::fmt::{self, Formatter};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use nalgebra::Point3;
use palpate::unstable::{ElasticBody, ElasticModel, ElasticTorque};
use palpate::{Arm, MapperConfig, PathPredictor, Sample};
use palpate_io::field::Saved;
use palpate_learn::LearnError;
use palpate_learn::elastic::BodyLearner;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::inbox::Inbox;
use crate::run::Mapped;
use crate::session::State;
use crate::threads::Shared;

/// Samples that may wait for the body to be bent.
const SAMPLES: usize = 4096;
/// Between two samples that the body learns or is bent by, s, at least.
const EVERY_S: f64 = 0.009;
/// Samples that wait while the body is still bent by each that is due.
const BACKLOG: usize = 100;
/// Samples of a touch that are learnt; what comes after is left out.
const MOST_SAMPLES: usize = 20_000;
/// Touches that are remembered, and learnt from: the newest.
const MOST_TOUCHES: usize = 32;
/// Niceness of the threads that learn and bend.
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
    bent: Mutex<Arc<Bent>>,
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

    /// The body of a field, and the touches that the field holds: those that the body has learnt come first.
    pub fn resumed(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        model: Arc<ElasticModel>,
        touches: Vec<Vec<Sample>>,
    ) -> Self {
        let (to_learner, from_body) = bounded(MOST_TOUCHES);
        let waiting = touches.len().saturating_sub(model.n_touches);
        let bent = Arc::new(Bent::at_rest(arm, Arc::clone(&model)));
        Self {
            arm: Arc::clone(arm),
            config: config.clone(),
            mapped: Inbox::new(SAMPLES),
            bent: Mutex::new(bent),
            learnt: Mutex::new(Learnt { model, touches, waiting }),
            to_learner,
            touches: from_body,
        }
    }

    /// Gives a field the body as it is known now, and the touches of the session.
    pub fn put_into(&self, saved: &mut Saved) {
        let learnt = lock(&self.learnt);
        saved.field.elastic = Some(Arc::clone(&learnt.model));
        saved.field.calibration = None; // bands are of springs alone
        saved.elastic_touches.clone_from(&learnt.touches);
        if let Some(snapshot) = &saved.snapshot {
            // Touches that have begun since it was taken are not in it.
            saved.elastic_touches.truncate(snapshot.touches as usize);
        }
    }

    /// Touches that are over, and that the body has not learnt.
    pub fn waiting(&self) -> usize {
        lock(&self.learnt).waiting
    }

    /// The most likely body as the arm bends it; none if no body has a torque.
    pub(crate) fn bent(&self) -> Option<BentBody> {
        let bent = Arc::clone(&lock(&self.bent));
        let body = bent.torque.body()?;
        Some((Arc::clone(body.body()), body.segments_m()))
    }

    /// Where samples go once they are mapped.
    pub(crate) fn mapped(&self) -> &Inbox<Mapped> {
        &self.mapped
    }

    /// A path predictor that bends the body as well.
    pub(crate) fn with_body(&self, predictor: PathPredictor) -> PathPredictor {
        let bent = Arc::clone(&lock(&self.bent));
        predictor.with_body(&bent.model, bent.torque.clone())
    }

    /// The thread that bends the body, and keeps the samples of touches.
    pub(crate) fn follow(&self, shared: &Shared) {
        let pool = nice_pool("bend");
        let mut now = Bent::clone(&lock(&self.bent));
        let (mut recorder, mut bent_s, mut lost) = (Recorder::default(), None::<f64>, 0);
        loop {
            let Some(mapped) = self.mapped.pop(LOOK) else {
                if shared.goes_on() {
                    continue;
                }
                break;
            };
            let dropped = self.mapped.dropped();
            if std::mem::replace(&mut lost, dropped) != dropped {
                recorder = Recorder::default(); // where touches begin and end is not known
                shared.note("the elastic body does not keep up: a touch is not learnt by it");
            }
            if let Some(touch) = recorder.take(&mapped) {
                self.hand_over(touch, shared);
            }
            let in_touch = mapped.begins || mapped.state != State::Waiting;
            if mapped.begins || (!in_touch && bent_s.is_some()) {
                now = Bent::at_rest(&self.arm, Arc::clone(&lock(&self.learnt).model));
                bent_s = None;
                *lock(&self.bent) = Arc::new(now.clone());
            }
            let at_s = mapped.sample.time_s;
            let is_due = at_s.zip(bent_s).is_none_or(|(now, last)| now - last >= EVERY_S);
            // A body that is late goes on from the newest sample; at the end nobody asks any more.
            let is_late = self.mapped.len() > BACKLOG && !mapped.begins;
            if in_touch && mapped.is_usable && is_due && !is_late && shared.goes_on() {
                let Ok(poses) = self.arm.robot.forward(&mapped.sample.q) else { continue };
                bent_s = at_s;
                on(pool.as_ref(), || now.torque.bend(&poses.world_from_link, at_s));
                let bent = Arc::new(now.clone());
                *lock(&self.bent) = bent;
            }
        }
        if let Some(touch) = recorder.end() {
            self.hand_over(touch, shared);
        }
    }

    fn hand_over(&self, touch: Vec<Sample>, shared: &Shared) {
        // The learner counts what waits once it has learnt something: by then this touch must be there.
        let mut learnt = lock(&self.learnt);
        match self.to_learner.try_send(touch.clone()) {
            Ok(()) => {
                learnt.touches.push(touch);
                learnt.waiting += 1;
            }
            Err(_) => {
                shared.note("the elastic body does not keep up: a touch is not learnt by it");
            }
        }
    }

    /// The thread that learns the body, touch by touch.
    pub(crate) fn learn(&self, shared: &Shared) {
        let pool = nice_pool("learn");
        // Touches that were not simulated yet: at first all of the field, of which the last `new` wait.
        let (mut learner, mut pending, mut new) = {
            let learnt = lock(&self.learnt);
            let learner = BodyLearner::new(&self.arm, &self.config, &learnt.model.bodies());
            (learner, learnt.touches.clone(), learnt.waiting)
        };
        while shared.goes_on() {
            if new == 0 {
                let Ok(touch) = self.touches.recv_timeout(LOOK) else { continue };
                pending.push(touch);
                new = 1;
            }
            let more: Vec<Vec<Sample>> = self.touches.try_iter().collect();
            new += more.len();
            pending.extend(more);
            let older = pending.len().saturating_sub(MOST_TOUCHES);
            pending.drain(..older);
            let left_out = new.saturating_sub(pending.len());
            lock(&self.learnt).waiting -= left_out;
            new -= left_out;
            learner.forget_all_but(MOST_TOUCHES - pending.len());
            let stop = || !shared.goes_on();
            let found =
                on(pool.as_ref(), || learner.learn(pending.iter().cloned(), (&stop, &|| ())));
            let mut learnt = lock(&self.learnt);
            let end = learnt.touches.len() - learnt.waiting + new;
            match found {
                Ok(model) => {
                    learnt.touches.drain(..end.saturating_sub(model.n_touches));
                    learnt.waiting -= new;
                    shared.note(format!(
                        "touches that the elastic body has learnt: {}",
                        model.n_touches
                    ));
                    learnt.model = Arc::new(model);
                    pending.clear();
                    new = 0;
                }
                Err(LearnError::Stopped) => return,
                Err(LearnError::Sample { touch, sample, source })
                    if (learner.n_touches()..learner.n_touches() + pending.len())
                        .contains(&touch) =>
                {
                    // The others are learnt without it.
                    let place = touch - learner.n_touches();
                    learnt.touches.remove(end - pending.len() + place);
                    let is_new = place + new >= pending.len();
                    pending.remove(place);
                    learnt.waiting -= usize::from(is_new);
                    new -= usize::from(is_new);
                    shared.note(format!(
                        "the elastic body leaves a touch out, whose sample {sample} it cannot use: {source}"
                    ));
                }
                Err(error) => {
                    return self.wait_for_the_end(shared, &error);
                }
            }
        }
    }

    /// What is left to a learner that cannot go on: a thread that ends would end the session.
    fn wait_for_the_end(&self, shared: &Shared, error: &LearnError) {
        shared.note(format!("the elastic body learns no more: {error}"));
        while shared.goes_on() {
            thread::sleep(LOOK);
        }
    }
}

/// Threads of low priority; none if the system has none to spare.
fn nice_pool(name: &'static str) -> Option<ThreadPool> {
    // Of the thread alone; without the right to do so, it works all the same.
    let nice = |_| {
        let _ = rustix::process::setpriority_process(None, NICE);
    };
    let name = move |number| format!("{name}-{number}");
    ThreadPoolBuilder::new().thread_name(name).start_handler(nice).build().ok()
}

/// Works on some threads, or on those of everyone.
fn on<T: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(work),
        None => work(),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn mapped(time_s: f64, state: State, contacts: usize) -> Mapped {
        let sample = Sample::new(Some(time_s), vec![time_s], vec![0.0]);
        let (begins, tare, is_usable) = (false, Vec::new(), true);
        Mapped { sample, contacts, state, begins, tare, is_usable }
    }

    #[test]
    fn a_touch_is_kept_with_its_whole_tare_and_thinned_after_it() {
        let mut recorder = Recorder::default();
        let tare: Vec<Sample> =
            (0..5).map(|n| mapped(0.001 * f64::from(n), State::Waiting, 0).sample).collect();
        let begins = Mapped { begins: true, tare, ..mapped(0.004, State::Taring, 0) };
        assert_eq!(recorder.take(&begins), None);
        for n in 5..8 {
            recorder.take(&mapped(0.001 * f64::from(n), State::Taring, 0));
        }
        for n in 8..108 {
            let is_usable = n != 60;
            let sample = mapped(0.001 * f64::from(n), State::Mapping, 3);
            assert_eq!(recorder.take(&Mapped { is_usable, ..sample }), None);
        }
        let touch = recorder.take(&mapped(0.2, State::Waiting, 0)).expect("it is over");
        let times_s: Vec<f64> = touch.iter().filter_map(|sample| sample.time_s).collect();
        assert!(times_s[..8].iter().zip(0..).all(|(s, n)| (s - 0.001 * f64::from(n)).abs() < 1e-9));
        let thinned = |[a, b]: &[f64; 2]| (EVERY_S - 1e-9..0.0111).contains(&(b - a));
        assert!(times_s[7..].array_windows().all(thinned), "{times_s:?}");
        assert!(times_s[times_s.len() - 1] > 0.095, "{times_s:?}");
        assert_eq!(recorder.end(), None, "nothing is left");
    }

    #[test]
    fn a_motion_that_touches_nothing_is_no_touch() {
        let mut recorder = Recorder::default();
        recorder.take(&Mapped { begins: true, ..mapped(0.0, State::Taring, 0) });
        recorder.take(&mapped(1.0, State::Mapping, 0));
        assert_eq!(recorder.take(&mapped(2.0, State::Waiting, 0)), None);
    }
}
