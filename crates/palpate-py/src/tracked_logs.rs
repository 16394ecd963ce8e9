//! Cache of the touches of the last evaluation, with their contacts, for the next evaluation of the same log.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::Arm;
use palpate_learn::tracked::{TouchSamples, TrackedTouches};
use palpate_work::WorkError;
use palpate_work::evaluate::{self, configs, fault, track};
use palpate_work::settings::Settings;
use palpate_work::settings::sections::TouchSettings;
use palpate_work::touches::{IfUndecided, RecordedTouch};
use serde_json::json;

use crate::log::{Source, opened};
use crate::watch::{Message, Watch};

/// Touches of an evaluation, with their contacts.
pub(crate) struct TrackedLogs {
    /// Everything that they depend on, as JSON.
    key: String,
    /// The touches as recorded.
    pub(crate) recorded: Vec<RecordedTouch>,
    /// The touches as evaluated.
    pub(crate) touches: Vec<TouchSamples>,
    /// The touches with their contacts, with the settings of `map`.
    tracked: Arc<TrackedTouches>,
    /// Sign, gravity and tare of the torques, as found in the logs.
    touch: TouchSettings,
    /// The notes and warnings about the logs.
    messages: Vec<Message>,
}

/// The touches of the last call with a name (`reuse`). Only one is kept, since contacts can take much memory.
static LAST: Mutex<Option<Arc<TrackedLogs>>> = Mutex::new(None);

impl TrackedLogs {
    /// The touches with their contacts.
    pub(crate) fn tracked(&self) -> Arc<TrackedTouches> {
        Arc::clone(&self.tracked)
    }

    /// Reads logs as the command does and computes contacts; or returns those of the last call, if the name `named` and
    /// all settings that matter are the same.
    pub(crate) fn of(
        sources: Vec<Source>,
        settings: &mut Settings,
        arm: &Arc<Arm>,
        (truth, named): (bool, Option<&str>),
        progress: &Watch,
    ) -> Result<Arc<Self>, WorkError> {
        let config = settings.config()?;
        let (place, touch) = ((&config.lattice, &config.contact), &settings.touch);
        let key = json!([named, truth, settings.log, settings.robot, touch, place]).to_string();
        let is_same = |last: &Arc<Self>| named.is_some() && last.key == key;
        let kept = {
            let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
            *last = last.take().filter(is_same); // frees its memory before new touches are read
            last.clone()
        };
        if let Some(logs) = kept {
            settings.touch.clone_from(&logs.touch);
            logs.messages.iter().for_each(|message| progress.push(message.clone()));
            return Ok(logs);
        }
        let mut touches = opened(sources, &settings.log)?;
        touches.angle_unit(arm, settings, progress)?;
        touches.prepare_torques(arm, settings, IfUndecided::Refuse, progress)?;
        let (recorded, touches) = evaluate::read(touches, (arm, settings), truth, progress)?;
        let tracked = track(arm, &configs(settings)?[0], &touches, progress)
            .map_err(|error| fault(&recorded, error, String::new()))?;
        let (touch, messages) = (settings.touch.clone(), progress.messages());
        let tracked = Arc::new(tracked);
        let logs = Arc::new(Self { key, recorded, touches, tracked, touch, messages });
        if named.is_some() {
            *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&logs));
        }
        Ok(logs)
    }
}
