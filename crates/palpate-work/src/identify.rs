//! Identifying an arm from logs of it in free motion.

use palpate::unstable::LinkId;
use palpate::{Arm, ExternalTorqueConfig, Robot, Sample};
use palpate_learn::identify::{IdentifiedArm, IdentifyConfig, IdentifyError, identify};

use crate::error::WorkError;
use crate::progress::Progress;
use crate::touches::RecordedTouch;

/// What to identify.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct IdentifySettings {
    /// The link in whose frame the payload is given; `None` for the link that the last joint
    /// carries.
    pub tool_link: Option<String>,
    /// Whether the logged torques are motor currents.
    pub currents: bool,
    /// Whether it is an error if the identified arm does not fit the held-out motion.
    pub strict: bool,
}

/// The result as JSON, without the model of the arm, which [`crate::arm_file`] writes.
pub fn json(found: &IdentifiedArm) -> serde_json::Value {
    serde_json::json!({
        "payload": found.payload, "joints": found.joints, "bodies": found.bodies,
        "base_parameters": found.base_parameters,
        "base_parameters_identified": found.base_parameters_identified,
        "delay_s": found.delay_s, "touched": found.touched, "read_times": found.read_times,
        "held_out": found.held_out, "misfit": found.misfit, "notes": found.notes,
    })
}

/// Identifies an arm, and warns if it does not fit the held-out motion.
///
/// # Errors
///
/// If no joint moves the link of the payload, the logs cannot be used, the arm does not fit the
/// held-out motion and the settings are `strict`, or on being stopped.
pub fn run(
    arm: &Arm,
    touches: &[RecordedTouch],
    torques: &ExternalTorqueConfig,
    settings: &IdentifySettings,
    progress: &dyn Progress,
) -> Result<IdentifiedArm, WorkError> {
    let robot = &arm.robot;
    let payload_link = match &settings.tool_link {
        Some(name) => {
            robot.link_id(name).filter(|link| robot.body_of(*link).is_some()).ok_or_else(|| {
                let known = moved_links(robot).join(", ");
                WorkError::Usage(format!(
                    "no joint moves a link `{name}` (--tool-link); there are {known}"
                ))
            })?
        }
        None => robot.bodies().last().expect("a robot has moving joints"),
    };
    let samples: Vec<&[Sample]> = touches.iter().map(|touch| &touch.samples[..]).collect();
    let config = IdentifyConfig { payload_link, currents: settings.currents };
    let bar = progress.begin(None, "models", "identifying");
    let found =
        identify(robot, &samples, torques, &config, (&|| progress.stopped(), &|| bar.step()));
    drop(bar);
    let found = found.map_err(|error| {
        if matches!(error, IdentifyError::Stopped) {
            return WorkError::Interrupted { kept: "; nothing was written".to_owned() };
        }
        let mut logs: Vec<String> =
            touches.iter().map(|touch| format!("`{}`", touch.log.display())).collect();
        logs.dedup();
        WorkError::Usage(format!("{}: {error}", logs.join(", ")))
    })?;
    match &found.misfit {
        Some(what) if settings.strict => {
            return Err(WorkError::LooksWrong(format!("{what} (--strict)")));
        }
        Some(what) => progress.warn(what),
        None => {}
    }
    Ok(found)
}

fn moved_links(robot: &Robot) -> Vec<&str> {
    let moved = |(index, _): &(usize, _)| robot.body_of(LinkId(*index as u16)).is_some();
    robot.links().iter().enumerate().filter(moved).map(|(_, link)| link.name.as_str()).collect()
}
