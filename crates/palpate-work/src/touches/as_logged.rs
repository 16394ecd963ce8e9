//! Checks of logs before their torques become external torques, since these defects are not visible afterwards.

use std::borrow::Cow;

use palpate::{Arm, ExternalTorqueConfig, Gravity, Sample, TorqueModel};

use super::Touches;
use super::conventions_of_logs::{AHEAD, touches_of};
use crate::conventions::KnownConvention;
use crate::error::WorkError;
use crate::inspect::log::{looks_wrong_as_logged, warn_of};
use crate::progress::Progress;
use crate::settings::Settings;

/// Codes of findings that wrong masses in the URDF can cause.
const OF_MASSES: [&str; 2] = ["payload", "gravity_misfit"];

impl Touches {
    /// Warns of what looks wrong with the first samples of each log, before their torques become external torques.
    /// `model` is the model of the identified arm; without it, the arm is still to be identified and its payload is
    /// unknown.
    ///
    /// # Errors
    ///
    /// If something looks wrong and the settings are `strict`, or the model belongs to another arm.
    pub(super) fn check_as_logged(
        &mut self,
        arm: &Arm,
        model: Option<&TorqueModel>,
        settings: &Settings,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        if model.is_none() && self.are_currents() {
            return Ok(());
        }
        let mut robot = Cow::Borrowed(&arm.robot);
        if let Some(model) = model {
            let masses = model.check(&arm.robot).map_err(WorkError::Usage)?;
            robot = Cow::Owned(arm.robot.clone().with_inertial_parameters(&masses));
        }
        let strict = settings.log.strict.unwrap_or_default();
        let has_arm = settings.robot.arm.is_some();
        let given = KnownConvention {
            torque_sign: settings.touch.torque_sign_given(),
            gravity: settings.touch.gravity_given(),
        };
        if has_arm && given.gravity == Some(Gravity::Removed) {
            let message = format!(
                "`{}`: these torques contain no gravity, and --arm was identified on torques that do: only its \
                 standard deviations are used, and they may be too small; give the measured torques",
                self.first_path()
            );
            if strict {
                return Err(WorkError::LooksWrong(format!("{message} (--strict)")));
            }
            progress.warn(&message);
        }
        let set = settings.touch.over_config(&ExternalTorqueConfig::default());
        let _ = self.logs.look_ahead(AHEAD);
        for (log, (path, _)) in self.logs.all().enumerate() {
            let Some(mut touches) = touches_of(self.logs.ahead_of(log), &robot) else { continue };
            for sample in touches.iter_mut().flat_map(|touch| &mut touch.samples) {
                let joints = model.iter().flat_map(|model| &model.joints);
                sample.tau.iter_mut().zip(joints).for_each(|(tau, joint)| *tau /= joint.gain);
            }
            if touches.iter().flat_map(|touch| &touch.samples).all(is_without_torque) {
                continue; // there is another warning for it
            }
            let given = (&set, given);
            let mut found = looks_wrong_as_logged(&mut touches, &robot, given, self.checked.0);
            found.retain(|finding| !self.reported.contains(finding.code));
            // Undecided conventions were reported before; an arm to be identified has no known masses yet.
            found.retain(|finding| finding.code != "undecided");
            found.retain(|finding| model.is_some() || !OF_MASSES.contains(&finding.code));
            for payload in found.iter_mut().filter(|one| has_arm && one.code == "payload") {
                payload.flags.clear();
                payload.what +=
                    "; the arm carries something else than when it was identified (--arm)";
            }
            self.reported.extend(found.iter().map(|finding| finding.code));
            warn_of(&found, &format!("`{}`", path.display()), strict, progress)?;
        }
        Ok(())
    }
}

fn is_without_torque(sample: &Sample) -> bool {
    sample.tau.iter().all(|tau| *tau == 0.0)
}
