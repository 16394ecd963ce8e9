//! Torques of bodies that the arm bends in every touch, with each kind of contact.

use std::sync::Arc;

use nalgebra::DMatrix;
use palpate::unstable::{ElasticBody, ElasticContactConfig, Equilibrium};
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
    /// Of the first body, with each of [`CONTACTS`].
    pub(super) first: Vec<Simulated>,
    /// Of the others, with the contacts that may be chosen: those that all touches but one speak for.
    others: Vec<[Option<Simulated>; CONTACTS.len()]>,
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

impl BodyTorques {
    /// How many steps [`Self::new`] counts.
    pub(crate) fn steps(touches: usize, bodies: usize) -> usize {
        touches * (CONTACTS.len() + bodies.saturating_sub(1))
    }

    /// Simulates all touches, several at a time; the result does not depend on how many. `step` is called
    /// after each.
    pub(crate) fn new(
        arm: &Arc<Arm>,
        bodies: &[Arc<ElasticBody>],
        (tracked, touches): (&Tracked, &[Touch]),
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<Self, LearnError> {
        let n = touches.len();
        let simulate = |body: &Arc<ElasticBody>, contact: usize, touch: usize| {
            let [friction, creep_s] = CONTACTS[contact];
            let config =
                ElasticContactConfig { friction, creep_s, ..ElasticContactConfig::default() };
            let equilibrium = Equilibrium::new(Arc::clone(arm), Arc::clone(body), config);
            follow(equilibrium, (touch, &touches[touch]), tracked, stop)
        };
        let [first, others @ ..] = bodies else { panic!("the caller gave a body") };
        let jobs = (0..n * CONTACTS.len()).into_par_iter().with_max_len(1);
        let all = jobs.map(|job| simulate(first, job / n, job % n).inspect(|_| step()));
        let (simulated, mut settled) = gathered(all.collect::<Result<_, LearnError>>()?);
        let of_contact = |contact: usize| simulated[contact * n..(contact + 1) * n].to_vec();
        let first: Vec<Simulated> = (0..CONTACTS.len()).map(of_contact).collect();

        let bodies = bodies.to_vec();
        let mut torques = Self { bodies, first, others: Vec::new(), settled };
        let all_but = |left_out: usize| (0..n).filter(move |&touch| touch != left_out).collect();
        let contacts = (0..=n).into_par_iter().map(|left_out| {
            let touches: Vec<usize> = all_but(left_out);
            torques.contact(tracked, &touches).0
        });
        let mut contacts: Vec<usize> = contacts.collect();
        contacts.sort_unstable();
        contacts.dedup();
        for body in others {
            let mut by_contact: [Option<Simulated>; CONTACTS.len()] = Default::default();
            for (number, &contact) in contacts.iter().enumerate() {
                let all = (0..n).into_par_iter().with_max_len(1).map(|touch| {
                    let simulated = simulate(body, contact, touch);
                    simulated.inspect(|_| {
                        if number == 0 {
                            step()
                        }
                    })
                });
                let (simulated, more) = gathered(all.collect::<Result<_, LearnError>>()?);
                settled.samples += more.samples;
                settled.unsettled += more.unsettled;
                by_contact[contact] = Some(simulated);
            }
            torques.others.push(by_contact);
        }
        Ok(Self { settled, ..torques })
    }

    /// Every n-th frame of each touch, from the first on.
    pub(crate) fn thinned(&self, n: usize) -> Self {
        let touch = |frames: &Vec<DMatrix<f64>>| frames.iter().step_by(n.max(1)).cloned().collect();
        let touches = |touches: &Simulated| touches.iter().map(touch).collect();
        let other = |by_contact: &[Option<Simulated>; CONTACTS.len()]| {
            by_contact.each_ref().map(|simulated| simulated.as_ref().map(touches))
        };
        Self {
            bodies: self.bodies.clone(),
            first: self.first.iter().map(touches).collect(),
            others: self.others.iter().map(other).collect(),
            settled: self.settled,
        }
    }

    /// The torques of the bodies with a contact that may be chosen, the first body first.
    pub(super) fn torques(&self, contact: usize) -> impl Iterator<Item = &Simulated> {
        let others = self.others.iter().filter_map(move |others| others[contact].as_ref());
        std::iter::once(&self.first[contact]).chain(others)
    }
}

/// Results in their order, and how often bodies came to rest in all of them.
fn gathered(all: Vec<(Vec<DMatrix<f64>>, Settled)>) -> (Simulated, Settled) {
    let settled = all.iter().fold(Settled::default(), |sum, (_, settled)| Settled {
        samples: sum.samples + settled.samples,
        unsettled: sum.unsettled + settled.unsettled,
    });
    (all.into_iter().map(|(torques, _)| torques).collect(), settled)
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
    let mut settled = Settled { samples: touch.samples.len() as u64, unsettled: 0 };
    let mut before_s: Option<f64> = None;
    for (sample, logged) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        let time_s = logged.time_s.zip(before_s).map_or(0.0, |(now, before)| now - before);
        before_s = logged.time_s;
        let at = |error: RobotError| {
            let source = MapperError::from(error);
            LearnError::Sample { touch: number, sample, source }
        };
        let poses = equilibrium.arm().robot.forward(&logged.q).map_err(at)?;
        settled.unsettled += u64::from(equilibrium.advance(&poses, time_s).unsettled > 0);
        if frames.get(torques.len()).is_some_and(|frame| frame.sample as usize == sample) {
            torques.push(equilibrium.torques(&poses));
        }
    }
    assert_eq!(torques.len(), frames.len(), "the touches are those that were tracked");
    Ok((torques, settled))
}
