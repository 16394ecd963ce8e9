//! The constant part of a recording: the arm's links, and the text beside them.

use palpate::{Arm, Lattice};
use palpate_view::Scene;

use crate::hull::Hulls;

/// The arm and the text of a recording with this name, without clock and torques.
pub(crate) fn scene(
    (arm, hulls): (&Arm, &Hulls),
    lattice: &Lattice,
    name: String,
    about: String,
) -> Scene {
    Scene {
        name,
        about,
        links: hulls.hulls.clone(),
        world_from_link: Vec::new(),
        joints: arm.robot.joint_names().map(str::to_owned).collect(),
        lattice: lattice.clone(),
        clock: false,
        torques: false,
    }
}

/// The explanation of a recording, in Markdown: what is `shown`, and, if torques are shown, what
/// the `expected` ones are.
pub(crate) fn about(shown: &str, arm: &Arm, lattice: &Lattice, expected: Option<&str>) -> String {
    let robot = arm.robot.name();
    let spacing_mm = 1e3 * lattice.spacing_m();
    let mut text = format!(
        "{shown}; robot `{robot}`.\n\nBalls are cells of {spacing_mm:.1} mm that the arm has \
         touched, by stiffness. Torque says how hard, hardly where: no value of a single cell is \
         a property of the material.\n"
    );
    if let Some(expected) = expected {
        text += &format!(
            "\nArrows go from where a touched point is at rest to where the arm has pushed \
             it, true to length; of more than 300, 300 are drawn.\n\nCurves, N·m: **grey** is \
             the measured external torque, without gravity and tare; **blue** what {expected}; \
             **red** the norm of the difference. Predicting zero would be wrong by the grey \
             norm.\n"
        );
    }
    text
}
