//! The figures of one touch: its start, tare, noise, push, contacts and end.

use std::sync::Arc;

use nalgebra::DVector;
use palpate::unstable::{CellRows, LinkContacts, TrackedSample, Tracker, is_contact_free};
use palpate::{Arm, CellId, ExternalTorqueConfig, Lattice, MIN_TARE_FRAMES, Robot, Sample, Tare};
use palpate_learn::evaluation::MeanStd;
use rayon::prelude::*;
use serde::Serialize;

use super::Place;
use super::farthest;
use super::reading::ConventionFit;
use crate::contact_counts::{ContactCounts, point};
use crate::error::WorkError;
use crate::progress::{Bar, Progress};
use crate::quantile::{bounds, extremes, quantile};
use crate::settings::SettingsError;
use crate::touches::RecordedTouch;

/// Largest distance of a joint from its start at which the arm is back, rad or m.
const BACK: f64 = 0.05;
/// Fewest and most frames at the end whose mean torque is used.
const END_FRAMES: [usize; 2] = [5, 20];

/// Changes of torque from frame to frame below this count as none, N·m.
pub(super) const NO_NOISE: f64 = 1e-6;

/// Figures of one touch.
#[derive(Debug, Clone, Serialize)]
pub struct TouchFacts {
    /// Name of the touch.
    pub name: String,
    /// Number of frames.
    pub frames: usize,
    /// Duration by the log's clock, s.
    pub duration_s: Option<f64>,
    /// Number of frames from the first on in which the arm stands still, or touches no point.
    pub start_frames: usize,
    /// Number of frames from the first on in which the arm stands still.
    #[serde(skip)]
    pub(super) still_frames: usize,
    /// Number of frames in which the arm touches points of the lattice.
    pub frames_in_contact: u64,
    /// Mean torque of the tare frames minus gravity, N·m; `None` without tare frames.
    pub tare: Option<Vec<f64>>,
    /// Standard deviation of torque minus gravity over the start, N·m; `None` if the start is too short.
    pub noise_std: Option<Vec<f64>>,
    /// Whether the torque of each joint has no noise while the arm stands still; `None` if the start is too short.
    #[serde(skip)]
    pub(super) silent: Option<Vec<bool>>,
    /// Largest external torque after the start, norm over all joints, N·m.
    pub peak_external: f64,
    /// Largest |external torque| of each joint after the start, N·m.
    pub peak_by_joint: Vec<f64>,
    /// Lowest and highest position of each joint, rad or m.
    pub range: Vec<[f64; 2]>,
    /// Mean external torque at the end, N·m, if the arm is back where it began.
    pub end_external: Option<Vec<f64>>,
    /// Work that the external torque does on the arm from the end of the start to its peak, J.
    pub work_until_peak_j: f64,
}

/// Computes the figures of touches.
pub(super) struct Figures {
    tracker: Tracker,
    lattice: Lattice,
    /// The torque convention under which the log is read.
    read: ExternalTorqueConfig,
    tare: Tare,
    still_rad: f64,
}

/// In a long log, contacts are simulated in about this many frames, spread evenly over the motion while the arm touches
/// something; the frames between have the same contacts. The second constant is the largest motion of a joint between
/// two of them, rad or m.
const MAX_FRAMES: f64 = 5_000.0;
const LONGEST_STEP: f64 = 0.02;

/// Motion of a joint, rad or m, after which contacts are simulated again, so that this happens in [`MAX_FRAMES`]
/// frames or more; 0 for logs with fewer frames.
fn step(touches: &[RecordedTouch]) -> f64 {
    let pairs = || touches.iter().flat_map(|touch| touch.samples.windows(2));
    if (pairs().count() as f64) < MAX_FRAMES {
        return 0.0;
    }
    let way: f64 = pairs().map(|pair| farthest(&pair[0].q, &pair[1].q)).sum();
    (way / MAX_FRAMES).min(LONGEST_STEP)
}

/// A touch, tracked in the lattice.
#[derive(Default)]
struct TouchTrack {
    /// Number of frames from the first on in which the arm stands still, or touches no point.
    start_frames: usize,
    /// Logged torques in the sign of external torques, minus gravity, by frame, N·m.
    raw: Vec<Vec<f64>>,
    touched: ContactCounts,
    /// Cells touched after the tare.
    cells: Vec<CellId>,
}

impl Figures {
    /// For logs of an arm under a configuration, read under a convention.
    pub(super) fn new(
        arm: &Arc<Arm>,
        (lattice, contact): &Place,
        (set, fit): (&ExternalTorqueConfig, ConventionFit),
    ) -> Result<Self, SettingsError> {
        let (tare, still_rad) = (set.tare, set.still_rad);
        let mut set = set.clone();
        // Without a tare, touches without a contact-free start can be tracked as well.
        (set.torque_sign, set.gravity, set.tare) = (fit.torque_sign, fit.gravity, Tare::None);
        let read = set.clone();
        let tracker = Tracker::new(Arc::clone(arm), lattice.clone(), contact, set)
            .map_err(SettingsError::value)?;
        Ok(Self { tracker, lattice: lattice.clone(), read, tare, still_rad })
    }

    /// The figures of touches with the robot's joints, the counts of touched points over all of them, and the number of
    /// touched cells. If the number of touched points of each frame is known (`contacts`, by touch), contacts are not
    /// simulated and the number of cells is 0.
    ///
    /// # Errors
    ///
    /// If the progress stops it.
    pub(super) fn of_all(
        &self,
        touches: &[RecordedTouch],
        contacts: Option<&[Vec<usize>]>,
        progress: &dyn Progress,
    ) -> Result<(Vec<TouchFacts>, ContactCounts, usize), WorkError> {
        let frames = touches.iter().map(RecordedTouch::frames).sum::<usize>();
        // With known contacts it takes almost no time.
        let bar = match contacts {
            None => Some(progress.begin(Some(frames as u64), "frames", "inspecting")),
            Some(_) => None,
        };
        let step = step(touches);
        let follow = |(number, touch): (usize, &RecordedTouch)| {
            let known = contacts.map(|contacts| contacts[number].as_slice());
            let track = self.follow(touch, (known, step), (bar.as_deref(), progress))?;
            Ok((self.figures(touch, &track), track))
        };
        let found = touches.par_iter().enumerate().map(follow);
        let found = found.collect::<Result<Vec<_>, WorkError>>()?;
        let (mut touched, mut cells) = (ContactCounts::default(), self.no_cells());
        for (_, track) in &found {
            touched.join(&track.touched);
            for &cell in &track.cells {
                cells.row_of(cell);
            }
        }
        Ok((found.into_iter().map(|(facts, _)| facts).collect(), touched, cells.len()))
    }

    fn no_cells(&self) -> CellRows {
        CellRows::new(self.lattice.clone())
    }

    /// Tracks a touch as the mapper does; contacts are simulated again once a joint has moved by `step`, rad or m.
    fn follow(
        &self,
        touch: &RecordedTouch,
        (known, step): (Option<&[usize]>, f64),
        (bar, progress): (Option<&dyn Bar>, &dyn Progress),
    ) -> Result<TouchTrack, WorkError> {
        let mut tracker = self.tracker.clone();
        tracker.begin_touch();
        let (robot, start) = (&self.tracker.arm().robot, &touch.samples[0].q);
        let mut last: Option<(Vec<f64>, usize)> = None;
        // Number of points touched, the points if they were looked for, and the torque before the tare.
        let mut feed = |frame: usize, sample: &Sample| {
            let near = last.as_ref().filter(|(q, _)| farthest(q, &sample.q) < step);
            // Where nothing was touched, the next frame may be the first that touches something.
            let near = near.map(|(_, count)| *count).filter(|count| *count > 0);
            if let Some(count) = known.map(|contacts| contacts[frame]).or(near) {
                return Some((count, Vec::new(), self.untared(sample)?));
            }
            let TrackedSample { contacts, untared, .. } = tracker.feed(sample).ok()?;
            last = Some((sample.q.clone(), contacts.len()));
            Some((contacts.len(), contacts.links, untared))
        };
        let (mut track, mut started) = (TouchTrack::default(), false);
        let mut touched = self.no_cells();
        for (frame, sample) in touch.samples.iter().enumerate() {
            if progress.stopped() {
                return Err(WorkError::Interrupted { kept: String::new() });
            }
            let Some((contacts, links, untared)) = feed(frame, sample) else {
                // The mapper would refuse it.
                started = true;
                track.raw.push(sample.tau.clone());
                track.touched.add(0);
                continue;
            };
            let at = (start.as_slice(), sample.q.as_slice());
            started |= !is_contact_free(robot, at, self.still_rad, contacts > 0);
            track.start_frames += usize::from(!started);
            track.raw.push(untared.as_slice().to_vec());
            track.touched.add(contacts);
            let learnt = match self.tare {
                Tare::None => true,
                Tare::Auto => started,
                Tare::Frames(frames) => frame >= frames as usize,
            };
            if learnt {
                for &cell in links.iter().flat_map(|link: &LinkContacts| &link.cells) {
                    touched.row_of(cell);
                }
            }
            if let Some(bar) = bar {
                bar.step();
            }
        }
        track.cells = touched.cells().to_vec();
        Ok(track)
    }

    /// Torque of a sample in the sign of external torques, minus gravity, N·m; `None` if it is refused.
    fn untared(&self, sample: &Sample) -> Option<DVector<f64>> {
        let robot = &self.tracker.arm().robot;
        let poses = robot.forward(&sample.q).ok()?;
        self.read.untared(robot, &poses, &sample.tau).ok()
    }

    /// The figures of a touch.
    fn figures(&self, touch: &RecordedTouch, track: &TouchTrack) -> TouchFacts {
        let TouchTrack { start_frames, raw, touched, .. } = track;
        let start_frames = *start_frames;
        let tare_frames = match self.tare {
            Tare::None => 0,
            Tare::Auto if start_frames < MIN_TARE_FRAMES as usize => 0,
            Tare::Auto => start_frames,
            Tare::Frames(frames) => (frames as usize).min(touch.frames()),
        };
        let tare = (tare_frames > 0).then(|| super::mean(&raw[..tare_frames], Vec::as_slice));
        let without = |row: &Vec<f64>| match &tare {
            Some(tare) => row.iter().zip(tare).map(|(tau, tare)| tau - tare).collect(),
            None => row.clone(),
        };
        let external: Vec<Vec<f64>> = raw.iter().map(without).collect();
        let push = start_frames.max(tare_frames).min(touch.frames());
        let pushed = || external[push..].iter();
        let norms = pushed().map(|row| row.iter().map(|tau| tau * tau).sum::<f64>().sqrt());
        let peak = norms.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        let (at, peak_external) = peak.map_or((0, 0.0), |(at, peak)| (push + at, peak));
        let joints = 0..touch.n_joints();
        let at_joint = |joint: usize| pushed().map(|row| row[joint].abs()).fold(0.0, f64::max);
        let range = |joint: usize| extremes(touch.samples.iter().map(|sample| sample.q[joint]));
        let still_frames = touch.still_frames(self.still_rad);
        let noise = still_frames.min(start_frames) >= MIN_TARE_FRAMES as usize;
        let noise_at = |joint: usize| {
            MeanStd::of(raw[..start_frames].iter().map(|row| row[joint])).map_or(0.0, |m| m.std)
        };
        TouchFacts {
            name: touch.name.clone(),
            frames: touch.frames(),
            duration_s: extremes(touch.times_s()).map(|[first, last]| last - first),
            start_frames,
            still_frames,
            frames_in_contact: touched.frames_in_contact(),
            noise_std: noise.then(|| joints.clone().map(noise_at).collect()),
            silent: noise.then(|| silent(&raw[..still_frames], touch)),
            peak_external,
            peak_by_joint: joints.clone().map(at_joint).collect(),
            range: joints.map(|joint| range(joint).unwrap_or_default()).collect(),
            end_external: end(touch, push)
                .map(|first| super::mean(&external[first..], Vec::as_slice)),
            work_until_peak_j: work(touch, &external, push, at),
            tare,
        }
    }
}

/// The box in which the origin of the last link moves, m, in words.
pub(super) fn last_link_box(touches: &[RecordedTouch], robot: &Robot) -> Option<String> {
    let link = robot.joints().last()?.child.index();
    let samples = touches.iter().flat_map(|touch| &touch.samples);
    let poses = samples.filter_map(|sample| robot.forward(&sample.q).ok());
    let places = poses.map(|poses| poses.world_from_link[link].translation.vector.into());
    let [low_m, high_m] = bounds(&places.collect::<Vec<[f64; 3]>>())?.map(point);
    Some(format!("the origin of `{}` moves within {low_m} .. {high_m} m", robot.links()[link].name))
}

/// Index of the first of the frames at the end, at most `END_FRAMES[1]`, in which the arm is back at its start; `None`
/// if they are too few, or the arm never left.
fn end(touch: &RecordedTouch, push: usize) -> Option<usize> {
    let start = touch.samples.first()?;
    let [fewest, most] = END_FRAMES;
    let late = touch.samples[push..].iter().rev();
    let back = late.take_while(|sample| farthest(&sample.q, &start.q) <= BACK).count();
    let frames = back.min(most);
    (frames >= fewest && push + back < touch.frames()).then(|| touch.frames() - frames)
}

/// `Σ τ·Δq` between two frames: the work of the external torque on the arm, J.
fn work(touch: &RecordedTouch, external: &[Vec<f64>], from: usize, to: usize) -> f64 {
    let power = |row: usize| {
        let [before, now] = [row - 1, row].map(|row| &touch.samples[row].q);
        let joints = now.iter().zip(before).zip(&external[row]);
        joints.map(|((now, before), tau)| tau * (now - before)).sum::<f64>()
    };
    (from.max(1)..=to).filter(|row| *row < touch.frames()).map(power).sum()
}

/// For each joint, whether at least 80 % of the frames have the torque of the frame before, with or without gravity.
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
