//! The prediction along a path.

use std::sync::Arc;

use nalgebra::DVector;

use crate::calibration::Calibration;

/// The prediction at one point of a path.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct PathPoint {
    /// τ̂: external torque, n_joints, N·m.
    pub torque: DVector<f64>,
    /// Standard deviation of τ̂, n_joints, N·m; use it to rank paths, not as a bound on the error.
    pub torque_std: DVector<f64>,
    /// Root of the sum of squares of the springs' torques, n_joints, N·m.
    pub torque_rss: DVector<f64>,
    /// Number of touched points of the lattice.
    pub contacts: usize,
    /// Number of these points that were touched when the field was learnt.
    pub known: usize,
}

/// The prediction along a path.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PathPrediction {
    /// One for each point of the path.
    pub points: Vec<PathPoint>,
    /// Whether the path continued from the arm's contacts, rather than free of contact.
    pub goes_on: bool,
    /// Number of stops; torques at the other points are interpolated.
    pub stops: usize,
    /// Calibration of the prediction bands, if the field has one.
    pub calibration: Option<Arc<Calibration>>,
}

/// Computes a half-width from level, torque, spread and contacts.
type HalfWidth = fn(&Calibration, f64, &[f64], &[f64], [usize; 2]) -> Option<DVector<f64>>;

impl PathPrediction {
    /// Half-widths of the bands at a level, n_joints for each point, N·m; `None` if the field is not calibrated, or not
    /// up to that level.
    pub fn half_width(&self, level: f64) -> Option<Vec<DVector<f64>>> {
        self.half_widths(level, Calibration::half_width)
    }

    /// Half-widths of the bands for the largest torque of the path ([`Calibration::peak_half_width`]), n_joints for
    /// each point, N·m.
    pub fn peak_half_width(&self, level: f64) -> Option<Vec<DVector<f64>>> {
        self.half_widths(level, Calibration::peak_half_width)
    }

    fn half_widths(&self, level: f64, of: HalfWidth) -> Option<Vec<DVector<f64>>> {
        let calibration = self.calibration.as_ref()?;
        let at = |point: &PathPoint| {
            let contacts = [point.contacts, point.known];
            let spread = calibration.spread(&point.torque_std, &point.torque_rss);
            of(calibration, level, point.torque.as_slice(), spread.as_slice(), contacts)
        };
        self.points.iter().map(at).collect()
    }
}
