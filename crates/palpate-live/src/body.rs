//! The object as an elastic body, in addition to the mapper's field: one thread bends it with the arm, another
//! learns it from completed touches. Both use thread pools of low priority.
//!
//! A newly learnt body replaces the previous one between touches, when the body is undeformed.
//! Questions and viewers get the body as the arm bends it. The mapper does not use the body: it learns
//! the whole external torque, and predicts the next sample from the field alone.

use std::fmt::{self, Formatter};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use nalgebra::Point3;
use palpate::unstable::{ElasticBody, ElasticModel, ElasticTorque};
use palpate::{Arm, MapperConfig, PathPredictor, Sample};
use palpate_io::field::SavedField;
use palpate_learn::LearnError;
use palpate_learn::elastic::ElasticBodyLearner;

use crate::background::{Share, nice_pool, on};
use crate::latest_queue::LatestQueue;
use crate::run::MappedSample;
use crate::session::SessionState;
use crate::threads::{Shared, lock};

/// Largest number of samples that wait for the body to be bent.
const SAMPLES: usize = 4096;
/// Smallest interval between two samples that are learnt or bend the body, s.
const EVERY_S: f64 = 0.009;
/// While more samples than this wait, they do not bend the body.
const BACKLOG: usize = 100;
/// Largest number of samples of a touch that are learnt; later ones are left out.
const MAX_SAMPLES: usize = 20_000;
/// Number of touches that are remembered and learnt from: the newest.
const MAX_TOUCHES: usize = 32;
/// Interval between checks whether the session has ended.
const LOOK: Duration = Duration::from_millis(50);

/// A body, and start and end of each of its segments as it is bent, m, world frame.
pub type BentBody = (Arc<ElasticBody>, Vec<[Point3<f64>; 2]>);

/// An elastic body beside a running robot.
pub struct LiveElasticBody {
    arm: Arc<Arm>,
    config: MapperConfig,
    mapped: LatestQueue<MappedSample>,
    learnt: Mutex<Learnt>,
    /// The body as the arm bends it.
    bent: Mutex<Arc<Bent>>,
    to_learner: Sender<Vec<Sample>>,
    touches: Receiver<Vec<Sample>>,
}

/// The body as learnt so far, and the touches.
struct Learnt {
    model: Arc<ElasticModel>,
    /// The newest touches: first those that the model has learnt, then those that it has not.
    touches: Vec<Vec<Sample>>,
    waiting: usize,
}

impl Learnt {
    /// Replaces the model. Bands that were calibrated on held-out touches stay; a body with touches but no bands, as after
    /// an extrapolation, gets none.
    fn replace(&mut self, model: ElasticModel) {
        let calibration = match &self.model.calibration {
            Some(own) if !own.of_other_objects => Some(own.clone()),
            None if self.model.n_touches > 0 => None,
            _ => model.calibration,
        };
        self.model = Arc::new(ElasticModel { calibration, ..model });
    }
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

impl LiveElasticBody {
    /// An untouched body; `bodies` are the shapes that it may have, the most likely first.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    ///
    /// # Panics
    ///
    /// If `bodies` is empty.
    pub fn new(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        bodies: &[Arc<ElasticBody>],
    ) -> Result<Self, LearnError> {
        let model = ElasticBodyLearner::new(arm, config, bodies).learn([], (&|| false, &|| ()))?;
        Ok(Self::resumed(arm, config, Arc::new(model), Vec::new()))
    }

    /// Resumes from the body of a saved field and the touches saved with it: those that the body has learnt
    /// come first.
    pub fn resumed(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        model: Arc<ElasticModel>,
        touches: Vec<Vec<Sample>>,
    ) -> Self {
        let (to_learner, from_body) = bounded(MAX_TOUCHES);
        let waiting = touches.len().saturating_sub(model.n_touches);
        let bent = Arc::new(Bent::at_rest(arm, Arc::clone(&model)));
        Self {
            arm: Arc::clone(arm),
            config: config.clone(),
            mapped: LatestQueue::new(SAMPLES),
            bent: Mutex::new(bent),
            learnt: Mutex::new(Learnt { model, touches, waiting }),
            to_learner,
            touches: from_body,
        }
    }

    /// Adds the body as learnt so far, and the touches, to a field that will be saved.
    pub fn put_into(&self, saved: &mut SavedField) {
        let learnt = lock(&self.learnt);
        saved.field.elastic = Some(Arc::clone(&learnt.model));
        saved.elastic_touches.clone_from(&learnt.touches);
        if let Some(snapshot) = &saved.snapshot {
            // The snapshot does not contain touches that began after it was taken.
            saved.elastic_touches.truncate(snapshot.touches as usize);
        }
    }

    /// Number of completed touches that the body has not learnt yet.
    pub fn waiting(&self) -> usize {
        lock(&self.learnt).waiting
    }

    /// The most likely body as the arm bends it; `None` if no body has a torque.
    pub(crate) fn bent(&self) -> Option<BentBody> {
        let bent = Arc::clone(&lock(&self.bent));
        let body = bent.torque.body()?;
        Some((Arc::clone(body.body()), body.segments_m()))
    }

    /// The queue of mapped samples.
    pub(crate) fn mapped(&self) -> &LatestQueue<MappedSample> {
        &self.mapped
    }

    /// The path predictor, extended to bend the body too.
    pub(crate) fn with_body(&self, predictor: PathPredictor) -> PathPredictor {
        let bent = Arc::clone(&lock(&self.bent));
        predictor.with_body(&bent.model, bent.torque.clone())
    }

    /// The thread that bends the body and records the samples of touches.
    pub(crate) fn follow(&self, shared: &Shared) {
        let pool = nice_pool("bend", Share::All);
        let mut now = Bent::clone(&lock(&self.bent));
        let (mut recorder, mut bent_s, mut lost) = (Recorder::default(), None::<f64>, 0);
        loop {
            let Some(mapped) = self.mapped.pop(LOOK) else {
                if shared.is_running() {
                    continue;
                }
                break;
            };
            let dropped = self.mapped.dropped();
            if std::mem::replace(&mut lost, dropped) != dropped {
                recorder = Recorder::default(); // the lost samples may have begun or ended a touch
                shared.note("the elastic body does not keep up: it leaves out a touch");
            }
            if let Some(touch) = recorder.take(&mapped) {
                self.hand_over(touch, shared);
            }
            let in_touch = mapped.begins || mapped.state != SessionState::Waiting;
            if mapped.begins || (!in_touch && bent_s.is_some()) {
                now = Bent::at_rest(&self.arm, Arc::clone(&lock(&self.learnt).model));
                bent_s = None;
                *lock(&self.bent) = Arc::new(now.clone());
            }
            let at_s = mapped.sample.time_s;
            let is_due = at_s.zip(bent_s).is_none_or(|(now, last)| now - last >= EVERY_S);
            // A backlog is skipped, and so are the last samples when the session ends.
            let is_late = self.mapped.len() > BACKLOG && !mapped.begins;
            if in_touch && mapped.is_usable && is_due && !is_late && shared.is_running() {
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
        // Locked before sending: the learner must find the touch in the list when it has learnt it.
        let mut learnt = lock(&self.learnt);
        match self.to_learner.try_send(touch.clone()) {
            Ok(()) => {
                learnt.touches.push(touch);
                learnt.waiting += 1;
            }
            Err(_) => {
                shared.note("the elastic body does not keep up: it leaves out a touch");
            }
        }
    }

    /// The thread that learns the body, touch by touch.
    pub(crate) fn learn(&self, shared: &Shared) {
        let pool = nice_pool("learn", Share::All);
        // `pending`: touches not simulated yet, at first all that were saved. The last `new` of them are
        // not learnt yet.
        let (mut learner, mut pending, mut new) = {
            let learnt = lock(&self.learnt);
            let learner = ElasticBodyLearner::new(&self.arm, &self.config, &learnt.model.bodies());
            (learner, learnt.touches.clone(), learnt.waiting)
        };
        while shared.is_running() {
            if new == 0 {
                let Ok(touch) = self.touches.recv_timeout(LOOK) else { continue };
                pending.push(touch);
                new = 1;
            }
            let more: Vec<Vec<Sample>> = self.touches.try_iter().collect();
            new += more.len();
            pending.extend(more);
            let older = pending.len().saturating_sub(MAX_TOUCHES);
            pending.drain(..older);
            let left_out = new.saturating_sub(pending.len());
            lock(&self.learnt).waiting -= left_out;
            new -= left_out;
            learner.forget_all_but(MAX_TOUCHES - pending.len());
            let stop = || !shared.is_running();
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
                    learnt.replace(model);
                    pending.clear();
                    new = 0;
                }
                Err(LearnError::Stopped) => return,
                Err(LearnError::Sample { touch, sample, source })
                    if (learner.n_touches()..learner.n_touches() + pending.len())
                        .contains(&touch) =>
                {
                    // Leave this touch out; the others are learnt in the next pass.
                    let place = touch - learner.n_touches();
                    learnt.touches.remove(end - pending.len() + place);
                    let is_new = place + new >= pending.len();
                    pending.remove(place);
                    learnt.waiting -= usize::from(is_new);
                    new -= usize::from(is_new);
                    shared.note(format!(
                        "the elastic body leaves out a touch, because its sample {sample} cannot be used: {source}"
                    ));
                }
                Err(error) => {
                    return self.wait_for_the_end(shared, &error);
                }
            }
        }
    }

    /// Reports an error and waits: if the thread returned, the session would end.
    fn wait_for_the_end(&self, shared: &Shared, error: &LearnError) {
        shared.note(format!("the elastic body has stopped learning: {error}"));
        while shared.is_running() {
            thread::sleep(LOOK);
        }
    }
}

impl fmt::Debug for LiveElasticBody {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_struct("LiveElasticBody").field("waiting", &self.waiting()).finish_non_exhaustive()
    }
}

/// Records the samples of a touch: all samples of the tare, then about 100 per second.
#[derive(Default)]
struct Recorder {
    touch: Vec<Sample>,
    touches_anything: bool,
}

impl Recorder {
    /// Takes the next sample; returns the touch that it ends, if there was a contact in it.
    fn take(&mut self, mapped: &MappedSample) -> Option<Vec<Sample>> {
        let over =
            if mapped.begins || mapped.state == SessionState::Waiting { self.end() } else { None };
        if mapped.begins {
            self.touch.clone_from(&mapped.tare);
        }
        let is_new = !mapped.begins || mapped.tare.is_empty();
        if is_new && mapped.state != SessionState::Waiting && mapped.is_usable {
            let last_s = self.touch.last().and_then(|last| last.time_s);
            let passed_s = mapped.sample.time_s.zip(last_s).map(|(now, last)| now - last);
            let is_due =
                mapped.state == SessionState::Taring || passed_s.is_none_or(|s| s >= EVERY_S);
            if is_due && self.touch.len() < MAX_SAMPLES {
                self.touch.push(mapped.sample.clone());
                self.touches_anything |= mapped.contacts > 0;
            }
        }
        over
    }

    /// Ends the touch; returns its samples, if there was a contact.
    fn end(&mut self) -> Option<Vec<Sample>> {
        let touch = std::mem::take(&mut self.touch);
        std::mem::take(&mut self.touches_anything).then_some(touch)
    }
}

#[cfg(test)]
mod tests {
    use palpate::unstable::{ElasticVariant, Segment, SegmentKind};
    use palpate::{Calibration, LearntTorques};

    use super::*;

    fn mapped(time_s: f64, state: SessionState, contacts: usize) -> MappedSample {
        let sample = Sample::new(Some(time_s), vec![time_s], vec![0.0]);
        let (begins, tare, is_usable) = (false, Vec::new(), true);
        MappedSample { sample, contacts, state, begins, tare, is_usable }
    }

    #[test]
    fn a_touch_is_kept_with_its_whole_tare_and_thinned_after_it() {
        let mut recorder = Recorder::default();
        let tare: Vec<Sample> =
            (0..5).map(|n| mapped(0.001 * f64::from(n), SessionState::Waiting, 0).sample).collect();
        let begins = MappedSample { begins: true, tare, ..mapped(0.004, SessionState::Taring, 0) };
        assert_eq!(recorder.take(&begins), None);
        for n in 5..8 {
            recorder.take(&mapped(0.001 * f64::from(n), SessionState::Taring, 0));
        }
        for n in 8..108 {
            let is_usable = n != 60;
            let sample = mapped(0.001 * f64::from(n), SessionState::Mapping, 3);
            assert_eq!(recorder.take(&MappedSample { is_usable, ..sample }), None);
        }
        let touch = recorder.take(&mapped(0.2, SessionState::Waiting, 0)).expect("it is over");
        let times_s: Vec<f64> = touch.iter().filter_map(|sample| sample.time_s).collect();
        assert!(times_s[..8].iter().zip(0..).all(|(s, n)| (s - 0.001 * f64::from(n)).abs() < 1e-9));
        let thinned = |[a, b]: &[f64; 2]| (EVERY_S - 1e-9..0.0111).contains(&(b - a));
        assert!(times_s[7..].array_windows().all(thinned), "{times_s:?}");
        assert!(times_s[times_s.len() - 1] > 0.095, "{times_s:?}");
        assert_eq!(recorder.end(), None, "nothing is left");
    }

    #[test]
    fn bands_calibrated_on_held_out_touches_stay_when_the_body_learns_on() {
        let stem = Segment {
            parent: None,
            kind: SegmentKind::Wood,
            start_m: [0.0; 3],
            end_m: [0.0, 0.0, 0.1],
            bare_m: 0.0,
            radius_m: 0.01,
            half_width_m: [0.0; 3],
            joint_stiffness: 20.0,
            branch: 0,
        };
        let body = ElasticBody::new(vec![stem]).unwrap();
        let variant = ElasticVariant { body, weight: 1.0, stiffness_factors: vec![1.0] };
        let bands = |error: f64, of_other_objects| {
            let learnt = LearntTorques { error_n_m: vec![error], torque_n_m: vec![1.0] };
            let others = Calibration::of_other_objects(&learnt, 2, 1.0).unwrap();
            Calibration { of_other_objects, ..others }
        };
        let model = |calibration: &Calibration| ElasticModel {
            variants: vec![variant.clone()],
            friction: 0.4,
            creep_s: 0.0,
            torque_limit_n_m: None,
            share: 1.0,
            n_touches: 1,
            speed_m_per_s: 0.1,
            residual_cells: Vec::new(),
            residual_n_per_m: Vec::new(),
            untouched_residual_n_per_m: 0.0,
            calibration: Some(calibration.clone()),
        };
        let newer = bands(0.2, true);
        let without = Arc::new(ElasticModel { calibration: None, ..model(&newer) });
        let mut extrapolated = Learnt { model: without, touches: Vec::new(), waiting: 0 };
        extrapolated.replace(model(&newer));
        assert_eq!(extrapolated.model.calibration, None);
        for (older, stays) in [(bands(0.1, true), false), (bands(0.1, false), true)] {
            let model_before = Arc::new(model(&older));
            let mut learnt = Learnt { model: model_before, touches: Vec::new(), waiting: 0 };
            learnt.replace(model(&newer));
            let wanted = if stays { &older } else { &newer };
            assert_eq!(learnt.model.calibration.as_ref(), Some(wanted));
        }
    }

    #[test]
    fn a_motion_that_touches_nothing_is_no_touch() {
        let mut recorder = Recorder::default();
        recorder.take(&MappedSample { begins: true, ..mapped(0.0, SessionState::Taring, 0) });
        recorder.take(&mapped(1.0, SessionState::Mapping, 0));
        assert_eq!(recorder.take(&mapped(2.0, SessionState::Waiting, 0)), None);
    }
}
