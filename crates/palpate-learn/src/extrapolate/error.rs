//! Errors of the extrapolation.

/// Why stiffness could not be extrapolated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ExtrapolateError {
    /// A setting out of its range.
    #[error("`{setting}` is {found}; it must be {wanted}")]
    Setting { setting: &'static str, found: f64, wanted: &'static str },
    /// A cloud without points.
    #[error("the cloud holds no point")]
    NothingSeen,
    /// A field without touched cells.
    #[error("the field holds no touched cell: there is no stiffness to extrapolate")]
    NothingTouched,
    /// The cloud is far from the touched cells.
    #[error(
        "the cloud and the touched cells are {gap_m:.3} m apart (along x, y, z by \
         {apart_m:.3?}): the cloud spans {cloud} m, the cells {field} m; is the cloud in the frame \
         of the robot's base, in metres, and is it the object that was touched?"
    )]
    Apart { gap_m: f64, apart_m: [f64; 3], cloud: String, field: String },
    /// No touched cell is near a point of the cloud.
    #[error(
        "no touched cell lies at a point of the cloud: the nearest is {gap_m:.3} m away, further \
         than {reach_m:.3} m; touch what the camera sees, or increase the reach"
    )]
    NoneTouched { gap_m: f64, reach_m: f64 },
    /// The method `torque` without remembered touches.
    #[error(
        "the method `torque` learns from torques, but the field remembers no touch; use \
         `cells` or `knn`, or a field that was saved with its memory"
    )]
    NoTorques,
}
