//! Touches that were read and followed for one evaluation, and serve the next of the same log.

use std::sync::{Arc, Mutex, PoisonError};

use palpate::Arm;
use palpate_learn::tracked::{Touch, Tracked};
use palpate_work::WorkError;
use palpate_work::evaluate::{self, configs, fault, follow};
use palpate_work::settings::Settings;
use palpate_work::settings::sections::TouchSettings;
use palpate_work::touches::{IfUndecided, RecordedTouch};
use serde_json::json;

use crate::log::{Source, opened};
use crate::watch::{Message, Watch};

/// Touches as an evaluation has them.
pub(crate) struct Followed {
    /// What they follow from.
    key: String,
    /// As they are recorded.
    pub(crate) recorded: Vec<RecordedTouch>,
    /// As they are evaluated.
    pub(crate) touches: Vec<Touch>,
    /// With their contacts under the settings of `map`.
    tracked: Arc<Tracked>,
    /// What the logs' torques were found to mean.
    touch: TouchSettings,
    /// The notes and warnings about the logs.
    messages: Vec<Message>,
}

/// Those of the last call that named its logs. One log at a time: its contacts can take much memory.
static LAST: Mutex<Option<Arc<Followed>>> = Mutex::new(None);

impl Followed {
    /// The touches with their contacts.
    pub(crate) fn tracked(&self) -> Arc<Tracked> {
        Arc::clone(&self.tracked)
    }

    /// Reads logs as the command does, and follows them; or takes what the last call has found, if `named` says that these
    /// are the same logs and the same arm, and all settings that matter for it are the same.
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
            *last = last.take().filter(is_same); // before others take its place in memory
            last.clone()
        };
        if let Some(followed) = kept {
            settings.touch.clone_from(&followed.touch);
            followed.messages.iter().for_each(|message| progress.push(message.clone()));
            return Ok(followed);
        }
        let mut touches = opened(sources, &settings.log)?;
        touches.angle_unit(arm, settings, progress)?;
        touches.external(arm, settings, IfUndecided::Refuse, progress)?;
        let (recorded, touches) = evaluate::read(touches, (arm, settings), truth, progress)?;
        let tracked = follow(arm, &configs(settings)?[0], &touches, progress)
            .map_err(|error| fault(&recorded, error, String::new()))?;
        let (touch, messages) = (settings.touch.clone(), progress.messages());
        let tracked = Arc::new(tracked);
        let followed = Arc::new(Self { key, recorded, touches, tracked, touch, messages });
        if named.is_some() {
            *LAST.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&followed));
        }
        Ok(followed)
    }
}
