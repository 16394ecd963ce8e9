//! Torques of an arm that was identified: external torques with a standard deviation each, in place of what was
//! measured. A touch is read as a whole, for speeds are computed out of what comes before and after.

use std::collections::VecDeque;
use std::sync::Arc;

use palpate::{
    Arm, ExternalTorqueConfig, Gravity, Sample, TorqueModel, TorqueSign, external_torques,
};
use palpate_io::log::LogEvent;

use super::{IfUndecided, TouchEvent, Touches};
use crate::arm_file;
use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::OrAuto;
use crate::settings::sections::{RobotSettings, TouchSettings};

/// An arm that was identified, and how its torques are logged.
pub(super) struct Identified {
    arm: Arc<Arm>,
    model: TorqueModel,
    causal: bool,
    torques: ExternalTorqueConfig,
    /// Events of the touch under way.
    ready: VecDeque<TouchEvent>,
}

impl Touches {
    /// Takes from the logs how their torques count, and, if the settings name an identified arm, makes them external
    /// ones; the settings say so then.
    ///
    /// # Errors
    ///
    /// As [`Touches::conventions`]; or if the arm's file cannot be read, or is of another robot.
    pub fn external(
        &mut self,
        arm: &Arc<Arm>,
        (robot, touch): (&RobotSettings, &mut TouchSettings),
        if_undecided: IfUndecided,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let Some(path) = &robot.arm else {
            return self.conventions(arm, touch, if_undecided, progress);
        };
        let model = arm_file::read(path, &arm.robot)?;
        self.conventions(arm, touch, IfUndecided::Refuse, progress)?;
        self.identified(arm, model, false, touch);
        Ok(())
    }

    /// Makes the torques external ones, as far as a model knows the arm; the settings say so then. Speeds are computed
    /// out of what lies around each sample, or, with `causal`, before it.
    pub fn identified(
        &mut self,
        arm: &Arc<Arm>,
        model: TorqueModel,
        causal: bool,
        touch: &mut TouchSettings,
    ) {
        let torques = touch.over_config(&ExternalTorqueConfig::default());
        let model = if causal { model.causal() } else { model };
        let (arm, ready) = (Arc::clone(arm), VecDeque::new());
        self.identified = Some(Identified { arm, model, causal, torques, ready });
        touch.torque_sign = Some(OrAuto::Is(TorqueSign::Plus));
        touch.gravity = Some(OrAuto::Is(Gravity::Removed));
    }

    /// What the logs say next, with external torques if the arm was identified.
    pub(super) fn read_external(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        let Some(identified) = &mut self.identified else { return self.read_on() };
        if let Some(event) = identified.ready.pop_front() {
            return Ok(Some(event));
        }
        let event = self.read_on()?;
        let mut samples: Vec<Sample> = Vec::new();
        while matches!(self.logs.look_ahead(1).next(), Some(LogEvent::Sample(_))) {
            if let Some(TouchEvent::Sample(sample)) = self.read_on()? {
                samples.push(sample);
            }
        }
        let Some(Identified { arm, model, causal, torques, .. }) = &self.identified else {
            unreachable!("it was there above")
        };
        for (number, sample) in samples.iter().enumerate() {
            let poses = arm.robot.forward(&sample.q).map_err(palpate::TrackerError::from);
            let fault = poses.and_then(|poses| torques.untared(&arm.robot, &poses, &sample.tau));
            if let Err(fault) = fault {
                let place = format!("touch `{}`, sample {number} (from 0)", self.read.0);
                return Err(WorkError::touch(self.log(), place, fault));
            }
        }
        let found = external_torques(&arm.robot, model, torques, &samples, *causal)
            .map_err(|error| WorkError::touch(self.log(), self.place(), error))?;
        let events = samples.into_iter().zip(found).map(|(mut sample, found)| {
            sample.tau = found.torque.as_slice().to_vec();
            sample.tau_std = Some(found.std.as_slice().to_vec());
            TouchEvent::Sample(sample)
        });
        if let Some(identified) = &mut self.identified {
            identified.ready.extend(events);
        }
        Ok(event)
    }
}
