//! `--viewer`: shows the session in the Rerun viewer, in a thread that does not delay the session.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use palpate::{Arm, Lattice};
use palpate_live::latest_queue::LatestQueue;
use palpate_live::view_feed::{ViewContent, ViewFrame, WAITING};
use palpate_view::{DrawnSample, Recording, SampleTorque, Scene, ViewError};

use crate::error::CliError;
use crate::hull::Hulls;
use crate::output::Output;
use crate::view::scene::{about, scene};
use crate::view::to::{failed, started};

/// Time between two checks whether the session has ended.
const LOOK: Duration = Duration::from_millis(100);
/// Longest time at the end for drawing the remaining frames.
const PATIENCE: Duration = Duration::from_secs(5);

/// A viewer and the thread that sends it the frames.
pub(super) struct Viewer {
    inbox: Arc<LatestQueue<ViewFrame>>,
    ending: Arc<AtomicBool>,
    thread: JoinHandle<Result<(), ViewError>>,
}

impl Viewer {
    /// Starts a viewer, or connects to the one at `url`.
    pub(super) fn start(
        url: Option<&str>,
        arm: &Arc<Arm>,
        lattice: &Lattice,
    ) -> Result<Self, CliError> {
        let url = url.map_or_else(started, |url| Ok(url.to_owned()))?;
        let hulls = Hulls::of(arm);
        let expected = "the torque predicted just before the sample was learnt";
        let about = about("A field is learnt from a running robot", arm, lattice, Some(expected));
        let mut scene = scene((arm, &hulls), lattice, "live".to_owned(), about);
        (scene.clock, scene.torques) = (true, true);
        let inbox = Arc::new(LatestQueue::new(WAITING));
        let ending = Arc::new(AtomicBool::new(false));
        let (connected, answer) = mpsc::sync_channel(1);
        let drawer = Drawer { arm: Arc::clone(arm), hulls, inbox: Arc::clone(&inbox) };
        let until = Arc::clone(&ending);
        let thread = thread::spawn(move || {
            let recording = match connect(&url, scene, &drawer) {
                Ok(recording) => recording,
                Err(error) => {
                    let _ = connected.send(Some(error)); // `answer` waits for it
                    return Ok(());
                }
            };
            let _ = connected.send(None);
            drawer.draw(recording, &until)
        });
        match answer.recv() {
            Ok(Some(error)) => Err(failed(error)),
            _ => Ok(Self { inbox, ending, thread }),
        }
    }

    /// The queue of frames to be drawn.
    pub(super) fn inbox(&self) -> Arc<LatestQueue<ViewFrame>> {
        Arc::clone(&self.inbox)
    }

    /// Waits until the remaining frames are drawn. If the viewer is gone, that is only noted.
    pub(super) fn end(self, output: &Output) {
        self.ending.store(true, Ordering::Relaxed);
        self.inbox.wake();
        let began = Instant::now();
        while !self.thread.is_finished() {
            if began.elapsed() >= PATIENCE {
                return output.note("the viewer no longer answers; the last samples are not shown");
            }
            thread::sleep(LOOK / 10);
        }
        if let Ok(Err(error)) = self.thread.join() {
            output.note(&error.to_string());
        }
        if self.inbox.dropped() > 0 {
            let dropped = self.inbox.dropped();
            output.note(&format!("the viewer was too slow: {dropped} updates are not shown"));
        }
    }
}

/// Connects to the viewer; its first view is of the arm with all joints at 0.
fn connect(url: &str, mut scene: Scene, drawer: &Drawer) -> Result<Recording<'static>, ViewError> {
    let at_zero = vec![0.0; drawer.arm.robot.n_joints()];
    scene.world_from_link = drawer.hulls.poses(&drawer.arm, &at_zero).unwrap_or_default();
    Recording::to_viewer(url, &scene)
}

/// Draws the frames of the session.
struct Drawer {
    arm: Arc<Arm>,
    hulls: Hulls,
    inbox: Arc<LatestQueue<ViewFrame>>,
}

impl Drawer {
    fn draw(&self, mut recording: Recording<'_>, until: &AtomicBool) -> Result<(), ViewError> {
        let mut touches = 0;
        loop {
            let ending = until.load(Ordering::Relaxed);
            match self.inbox.pop(LOOK) {
                Some(seen) => self.say(&mut recording, &seen, &mut touches)?,
                None if ending => return recording.finish(),
                None => {}
            }
        }
    }

    fn say(
        &self,
        recording: &mut Recording<'_>,
        seen: &ViewFrame,
        touches: &mut u32,
    ) -> Result<(), ViewError> {
        let (sample, time_s) = (seen.sample, Some(seen.since.as_secs_f64()));
        match &seen.what {
            ViewContent::Touch => {
                *touches += 1;
                recording.touch(&touches.to_string(), sample, time_s)
            }
            ViewContent::Arm { q, contacts, torques } => {
                // The mapper has already refused positions that do not fit the arm.
                let Ok(poses) = self.hulls.poses(&self.arm, q) else { return Ok(()) };
                let torque = torques.as_ref();
                let torque =
                    torque.map(|(measured, predicted)| SampleTorque { measured, predicted });
                let world_from_link = &poses;
                recording.frame(&DrawnSample { sample, time_s, world_from_link, contacts, torque })
            }
            ViewContent::Field(field) => recording.field(field, sample, time_s),
            ViewContent::Body((body, segments_m)) => {
                recording.body((body, segments_m), sample, time_s)
            }
        }
    }
}
