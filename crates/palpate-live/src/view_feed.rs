//! What a viewer of a session gets, now and then.
//!
//! It goes through an [`Inbox`], so a viewer that does not keep up loses what is old and delays
//! nobody.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::{Contacts, Field, Mapper, Sample};

use crate::body::{BentBody, LiveBody};
use crate::inbox::Inbox;
use crate::session::{State, StepOutcome};
use crate::timer::Timer;

/// Between two positions of the arm: more would not look smoother.
const ARM: Duration = Duration::from_millis(40);
/// Between two fields.
const FIELD: Duration = Duration::from_secs(1);

/// Frames that may wait for the viewer.
pub const WAITING: usize = 64;

/// Something to draw.
#[derive(Debug, Clone)]
pub struct ViewFrame {
    /// Number of the sample in the session, from 0.
    pub sample: u64,
    /// When it came, since the session began.
    pub since: Duration,
    /// What there is to draw.
    pub what: What,
}

/// What there is to draw.
#[derive(Debug, Clone)]
pub enum What {
    /// A touch begins.
    Touch,
    /// Where the arm is, what it touches and what it measures.
    Arm {
        /// Joint positions, n_joints, rad or m.
        q: Vec<f64>,
        /// What the arm displaces.
        contacts: Contacts,
        /// τ_ext and τ̂, n_joints, N·m, once the touch has its tare.
        torques: Option<(DVector<f64>, DVector<f64>)>,
    },
    /// The field as it is.
    Field(Box<Field>),
    /// The elastic body.
    Body(BentBody),
}

/// Picks what is drawn.
pub(crate) struct ViewFeed {
    to: Arc<Inbox<ViewFrame>>,
    body: Option<Arc<LiveBody>>,
    began: Instant,
    samples: u64,
    arm: Timer,
    field: Timer,
}

impl ViewFeed {
    pub(crate) fn new(to: Arc<Inbox<ViewFrame>>, body: Option<Arc<LiveBody>>) -> Self {
        let (arm, field) = (Timer::new(ARM), Timer::new(FIELD));
        Self { to, body, began: Instant::now(), samples: 0, arm, field }
    }

    /// Takes a sample that came at `at`, and what the session made of it.
    pub(crate) fn sample(
        &mut self,
        (sample, at): (&Sample, Instant),
        (outcome, state, mapper): (&StepOutcome, State, &Mapper),
    ) {
        let number = self.samples;
        self.samples += 1;
        let push = |what| {
            let since = at.saturating_duration_since(self.began);
            self.to.push(ViewFrame { sample: number, since, what });
        };
        if outcome.begins {
            push(What::Touch);
        }
        if self.arm.is_due(at) {
            // Where nothing is mapped, the contacts are those of a touch that is over.
            let contacts =
                if state == State::Waiting { Contacts::default() } else { mapper.contacts() };
            push(What::Arm { q: sample.q.clone(), contacts, torques: outcome.torques.clone() });
            if let Some(bent) = self.body.as_ref().and_then(|body| body.bent()) {
                push(What::Body(bent));
            }
        }
        if state == State::Mapping && self.field.is_due(at) {
            push(What::Field(Box::new(mapper.field())));
        }
    }
}
