//! `palpate compare`: whether touches contradict a field, and what has changed.

use std::path::PathBuf;

use palpate_io::field::{self, SavedField};
use palpate_learn::change::moved::{ObjectMotion, moved};
use palpate_learn::change::{Change, Comparison};
use palpate_work::change::{ComparisonReport, compare};

use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::interrupt;
use crate::output::{Output, figure, table};
use crate::predict::open_beside;
use crate::settings::RobotLogAndTouchSettings;

const NOTES: &str = "Examples:
  palpate compare field.npz recordings/today
  palpate compare field.npz today/ --moved moved.npz

A touch contradicts the field if it fits worse than the touches that `palpate map` held out to \
calibrate the field's bands. `contradiction` is its misfit divided by a limit that one in forty \
unchanged touches exceeds. Above 1, the change is the simplest one that explains most of the \
error: the object has moved (up to 6 cm over the ground, 2 cm up or down, and 17° about the \
vertical), or it is softer or harder. Otherwise it is another object, or changed in another way. \
The result is unknown if the field knows less than 10 % of what was touched, or less than 60 % \
and the touches contradict it but it predicts a part of their torque. If it knows less than 60 %, \
nothing contradicts it, and not every touch repeats a remembered one, the text is `no contradiction` \
in place of `unchanged`: this is no evidence that nothing has changed. Each touch is compared alone, and all of them together.

A touch that repeats the path of one in the field's memory, to within a cell, is compared with \
the torque measured then: it contradicts the field if the torques differ by more than a quarter. \
Make such touches if you can: other touches fit the field less well even if nothing has changed, \
so that fewer changes are detected. If the arm meets almost no torque any more, or misses the \
object, the result is `softer`.";

/// Flags of `palpate compare`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// The field that was learned before
    #[arg(value_name = "FIELD.npz")]
    field: PathBuf,
    /// Logs of the new touches
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Output file of the field, moved with the object; written only if the object has moved
    #[arg(long, value_name = "FILE.npz")]
    moved: Option<PathBuf>,
    /// Print the comparison as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotLogAndTouchSettings,
}

/// Compares touches of logs with a field.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    let mut places = FilePaths::read(&args.settings, &settings, &args.logs);
    places.input("the field", Some(&args.field));
    places.output("the moved field (--moved)", args.moved.as_deref())?;
    interrupt::listen();
    let saved = field::load(&args.field).map_err(CliError::file)?;
    let (touches, arm, touch) = open_beside(&saved, &args.logs, &mut settings, output)?;
    let report = compare(&arm, &saved, touch, touches, output)?;
    if let Some(path) = &args.moved {
        match report.together.change {
            Change::Moved(motion) if motion.is_at_search_bound() => output.note(
                "the motion that fits best is at the limit of the search, so no moved field is written",
            ),
            Change::Moved(motion) => {
                let moved = SavedField::of_field(moved(&saved.field, motion), &saved.robot);
                file_paths::save(path, &moved)?;
            }
            _ => output.note(
                "the touches together do not show that the object has moved, so no moved field is written",
            ),
        }
    }
    if args.json { output.json(&report) } else { output.result(&text(&report)) }
}

/// The report as text.
fn text(report: &ComparisonReport) -> String {
    let header =
        ["touch", "known", "contradiction", "error", "repeated", "scaled", "moved", "change"];
    let row = |name: &str, own: &Comparison, touches: usize| {
        let error = [own.error.field, own.error.repeated, own.error.scaled, own.error.moved];
        let [error, repeated, scaled, moved] = error.map(|error| figure(error, 2));
        let known = format!("{:.0} %", 100.0 * own.known);
        let contradiction = format!("{:.2}", own.contradiction);
        let change = change_in_words(own, touches);
        vec![name.to_owned(), known, contradiction, error, repeated, scaled, moved, change]
    };
    let mut rows: Vec<Vec<String>> =
        report.touches.iter().map(|touch| row(&touch.name, &touch.comparison, 1)).collect();
    if rows.len() > 1 {
        rows.push(row("together", &report.together, report.touches.len()));
    }
    format!(
        "Contradiction: above 1 the touches do not fit the field. Errors are relative to predicting zero; error: of \
         the field;\nrepeated: of the torque that a remembered touch measured along the same path; scaled: of the field's \
         torques times\nthe best factor; moved: of the field after the best motion.\n\n{}",
        table(&header, rows)
    )
}

/// What a number of touches show to have changed, in words. `Unchanged` has two texts: if the field knows little of what
/// was touched, the touches show only that they do not contradict it.
fn change_in_words(comparison: &Comparison, touches: usize) -> String {
    let place = comparison.place.map_or_else(String::new, |place| {
        let [x, y, z] = place.centre_m;
        format!(" within {:.0} cm of ({x:.2}, {y:.2}, {z:.2}) m", 100.0 * place.radius_m)
    });
    match comparison.change {
        Change::Unchanged if comparison.is_with_known(touches) => "unchanged".to_owned(),
        Change::Unchanged => {
            format!("no contradiction ({:.0} % known)", (100.0 * comparison.known).floor())
        }
        Change::Unknown => "unknown: the field knows too few of the touched cells".to_owned(),
        Change::Moved(motion) => {
            let ObjectMotion { shift_m: [x, y, z], turn_rad, .. } = motion;
            let least = if motion.is_at_search_bound() { "at least " } else { "" };
            let (shift, turn) = (100.0 * x.hypot(y), turn_rad.to_degrees());
            let [x, y, z] = [x, y, z].map(|own| 100.0 * own);
            format!("moved by {least}{shift:.1} cm ({x:.1}, {y:.1}, {z:.1}), turned by {turn:.0}°")
        }
        Change::Softer { factor } => format!("softer, {factor:.2} times{place}"),
        Change::Harder { factor } => format!("harder, {factor:.2} times{place}"),
        Change::Other => format!("another object, or changed in another way{place}"),
    }
}

#[cfg(test)]
mod tests {
    use palpate_learn::change::RelativeErrors;

    use super::*;

    #[test]
    fn a_touch_of_mostly_unknown_cells_is_not_called_unchanged() {
        let words = |known: f64, repeats: &[&str], touches: usize| {
            let comparison = Comparison {
                known,
                contradiction: 0.8,
                repeats: repeats.iter().map(|name| (*name).to_owned()).collect(),
                change: Change::Unchanged,
                error: RelativeErrors { field: None, scaled: None, moved: None, repeated: None },
                place: None,
            };
            change_in_words(&comparison, touches)
        };
        assert_eq!(words(0.131, &[], 1), "no contradiction (13 % known)");
        assert_eq!(words(0.131, &["#0 push"], 1), "unchanged");
        assert_eq!(words(0.541, &["#0 push"], 2), "no contradiction (54 % known)");
        assert_eq!(words(0.6, &[], 2), "unchanged");
    }
}
