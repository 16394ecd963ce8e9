//! Why the guard's flag is up, with messages for the user.

use std::fmt;

/// Why the flag is up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum Cause {
    #[error("palpate has ended")]
    Ended,
    #[error("{of} external torque of joint `{joint}` is {torque_n_m:.2} N·m")]
    Limit { joint: String, torque_n_m: f64, of: TorqueSource },
    #[error("no usable joint state arrives; the last one was refused: {0}")]
    Refused(String),
    #[error("no joint state comes")]
    Silence,
    #[error("the mapper does not keep up with the joint states")]
    Lag,
    #[error("palpate did not run for a while; is the computer too busy?")]
    Stalled,
    #[error(
        "the arm stands still but is loaded: the torque of joint `{joint}` differs from gravity by \
         {bias_n_m:.2} N·m, more than {limit_n_m:.2} (--guard-bias)"
    )]
    Loaded { joint: String, bias_n_m: f64, limit_n_m: f64 },
    #[error(
        "the arm stands still, and the torque of joint `{joint}` differs by {change_n_m:.2} N·m from the tare of \
         the free arm, more than half the limit: is the arm loaded? If it touches nothing, call /palpate/tare"
    )]
    TareChanged { joint: String, change_n_m: f64 },
    #[error("sign or gravity of the torques seems to be set wrong: {0}")]
    Misread(String),
    #[error("the joint positions jump back and forth: do two drivers publish them?")]
    Jumping,
    #[error("no tare is known yet: the arm must stand still and touch nothing")]
    Untared,
}

/// Which torque exceeds the limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TorqueSource {
    /// The measured torque.
    Measured,
    /// The predicted torque.
    Predicted,
    /// The outer end of the band around the predicted torque.
    Band,
}

impl fmt::Display for TorqueSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Measured => "the measured",
            Self::Predicted => "the predicted",
            Self::Band => "the outer end of the band around the predicted",
        })
    }
}
