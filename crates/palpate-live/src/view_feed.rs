//! What whoever draws a session gets to see of it, now and then.
//!
//! It goes through an [`Inbox`], so a drawer that does not keep up loses what is old and holds up
//! nobody.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::{Contacts, Field, Mapper, Sample};

use crate::inbox::Inbox;
use crate::session::{State, StepOutcome};

/// Between two moments: what moves faster looks no better.
const MOMENT: Duration = Duration::from_millis(40);
/// Between two fields.
const FIELD: Duration = Duration::from_secs(1);

/// Moments that may wait for whoever draws them.
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
    /// Where the arm is, and what it feels.
    Moment {
        /// Joint positions, n_joints, rad or m.
        q: Vec<f64>,
        /// What the arm displaces.
        contacts: Contacts,
        /// τ_ext and τ̂, n_joints, N·m, once the touch has its tare.
        torques: Option<(DVector<f64>, DVector<f64>)>,
    },
    /// The field as it is.
    Field(Box<Field>),
}

/// Picks what is drawn.
pub(crate) struct Picker {
    to: Arc<Inbox<ViewFrame>>,
    began: Instant,
    samples: u64,
    moment: Option<Instant>,
    field: Option<Instant>,
}

impl Picker {
    pub(crate) fn new(to: Arc<Inbox<ViewFrame>>) -> Self {
        Self { to, began: Instant::now(), samples: 0, moment: None, field: None }
    }

    /// Looks at a sample that came at `at`, and what the session made of it.
    pub(crate) fn sample(
        &mut self,
        (sample, at): (&Sample, Instant),
        (told, state, mapper): (&StepOutcome, State, &Mapper),
    ) {
        let number = self.samples;
        self.samples += 1;
        let say = |what| {
            let since = at.saturating_duration_since(self.began);
            self.to.push(ViewFrame { sample: number, since, what });
        };
        if told.begins {
            say(What::Touch);
        }
        if due(&mut self.moment, MOMENT, at) {
            // Where nothing is mapped, the contacts are those of a touch that is over.
            let contacts =
                if state == State::Waiting { Contacts::default() } else { mapper.contacts() };
            let (q, torques) = (sample.q.clone(), told.torques.clone());
            say(What::Moment { q, contacts, torques });
        }
        if state == State::Mapping && due(&mut self.field, FIELD, at) {
            say(What::Field(Box::new(mapper.field())));
        }
    }
}

/// Whether something is due that was last done then; it then is done now.
fn due(last: &mut Option<Instant>, every: Duration, now: Instant) -> bool {
    let due = last.is_none_or(|last| now.saturating_duration_since(last) >= every);
    if due {
        *last = Some(now);
    }
    due
}
