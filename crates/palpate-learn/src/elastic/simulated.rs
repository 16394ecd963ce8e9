//! Torques of bodies that the arm bends in every touch, with each kind of contact.

use std::sync::Arc;

use nalgebra::DMatrix;
use palpate::unstable::{Downsampling, ElasticBody, ElasticContactConfig, Equilibrium};
use palpate::{Arm, MapperError, RobotError};
use rayon::prelude::*;

use crate::error::{LearnError, Stop, unless_stopped};
use crate::tracked::{Touch, Tracked};

/// Contacts between arm and body that are tried: friction, and creep, s
/// ([`ElasticContactConfig::creep_s`]).
pub const CONTACTS: [[f64; 2]; 6] =
    [[0.15, 0.0], [0.4, 0.0], [0.8, 0.0], [0.15, 1e-4], [0.4, 1e-4], [0.8, 1e-4]];
/// n_joints × trees of the body, N·m at a stiffness factor of one, by touch and frame of [`Tracked`].
pub(super) type Simulated = Vec<Vec<DMatrix<f64>>>;

/// Of [`CONTACTS`], that of an object that was not touched yet.
pub(super) const UNTOUCHED: usize = 4;

/// Torque of an object's bodies along every touch.
#[derive(Debug, Clone)]
pub(crate) struct BodyTorques {
    /// The bodies, the likeliest first.
    pub(super) bodies: Vec<Arc<ElasticBody>>,
    /// By contact ([`CONTACTS`]) and body: of the first body with each contact, of the others with those that
    /// may be chosen.
    simulated: Vec<Vec<Simulated>>,
    /// Samples, all contacts counted, and those in which the body did not come to rest.
    pub(crate) settled: Settled,
}

/// How often the body came to rest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Settled {
    /// Samples, each with every contact.
    pub samples: u64,
    /// Those in which the iterations were used up before the body was at rest: its torque is that of the
    /// last iteration.
    pub unsettled: u64,
}

/// How many steps are counted while so many bodies are simulated along so many touches.
pub fn steps(touches: usize, bodies: usize) -> usize {
    touches * (CONTACTS.len() + bodies.saturating_sub(1))
}

impl BodyTorques {
    /// Of these bodies, along no touch.
    pub(crate) fn new(bodies: &[Arc<ElasticBody>]) -> Self {
        assert!(!bodies.is_empty(), "the caller gave a body");
        let simulated = vec![vec![Vec::new(); bodies.len()]; CONTACTS.len()];
        Self { bodies: bodies.to_vec(), simulated, settled: Settled::default() }
    }

    /// Simulates the touches that are not yet, several at a time; the result does not depend on how many. The
    /// contact is one that a set of `training` touches will choose. `step` is called [`steps`] times.
    pub(crate) fn extend(
        &mut self,
        arm: &Arc<Arm>,
        (tracked, touches): (&Tracked, &[Touch]),
        training: &[Vec<usize>],
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<(), LearnError> {
        let first: Vec<[usize; 2]> = (0..CONTACTS.len()).map(|contact| [contact, 0]).collect();
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

    /// Simulates what is missing of these contacts and bodies; `step` is called with the contact.
    fn simulate(
        &mut self,
        arm: &Arc<Arm>,
        (tracked, touches): (&Tracked, &[Touch]),
        wanted: &[[usize; 2]],
        (stop, step): (Stop<'_>, &(dyn Fn(usize) + Sync)),
    ) -> Result<(), LearnError> {
        let missing = |&[contact, body]: &[usize; 2]| {
            let simulated = self.simulated[contact][body].len();
            (simulated..touches.len()).map(move |touch| [contact, body, touch])
        };
        let jobs: Vec<[usize; 3]> = wanted.iter().flat_map(missing).collect();
        let simulate = |&[contact, body, touch]: &[usize; 3]| {
            let [friction, creep_s] = CONTACTS[contact];
            let config =
                ElasticContactConfig { friction, creep_s, ..ElasticContactConfig::default() };
            let body = Arc::clone(&self.bodies[body]);
            let equilibrium = Equilibrium::new(Arc::clone(arm), body, config);
            let followed = follow(equilibrium, (touch, &touches[touch]), tracked, stop);
            followed.inspect(|_| step(contact))
        };
        let all: Result<Vec<_>, LearnError> =
            jobs.par_iter().with_max_len(1).map(simulate).collect();
        for ([contact, body, _], (torques, settled)) in jobs.iter().zip(all?) {
            self.simulated[*contact][*body].push(torques);
            self.settled.samples += settled.samples;
            self.settled.unsettled += settled.unsettled;
        }
        Ok(())
    }

    /// Keeps so many touches from the first on.
    pub(crate) fn truncate(&mut self, touches: usize) {
        self.simulated.iter_mut().flatten().for_each(|simulated| simulated.truncate(touches));
    }

    /// Forgets touches from the first on.
    pub(crate) fn forget(&mut self, touches: usize) {
        for simulated in self.simulated.iter_mut().flatten() {
            simulated.drain(..touches.min(simulated.len()));
        }
    }

    /// The torques of the first body with a contact.
    pub(super) fn first(&self, contact: usize) -> &Simulated {
        &self.simulated[contact][0]
    }

    /// The torques of the bodies with a contact that may be chosen, the first body first.
    pub(super) fn torques(&self, contact: usize) -> &[Simulated] {
        &self.simulated[contact]
    }
}

/// The body's torque in the frames of a touch.
fn follow(
    mut equilibrium: Equilibrium,
    (number, touch): (usize, &Touch),
    tracked: &Tracked,
    stop: Stop<'_>,
) -> Result<(Vec<DMatrix<f64>>, Settled), LearnError> {
    let frames = &tracked.touches[number].frames;
    let mut torques = Vec::with_capacity(frames.len());
    let mut settled = Settled { samples: 0, unsettled: 0 };
    let (mut before_s, mut downsampling) = (None::<f64>, Downsampling::default());
    for (sample, logged) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        if !downsampling.takes(logged) {
            continue; // as no frame is learnt from
        }
        settled.samples += 1;
        let passed_s = logged.time_s.zip(before_s).map(|(now, before)| now - before);
        before_s = logged.time_s;
        let at = |error: RobotError| {
            let source = MapperError::from(error);
            LearnError::Sample { touch: number, sample, source }
        };
        let poses = equilibrium.arm().robot.forward(&logged.q).map_err(at)?;
        settled.unsettled +=
            u64::from(equilibrium.advance(&poses.world_from_link, passed_s).unsettled > 0);
        if frames.get(torques.len()).is_some_and(|frame| frame.sample as usize == sample) {
            torques.push(equilibrium.torques(&poses));
        }
    }
    assert_eq!(torques.len(), frames.len(), "the touches are those that were tracked");
    Ok((torques, settled))
}
