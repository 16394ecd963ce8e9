//! Simulated torques of elastic bodies along every touch, for each kind of contact.

use std::sync::Arc;

use nalgebra::DMatrix;
use palpate::unstable::{Downsampling, ElasticBody, ElasticContactConfig, Equilibrium};
use palpate::{Arm, MapperError, RobotError};
use rayon::prelude::*;

use crate::error::{LearnError, Stop, unless_stopped};
use crate::tracked::{TouchSamples, TrackedTouches};

/// Contacts between arm and body that are tried: friction, and creep, s
/// ([`ElasticContactConfig::creep_s`]).
pub const CONTACT_CANDIDATES: [[f64; 2]; 6] =
    [[0.15, 0.0], [0.4, 0.0], [0.8, 0.0], [0.15, 1e-4], [0.4, 1e-4], [0.8, 1e-4]];
/// Torques by touch and frame of [`TrackedTouches`]: n_joints × trees of the body, N·m at a stiffness factor of 1.
pub(super) type Simulated = Vec<Vec<DMatrix<f64>>>;

/// Index in [`CONTACT_CANDIDATES`] of the contact that is assumed before any touch.
pub(super) const UNTOUCHED: usize = 4;

/// Torque of an object's bodies along every touch.
#[derive(Debug, Clone)]
pub(crate) struct BodyTorques {
    /// The bodies, the most likely first.
    pub(super) bodies: Vec<Arc<ElasticBody>>,
    /// By contact ([`CONTACT_CANDIDATES`]) and body. The first body is simulated with each contact, the others only
    /// with those that training touches choose.
    simulated: Vec<Vec<Simulated>>,
    /// Convergence of the simulations so far.
    pub(crate) convergence: ConvergenceCounts,
}

/// How often the simulation of a body converged to rest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ConvergenceCounts {
    /// Simulated samples; a sample counts once for each contact and body.
    pub samples: u64,
    /// Samples in which the iteration limit was reached before the body was at rest; their torque is that
    /// of the last iteration.
    pub not_converged: u64,
}

/// Number of calls of `step` for the simulation of this many bodies along touches.
pub fn steps(touches: usize, bodies: usize) -> usize {
    touches * (CONTACT_CANDIDATES.len() + bodies.saturating_sub(1))
}

impl BodyTorques {
    /// These bodies, without touches.
    pub(crate) fn new(bodies: &[Arc<ElasticBody>]) -> Self {
        assert!(!bodies.is_empty(), "the caller gave a body");
        let simulated = vec![vec![Vec::new(); bodies.len()]; CONTACT_CANDIDATES.len()];
        Self { bodies: bodies.to_vec(), simulated, convergence: ConvergenceCounts::default() }
    }

    /// Simulates the touches that are new, in parallel; the result does not depend on the number of
    /// threads. The first body is simulated with every contact, the others with those that a set of
    /// `training` touches chooses. `step` is called [`steps`] times.
    pub(crate) fn extend(
        &mut self,
        arm: &Arc<Arm>,
        (tracked, touches): (&TrackedTouches, &[TouchSamples]),
        training: &[Vec<usize>],
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<(), LearnError> {
        let first: Vec<[usize; 2]> =
            (0..CONTACT_CANDIDATES.len()).map(|contact| [contact, 0]).collect();
        let bodies = self.bodies.len();
        self.simulate(arm, (tracked, touches), &first, (stop, &|_| step()))?;
        let chosen = training.par_iter().map(|touches| self.contact(tracked, touches).0);
        let mut contacts: Vec<usize> = chosen.collect();
        contacts.sort_unstable();
        contacts.dedup();
        let others =
            contacts.iter().flat_map(|&contact| (1..bodies).map(move |body| [contact, body]));
        let others: Vec<[usize; 2]> = others.collect();
        let step = |contact: usize| {
            if contact == contacts[0] {
                step()
            }
        };
        self.simulate(arm, (tracked, touches), &others, (stop, &step))
    }

    /// Simulates the missing touches of the wanted `[contact, body]` pairs; `step` is called with the contact.
    fn simulate(
        &mut self,
        arm: &Arc<Arm>,
        (tracked, touches): (&TrackedTouches, &[TouchSamples]),
        wanted: &[[usize; 2]],
        (stop, step): (Stop<'_>, &(dyn Fn(usize) + Sync)),
    ) -> Result<(), LearnError> {
        let missing = |&[contact, body]: &[usize; 2]| {
            let simulated = self.simulated[contact][body].len();
            (simulated..touches.len()).map(move |touch| [contact, body, touch])
        };
        let jobs: Vec<[usize; 3]> = wanted.iter().flat_map(missing).collect();
        let simulate = |&[contact, body, touch]: &[usize; 3]| {
            let [friction, creep_s] = CONTACT_CANDIDATES[contact];
            let config =
                ElasticContactConfig { friction, creep_s, ..ElasticContactConfig::default() };
            let body = Arc::clone(&self.bodies[body]);
            let equilibrium = Equilibrium::new(Arc::clone(arm), body, config);
            let followed = follow(equilibrium, (touch, &touches[touch]), tracked, stop);
            followed.inspect(|_| step(contact))
        };
        let all: Result<Vec<_>, LearnError> =
            jobs.par_iter().with_max_len(1).map(simulate).collect();
        for ([contact, body, _], (torques, convergence)) in jobs.iter().zip(all?) {
            self.simulated[*contact][*body].push(torques);
            self.convergence.samples += convergence.samples;
            self.convergence.not_converged += convergence.not_converged;
        }
        Ok(())
    }

    /// Keeps only the first `touches` touches.
    pub(crate) fn truncate(&mut self, touches: usize) {
        self.simulated.iter_mut().flatten().for_each(|simulated| simulated.truncate(touches));
    }

    /// Forgets the first `touches` touches.
    pub(crate) fn forget(&mut self, touches: usize) {
        for simulated in self.simulated.iter_mut().flatten() {
            simulated.drain(..touches.min(simulated.len()));
        }
    }

    /// The torques of the first body with this contact.
    pub(super) fn first(&self, contact: usize) -> &Simulated {
        &self.simulated[contact][0]
    }

    /// The torques of all bodies with this contact, which training touches must have chosen.
    pub(super) fn torques(&self, contact: usize) -> &[Simulated] {
        &self.simulated[contact]
    }
}

/// The body's torque in the frames of a touch.
fn follow(
    mut equilibrium: Equilibrium,
    (number, touch): (usize, &TouchSamples),
    tracked: &TrackedTouches,
    stop: Stop<'_>,
) -> Result<(Vec<DMatrix<f64>>, ConvergenceCounts), LearnError> {
    let frames = &tracked.touches[number].frames;
    let mut torques = Vec::with_capacity(frames.len());
    let mut convergence = ConvergenceCounts { samples: 0, not_converged: 0 };
    let (mut before_s, mut downsampling) = (None::<f64>, Downsampling::default());
    for (sample, logged) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        if !downsampling.takes(logged) {
            continue; // this sample becomes no frame
        }
        convergence.samples += 1;
        let passed_s = logged.time_s.zip(before_s).map(|(now, before)| now - before);
        before_s = logged.time_s;
        let at = |error: RobotError| {
            let source = MapperError::from(error);
            LearnError::Sample { touch: number, sample, source }
        };
        let poses = equilibrium.arm().robot.forward(&logged.q).map_err(at)?;
        convergence.not_converged +=
            u64::from(equilibrium.advance(&poses.world_from_link, passed_s).not_converged > 0);
        if frames.get(torques.len()).is_some_and(|frame| frame.sample as usize == sample) {
            torques.push(equilibrium.torques(&poses));
        }
    }
    assert_eq!(torques.len(), frames.len(), "the touches are those that were tracked");
    Ok((torques, convergence))
}
