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
         touched; colour and size show their stiffness. Torques determine the stiffness of a \
         region, but hardly that of each cell in it: the value of a single cell is not a property \
         of the material.\n"
    );
    if let Some(expected) = expected {
        text += &format!(
            "\nArrows go from the rest position of a touched point to where the arm has pushed \
             it, to scale; at most 300 are drawn.\n\nCurves, N·m: **grey** is the measured \
             external torque, without gravity and tare; **blue** {expected}; **red** the norm of \
             the difference. The grey norm is also the error of predicting zero.\n"
        );
    }
    text
}
