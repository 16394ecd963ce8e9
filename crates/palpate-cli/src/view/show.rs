//! The command: decides what is shown, and where.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::{Arm, ContactConfig, Lattice, Mapper, Predictor};
use palpate_io::field::{self, SavedField};
use palpate_view::{DrawnSample, Recording, Scene};
use palpate_work::robot;
use palpate_work::touches::Touches;
use serde_json::json;

use crate::error::CliError;
use crate::file_paths::{self, FilePaths, last_part};
use crate::hull::Hulls;
use crate::output::Output;
use crate::settings::{Settings, SettingsError};
use crate::{interrupt, logs};

use super::args::Args;
use super::play::{Follower, Played, Player};
use super::scene::{about, scene};
use super::to::{To, failed};

/// The field and the logs among the arguments.
struct Named<'a> {
    field: Option<&'a Path>,
    logs: Vec<PathBuf>,
}

impl<'a> Named<'a> {
    /// Fields end in .npz, as everywhere; all else are logs.
    fn of(what: &'a [PathBuf]) -> Result<Self, CliError> {
        let is_field = |path: &&PathBuf| {
            path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npz"))
        };
        let (fields, logs): (Vec<_>, Vec<_>) = what.iter().partition(is_field);
        if let [one, other, ..] = fields[..] {
            return Err(CliError::Usage(format!(
                "`{}` and `{}` are both fields, and one is shown at a time; leave out one",
                one.display(),
                other.display()
            )));
        }
        Ok(Self {
            field: fields.first().map(|path| path.as_path()),
            logs: logs.into_iter().cloned().collect(),
        })
    }
}

impl Args {
    /// Refuses an output that cannot be written, or is one of the inputs.
    fn check_places(&self, named: &Named<'_>, settings: &Settings) -> Result<(), CliError> {
        let Some(path) = &self.save else { return Ok(()) };
        let mut places = FilePaths::read(&self.settings, settings, &named.logs);
        places.input("the field", named.field);
        places.output("the recording (--save)", Some(path))?;
        file_paths::format_of(path, "recording", &[("rrd", ())])
    }
}

/// Shows a field, logs, or both.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let named = Named::of(&args.what)?;
    if let (Some(field), Some(setting)) = (named.field, args.settings.of_learning()) {
        return Err(CliError::Usage(format!(
            "{setting} settings are for learning, but the field `{}` has its own; leave them \
             out, or leave out the field to learn a new one",
            field.display()
        )));
    }
    let mut settings = match named.field {
        Some(_) => args.settings.load()?,
        None => args.settings.load_without_body()?,
    };
    if named.field.is_none() {
        settings.config()?;
    }
    args.check_places(&named, &settings)?;
    interrupt::listen();
    let saved = named.field.map(field::load).transpose().map_err(CliError::file)?;
    let (touches, arm) =
        logs::open(&named.logs, &mut settings, logs::IfUndecided::LeaveOpen, output)?;
    if let Some(saved) = &saved {
        robot::warn_of_other_robot((&saved.robot, saved.snapshot.as_ref()), &arm, output);
    }
    let to = To::of(args)?;
    let touches = (!named.logs.is_empty()).then_some(touches);
    let stage = Stage { args, named: &named, settings: &settings, arm: &arm, saved, output };
    let (place, played) = match (touches, &stage.saved) {
        (Some(touches), _) => stage.play(touches, to)?,
        (None, Some(saved)) => (stage.show_field(saved, to)?, None),
        (None, None) => unreachable!("clap asks for a field or a log"),
    };
    stage.print_result(&place, played.as_ref())
}

/// Everything that is known before anything is shown.
struct Stage<'a> {
    args: &'a Args,
    named: &'a Named<'a>,
    settings: &'a Settings,
    arm: &'a Arc<Arm>,
    saved: Option<SavedField>,
    output: &'a Output,
}

impl Stage<'_> {
    /// Plays logs; returns where the recording is, and what was played.
    fn play(&self, touches: Touches, to: To) -> Result<(String, Option<Played>), CliError> {
        let (follower, place) = self.follower()?;
        let lattice = place.0.clone();
        let touches = touches.for_arm(self.arm, &self.settings.log, lattice.clone())?;
        let mut player = Player::new(follower, touches)?;
        let hulls = Hulls::of(self.arm);
        let mut scene = self.scene(&hulls, &lattice);
        (scene.clock, scene.torques) = (player.timed, true);
        // Joint positions that do not fit the arm are an error when the sample is processed.
        let first = player.first_q().and_then(|q| hulls.poses(self.arm, q).ok());
        scene.world_from_link = first.unwrap_or_default();
        logs::note_robot(self.arm, self.settings, self.output);
        let (place, played) = to.record(&scene, |recording| {
            if let Some(saved) = &self.saved {
                recording.field(&saved.field, 0, scene.clock.then_some(0.0)).map_err(failed)?;
            }
            player.play(recording, (self.arm, &hulls), self.args, self.output)
        })?;
        player.touches.report_warnings(self.output);
        Ok((place, Some(played)))
    }

    /// What predicts the torques, the field or a new mapper; and its lattice and contact model.
    fn follower(&self) -> Result<(Follower, (Lattice, ContactConfig)), CliError> {
        let arm = Arc::clone(self.arm);
        match &self.saved {
            Some(SavedField { field, .. }) => {
                let touch = self.settings.torque_convention_for_field(&field.touch)?;
                let predictor = Predictor::new(arm, field, touch).map_err(SettingsError::value)?;
                let place = (field.lattice.clone(), field.contact.clone());
                Ok((Follower::Predictor(Box::new(predictor)), place))
            }
            None => {
                let config = self.settings.config()?;
                let mapper = Mapper::new(arm, config.clone()).map_err(SettingsError::value)?;
                Ok((Follower::Mapper(Box::new(mapper)), (config.lattice, config.contact)))
            }
        }
    }

    /// Shows a field alone; returns where the recording is.
    fn show_field(&self, saved: &SavedField, to: To) -> Result<String, CliError> {
        let hulls = Hulls::of(self.arm);
        let mut scene = self.scene(&hulls, &saved.field.lattice);
        let n_joints = self.arm.robot.n_joints();
        let last = saved.snapshot.as_ref().and_then(|snapshot| snapshot.sample_log.last());
        let last = last.and_then(|touch| touch.q.rchunks_exact(n_joints).next());
        if last.is_none() {
            self.output.note("the field remembers no touch: the arm is shown with all joints at 0");
        }
        let q = last.map_or(vec![0.0; n_joints], <[f64]>::to_vec);
        let poses = hulls.poses(self.arm, &q).map_err(CliError::file)?;
        scene.world_from_link.clone_from(&poses);
        let show = |recording: &mut Recording<'_>| {
            let contacts = palpate::Contacts::default();
            let (sample, time_s, torque) = (0, None, None);
            let world_from_link = &poses;
            let frame =
                DrawnSample { sample, time_s, world_from_link, contacts: &contacts, torque };
            recording.frame(&frame)?;
            if let Some(model) = &saved.field.elastic {
                let body = model.equilibrium(self.arm);
                recording.body((body.body(), &body.segments_m()), 0, None)?;
            }
            recording.field(&saved.field, 0, None)
        };
        Ok(to.record(&scene, |recording| show(recording).map_err(failed))?.0)
    }

    /// The arm and the text of the recording, without clock and torques.
    fn scene(&self, hulls: &Hulls, lattice: &Lattice) -> Scene {
        let name = self.args.what.iter().map(|path| last_part(path)).collect::<Vec<_>>().join(", ");
        scene((self.arm, hulls), lattice, name, self.about(lattice))
    }

    /// The explanation of the recording, in Markdown.
    fn about(&self, lattice: &Lattice) -> String {
        let logs: Vec<String> =
            self.named.logs.iter().map(|log| format!("`{}`", last_part(log))).collect();
        let logs = logs.join(", ");
        let (shown, expected) = match (self.named.field, self.named.logs.is_empty()) {
            (Some(field), true) => (format!("The field `{}`", last_part(field)), None),
            (Some(field), false) => (
                format!("The field `{}` predicts {logs}", last_part(field)),
                Some("the torque that the field predicts"),
            ),
            (None, _) => (
                format!("A field is learnt from {logs}"),
                Some("the torque predicted just before the sample was learnt"),
            ),
        };
        about(&shown, self.arm, lattice, expected)
    }

    /// Prints where the recording is, and what was played.
    fn print_result(&self, place: &str, played: Option<&Played>) -> Result<(), CliError> {
        let args = self.args;
        if args.json {
            let viewer = args.save.is_none().then_some(place);
            let summary = json!({ "recording": args.save, "viewer": viewer, "played": played });
            return self.output.json(&summary);
        }
        let mut text = match &args.save {
            Some(path) => format!("The recording is in `{}`.\n", path.display()),
            None => format!("It is in the viewer at {place}.\n"),
        };
        text += &played.map(Played::text).unwrap_or_default();
        if let Some(path) = &args.save {
            text += &format!("Next: rerun {}\n", path.display());
        }
        self.output.result(&text)
    }
}
