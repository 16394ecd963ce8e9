//! The logged samples of touches that are still remembered.
//!
//! A remembered frame takes megabytes, most of them contacts. The joint positions and torques that it
//! came from take a hundredth of that, and the same samples always have the same contacts. So a mapper
//! is saved with its sample log in place of its frames, and the frames are simulated again from it.
//! The log holds only touches of which a frame is remembered, and the one under way; it is bounded
//! by the same number of bytes as the memory.

use std::collections::HashSet;

use crate::estimator::FrameId;
use crate::tracker::Sample;

/// The samples of one touch, as logged.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LoggedTouch {
    /// Number of the touch, counted from the first touch of the mapper.
    pub touch: u32,
    /// Its name; empty if it has none.
    pub name: String,
    /// Whether the touch is still under way.
    pub open: bool,
    /// Whether its samples exceeded the limit of the log and were dropped.
    pub lost: bool,
    /// By sample, whether it was too close to the last learnt one to be learnt ([`crate::unstable::Downsampling`]);
    /// empty if no sample was.
    pub skipped: Vec<bool>,
    /// Joint positions, samples × n_joints, rad or m.
    pub q: Vec<f64>,
    /// Logged torques, samples × n_joints, N·m or N.
    pub tau: Vec<f64>,
    /// Standard deviations of the torques, samples × n_joints; [`NO_STD`] for a sample without, empty if no sample has
    /// any.
    pub tau_std: Vec<f64>,
}

/// Marks a sample without standard deviations.
pub const NO_STD: f64 = -1.0;

impl LoggedTouch {
    /// Its samples, of `n_joints` joints. Their times are not the logged ones, but such that the same samples are
    /// skipped: 50 ms from one learnt sample to the next.
    pub fn samples(&self, n_joints: usize) -> impl Iterator<Item = Sample> {
        let stds =
            self.tau_std.chunks(n_joints).map(|std| (std[0] != NO_STD).then(|| std.to_vec()));
        let stds = stds.chain(std::iter::repeat(None));
        let skipped = self.skipped.iter().copied().chain(std::iter::repeat(false));
        let times = skipped.scan(0.0, |time_s, skipped| {
            *time_s += if skipped { 0.0 } else { 0.05 };
            Some(Some(*time_s))
        });
        let joints = self.q.chunks(n_joints).zip(self.tau.chunks(n_joints));
        joints.zip(stds.zip(times)).map(|((q, tau), (tau_std, time_s))| Sample {
            tau_std,
            ..Sample::new(time_s, q.to_vec(), tau.to_vec())
        })
    }

    /// Whether its learnt samples are among the first ones, or all, of these, in the same order, from the first sample on:
    /// joint positions, rad or m, and logged torques, N·m or N, samples × `n_joints` each. Samples that are not learnt
    /// may have been passed over in one of the two. A touch without samples is no start.
    pub fn is_start_of(&self, q: &[f64], tau: &[f64], n_joints: usize) -> bool {
        let mut rows = q.chunks(n_joints).zip(tau.chunks(n_joints));
        let mut own = self.q.chunks(n_joints).zip(self.tau.chunks(n_joints));
        let starts = own.next().is_some_and(|first| rows.next() == Some(first));
        let skipped = self.skipped.iter().copied().chain(std::iter::repeat(false)).skip(1);
        let mut learnt = own.zip(skipped).filter_map(|(own, skipped)| (!skipped).then_some(own));
        starts && learnt.all(|own| rows.any(|row| row == own))
    }
}

/// The logged touches, the one under way last.
#[derive(Debug, Default)]
pub(super) struct SampleLog {
    touches: Vec<LoggedTouch>,
    /// Number of touches begun so far.
    begun: u32,
    /// Number of samples of the touch under way.
    samples: u32,
    /// Touches from which frames were learnt.
    learnt: HashSet<u32>,
    /// Number of learnt touches whose samples are gone.
    gone: u32,
}

impl SampleLog {
    /// The log of a resumed mapper with these touches, for samples of `n_joints` joints.
    pub(super) fn resume(
        touches: Vec<LoggedTouch>,
        (begun, gone): (u32, u32),
        remembered: impl Iterator<Item = FrameId>,
        n_joints: usize,
    ) -> Self {
        let under_way = touches.last().filter(|touch| touch.open);
        let samples = under_way.map_or(0, |touch| (touch.q.len() / n_joints) as u32);
        let learnt = remembered.map(|frame| frame.touch).collect();
        Self { touches, begun, samples, learnt, gone }
    }

    /// Names the touch under way.
    pub(super) fn name(&mut self, name: &str) {
        if let Some(touch) = self.touches.last_mut() {
            name.clone_into(&mut touch.name);
        }
    }

    /// Sets the number of the next touch.
    pub(super) fn number_next(&mut self, touch: u32) {
        self.begun = touch;
    }

    /// Notes that a frame is learnt.
    pub(super) fn learns(&mut self, frame: FrameId) {
        self.learnt.insert(frame.touch);
    }

    /// Number of touches begun so far.
    pub(super) fn begun(&self) -> u32 {
        self.begun
    }

    /// Number of samples of the touch under way.
    pub(super) fn samples(&self) -> u32 {
        self.samples
    }

    /// Number of learnt touches of which frames are remembered.
    pub(super) fn learnt(&self) -> u32 {
        self.learnt.len() as u32
    }

    /// Standard deviations of the torques of a logged sample, if it has them.
    pub(super) fn tau_std(&self, frame: FrameId, n_joints: usize) -> Option<&[f64]> {
        let touch = self.touches.iter().find(|logged| logged.touch == frame.touch)?;
        let std = touch.tau_std.chunks(n_joints).nth(frame.sample as usize)?;
        (std[0] != NO_STD).then_some(std)
    }

    /// Starts a touch; those of which no frame is remembered are dropped.
    pub(super) fn begin_touch(&mut self, remembered: &[FrameId]) {
        self.end_touch(remembered);
        let touch = LoggedTouch { touch: self.begun, open: true, ..LoggedTouch::default() };
        self.touches.push(touch);
        self.begun += 1;
        self.samples = 0;
    }

    /// Ends the touch under way; touches of which no frame is remembered are dropped.
    pub(super) fn end_touch(&mut self, remembered: &[FrameId]) {
        if let Some(touch) = self.touches.last_mut() {
            touch.open = false;
        }
        let needed = touches_of(remembered);
        self.touches.retain(|touch| {
            let keep = needed.contains(&touch.touch);
            // Lost touches are counted already.
            self.gone += u32::from(!keep && !touch.lost && self.learnt.contains(&touch.touch));
            keep
        });
        self.learnt.retain(|touch| needed.contains(touch));
    }

    /// Logs a sample of the touch under way and returns its identity.
    pub(super) fn record(&mut self, sample: &Sample, is_skipped: bool) -> FrameId {
        let touch = self.touches.last_mut().expect("the tracker refuses samples before a touch");
        if !touch.lost {
            if is_skipped || !touch.skipped.is_empty() {
                touch.skipped.resize(self.samples as usize, false);
                touch.skipped.push(is_skipped);
            }
            touch.q.extend_from_slice(&sample.q);
            if let Some(std) = &sample.tau_std {
                touch.tau_std.resize(touch.tau.len(), NO_STD);
                touch.tau_std.extend_from_slice(std);
            }
            touch.tau.extend_from_slice(&sample.tau);
            if !touch.tau_std.is_empty() {
                touch.tau_std.resize(touch.tau.len(), NO_STD);
            }
        }
        self.samples += 1;
        FrameId { touch: touch.touch, sample: self.samples - 1 }
    }

    /// An earlier touch whose samples are the first samples, or all, of the last touch, of `n_joints` joints.
    pub(super) fn repeated(&self, n_joints: usize) -> Option<&LoggedTouch> {
        let (last, earlier) = self.touches.split_last()?;
        earlier.iter().find(|touch| touch.is_start_of(&last.q, &last.tau, n_joints))
    }

    /// Drops the oldest touches until the log fits into `limit` bytes; returns those that were dropped.
    ///
    /// A touch under way that alone exceeds the limit loses its samples: its frames cannot be simulated again once the
    /// mapper is saved.
    pub(super) fn bound(&mut self, limit: usize) -> Vec<u32> {
        let mut dropped = Vec::new();
        while self.bytes() > limit {
            let oldest = &mut self.touches[0];
            if oldest.open {
                self.gone += u32::from(!oldest.lost);
                oldest.lost = true;
                (oldest.q, oldest.tau, oldest.tau_std) = Default::default();
                oldest.skipped = Vec::new();
            } else {
                self.gone += 1;
                dropped.push(self.touches.remove(0).touch);
            }
        }
        dropped
    }

    /// Bytes of the logged samples.
    pub(super) fn bytes(&self) -> usize {
        let numbers: usize = (self.touches.iter())
            .map(|touch| touch.q.len() + touch.tau.len() + touch.tau_std.len())
            .sum();
        numbers * size_of::<f64>()
    }

    /// Whether a touch exceeded the limit of the log, so that its frames cannot be simulated again.
    pub(super) fn is_lost(&self, touch: u32) -> bool {
        self.touches.iter().any(|logged| logged.touch == touch && logged.lost)
    }

    /// The touches of these remembered frames, from number `first` on, and the last one if it is still under way (a
    /// touch without a tare is over before it is ended); and the number of learnt touches whose samples are gone.
    pub(super) fn needed_by(
        &self,
        remembered: &[FrameId],
        (first, under_way): (u32, bool),
    ) -> (Vec<LoggedTouch>, u32) {
        let needed = touches_of(remembered);
        let is_open = |touch: &LoggedTouch| touch.open && under_way;
        let keep =
            |touch: &&LoggedTouch| !touch.lost && (is_open(touch) || needed.contains(&touch.touch));
        let kept = self.touches.iter().filter(|touch| touch.touch >= first).filter(keep);
        let kept =
            kept.map(|touch| LoggedTouch { open: is_open(touch), ..touch.clone() }).collect();
        let goes = |touch: &&LoggedTouch| {
            !keep(touch) && !touch.lost && self.learnt.contains(&touch.touch)
        };
        (kept, self.gone + self.touches.iter().filter(goes).count() as u32)
    }
}

/// The touches to which these frames belong.
fn touches_of(frames: &[FrameId]) -> HashSet<u32> {
    frames.iter().map(|frame| frame.touch).collect()
}
