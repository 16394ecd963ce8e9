//! The figures of one touch: its start, tare, noise, push and end.

use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::Tracker;
use palpate::{
    Arm, ContactConfig, ExternalTorqueConfig, Gravity, Lattice, MIN_TARE_FRAMES, Robot, Sample,
    SettingError, Tare, TrackerError,
};
use serde::Serialize;

use super::reading::Fit;
use super::record::{Touch, farthest};
use crate::quantile::{extremes, quantile};

/// The arm is back where it began within this, rad or m.
const BACK: f64 = 0.05;
/// Fewest and most frames at the end whose mean torque is looked at.
const END_FRAMES: [usize; 2] = [5, 20];

/// Torques that change less from frame to frame do not change, N·m.
pub(super) const NO_NOISE: f64 = 1e-6;

/// What one touch holds.
#[derive(Debug, Clone, Serialize)]
pub(super) struct TouchFacts {
    pub name: String,
    pub frames: usize,
    pub duration_s: Option<f64>,
    /// Frames from the first on in which the arm is still, or touches no point.
    pub start_frames: usize,
    /// Frames in which it stands still, of those.
    #[serde(skip)]
    pub still_frames: usize,
    /// Mean torque of the tare frames, gravity taken off, N·m; `None` without any.
    pub tare: Option<Vec<f64>>,
    /// Standard deviation over the start, gravity taken off, N·m; `None` if it is too short.
    pub noise_std: Option<Vec<f64>>,
    /// Whether the torque of each joint stands still with the arm; `None` if it never does.
    #[serde(skip)]
    pub silent: Option<Vec<bool>>,
    /// The largest external torque after the start, over all joints, N·m.
    pub peak_external: f64,
    /// The same at each joint, N·m.
    pub peak_by_joint: Vec<f64>,
    /// From where to where each joint moves, rad or m.
    pub range: Vec<[f64; 2]>,
    /// Mean external torque at the end, N·m, if the arm is back where it began.
    pub end_external: Option<Vec<f64>>,
    /// Work that the external torque does on the arm from the start to its peak, J.
    pub work_until_peak_j: f64,
}

/// Finds the figures of touches, one after another.
pub(super) struct Figures {
    tracker: Tracker,
    arm: Arc<Arm>,
    fit: Fit,
    tare: Tare,
    still_rad: f64,
}

impl Figures {
    /// For logs of an arm, read under a convention.
    pub(super) fn new(
        arm: &Arc<Arm>,
        set: &ExternalTorqueConfig,
        fit: Fit,
    ) -> Result<Self, SettingError> {
        // The start does not depend on torques.
        let mut config = set.clone();
        (config.gravity, config.tare) = (Gravity::Removed, Tare::Auto);
        let (lattice, contact) = (Lattice::default(), ContactConfig::default());
        let tracker = Tracker::new(Arc::clone(arm), lattice, &contact, config)?;
        let (tare, still_rad) = (set.tare, set.still_rad);
        Ok(Self { tracker, arm: Arc::clone(arm), fit, tare, still_rad })
    }

    /// The figures of a touch with the robot's joints.
    pub(super) fn of(&mut self, touch: &Touch) -> TouchFacts {
        let start_frames = self.start(touch);
        let raw = without_gravity(touch, &self.arm.robot, &self.fit);
        let tare_frames = match self.tare {
            Tare::None => 0,
            Tare::Auto if start_frames < MIN_TARE_FRAMES as usize => 0,
            Tare::Auto => start_frames,
            Tare::Frames(frames) => (frames as usize).min(touch.frames()),
        };
        let tare = (tare_frames > 0).then(|| super::mean(&raw[..tare_frames]));
        let external: Vec<Vec<f64>> =
            raw.iter().map(|raw| minus(raw, tare.as_deref().unwrap_or(&[]))).collect();
        let push = start_frames.max(tare_frames).min(touch.frames());
        let n = touch.n_joints();
        let at_joint = |joint: usize| external[push..].iter().map(move |row| row[joint].abs());
        let norms: Vec<f64> = external[push..].iter().map(|row| norm(row)).collect();
        let peak = norms.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let (at, peak_external) = peak.map_or((0, 0.0), |(at, &peak)| (push + at, peak));
        let column = |joint: usize| extremes(touch.q.iter().map(|q| q[joint])).unwrap_or_default();
        let still_frames = touch.still_frames(self.still_rad);
        let noise = still_frames.min(start_frames) >= MIN_TARE_FRAMES as usize;
        TouchFacts {
            name: touch.name.clone(),
            frames: touch.frames(),
            duration_s: extremes(touch.times_s.iter().copied()).map(|[first, last]| last - first),
            start_frames,
            still_frames,
            noise_std: noise.then(|| std_of(&raw[..start_frames])),
            silent: noise.then(|| silent(&raw[..still_frames], &touch.tau[..still_frames])),
            peak_external,
            peak_by_joint: (0..n).map(|joint| at_joint(joint).fold(0.0, f64::max)).collect(),
            range: (0..n).map(column).collect(),
            end_external: end(touch, push).map(|first| super::mean(&external[first..])),
            work_until_peak_j: work(touch, &external, push, at),
            tare,
        }
    }

    /// How many frames the touch begins without contact, as the mapper sees it.
    fn start(&mut self, touch: &Touch) -> usize {
        self.tracker.begin_touch();
        for (frame, (q, tau)) in touch.q.iter().zip(&touch.tau).enumerate() {
            let sample = Sample::new(None, q.clone(), tau.clone());
            match self.tracker.feed(&sample) {
                Ok(step) if step.external.is_none() => {}
                Err(TrackerError::NoContactFreeStart { found, .. }) => return found as usize,
                _ => return frame,
            }
        }
        touch.frames()
    }
}

/// The logged torques in the sign of external ones, less gravity.
fn without_gravity(touch: &Touch, robot: &Robot, fit: &Fit) -> Vec<Vec<f64>> {
    let raw = touch.q.iter().zip(&touch.tau).map(|(q, tau)| {
        let mut raw = DVector::from_column_slice(tau) * super::sign(fit.torque_sign);
        if fit.gravity == Gravity::Included
            && let Ok(poses) = robot.forward(q)
        {
            raw -= robot.gravity_torque(&poses);
        }
        raw.iter().copied().collect()
    });
    raw.collect()
}

/// The first of the last frames, if in all of them the arm is back where it began.
fn end(touch: &Touch, push: usize) -> Option<usize> {
    let start = touch.q.first()?;
    let [fewest, most] = END_FRAMES;
    let back = touch.q[push..].iter().rev().take_while(|q| farthest(q, start) <= BACK).count();
    let frames = back.min(most);
    (frames >= fewest && push + back < touch.frames()).then(|| touch.frames() - frames)
}

/// `Σ τ·Δq` between two frames: what the object gives to the arm.
fn work(touch: &Touch, external: &[Vec<f64>], from: usize, to: usize) -> f64 {
    let power = |row: usize| {
        let joints = touch.q[row].iter().zip(&touch.q[row - 1]).zip(&external[row]);
        joints.map(|((now, before), tau)| tau * (now - before)).sum::<f64>()
    };
    (from.max(1)..=to).filter(|row| *row < touch.frames()).map(power).sum()
}

fn minus(row: &[f64], tare: &[f64]) -> Vec<f64> {
    row.iter().enumerate().map(|(j, tau)| tau - tare.get(j).unwrap_or(&0.0)).collect()
}

fn norm(row: &[f64]) -> f64 {
    row.iter().map(|tau| tau * tau).sum::<f64>().sqrt()
}

/// Whether hardly any frame differs from the one before, at each joint, with or without gravity.
fn silent(raw: &[Vec<f64>], logged: &[Vec<f64>]) -> Vec<bool> {
    let step = |rows: &[Vec<f64>], joint: usize| {
        let steps = rows.windows(2).map(|pair| (pair[1][joint] - pair[0][joint]).abs());
        quantile(&steps.collect::<Vec<_>>(), 0.8).unwrap_or(0.0)
    };
    let joints = 0..raw.first().map_or(0, Vec::len);
    joints.map(|joint| step(raw, joint).min(step(logged, joint)) < NO_NOISE).collect()
}

/// Standard deviation of each column.
fn std_of(rows: &[Vec<f64>]) -> Vec<f64> {
    let mean = super::mean(rows);
    let deviation = |(joint, mean): (usize, &f64)| {
        let squares: f64 = rows.iter().map(|row| (row[joint] - mean).powi(2)).sum();
        (squares / (rows.len() - 1) as f64).sqrt()
    };
    mean.iter().enumerate().map(deviation).collect()
}
