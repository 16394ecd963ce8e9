//! The figures of one touch: its start, tare, noise, push, contacts and end.

use std::collections::HashSet;
use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::Tracker;
use palpate::{
    Arm, CellId, ExternalTorqueConfig, Gravity, MIN_TARE_FRAMES, MapperConfig, Robot, Tare,
    TrackerError,
};
use rayon::prelude::*;
use serde::Serialize;

use super::farthest;
use super::reading::Fit;
use crate::error::WorkError;
use crate::progress::{Bar, Progress};
use crate::quantile::{extremes, quantile};
use crate::settings::SettingsError;
use crate::touched::{Touched, point};
use crate::touches::RecordedTouch;

/// The arm is back where it began within this, rad or m.
const BACK: f64 = 0.05;
/// Fewest and most frames at the end whose mean torque is looked at.
const END_FRAMES: [usize; 2] = [5, 20];

/// Torques that change less from frame to frame do not change, N·m.
pub(super) const NO_NOISE: f64 = 1e-6;

/// What one touch holds.
#[derive(Debug, Clone, Serialize)]
pub struct TouchFacts {
    /// Its name.
    pub name: String,
    /// Its frames.
    pub frames: usize,
    /// From the first to the last by the log's clock, s.
    pub duration_s: Option<f64>,
    /// Frames from the first on in which the arm is still, or touches no point.
    pub start_frames: usize,
    /// Frames in which it stands still, of those.
    #[serde(skip)]
    pub(super) still_frames: usize,
    /// Frames in which the arm touches points of the lattice.
    pub frames_in_contact: u64,
    /// Mean torque of the tare frames, gravity taken off, N·m; `None` without any.
    pub tare: Option<Vec<f64>>,
    /// Standard deviation over the start, gravity taken off, N·m; `None` if it is too short.
    pub noise_std: Option<Vec<f64>>,
    /// Whether the torque of each joint stands still with the arm; `None` if it never does.
    #[serde(skip)]
    pub(super) silent: Option<Vec<bool>>,
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

/// Finds the figures of touches.
pub(super) struct Figures {
    /// Finds the contact-free start.
    tracker: Tracker,
    /// Finds the contacts of touches without such a start as well.
    untared: Tracker,
    arm: Arc<Arm>,
    fit: Fit,
    tare: Tare,
    still_rad: f64,
}

impl Figures {
    /// For logs of an arm under a configuration, read under a convention.
    pub(super) fn new(
        arm: &Arc<Arm>,
        config: &MapperConfig,
        (set, fit): (&ExternalTorqueConfig, Fit),
    ) -> Result<Self, SettingsError> {
        let tracker = |tare| {
            // Neither the start nor contacts depend on torques.
            let mut set = set.clone();
            (set.gravity, set.tare) = (Gravity::Removed, tare);
            Tracker::new(Arc::clone(arm), config.lattice.clone(), &config.contact, set)
                .map_err(|error| SettingsError::Value(Box::new(error.into())))
        };
        let (tracker, untared) = (tracker(Tare::Auto)?, tracker(Tare::None)?);
        let (tare, still_rad) = (set.tare, set.still_rad);
        Ok(Self { tracker, untared, arm: Arc::clone(arm), fit, tare, still_rad })
    }

    /// The figures of touches with the robot's joints, what all of them touch, and how many cells.
    ///
    /// # Errors
    ///
    /// If the progress stops it.
    pub(super) fn of_all(
        &self,
        touches: &[RecordedTouch],
        progress: &dyn Progress,
    ) -> Result<(Vec<TouchFacts>, (Touched, usize)), WorkError> {
        let frames = touches.iter().map(RecordedTouch::frames).sum::<usize>();
        let bar = progress.begin(Some(frames as u64), "frames", "inspecting");
        let of = |touch: &RecordedTouch| self.of(touch, (&*bar, progress));
        let found: Vec<_> = touches.par_iter().map(of).collect::<Result<_, _>>()?;
        let (mut facts, mut touched, mut cells) = (Vec::new(), Touched::default(), HashSet::new());
        for (of_touch, contacts, touched_cells) in found {
            facts.push(of_touch);
            touched.join(&contacts);
            cells.extend(touched_cells);
        }
        Ok((facts, (touched, cells.len())))
    }

    /// The figures of a touch with the robot's joints, and what it touches.
    fn of(
        &self,
        touch: &RecordedTouch,
        watch: (&dyn Bar, &dyn Progress),
    ) -> Result<(TouchFacts, Touched, HashSet<CellId>), WorkError> {
        let start_frames = self.start(touch);
        let raw = without_gravity(touch, &self.arm.robot, &self.fit);
        let tare_frames = match self.tare {
            Tare::None => 0,
            Tare::Auto if start_frames < MIN_TARE_FRAMES as usize => 0,
            Tare::Auto => start_frames,
            Tare::Frames(frames) => (frames as usize).min(touch.frames()),
        };
        let (touched, cells) = self.touched(touch, tare_frames, watch)?;
        let tare = (tare_frames > 0).then(|| super::mean(&raw[..tare_frames], Vec::as_slice));
        let external: Vec<Vec<f64>> =
            raw.iter().map(|raw| minus(raw, tare.as_deref().unwrap_or(&[]))).collect();
        let push = start_frames.max(tare_frames).min(touch.frames());
        let n = touch.n_joints();
        let at_joint = |joint: usize| external[push..].iter().map(move |row| row[joint].abs());
        let norms: Vec<f64> = external[push..].iter().map(|row| norm(row)).collect();
        let peak = norms.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        let (at, peak_external) = peak.map_or((0, 0.0), |(at, &peak)| (push + at, peak));
        let positions = |joint: usize| touch.samples.iter().map(move |sample| sample.q[joint]);
        let still_frames = touch.still_frames(self.still_rad);
        let noise = still_frames.min(start_frames) >= MIN_TARE_FRAMES as usize;
        let facts = TouchFacts {
            name: touch.name.clone(),
            frames: touch.frames(),
            duration_s: extremes(touch.times_s()).map(|[first, last]| last - first),
            start_frames,
            still_frames,
            frames_in_contact: touched.frames_in_contact(),
            noise_std: noise.then(|| std_of(&raw[..start_frames])),
            silent: noise.then(|| silent(&raw[..still_frames], touch)),
            peak_external,
            peak_by_joint: (0..n).map(|joint| at_joint(joint).fold(0.0, f64::max)).collect(),
            range: (0..n).map(|joint| extremes(positions(joint)).unwrap_or_default()).collect(),
            end_external: end(touch, push)
                .map(|first| super::mean(&external[first..], Vec::as_slice)),
            work_until_peak_j: work(touch, &external, push, at),
            tare,
        };
        Ok((facts, touched, cells))
    }

    /// How many frames the touch begins without contact, as the mapper sees it.
    fn start(&self, touch: &RecordedTouch) -> usize {
        let mut tracker = self.tracker.clone();
        tracker.begin_touch();
        for (frame, sample) in touch.samples.iter().enumerate() {
            match tracker.feed(sample) {
                Ok(step) if step.external.is_none() => {}
                Err(TrackerError::NoContactFreeStart { found, .. }) => return found as usize,
                _ => return frame,
            }
        }
        touch.frames()
    }

    /// What the arm touches, and the cells of it after the tare, as the mapper sees it.
    fn touched(
        &self,
        touch: &RecordedTouch,
        tare_frames: usize,
        (bar, progress): (&dyn Bar, &dyn Progress),
    ) -> Result<(Touched, HashSet<CellId>), WorkError> {
        let mut tracker = self.untared.clone();
        tracker.begin_touch();
        let (mut touched, mut cells) = (Touched::default(), HashSet::new());
        for (frame, sample) in touch.samples.iter().enumerate() {
            if progress.stopped() {
                return Err(WorkError::Interrupted { kept: String::new() });
            }
            let contacts = tracker.feed(sample).map(|step| step.contacts).unwrap_or_default();
            touched.add(contacts.len());
            if frame >= tare_frames {
                cells.extend(contacts.links.iter().flat_map(|link| &link.cells));
            }
            bar.step();
        }
        Ok((touched, cells))
    }
}

/// Within what box the origin of the last link moves, m.
pub(super) fn last_link_box(touches: &[RecordedTouch], robot: &Robot) -> Option<String> {
    let link = robot.joints().last()?.child.index();
    let samples = touches.iter().flat_map(|touch| &touch.samples);
    let poses = samples.filter_map(|sample| robot.forward(&sample.q).ok());
    let places: Vec<_> =
        poses.map(|poses| poses.world_from_link[link].translation.vector).collect();
    let side = |axis: usize| extremes(places.iter().map(|place| place[axis]));
    let sides = [side(0)?, side(1)?, side(2)?];
    let [low_m, high_m] = [0, 1].map(|end| point(sides.map(|side| side[end])));
    Some(format!("the origin of `{}` moves within {low_m} .. {high_m} m", robot.links()[link].name))
}

/// The logged torques in the sign of external ones, less gravity.
fn without_gravity(touch: &RecordedTouch, robot: &Robot, fit: &Fit) -> Vec<Vec<f64>> {
    let raw = touch.samples.iter().map(|sample| {
        let mut raw = DVector::from_column_slice(&sample.tau) * super::sign(fit.torque_sign);
        if fit.gravity == Gravity::Included
            && let Ok(poses) = robot.forward(&sample.q)
        {
            raw -= robot.gravity_torque(&poses);
        }
        raw.iter().copied().collect()
    });
    raw.collect()
}

/// The first of the last frames, if in all of them the arm is back where it began.
fn end(touch: &RecordedTouch, push: usize) -> Option<usize> {
    let start = touch.samples.first()?;
    let [fewest, most] = END_FRAMES;
    let late = touch.samples[push..].iter().rev();
    let back = late.take_while(|sample| farthest(&sample.q, &start.q) <= BACK).count();
    let frames = back.min(most);
    (frames >= fewest && push + back < touch.frames()).then(|| touch.frames() - frames)
}

/// `Σ τ·Δq` between two frames: what the object gives to the arm.
fn work(touch: &RecordedTouch, external: &[Vec<f64>], from: usize, to: usize) -> f64 {
    let power = |row: usize| {
        let [before, now] = [row - 1, row].map(|row| &touch.samples[row].q);
        let joints = now.iter().zip(before).zip(&external[row]);
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
fn silent(raw: &[Vec<f64>], touch: &RecordedTouch) -> Vec<bool> {
    let logged: Vec<&Vec<f64>> = touch.samples.iter().map(|sample| &sample.tau).collect();
    let change = |steps: Vec<f64>| quantile(&steps, 0.8).unwrap_or(0.0);
    let is_silent = |joint: usize| {
        let pairs = 1..raw.len();
        let raw = pairs.clone().map(|row| (raw[row][joint] - raw[row - 1][joint]).abs());
        let logged = pairs.map(|row| (logged[row][joint] - logged[row - 1][joint]).abs());
        change(raw.collect()).min(change(logged.collect())) < NO_NOISE
    };
    (0..raw.first().map_or(0, Vec::len)).map(is_silent).collect()
}

/// Standard deviation of each column.
fn std_of(rows: &[Vec<f64>]) -> Vec<f64> {
    let mean = super::mean(rows, Vec::as_slice);
    let deviation = |(joint, mean): (usize, &f64)| {
        let squares: f64 = rows.iter().map(|row| (row[joint] - mean).powi(2)).sum();
        (squares / (rows.len() - 1) as f64).sqrt()
    };
    mean.iter().enumerate().map(deviation).collect()
}
