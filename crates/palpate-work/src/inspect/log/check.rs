//! Checks a log while it is being learnt from, with the findings of `inspect`.
//!
//! The caller tracks the touches anyway, and passes every sample with its number of touched points. The samples so far
//! are checked after three touches, so that a misread log is reported before hours of work, then each time that there
//! are four times as many touches, and at the end. Beside a running robot, the touch in progress is checked as well.

use std::cmp::Reverse;
use std::collections::HashSet;
use std::sync::Arc;

use palpate::{Arm, ExternalTorqueConfig, Gravity, Robot, Sample};
use palpate_io::log::AngleUnit;

use super::joints::{Matching, miscounted};
use super::{AsLogged, Place, Read};
use crate::conventions::KnownConvention;
use crate::error::WorkError;
use crate::inspect::finding::{Finding, Level};
use crate::inspect::words::{counted, listed};
use crate::progress::Progress;
use crate::touches::{RecordedTouch, Touches};

/// Most frames that are kept for the check: 50 MB for seven joints. Later frames are not checked.
const MAX_FRAMES: usize = 250_000;
/// Number of touches after which they are checked for the first time.
const FIRST_TOUCHES: usize = 3;
/// Codes of findings about a whole touch.
const OF_WHOLE_TOUCHES: [&str; 4] = ["never_moves", "no_contact", "no_start", "drift"];
/// Codes of other findings that do not apply to a running robot: those about times and repeats of samples, since a mapper
/// that keeps up skips samples.
const NOT_LIVE: [&str; 3] = ["duplicate_frames", "gaps", "clock"];

/// Collects touches while they are tracked, and checks them.
pub struct LogCheck {
    arm: Arc<Arm>,
    place: Place,
    set: ExternalTorqueConfig,
    angle_unit: AngleUnit,
    strict: bool,
    touches: Vec<RecordedTouch>,
    /// Number of touched points in each frame of each touch, if the touches are tracked.
    contacts: Option<Vec<Vec<usize>>>,
    frames: usize,
    /// Number of touches after which they are checked next.
    next: usize,
    /// Number of touches of a running robot so far.
    live_touches: usize,
    /// Codes of the findings that were reported already.
    reported: HashSet<&'static str>,
}

impl LogCheck {
    /// A check of the touches of an arm; `place` is the lattice and the contact model, `set` the torque convention. If
    /// `strict`, [`Self::check`] returns an error if something looks wrong.
    pub fn new(
        arm: &Arc<Arm>,
        place: Place,
        set: &ExternalTorqueConfig,
        (angle_unit, strict): (AngleUnit, bool),
    ) -> Self {
        Self {
            arm: Arc::clone(arm),
            place,
            set: set.clone(),
            angle_unit,
            strict,
            touches: Vec::new(),
            contacts: Some(Vec::new()),
            frames: 0,
            next: FIRST_TOUCHES,
            live_touches: 0,
            reported: HashSet::new(),
        }
    }

    /// The same check, with codes of findings that were reported already.
    #[must_use]
    pub(crate) fn without_reported(mut self, reported: &HashSet<&'static str>) -> Self {
        self.reported.extend(reported);
        self
    }

    /// The same check with touches that were read and not tracked.
    #[must_use]
    pub fn of(mut self, touches: &[RecordedTouch]) -> Self {
        self.contacts = None;
        for touch in touches {
            let frames = touch.samples.len().min(MAX_FRAMES - self.frames);
            let samples = touch.samples[..frames].to_vec();
            let RecordedTouch { log, name, joint_names, .. } = touch.clone();
            self.touches.push(RecordedTouch { log, name, joint_names, samples });
            self.frames += frames;
        }
        self
    }

    /// Begins the touch that was read last; checks those before it, if a check is due.
    ///
    /// # Errors
    ///
    /// As [`Self::check`].
    pub fn begin(
        &mut self,
        name: &str,
        touches: &Touches,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        if self.touches.len() == self.next {
            self.next *= 4;
            let read = counted(self.touches.len(), "touch");
            let mut found = self.findings(progress)?;
            // Without gravity, the sign follows from work, of which a few touches may show too little.
            if self.set.gravity == Gravity::Removed {
                found.retain(|finding| finding.code != "torque_sign");
            }
            let log = format!("{} ({read} read so far)", self.log().trim_end_matches(','));
            self.warn(&found, &log, progress)?;
        }
        self.begin_touch(touches.begun(name));
        Ok(())
    }

    fn begin_touch(&mut self, touch: RecordedTouch) {
        self.touches.push(touch);
        self.contacts.get_or_insert_default().push(Vec::new());
    }

    /// Begins a touch of a running robot, with samples at rest. The touches before it are dropped if they have more
    /// than `most_frames` frames.
    pub fn begin_live(&mut self, start: &[Sample], most_frames: usize) {
        if self.frames > most_frames {
            (self.touches, self.contacts, self.frames) = (Vec::new(), None, 0);
        }
        self.live_touches += 1;
        let name = format!("touch {}", self.live_touches);
        self.begin_touch(RecordedTouch { name, ..RecordedTouch::default() });
        start.iter().for_each(|sample| self.add(sample, 0));
    }

    /// Checks the touches of a running robot, of which the last is in progress; returns a line for each kind of finding
    /// that was not reported yet.
    pub fn look_live(&mut self, progress: &dyn Progress) -> Vec<String> {
        let mut found = self.findings(progress).unwrap_or_default();
        let codes = OF_WHOLE_TOUCHES.iter().chain(&NOT_LIVE);
        found.retain(|finding| !codes.clone().any(|code| *code == finding.code));
        self.reported.extend(found.iter().map(|finding| finding.code));
        lines(&found, "the robot's log")
    }

    /// Adds a frame to the present touch, with its number of touched points.
    pub fn add(&mut self, sample: &Sample, contacts: usize) {
        let of_touch = self.contacts.as_mut().and_then(|all| all.last_mut());
        if let (Some(touch), Some(of_touch)) = (self.touches.last_mut(), of_touch)
            && self.frames < MAX_FRAMES
        {
            touch.samples.push(sample.clone());
            of_touch.push(contacts);
            self.frames += 1;
        }
    }

    /// Checks the touches so far, and warns of findings that were not reported yet.
    ///
    /// # Errors
    ///
    /// If something looks wrong and the check is `strict`, or the progress stops it.
    pub fn check(&mut self, progress: &dyn Progress) -> Result<(), WorkError> {
        let found = self.findings(progress)?;
        self.warn(&found, &self.log(), progress)
    }

    /// Warns of findings; `log` names the log in messages.
    fn warn(
        &mut self,
        found: &[Finding],
        log: &str,
        progress: &dyn Progress,
    ) -> Result<(), WorkError> {
        self.reported.extend(found.iter().map(|finding| finding.code));
        warn_of(found, log, self.strict, progress)
    }

    /// Warns of what may be the reason for an error in the present touch, of which the rest was not read.
    pub fn explain(mut self, progress: &dyn Progress) {
        self.strict = false;
        let mut found = self.findings(progress).unwrap_or_default();
        found.retain(|finding| !OF_WHOLE_TOUCHES.contains(&finding.code));
        let _ = self.warn(&found, &self.log(), progress);
    }

    /// What looks wrong and was not reported yet, errors first.
    fn findings(&self, progress: &dyn Progress) -> Result<Vec<Finding>, WorkError> {
        let with_frames = |touch: &RecordedTouch| !touch.samples.is_empty();
        let mut touches = self.touches.clone();
        touches.retain(with_frames);
        let mut contacts = self.contacts.clone();
        if let Some(contacts) = &mut contacts {
            contacts.retain(|touch| !touch.is_empty());
        }
        if touches.is_empty() {
            return Ok(Vec::new());
        }
        let robot = &self.arm.robot;
        if let Some(finding) = touches.iter().find_map(|touch| miscounted(touch, robot)) {
            return Ok(vec![finding]); // nothing that needs the robot can be checked
        }
        let matching = matching(&touches);
        let Self { arm, place, set, angle_unit, .. } = self;
        let given = KnownConvention::of(set);
        let (angle_unit, is_identified) = (Some(*angle_unit), set.identified);
        let read = Read { arm, place, set, given, angle_unit, matching, is_identified };
        let mut found = read.judge(&mut touches, contacts.as_deref(), progress)?.findings;
        found.retain(|one| one.level > Level::Note && !self.reported.contains(one.code));
        found.sort_by_key(|finding| Reverse(finding.level));
        Ok(found)
    }

    /// Name of the log in messages.
    fn log(&self) -> String {
        let mut logs: Vec<_> = self.touches.iter().map(|touch| &touch.log).collect();
        logs.dedup();
        let first = logs.first().map_or(String::new(), |log| log.display().to_string());
        match logs.len() {
            0 | 1 if first.is_empty() => "the log".to_owned(),
            0 | 1 => format!("`{first}`"),
            logs => format!("`{first}`, or a later one of {},", counted(logs, "log")),
        }
    }
}

/// The warnings and errors about touches for which no contacts are simulated, errors first. `set` is the torque
/// convention where it is not given.
pub(crate) fn looks_wrong_as_logged(
    touches: &mut [RecordedTouch],
    robot: &Robot,
    (set, given): (&ExternalTorqueConfig, KnownConvention),
    angle_unit: AngleUnit,
) -> Vec<Finding> {
    let as_they_are = (Some(angle_unit), matching(touches));
    let mut found = AsLogged::of(touches, robot, (set, given), as_they_are).findings;
    found.retain(|one| one.level > Level::Note);
    found.sort_by_key(|finding| Reverse(finding.level));
    found
}

fn matching(touches: &[RecordedTouch]) -> Matching {
    let named = touches.iter().all(|touch| touch.joint_names.is_some());
    if named { Matching::InOrder } else { Matching::Unnamed }
}

/// Warns of what looks wrong with a log.
///
/// # Errors
///
/// If `strict` and there are findings.
pub(crate) fn warn_of(
    found: &[Finding],
    log: &str,
    strict: bool,
    progress: &dyn Progress,
) -> Result<(), WorkError> {
    let lines = lines(found, log);
    let Some(worst) = lines.first() else { return Ok(()) };
    if strict {
        let more = match lines.len() - 1 {
            0 => String::new(),
            more => format!("; and {more} more"),
        };
        let advice = "(--strict; `palpate inspect` says more)";
        return Err(WorkError::LooksWrong(format!("{worst}{more} {advice}")));
    }
    lines.iter().for_each(|line| progress.warn(line));
    progress.note("`palpate inspect` says more; --strict makes that an error");
    Ok(())
}

/// A line for each kind of finding, with the other joints that show the same.
fn lines(found: &[Finding], log: &str) -> Vec<String> {
    let firsts = found
        .iter()
        .enumerate()
        .filter(|(at, one)| !found[..*at].iter().any(|before| before.code == one.code));
    let line = |(at, first): (usize, &Finding)| {
        let others = found[at + 1..].iter().filter(|other| other.code == first.code);
        let parts: Vec<&str> =
            others.flat_map(|other| other.parts.iter().map(String::as_str)).collect();
        let more = match parts.is_empty() {
            true => String::new(),
            false => format!("; likewise {}", listed(&parts)),
        };
        first.line(log) + &more
    };
    firsts.map(line).collect()
}
