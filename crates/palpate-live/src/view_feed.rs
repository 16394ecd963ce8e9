//! Sends frames of a session to a viewer, at a limited rate.
//!
//! They go through a [`LatestQueue`]: a viewer that does not keep up loses the oldest frames and does
//! not delay the mapper.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::{Contacts, Field, Mapper, Sample};

use crate::body::{BentBody, LiveElasticBody};
use crate::latest_queue::LatestQueue;
use crate::session::{SessionState, StepOutcome};
use crate::timer::Timer;

/// Interval between two frames of the arm.
const ARM: Duration = Duration::from_millis(40);
/// Interval between two frames of the field.
const FIELD: Duration = Duration::from_secs(1);

/// Largest number of frames that wait for the viewer.
pub const WAITING: usize = 64;

/// A frame to draw.
#[derive(Debug, Clone)]
pub struct ViewFrame {
    /// Number of the sample in the session, from 0.
    pub sample: u64,
    /// Time of its arrival since the session began.
    pub since: Duration,
    /// Content of the frame.
    pub what: ViewContent,
}

/// Content of a frame.
#[derive(Debug, Clone)]
pub enum ViewContent {
    /// A touch begins.
    Touch,
    /// Position, contacts and torques of the arm.
    Arm {
        /// Joint positions, n_joints, rad or m.
        q: Vec<f64>,
        /// The cells that the arm displaces.
        contacts: Contacts,
        /// τ_ext and τ̂, n_joints, N·m, once the touch has its tare.
        torques: Option<(DVector<f64>, DVector<f64>)>,
    },
    /// The present field.
    Field(Box<Field>),
    /// The elastic body as it is bent now.
    Body(BentBody),
}

/// Selects the frames that are drawn.
pub(crate) struct ViewFeed {
    to: Arc<LatestQueue<ViewFrame>>,
    body: Option<Arc<LiveElasticBody>>,
    began: Instant,
    samples: u64,
    arm: Timer,
    field: Timer,
}

impl ViewFeed {
    pub(crate) fn new(to: Arc<LatestQueue<ViewFrame>>, body: Option<Arc<LiveElasticBody>>) -> Self {
        let (arm, field) = (Timer::new(ARM), Timer::new(FIELD));
        Self { to, body, began: Instant::now(), samples: 0, arm, field }
    }

    /// Takes a sample that came at `at`, with its outcome, the state of the session, and the
    /// mapper.
    pub(crate) fn sample(
        &mut self,
        (sample, at): (&Sample, Instant),
        (outcome, state, mapper): (&StepOutcome, SessionState, &Mapper),
    ) {
        let number = self.samples;
        self.samples += 1;
        let push = |what| {
            let since = at.saturating_duration_since(self.began);
            self.to.push(ViewFrame { sample: number, since, what });
        };
        if outcome.begins {
            push(ViewContent::Touch);
        }
        if self.arm.is_due(at) {
            // While the session waits, the mapper still has the contacts of the last touch.
            let contacts = if state == SessionState::Waiting {
                Contacts::default()
            } else {
                mapper.contacts()
            };
            push(ViewContent::Arm {
                q: sample.q.clone(),
                contacts,
                torques: outcome.torques.clone(),
            });
            if let Some(bent) = self.body.as_ref().and_then(|body| body.bent()) {
                push(ViewContent::Body(bent));
            }
        }
        if state == SessionState::Mapping && self.field.is_due(at) {
            push(ViewContent::Field(Box::new(mapper.field())));
        }
    }
}
