//! Findings from the figures of the touches: contacts, starts, tares, noise, pushes, ends.

use palpate::unstable::{Joint, JointKind};
use palpate::{Gravity, MIN_TARE_FRAMES, Robot, Tare};
use palpate_learn::torque_errors::RELATIVE_FROM_N_M;

use super::super::finding::Finding;
use super::super::words::{counted, listed, number};
use super::figures::{NO_NOISE, TouchFacts};
use super::reading::ConventionFits;
use crate::quantile::median;

/// Figures of touches, and what is needed to judge them.
pub(super) struct JudgedFigures<'a> {
    pub robot: &'a Robot,
    pub touches: &'a [TouchFacts],
    pub tare: Tare,
    /// Whether the arm was identified, so that no tare is needed.
    pub is_identified: bool,
    /// How well the conventions explain the log; the figures are under the accepted one.
    pub fits: &'a ConventionFits,
}

/// Torque from which on a value is unusual at a joint: `torque`, N·m, or the share `part` of its
/// effort limit, if larger. For a prismatic joint, ten times `torque`, N.
fn unusual(joint: &Joint, torque: f64, part: f64) -> f64 {
    let torque = if joint.kind == JointKind::Prismatic { 10.0 * torque } else { torque };
    torque.max(part * joint.effort.unwrap_or(0.0))
}

/// Whether the arm moves in a touch and touches no point of the lattice. What the torques mean
/// cannot be determined then.
fn passes_by(touch: &TouchFacts) -> bool {
    touch.frames_in_contact == 0 && touch.still_frames < touch.frames
}

impl JudgedFigures<'_> {
    /// Everything that looks wrong. `nothing` is the message if no frame touches the lattice;
    /// `moves` is the box in which the last link moves, in words.
    pub(super) fn findings(&self, nothing: Option<String>, moves: Option<String>) -> Vec<Finding> {
        let mut findings = Vec::from_iter(self.no_contact(nothing, moves));
        findings.extend(self.no_start());
        findings.extend(self.moving_tare());
        findings.extend(self.never_moves());
        // With a misfit, offsets at rest come from gravity.
        if !self.fits.misfit() {
            findings.extend(self.bias());
            findings.extend(self.weak());
        }
        findings.extend(self.noiseless());
        findings.extend(self.noisy());
        findings.extend(self.drift());
        findings
    }

    /// The touches whose torques can be judged.
    fn judged(&self) -> impl Iterator<Item = &TouchFacts> {
        self.touches.iter().filter(|touch| !passes_by(touch))
    }

    /// A warning about the touches `shown`; `None` if there are none. The message is `what`,
    /// followed by their names.
    fn in_touches<'b>(
        &self,
        shown: impl Iterator<Item = &'b TouchFacts>,
        (code, what, remedy): (&'static str, &str, &str),
    ) -> Option<Finding> {
        let names: Vec<&str> = shown.map(|touch| touch.name.as_str()).collect();
        let these = match self.touches.len() {
            _ if names.is_empty() => return None,
            1 => format!("touch `{}`", names[0]),
            all if all == names.len() => format!("all {all} touches"),
            all => format!("{} of {}: {}", names.len(), counted(all, "touch"), listed(&names)),
        };
        Some(Finding::warning(code, format!("{what} {these}"), remedy).in_touches(&names))
    }

    /// A warning about those judged touches that meet a condition.
    fn shown(
        &self,
        shows: impl Fn(&TouchFacts) -> bool,
        texts: (&'static str, &str, &str),
    ) -> Option<Finding> {
        self.in_touches(self.judged().filter(|touch| shows(touch)), texts)
    }

    fn no_contact(&self, nothing: Option<String>, moves: Option<String>) -> Option<Finding> {
        let what = "the arm moves and touches no point of the lattice in";
        let moves = moves.map_or(String::new(), |moves| format!(": {moves}"));
        let remedy = format!(
            "put the box where the arm touches the object (--box-low-m and --box-high-m, or \
             --origin-m and --shape){moves}; or check the robot (--robot) and the unit of the \
             joints (--angle-unit)"
        );
        let passing = self.touches.iter().filter(|touch| passes_by(touch));
        let finding = self.in_touches(passing, ("no_contact", what, &remedy))?;
        Some(Finding { what: nothing.unwrap_or(finding.what), ..finding })
    }

    fn no_start(&self) -> Option<Finding> {
        let fewest = MIN_TARE_FRAMES as usize;
        let early = format!("the arm moves before {fewest} frames are over");
        let wants_start = self.tare == Tare::Auto && !self.is_identified;
        let shows = |touch: &TouchFacts| wants_start && touch.start_frames < fewest;
        if self.fits.accepted().gravity == Gravity::Removed {
            let what = format!(
                "no contact-free start ({early}): no tare is subtracted from the external torques in"
            );
            let remedy = "the sensors' bias is still in them; start the log earlier, with the arm still \
                          and without contact, and it is subtracted";
            return self.shown(shows, ("no_start", &what, remedy));
        }
        let what = format!("no contact-free start: {early}, in");
        let remedy = "start the log earlier, with the arm still and without contact; or use --tare-frames N \
                      to take the tare from the first N frames in any case, or --no-tare if the \
                      torques are external ones already; with --arm, from `palpate identify`, no such \
                      start is needed";
        self.shown(shows, ("no_start", &what, remedy)).map(Finding::refused)
    }

    /// Checks that the touches have the frames that are given for the tare, and that the arm stands
    /// still in them.
    fn moving_tare(&self) -> Option<Finding> {
        let Tare::Frames(wanted) = self.tare else { return None };
        let what = format!("fewer frames than --tare-frames {wanted} in");
        let too_long = ("tare_too_long", what.as_str(), "give a smaller --tare-frames");
        let wanted = wanted as usize;
        if let Some(finding) = self.shown(|touch| touch.frames < wanted, too_long) {
            return Some(finding.refused());
        }
        let what = format!("the arm moves within the {wanted} frames of --tare-frames in");
        let remedy = "contact torques in these frames count as bias; give a smaller number, or leave \
                      --tare-frames out, so that the contact-free start is found";
        self.shown(|touch| touch.still_frames < wanted, ("moving_tare", &what, remedy))
    }

    fn never_moves(&self) -> Option<Finding> {
        let what = "the arm never leaves its start in";
        let remedy = "nothing can be learnt from it; check the unit (--angle-unit), or leave the \
                      touch out";
        // A touch with a refused sample is known only up to there, so short ones are not judged.
        let shows = |touch: &TouchFacts| {
            touch.start_frames == touch.frames && touch.frames >= 2 * MIN_TARE_FRAMES as usize
        };
        self.shown(shows, ("never_moves", what, remedy))
    }

    /// Tares that are too large to be the bias of a sensor.
    fn bias(&self) -> Vec<Finding> {
        let of_joint = |(j, joint): (usize, &Joint)| {
            let least = unusual(joint, 1.0, 0.02);
            let off = |touch: &TouchFacts| touch.tare.as_ref().map_or(0.0, |tare| tare[j]);
            let offs = self.judged().map(off);
            let largest = offs.max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
            let shows = |touch: &TouchFacts| off(touch).abs() > least;
            let what = format!(
                "the torque of joint `{}` is off by up to {} N·m at rest, in",
                joint.name,
                number(largest)
            );
            let remedy = if self.judged().all(shows) {
                "the arm may carry something that is not in its URDF (--payload-link, \
                 --payload-mass-kg), or the sensor needs calibration; the tare corrects a payload only \
                 while the arm stays near the pose of the start"
            } else {
                "the arm may have been touching something when these touches began: the tare then \
                 removes that force; start farther away, or leave these touches out"
            };
            Some(self.shown(shows, ("bias", &what, remedy))?.at(&[&joint.name]))
        };
        self.robot.joints().iter().enumerate().filter_map(of_joint).collect()
    }

    /// Standard deviation of a joint's torque at rest, N·m, for each judged touch in which it is
    /// known.
    fn noise(&self, joint: usize) -> Vec<f64> {
        self.judged().filter_map(|touch| Some(touch.noise_std.as_ref()?[joint])).collect()
    }

    /// Whether a joint's torque has no noise in all touches in which its noise is known.
    fn is_silent(&self, joint: usize) -> bool {
        let silent: Vec<bool> =
            self.judged().filter_map(|touch| Some(touch.silent.as_ref()?[joint])).collect();
        let lives = self.judged().any(|touch| touch.peak_by_joint[joint] > NO_NOISE);
        lives && !silent.is_empty() && silent.iter().all(|silent| *silent)
    }

    fn noiseless(&self) -> Option<Finding> {
        let joints = self.robot.joints().iter().enumerate();
        let silent = joints.filter(|(j, _)| self.is_silent(*j));
        let silent: Vec<_> =
            silent.map(|(_, joint)| (joint.name.as_str(), joint.name.clone())).collect();
        let what = "the torques at rest have no noise at all";
        let remedy = "fine if the log is simulated; otherwise they are filtered, estimated or held, and \
                      lag behind the motion: log the values of the sensors themselves";
        Finding::of_parts("no_noise", &silent, what, remedy).map(Finding::noted)
    }

    fn noisy(&self) -> Option<Finding> {
        let joints = self.robot.joints().iter().enumerate();
        let loud = joints.filter_map(|(j, joint)| {
            let std = median(&self.noise(j)).filter(|std| *std > unusual(joint, 0.5, 0.01))?;
            Some((joint.name.as_str(), format!("{} {} N·m", joint.name, number(std))))
        });
        let what = "the torques at rest are noisy (standard deviation)";
        let remedy = "check brakes, controller and wiring, or raise --torque-std to this value; if it \
                      is drift, wait before the touch";
        Finding::of_parts("noise", &loud.collect::<Vec<_>>(), what, remedy)
    }

    fn weak(&self) -> Option<Finding> {
        let what = format!("the external torque stays below {RELATIVE_FROM_N_M} N·m in");
        let remedy = "the arm hardly touches anything; from this the field learns where there is no object, \
                      but not how stiff the object is; push farther";
        let shows = |touch: &TouchFacts| {
            touch.start_frames < touch.frames && touch.peak_external < RELATIVE_FROM_N_M
        };
        self.shown(shows, ("weak_touch", &what, remedy)).map(Finding::noted)
    }

    /// Torques that remain at the end although the arm is back where it began.
    fn drift(&self) -> Option<Finding> {
        let left = |touch: &TouchFacts| {
            touch.tare.as_ref()?; // without one, the torques need not begin at zero either
            let end = touch.end_external.as_ref()?;
            let joints = self.robot.joints().iter().zip(end);
            let off = joints.filter(|(joint, tau)| tau.abs() > unusual(joint, 0.3, 0.02));
            let most = off.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
            Some(format!("{}: {} by {} N·m", touch.name, most.0.name, number(*most.1)))
        };
        let places: Vec<String> = self.judged().filter_map(left).collect();
        let what = "torques do not come back to zero at the end although the arm is back where it \
                    began, in";
        let remedy = "the sensors drift (let them warm up, touch more briefly), or the object \
                      moved and still leans on the arm";
        let drift = self.shown(|touch| left(touch).is_some(), ("drift", what, remedy))?;
        Some(Finding { what: format!("{} ({})", drift.what, listed(&places)), ..drift })
    }
}
