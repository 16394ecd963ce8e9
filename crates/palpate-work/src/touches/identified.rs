//! External torques of an identified arm, each with a standard deviation, in place of the measured torques. A touch is
//! read as a whole, since speeds are computed from the samples before and after.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, Differentiation, ExternalTorqueConfig, Sample, TorqueModel, external_torques};
use palpate_io::input;
use palpate_io::log::LogEvent;

use super::{CURRENTS, IfUndecided, TouchEvent, Touches, bytes_of, is_of_currents};
use crate::arm_file;
use crate::conventions::KnownConvention;
use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::Settings;
use crate::settings::sections::TouchSettings;

/// Turns the measured torques of an identified arm into external torques.
pub(super) struct ExternalReader {
    arm: Arc<Arm>,
    model: TorqueModel,
    differentiation: Differentiation,
    torques: ExternalTorqueConfig,
    /// Events of the present touch that were not handed on yet.
    ready: VecDeque<TouchEvent>,
}

impl Touches {
    /// Completes the torque convention in the settings from the logs. If the settings name an identified arm, the
    /// torques become external torques.
    ///
    /// # Errors
    ///
    /// If the torque convention is refused, or the arm's file cannot be read or belongs to another robot.
    pub fn prepare_torques(
        &mut self,
        arm: &Arc<Arm>,
        settings: &mut Settings,
        if_undecided: IfUndecided,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        let Some(model) = arm_file::of(&settings.robot, &arm.robot)? else {
            self.refuse_currents()?;
            let arm = (&**arm, KnownConvention::default());
            return self.conventions(arm, &mut settings.touch, if_undecided, progress);
        };
        self.decide_convention(arm, Some((model, Differentiation::Centred)), settings, progress)
    }

    /// Finds sign and gravity of the logged torques and writes them into the settings. With a model, the torques become
    /// external torques; without, for an arm that is to be identified, they stay as logged.
    ///
    /// # Errors
    ///
    /// If the data do not decide the convention, if something looks wrong and the settings are `strict`, or if the
    /// model belongs to another arm.
    pub fn decide_convention(
        &mut self,
        arm: &Arc<Arm>,
        model: Option<(TorqueModel, Differentiation)>,
        settings: &mut Settings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        // To identify an arm, or to use an identified one, needs torques with gravity.
        let needs_gravity = model.is_none() || settings.robot.arm.is_some();
        if let Some(path) = needs_gravity.then(|| self.read_measured()).transpose()?.flatten() {
            progress.note(&format!(
                "`{}`: the measured torques are read, which contain gravity, not the external ones",
                path.display()
            ));
        }
        let known = model.as_ref().map(|(model, _)| model);
        self.currents |= known.is_some_and(TorqueModel::is_of_currents);
        let of_arm = arm_file::convention(&settings.robot, &arm.robot)?;
        let if_undecided = match known {
            Some(_) => IfUndecided::Refuse,
            None => IfUndecided::TakeForCurrents,
        };
        self.conventions((&**arm, of_arm), &mut settings.touch, if_undecided, progress)?;
        self.check_as_logged(arm, known, settings, progress)?;
        model.map_or(Ok(()), |(model, differentiation)| {
            self.use_arm_model(arm, model, differentiation, &settings.touch)
        })
    }

    /// Reads measured torques, which contain gravity, in place of external ones, if every log of external torques
    /// holds both; returns the path of the first such log. No touch may have been read before.
    ///
    /// # Errors
    ///
    /// If a log cannot be opened again.
    pub fn read_measured(&mut self) -> Result<Option<PathBuf>, WorkError> {
        Ok(self.logs.read_measured()?)
    }

    /// Refuses logs of motor currents, since their gains are unknown.
    ///
    /// # Errors
    ///
    /// If the columns of any log are motor currents.
    pub fn refuse_currents(&self) -> Result<(), WorkError> {
        let Some((path, _)) = self.logs.all().find(is_of_currents) else { return Ok(()) };
        Err(WorkError::Usage(format!("`{}`: {}", path.display(), CURRENTS.join("; "))))
    }

    /// Turns the torques into external torques with the model of an arm; `touch` is the convention in which they are
    /// logged.
    ///
    /// # Errors
    ///
    /// If the columns of a log are motor currents, and the model was identified on torques, or not at all.
    pub fn use_arm_model(
        &mut self,
        arm: &Arc<Arm>,
        model: TorqueModel,
        differentiation: Differentiation,
        touch: &TouchSettings,
    ) -> Result<(), WorkError> {
        if !model.is_of_currents() {
            self.refuse_currents()?;
        }
        let torques = touch.over_config(&ExternalTorqueConfig::default());
        let (arm, ready) = (Arc::clone(arm), VecDeque::new());
        self.identified = Some(ExternalReader { arm, model, differentiation, torques, ready });
        Ok(())
    }

    /// The next event of the logs, with external torques if the arm was identified.
    pub(super) fn read_external(&mut self) -> Result<Option<TouchEvent>, WorkError> {
        let Some(identified) = &mut self.identified else { return self.read_on() };
        if let Some(event) = identified.ready.pop_front() {
            return Ok(Some(event));
        }
        let event = self.read_on()?;
        let (mut samples, mut bytes): (Vec<Sample>, usize) = (Vec::new(), 0);
        while matches!(self.logs.look_ahead(1).next(), Some(LogEvent::Sample(_))) {
            if let Some(TouchEvent::Sample(sample)) = self.read_on()? {
                // With the standard deviations that are added below.
                bytes += bytes_of(&sample) + 8 * sample.q.len();
                if bytes as u64 > input::largest() {
                    let (log, (touch, _)) = (self.log().display(), &self.read);
                    let too_large = input::too_large();
                    return Err(format!(
                        "`{log}`: touch `{touch}`: with an identified arm, this touch needs {too_large}"
                    )
                    .into());
                }
                samples.push(sample);
            }
        }
        let Some(ExternalReader { arm, model, differentiation, torques, .. }) = &self.identified
        else {
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
        let found = external_torques(&arm.robot, model, torques, &samples, *differentiation)
            .map_err(|error| {
                WorkError::touch(self.log(), format!("touch `{}`", self.read.0), error)
            })?;
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
