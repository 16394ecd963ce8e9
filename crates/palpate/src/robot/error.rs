//! What can be wrong with a robot description.

/// What can be wrong with a robot description, or with a request made of a robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RobotError {
    /// Not XML, or an element that is not valid in URDF.
    #[error("not a readable URDF: {reason}")]
    Xml { reason: String },
    /// A reference to a link or joint that is not declared.
    #[error("{user} refers to {wanted}, which the URDF does not declare")]
    Undeclared { user: String, wanted: String },
    /// A name that is used twice.
    #[error("the URDF declares {thing} twice; names must be unique")]
    Duplicate { thing: String },
    /// Links or mimic joints that form a loop.
    #[error("{things} form a loop through {through}; only trees are supported")]
    Loop { things: &'static str, through: String },
    /// A link that is the child of two joints: in closed kinematic chains, joint torques are not unique.
    #[error(
        "link `{link}` is the child of two joints, `{first}` and `{second}`; only trees are supported, \
         not closed loops"
    )]
    TwoParents { link: String, first: String, second: String },
    /// No root link, or several; the root link is the world frame.
    #[error("found {} root links ({}), wanted one that carries all other links", roots.len(), roots.join(", "))]
    Roots { roots: Vec<String> },
    /// Joints of more than one degree of freedom.
    #[error(
        "joint `{joint}` is {kind}; wanted revolute, continuous, prismatic or fixed joints only"
    )]
    JointKind { joint: String, kind: &'static str },
    /// A number out of its range.
    #[error("{thing} is {found}, wanted {wanted}")]
    Number { thing: String, found: String, wanted: &'static str },
    /// A robot without moving joints.
    #[error("none of the {joints} joints of robot `{robot}` moves, wanted at least one that does")]
    Immobile { robot: String, joints: usize },
    /// A joint vector of the wrong length.
    #[error("got {got} joint angles, the robot has {expected} moving joints")]
    JointCount { expected: usize, got: usize },
}

impl RobotError {
    pub(super) fn number(
        thing: String,
        found: impl std::fmt::Display,
        wanted: &'static str,
    ) -> Self {
        Self::Number { thing, found: format!("{found}"), wanted }
    }
}
