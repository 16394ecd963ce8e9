//! An elastic body that learns touches one by one.

use std::sync::Arc;

use palpate::unstable::{ElasticBody, ElasticModel};
use palpate::{Arm, MapperConfig, Sample};

use super::simulated::{BodyTorques, ConvergenceCounts};
use super::{learn_with_body, model, with_torque};
use crate::calibrate::calibrate;
use crate::error::{LearnError, Stop};
use crate::folds::inner_folds;
use crate::tracked::{TouchSamples, TrackedTouches};

/// Learns an object's elastic body from touches. Simulated torques are kept, so that only new touches are simulated.
#[derive(Debug, Clone)]
pub struct ElasticBodyLearner {
    arm: Arc<Arm>,
    config: MapperConfig,
    touches: Vec<TouchSamples>,
    torques: Arc<BodyTorques>,
    calibrates: bool,
}

impl ElasticBodyLearner {
    /// A learner without touches. `bodies` are alternatives for the same object, the most likely first.
    ///
    /// # Panics
    ///
    /// Without a body.
    pub fn new(arm: &Arc<Arm>, config: &MapperConfig, bodies: &[Arc<ElasticBody>]) -> Self {
        let torques = Arc::new(BodyTorques::new(bodies));
        let (arm, config) = (Arc::clone(arm), config.clone());
        Self { arm, config, touches: Vec::new(), torques, calibrates: false }
    }

    /// Also calibrates the bands on held-out touches, if enough of them have torque. For this, each of these is predicted
    /// from the others, which takes about a quarter of all the time.
    #[must_use]
    pub fn calibrating(self) -> Self {
        Self { calibrates: true, ..self }
    }

    /// The most times that held-out touches are predicted, if this many touches are learnt.
    pub fn folds(&self, touches: usize) -> usize {
        if self.calibrates { inner_folds(&(0..touches).collect::<Vec<_>>()).len() } else { 0 }
    }

    /// Number of learnt touches.
    pub fn n_touches(&self) -> usize {
        self.touches.len()
    }

    /// How often the simulation of the bodies converged.
    pub fn convergence(&self) -> ConvergenceCounts {
        self.torques.convergence
    }

    /// Learns more touches, and returns the body that explains all touches so far. After an error the learner is as
    /// before.
    ///
    /// `step` is called after each simulated touch, from any thread: [`super::steps`] times for the new
    /// touches, and again for older ones if the best contact has changed. If the learner is calibrating, it is also
    /// called at most [`ElasticBodyLearner::folds`] times.
    ///
    /// # Errors
    ///
    /// Names the first touch and sample that cannot be used.
    pub fn learn(
        &mut self,
        more: impl IntoIterator<Item = Vec<Sample>>,
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<ElasticModel, LearnError> {
        let before = self.touches.len();
        for samples in more {
            let name = format!("touch {} (from 0)", self.touches.len());
            self.touches.push(TouchSamples { name, samples, truth: None });
        }
        let learnt = self.learn_all((stop, step));
        if learnt.is_err() {
            self.touches.truncate(before);
            Arc::make_mut(&mut self.torques).truncate(before);
        }
        learnt
    }

    fn learn_all(
        &mut self,
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<ElasticModel, LearnError> {
        let touches = &self.touches[..];
        let mut tracked = TrackedTouches::new(&self.arm, &self.config, touches, stop)?;
        let all: Vec<usize> = (0..touches.len()).collect();
        let torques = Arc::make_mut(&mut self.torques);
        let counted = if self.calibrates { with_torque(&tracked, &all) } else { Vec::new() };
        let folds = inner_folds(&counted).into_iter();
        let mut training: Vec<Vec<usize>> = folds.map(|fold| fold.train).collect();
        training.push(all.clone());
        torques.extend(&self.arm, (&tracked, touches), &training, (stop, step))?;
        tracked.body = Some(Arc::clone(&self.torques));
        let mut model = model(&tracked, &all, &self.config, stop)?;
        let own = calibrate(learn_with_body, &tracked, &counted, &self.config, (stop, step))?;
        model.calibration = own.or(model.calibration);
        Ok(model)
    }

    /// Forgets all touches but the `newest` last ones.
    pub fn forget_all_but(&mut self, newest: usize) {
        let older = self.touches.len().saturating_sub(newest);
        self.touches.drain(..older);
        Arc::make_mut(&mut self.torques).forget(older);
    }
}
